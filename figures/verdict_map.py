"""The kind of motion that a kick leads to, over load and friction.

Uniform rods, set-valued friction with mu_s = 4 mu_k, pins of radius 0.1 that carry the
load; rods may turn over. About half a minute on two cores, compilation included.
"""

import colours
import matplotlib.pyplot as plt
import numpy as np
import style

import ziegler_jax as zj
from ziegler_jax import CODE

POINTS, KICK = 64, 0.3
# cycles by their passages of phi1 = 0 a period: dark to light; then the other kinds
BLUES = plt.get_cmap("Blues")
KINDS = {
    "stuck": colours.REST,
    "cycle of 1 passage": BLUES(0.95),
    "cycle of 2": BLUES(0.7),
    "cycle of 3": BLUES(0.5),
    "cycle of 4 or 6": BLUES(0.3),
    "cycle, not certified": BLUES(0.1),
    "quasi-periodic": colours.ORANGE,
    "chaotic": colours.VERMILLION,
    "undecided": "0.5",
}


def point(q, mu_k):
    friction = zj.SetValuedCoulomb(4 * mu_k, mu_k, pin_radius=0.1)
    column = zj.uniform_rods(q, friction=friction)
    windows, start = zj.Windows(escape=60.0), zj.State(omega=(0.0, KICK))
    return zj.settle(column, start, windows=windows, exponents=2)


def main():
    q, mu_k = np.linspace(1, 7, POINTS), np.linspace(0.005, 0.26, POINTS)
    ds = zj.sweep(point, q=q, mu_k=mu_k)
    called = ds.kind.values
    undecided = list(KINDS).index("undecided") + 1
    kind = np.full(called.shape, undecided)
    cycles = 1 + np.clip(ds.returns.values.astype(int), 1, 4)
    kind = np.where(called == CODE.cycle, cycles, kind)
    kind = np.where(called == CODE.stuck, 1, kind)
    for code, number in ((CODE.periodic, 6), (CODE.quasi_periodic, 7)):
        kind = np.where(called == code, number, kind)
    kind = np.where(called == CODE.chaotic, 8, kind)
    codes = range(1, len(KINDS) + 1)
    names = " ".join(name.replace(" ", "_") for name in KINDS)
    flags = {"flag_values": list(codes), "flag_meanings": names}
    plane = ds.assign(kind=(("q", "mu_k"), kind, flags))
    figure, ax = plt.subplots(figsize=(8.3, 4.6))
    chosen = dict(zip(codes, KINDS.values(), strict=True))
    zj.plot.map(plane, "kind", x="q", y="mu_k", ax=ax, colours=chosen)
    handles = ax.get_legend().legend_handles
    ax.legend(handles=handles, loc="center left", bbox_to_anchor=(1, 0.5))
    ax.set(
        xlabel="follower load $q = F l/k$",
        ylabel=r"kinetic friction $\mu_k$",
    )
    ax.set_title(
        r"Uniform rods, dry friction $\mu_s = 4\mu_k$, pins of $0.1\,l$; "
        rf"kick $\dot\varphi_2(0) = {KICK}\sqrt{{k/(m l^2)}}$",
        loc="left",
        fontsize=10,
    )
    style.save(figure, __file__)
    for name in ("compile_seconds", "run_seconds", "points"):
        print(name, ds.attrs[name])


if __name__ == "__main__":
    main()
