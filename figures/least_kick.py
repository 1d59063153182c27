"""The least energy that starts flutter, over load and friction, and its collapse.

64 x 64 least kicks over all rates of the two rods, with set-valued friction, mu_s =
mu_k, the torque tau in both joints.
"""

import colours
import matplotlib.pyplot as plt
import numpy as np
import style

import ziegler_jax as zj


def point(q, tau):
    # where motions are small, so must be what is neglected of them
    method = zj.Method(rtol=1e-8, atol=1e-8 * tau)
    return zj.least_kick(style.dry(q, tau), (0.0, 60 * tau**2), method=method)


def main():
    taus = np.geomspace(0.001, 0.16, 64)
    ds = zj.sweep(point, q=np.linspace(1.6, 2.6, 64), tau=taus)
    print({k: ds.attrs[k] for k in ("run_seconds", "compile_seconds")})
    for name in ("outcome", "edge"):
        print(name, np.unique(ds[name], return_counts=True))
    scaled = (ds.energy / ds.tau**2).where(ds.outcome == zj.CODE.found)
    scaled.attrs = {"long_name": "least energy over torque squared", "units": "$1/k$"}
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4.2), layout="constrained")
    left.set_yscale("log")
    shown = scaled.to_dataset(name="scaled")
    zj.plot.map(shown, "scaled", x="q", y="tau", ax=left, vmin=1.5, vmax=9)
    left.set_facecolor(colours.REST)
    none = {"facecolor": colours.REST, "edgecolor": "0.5", "lw": 0.5}
    left.fill([], [], **none, label=r"none below $60\,\tau^2$")
    slow = ds.outcome == zj.CODE.undecided
    qs, ts = np.meshgrid(ds.q, ds.tau, indexing="ij")
    if slow.any():
        left.plot(qs[slow], ts[slow], "k.", ms=3, label="undecided")
    left.legend(loc="lower right", frameon=True)
    left.set_xlabel("load $q = Fl/k$")
    left.set_ylabel(r"friction torque $\tau$ ($k$)")
    left.set_title("Least energy that starts flutter:\nuniform rods", loc="left")
    shades = plt.get_cmap("viridis")(np.linspace(0, 0.9, 4))
    for q, colour in zip((1.8, 2.0, 2.3, 2.6), shades, strict=True):
        one = scaled.sel(q=q, method="nearest")
        apart = abs(one / one[0] - 1)[taus > 0.003]
        right.loglog(apart.tau, apart, color=colour, label=f"{float(one.q):.3g}")
    right.loglog(apart.tau, 5 * apart.tau**2, "k--", lw=1, label=r"$5\,\tau^2$")
    right.set_xlabel(r"friction torque $\tau$ ($k$)")
    right.set_ylabel(r"departure of $E^*/\tau^2$ from its limit")
    right.set_title("Its limit of\nsmall dry friction", loc="left")
    right.legend(title="load $q$")
    right.spines[["top", "right"]].set_visible(False)
    style.save(figure, __file__)


if __name__ == "__main__":
    main()
