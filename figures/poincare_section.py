"""Sections phi1 = 0, rising: a chaotic stick-slip motion and frictionless ones.

Into poincare_section.png. With friction one set attracts every start; without it each
start keeps its own curve: nothing attracts.
"""

from pathlib import Path

import jax
import matplotlib.pyplot as plt
import numpy as np

import ziegler_jax as zj

Q, TAU_S, TAU_K = 3.9, 0.226, 0.0565
Q_FREE, KICKS = 2.0, np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])


def chaotic(kick):
    load = zj.ConstantLoad(1.0)
    friction = zj.SetValuedCoulomb(TAU_S, TAU_K, pin_radius=1.0, load=load)
    start = zj.State(omega=(0.0, kick))
    column = zj.uniform_rods(Q, friction=friction)
    return zj.poincare(
        column, start, points=1000, method=zj.Method(rtol=1e-8, atol=1e-8)
    )


def free(kick):
    start = zj.State(omega=(0.0, kick))
    column = zj.uniform_rods(Q_FREE)
    return zj.poincare(column, start, points=400, transient=0.0, escape=100.0)


def main():
    jax.config.update("jax_enable_x64", True)
    figure, axes = plt.subplots(1, 2, figsize=(8.3, 4.1), layout="constrained")
    figure.suptitle(
        r"Passages of the section $\varphi_1 = 0$, $\dot\varphi_1 > 0$", fontsize=11
    )
    found = jax.jit(jax.vmap(chaotic))(np.array([0.3, 0.4, 0.5, 0.6]))
    axes[0].plot(
        np.ravel(found.phi[..., 1]), np.ravel(found.omega[..., 1]), "k.", ms=1.2
    )
    axes[0].set_title(
        rf"chaotic: $q = {Q}$, $\tau_s = {TAU_S}\,k$, $\tau_k = {TAU_K}\,k$",
        fontsize=10,
    )
    found = jax.jit(jax.vmap(free))(KICKS)
    colours = plt.colormaps["viridis"](np.linspace(0, 0.9, KICKS.size))
    for phi, omega, kick, colour in zip(
        found.phi, found.omega, KICKS, colours, strict=True
    ):
        axes[1].plot(phi[:, 1], omega[:, 1], ".", ms=2, color=colour, label=f"{kick:g}")
    axes[1].set_title(f"no friction, $q = {Q_FREE}$: a curve each kick", fontsize=10)
    axes[0].set_xticks([-0.110, -0.105, -0.100])
    axes[1].legend(
        title="kick\n($\\sqrt{k/(m l^2)}$)",
        markerscale=4,
        loc="center left",
        bbox_to_anchor=(1, 0.5),
    )
    for ax in axes:
        ax.set(
            xlabel=r"angle $\varphi_2$ (rad)",
            ylabel=r"rate $\dot\varphi_2$ (rad $\sqrt{k/(m l^2)}$)",
        )
    axes[0].figure.savefig(Path(__file__).with_suffix(".png"), dpi=200)


if __name__ == "__main__":
    main()
