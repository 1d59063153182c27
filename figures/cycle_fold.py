"""Where rest and flutter coexist, and the cycles that meet at the fold between them."""

import functools

import jax
import jax.numpy as jnp
import linear_style as style
import matplotlib.pyplot as plt
import numpy as np

import ziegler_jax as zj

TAU, START = 0.1, 1.95


def column(q, tau):  # constant torque in both joints, mu_s = mu_k
    load = zj.ConstantLoad(1.0)
    return zj.uniform_rods(
        q, friction=zj.SetValuedCoulomb(tau, pin_radius=1.0, load=load)
    )


def kicked(tau):
    return zj.settle(column(START, tau), zj.State(omega=(0.0, 3.0))).final


@jax.jit
@jax.vmap
def folds(tau):
    return zj.cycle_fold(lambda q: column(q, tau), kicked(tau), START)


@functools.partial(jax.jit, static_argnames="direction")
def branch(tau, direction):
    return zj.continue_cycle(
        lambda q: column(q, tau), kicked(tau), START, direction=direction, points=45
    )


def main():
    figure, axes = plt.subplots(1, 3, figsize=(14, 4.6))
    left, middle, right = axes
    tau = np.linspace(0.01, 0.1, 10)  # above, another fold comes first from START
    found = folds(jnp.asarray(tau))
    q_fold = np.asarray(found.value)
    tau, q_fold = tau[np.isfinite(q_fold)], q_fold[np.isfinite(q_fold)]
    q_cr = float(zj.critical_load(zj.uniform_rods()).q)
    left.fill_betweenx(tau, q_fold, 3, color="#FBE6D0", lw=0)
    left.plot(q_fold, tau, color=style.BLUE, lw=2.5)
    left.axvline(q_cr, color=style.ORANGE, lw=2, ls="--")
    left.text(1.02, 0.075, "no cycle\non this\nbranch", fontsize=11)
    left.text(1.95, 0.06, "rest\nand flutter")
    left.text(q_cr + 0.03, 0.008, "$q_{cr}$, no friction", rotation=90, fontsize=12)
    left.text(1.52, 0.035, "fold of cycles", color=style.BLUE, fontsize=12)
    left.set(xlim=(1.0, 3), ylim=(0, 0.1), ylabel=r"friction torque $\tau$ ($k$)")
    back, on = branch(TAU, -1), branch(TAU, 1)
    for b in (back, on):
        p, stable = b.points, np.asarray(b.points.stable)
        q, size = np.asarray(p.parameter), np.asarray(p.amplitude.joint[:, 1])
        mu = np.abs(np.asarray(p.multipliers))
        known = np.isfinite(q)
        for mask, dash in ((known & stable, "-"), (known & ~stable, "--")):
            grown = mask | np.roll(mask & (np.arange(len(q)) < len(q) - 1), 1) & known
            middle.plot(
                np.where(grown, q, np.nan), size, dash, color=style.BLUE, lw=2.5
            )
            right.plot(
                np.where(grown, q, np.nan), mu[:, 1], dash, color=style.BLUE, lw=2.5
            )
            right.plot(
                np.where(grown, q, np.nan), mu[:, 2], dash, color=style.GREEN, lw=2
            )
    middle.set_ylabel(r"largest $|\varphi_2 - \varphi_1|$ (rad)")
    right.axhline(1, color="0.6", lw=1)
    right.set_ylabel(r"Floquet multipliers $|\mu|$ beside 1 and 0")
    right.set_ylim(0, 2.5)
    for ax in axes:
        ax.set_xlabel("load $q = Fl/k$")
        ax.spines[["top", "right"]].set_visible(False)
    left.set_title("set-valued friction, $\\mu_s = \\mu_k$", loc="left")
    for ax in (middle, right):
        ax.set_title(rf"$\tau$ = {TAU}: stable —, unstable - -", loc="left")
    for ax in (middle, right):
        ax.set_xlim(1.5, 2.7)
    figure.tight_layout()
    style.save(figure, __file__)


if __name__ == "__main__":
    main()
