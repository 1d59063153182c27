"""The critical kick by its direction: rates of the two rods at the start."""

import colours
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import style

import ziegler_jax as zj

TAU = 0.02


def point(q, angle):
    kick = zj.State(omega=(jnp.cos(angle), jnp.sin(angle)))
    return zj.critical_kick(
        style.dry(q, TAU), kick, (0.0, 3.0), search=zj.Search(scan=16)
    )


def main():
    angle = np.linspace(0, np.pi, 240, endpoint=False)
    ds = zj.sweep(point, q=[1.6, 1.9, 2.3], angle=angle)
    print(np.unique(ds.outcome, return_counts=True), ds.attrs["run_seconds"])
    figure, ax = plt.subplots(figsize=(6.6, 6), subplot_kw={"projection": "polar"})
    looks = (colours.BLUE, "-"), (colours.GREEN, "--"), (colours.VERMILLION, ":")
    around = np.append(np.concatenate([angle, angle + np.pi]), 0.0)
    for q, (colour, line) in zip(ds.q.values, looks, strict=True):
        kick = ds.threshold.sel(q=q).values
        # the column is symmetric: the opposite kick has the same threshold
        closed = np.append(np.tile(kick, 2), kick[0])
        ax.plot(around, closed, line, color=colour, lw=2, label=f"{q:g}")
    ax.set_xticks(np.arange(4) * np.pi / 2)
    ax.set_xticklabels(
        [
            r"$\dot\varphi_1$",
            r"$\dot\varphi_2$",
            r"$-\dot\varphi_1$",
            r"$-\dot\varphi_2$",
        ]
    )
    ax.set_rlabel_position(22)
    ax.legend(title="load $q$", loc="upper left", bbox_to_anchor=(1.02, 1.0))
    ax.set_rscale("log")
    ax.set_rlim(0.02, 3.0)
    ax.set_rticks([0.1, 1.0], ["0.1", "1"])
    title = (
        "Critical kick by its direction: rest inside, flutter outside;\n"
        r"dry friction $\tau$ = 0.02 $k$ in both joints, rates in $\sqrt{k/(ml^2)}$"
        ", logarithmic"
    )
    ax.set_title(title, pad=18, fontsize=11)
    style.save(figure, __file__)


if __name__ == "__main__":
    main()
