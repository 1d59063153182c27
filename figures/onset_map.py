"""The load at which a kick first sets off flutter, over static and kinetic friction."""

import matplotlib.pyplot as plt
import numpy as np
import style

import ziegler_jax as zj


def point(mu_s, mu_k):
    kick = zj.State(omega=(0.0, 0.6))
    return zj.flutter_onset(
        lambda q: style.dry(q, mu_s, mu_k),
        kick,
        (0.2, 2.6),
        search=zj.Search(scan=12, halvings=6),
    )


def main():
    mu = np.linspace(0.01, 0.16, 26)
    ds = zj.sweep(point, mu_s=mu, mu_k=mu, where=lambda mu_s, mu_k: mu_k <= mu_s)
    print(np.unique(ds.outcome, return_counts=True), ds.attrs["run_seconds"])
    figure, ax = plt.subplots(figsize=(7.5, 5))
    ds.threshold.attrs["long_name"] = "onset load $q = F l/k$"
    zj.plot.map(ds, "threshold", x="mu_s", y="mu_k", ax=ax)
    s, k = np.meshgrid(ds.mu_s, ds.mu_k, indexing="ij")
    ax.plot([0.005, 0.163], [0.005, 0.163], color="0.45", lw=1)
    ax.text(0.09, 0.097, r"$\tau_s = \tau_k$", color="0.45", ha="right")
    for code, mark, text in (
        (zj.CODE.repeated, "w.", "rest returns above"),
        (zj.CODE.undecided, "kx", "undecided"),
        (zj.CODE.rests, "k_", "rest up to $q = 2.6$"),
    ):
        here = ds.outcome.values == code
        if here.any():
            ax.plot(s[here], k[here], mark, ms=4, label=text)
    ax.set_xlabel(r"static friction torque $\tau_s$ ($k$)")
    ax.set_ylabel(r"kinetic friction torque $\tau_k$ ($k$)")
    ax.set_title(
        "Set-valued friction: first flutter after a kick\n"
        r"$\dot\varphi_2(0) = 0.6\,\sqrt{k/(m l^2)}$",
        loc="left",
    )
    ax.legend(loc="upper left", facecolor="0.6", frameon=True)
    ax.spines[["top", "right"]].set_visible(False)
    style.save(figure, __file__)


if __name__ == "__main__":
    main()
