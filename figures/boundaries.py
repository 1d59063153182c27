"""Where flutter begins under equal friction in both joints, and where nothing is known.

Coarse cells of the main job's map at mu_s = mu_k, and its boundaries as `refine`
follows them: between rest and cycles to 1e-6 of the range, those of what is undecided
to 1e-3, its border at high loads being no line.
"""

import matplotlib.pyplot as plt
import numpy as np
import style

import ziegler_jax as zj
from ziegler_jax.__main__ import KICK, MU_RANGE, PIN_RADIUS, Q_RANGE, point

STUCK, CYCLE = zj.CODE.stuck, zj.CODE.cycle
KINDS = {  # colour and text of a boundary, by its labels
    (STUCK, CYCLE): ("#D55E00", "stuck to a cycle"),
    (zj.CODE.unsettled, STUCK): ("#0072B2", "stuck to unsettled"),
    (zj.CODE.unsettled, CYCLE): ("#000000", "unsettled to a cycle"),
}


def section(q, mu):
    return point(q, mu, mu)


def main():
    axes = {"q": np.linspace(*Q_RANGE, 33), "mu": np.linspace(*MU_RANGE, 33)}
    coarse = zj.sweep(section, **axes)
    ds = zj.refine(section, coarse, width=1e-6, levels=3)
    print({n: v for n, v in ds.attrs.items() if n.startswith("refine")})
    figure, ax = plt.subplots(figsize=(7.5, 4.6), layout="constrained")
    cells = ds.sel(joint=2).drop_vars("boundary_line")  # lines of our own colours
    zj.plot.map(cells, "joint_amplitude", x="q", y="mu", ax=ax, cmap="Greys", vmax=3)
    cells_legend = ax.get_legend().legend_handles
    labels = np.sort(ds.boundary_outcome.values, axis=1)
    for pair, (colour, text) in KINDS.items():
        mine = (labels == pair).all(axis=1)
        for line in np.unique(ds.boundary_line.values[mine]):
            at = ds.boundary_line.values == line
            xy = ds.boundary_q.values[at], ds.boundary_mu.values[at]
            ax.plot(*xy, color=colour, lw=1.2, label=text)
            text = None
    ax.set_ylabel(r"friction coefficients $\mu_s = \mu_k$ (–)")
    lines = [line for line in ax.lines if not line.get_label().startswith("_")]
    ax.get_legend().remove()
    figure.legend(handles=[*lines, *cells_legend], loc="outside upper left", ncols=3)
    ax.set_title(
        rf"Uniform rods, pins of {PIN_RADIUS} l, kick $\dot\varphi_2(0)$ = {KICK[1]} "
        r"$\sqrt{k/(m l^2)}$",
        loc="left",
        fontsize=11,
    )
    style.save(figure, __file__)


if __name__ == "__main__":
    main()
