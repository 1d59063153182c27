"""What kind of motion a kick leads to, over load and friction, into verdict_map.png.

Uniform rods, set-valued friction with mu_s = 4 mu_k, pins of radius 0.1 that carry the
load; rods may turn over. About half a minute on two cores, compilation included.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.patches import Patch

import ziegler_jax as zj
from ziegler_jax import VERDICT

POINTS = 64
# cycles by their passages of phi1 = 0 a period: dark to light; then the other verdicts
KINDS = {
    "stuck": zj.plot.REST_COLOUR,
    "cycle, 1 passage": "#08306B",
    "2": "#2171B5",
    "3": "#6BAED6",
    "4 to 16": "#BDD7E7",
    "more, or slow": "#FFFFFF",
    "quasi-periodic": zj.plot.YELLOW,
    "chaotic": zj.plot.VERMILLION,
    "undecided": "#7F7F7F",
}


def point(q, mu_k):
    friction = zj.SetValuedCoulomb(4 * mu_k, mu_k, pin_radius=0.1)
    column = zj.uniform_rods(q, friction=friction)
    return zj.verdict(column, zj.State(omega=(0.0, 0.3)), escape=60.0)


def main():
    zj.configure_cpu()
    q, mu_k = np.linspace(1, 7, POINTS), np.linspace(0.005, 0.26, POINTS)
    ds = zj.sweep(point, q=q, mu_k=mu_k)
    verdict = ds.verdict.values
    passages = np.searchsorted([1, 2, 3, 4, 17], ds.period_count.values, side="right")
    kind = np.where(passages == 0, 5, passages)  # of cycles
    kind = np.where(verdict == VERDICT.stuck, 0, kind)
    kind = np.where(verdict == VERDICT.quasi_periodic, 6, kind)
    kind = np.where(verdict == VERDICT.chaotic, 7, kind)
    kind = np.where(verdict < VERDICT.stuck, 8, kind)
    _, ax = plt.subplots(figsize=(8.3, 4.6), layout="constrained")
    norm = BoundaryNorm(np.arange(len(KINDS) + 1) - 0.5, len(KINDS))
    ax.pcolormesh(q, mu_k, kind.T, cmap=ListedColormap(list(KINDS.values())), norm=norm)
    ax.set(xlabel="follower load $q = F l/k$", ylabel=r"kinetic friction $\mu_k$")
    ax.set_title(r"$\mu_s = 4\mu_k$, $R_{pin}/l = 0.1$, $N = q$", loc="left")
    handles = [
        Patch(facecolor=colour, edgecolor=zj.plot.GREY, label=name)
        for name, colour in KINDS.items()
    ]
    ax.legend(handles=handles, loc="center left", bbox_to_anchor=(1, 0.5))
    ax.figure.savefig(Path(__file__).with_suffix(".png"), dpi=200)
    for name in ("compile_seconds", "run_seconds", "points"):
        print(name, ds.attrs[name])


if __name__ == "__main__":
    main()
