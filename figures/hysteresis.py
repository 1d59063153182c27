"""Load up and down, the last state carried on: rest and flutter coexist between."""

import colours
import matplotlib.pyplot as plt
import numpy as np
import style

import ziegler_jax as zj

LOADS, KICK = np.linspace(1.2, 2.6, 43), 0.2
SCENES = ((0.02, 0.02), (0.04, 0.04), (0.06, 0.03))  # tau_s, tau_k
WAYS = (("down", "v", colours.BLUE), ("up", "^", colours.VERMILLION))


def point(mu_s, ratio):
    return zj.sweep_up_down(
        lambda q: style.dry(q, mu_s, ratio * mu_s),
        LOADS,
        kick=zj.State(omega=(0.0, KICK)),
        observers=(zj.StickFraction(),),
    )


def main():
    ds = zj.sweep(
        point,
        where=lambda mu_s, ratio: (mu_s > 0.05) == (ratio < 1),
        mu_s=[0.02, 0.04, 0.06],
        ratio=[0.5, 1.0],
    )
    figure, axes = plt.subplots(2, 3, figsize=(11, 5.6), sharex=True, sharey="row")
    for (upper, lower), (s, k) in zip(axes.T, SCENES, strict=True):
        one = ds.sel(mu_s=s, ratio=k / s, joint=2)
        for branch, mark, colour in WAYS:
            way = one.sel(branch=branch)
            look = {"color": colour, "mfc": "none", "ms": 4, "label": branch}
            upper.plot(way.q, way.joint_amplitude, mark, **look)
            lower.plot(way.q, way.stick_fraction, mark, **look)
        upper.set_title(rf"$\tau_s = {s:g}\,k$, $\tau_k = {k:g}\,k$", loc="left")
        lower.set_xlabel("load $q = Fl/k$")
    axes[0, 0].set_ylabel(r"largest $|\varphi_2 - \varphi_1|$ (rad)")
    axes[1, 0].set_ylabel("stick fraction of joint 2")
    axes[0, 0].legend(title="load goes")
    for ax in axes.flat:
        ax.spines[["top", "right"]].set_visible(False)
    figure.suptitle(
        "Set-valued friction, constant torques in both joints; at each load a kick of "
        rf"{KICK} $\sqrt{{k/(m l^2)}}$ to $\dot\varphi_2$",
        fontsize=12,
    )
    figure.tight_layout()
    style.save(figure, __file__)


if __name__ == "__main__":
    main()
