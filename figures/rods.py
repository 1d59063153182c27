"""From Ziegler to Beck: where 2 to 6 rods flutter, over load and joint friction."""

import matplotlib.pyplot as plt
import numpy as np
import style

import ziegler_jax as zj

WINDOWS = zj.Windows(transient=20.0, length=8.0, max_windows=20)
TITLE = "Beck's column in rods, smoothed friction in each joint, after a small kick"


def point_of(n):
    def point(q, tau):
        load, start = zj.ConstantLoad(1.0), zj.State(omega=(0.0,) * (n - 1) + (0.5,))
        law = zj.SmoothCoulomb(tau, pin_radius=1.0, v_smooth=0.1, load=load)
        return zj.settle(zj.beck(n, q, friction=law), start, windows=WINDOWS)

    return point


def main():
    shared = {"sharex": True, "sharey": True, "layout": "constrained"}
    figure, axes = plt.subplots(1, 5, figsize=(10.5, 4.2), **shared)
    how = {"x": "tau", "y": "q", "vmin": 0, "vmax": 2, "colorbar": False}
    grid = {"q": np.linspace(5, 20, 31), "tau": np.linspace(0.01, 0.17, 17)}
    legend = {}
    for n, ax in zip(range(2, 7), axes, strict=True):
        tip = zj.sweep(point_of(n), **grid).isel(rod=-1)
        zj.plot.map(tip, "rod_amplitude", ax=ax, **how)
        own = ax.get_legend()
        names = [text.get_text() for text in own.get_texts()]
        legend |= dict(zip(names, own.legend_handles, strict=True))
        own.remove()
        line = ax.axhline(zj.critical_load(zj.beck(n)).q_cr, color="k", ls="--", lw=1)
        ax.set(title=f"{n} rods", xlabel=r"friction $\tau$ ($EI/L$)", ylabel="")
        print(n, np.unique(tip.outcome, return_counts=True), tip.attrs["run_seconds"])
    axes[0].set_ylabel(r"load $P L^2/(E I)$")
    axes[0].set_xticks([0.05, 0.15])
    about = {"label": "largest angle of the last rod (rad)"}
    figure.colorbar(axes[0].collections[0], ax=axes, **about)
    legend["flutter without friction"] = line
    where = {"loc": "outside lower center", "ncols": 5}
    figure.legend(list(legend.values()), list(legend), **where)
    figure.suptitle(TITLE, fontsize=12)
    style.save(figure, __file__)


if __name__ == "__main__":
    main()
