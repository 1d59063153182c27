"""Ziegler's paradox: damping however small lowers q_cr, by the ratio c1/c2 alone."""

import colours
import jax
import matplotlib.pyplot as plt
import numpy as np
import style

import ziegler_jax as zj


def main():
    c = np.geomspace(1e-6, 1.5, 400)
    figure, axes = plt.subplots(1, 2, figsize=(10.5, 4.4))
    columns = (
        (style.SEED, lambda **parts: zj.uniform_rods(**parts)),
        (style.ZIEGLER, lambda **parts: zj.point_masses(2, 1, **parts)),
    )
    lines = (
        (0.3, colours.GREEN, "-."),
        (1.0, colours.BLUE, "-"),
        (4.0, colours.PURPLE, "--"),
        (20.0, colours.VERMILLION, ":"),
    )
    for ax, (name, make) in zip(axes, columns, strict=True):
        undamped = float(zj.critical_load(make()).q_cr)
        for ratio, colour, dash in lines:
            q = jax.vmap(
                lambda c, make=make, ratio=ratio: (
                    zj.critical_load(make(damping=zj.Viscous(ratio * c, c))).q_cr
                )
            )(c)
            ax.semilogx(c, q, dash, color=colour, lw=2.5, label=f"{ratio:g}")
        ax.axhline(undamped, color="0.6", lw=1)
        ax.plot(6e-7, undamped, "D", color="k", ms=8, clip_on=False, zorder=3)
        ax.annotate(
            f"undamped: {undamped:.4f}",
            (6e-7, undamped),
            (12, 7),
            textcoords="offset points",
        )
        ax.set_xlim(6e-7, 1.5)
        ax.set_ylim(0.7, 3.2)
        ax.set_xlabel(r"damping $c_2$ ($\sqrt{kml^2}$), ratio $c_1/c_2$ fixed")
        ax.set_title(name, loc="left")
        ax.spines[["top", "right"]].set_visible(False)
    axes[0].set_ylabel("critical load $q_{cr}$")
    axes[1].legend(title="$c_1/c_2$", loc="upper left", bbox_to_anchor=(1.0, 1.0))
    figure.tight_layout()
    style.save(figure, __file__)


if __name__ == "__main__":
    main()
