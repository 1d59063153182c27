"""The kick that sets off flutter over load and friction, and its collapse over tau.

64 x 64 thresholds with set-valued friction, mu_s = mu_k, the torque tau in both joints.
"""

import colours
import matplotlib.pyplot as plt
import numpy as np
import style

import ziegler_jax as zj

RATE, UNITS = r"$\sqrt{k/(ml^2)}$", "sqrt(k/(m l^2))"


def point(q, tau):
    kick = zj.State(omega=(0.0, 1.0))
    return zj.critical_kick(style.dry(q, tau), kick, (0.0, 1.6))


def main():
    taus = np.geomspace(0.01, 0.16, 64)
    ds = zj.sweep(point, q=np.linspace(1.2, 2.6, 64), tau=taus)
    print({k: ds.attrs[k] for k in ("run_seconds", "compile_seconds")})
    print(np.unique(ds.outcome, return_counts=True))
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4.2), layout="constrained")
    kick = {"long_name": r"kick $\dot\varphi_2(0)$", "units": UNITS}
    ds.threshold.attrs |= kick
    left.set_yscale("log")
    zj.plot.map(ds, "threshold", x="q", y="tau", ax=left, norm="log")
    left.set_facecolor(colours.REST)
    left.text(1.22, 0.1, "rest after all\nkicks to 1.6")
    slow = ds.outcome == zj.CODE.undecided
    qs, ts = np.meshgrid(ds.q, ds.tau, indexing="ij")
    left.plot(qs[slow], ts[slow], "k.", ms=2, label="undecided")
    left.legend(loc="lower right", frameon=True, markerscale=4)
    left.set_xlabel("load $q = Fl/k$")
    left.set_ylabel(r"friction torque $\tau$ ($k$)")
    left.set_title("Smallest kick that starts flutter:\nuniform rods", loc="left")
    shades = plt.get_cmap("viridis")(np.linspace(0, 0.9, 5))
    for tau, colour in zip(taus[[0, 16, 32, 48, 63]], shades, strict=True):
        one = ds.sel(tau=tau)
        right.semilogy(one.q, one.threshold / tau, color=colour, label=f"{tau:.3f}")
    right.set_xlabel("load $q = Fl/k$")
    right.set_yticks([4, 6, 10, 20, 40], ["4", "6", "10", "20", "40"], minor=False)
    right.minorticks_off()
    right.set_ylabel(rf"kick over torque $\dot\varphi_2(0) / \tau$ ({RATE}$/k$)")
    right.set_title("The same over the\ntorque of dry friction", loc="left")
    figure.get_layout_engine().set(wspace=0.08)
    right.legend(title=r"torque $\tau$ ($k$)", labelspacing=0.3)
    right.spines[["top", "right"]].set_visible(False)
    style.save(figure, __file__)


if __name__ == "__main__":
    main()
