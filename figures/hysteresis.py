"""Load up and down, the last state carried on: rest and flutter coexist between."""

import matplotlib.pyplot as plt
import numpy as np
import onset_style as style

import ziegler_jax as zj

LOADS = np.linspace(1.2, 2.6, 43)
KICK = zj.State(omega=(0.0, 0.2))


def point(mu_s, mu_k):
    return zj.sweep_up_down(
        lambda q: style.dry(q, mu_s, mu_k),
        LOADS,
        kick=KICK,
        rtol_settle=1e-3,
        observers=(zj.StickFraction(),),
    )


def main():
    scenes = ((0.02, 0.02), (0.04, 0.04), (0.06, 0.03))
    mu = [0.02, 0.03, 0.04, 0.06]
    ds = zj.sweep(
        point,
        mu_s=mu,
        mu_k=mu,
        where=lambda mu_s, mu_k: sum(
            (mu_s == s) & (mu_k == k) for s, k in scenes
        ).astype(bool),
    )
    print(ds.attrs["run_seconds"])
    figure, axes = plt.subplots(2, 3, figsize=(11, 5.6), sharex=True, sharey="row")
    for (upper, lower), (s, k) in zip(axes.T, scenes, strict=True):
        one = ds.sel(mu_s=s, mu_k=k)
        for branch, mark, colour in (
            ("down", "v", style.BLUE),
            ("up", "^", style.ORANGE),
        ):
            way = one.sel(branch=branch)
            upper.plot(
                way.q,
                way.joint_amplitude.sel(joint=2),
                mark,
                ms=4,
                mfc="none",
                color=colour,
                label=branch,
            )
            lower.plot(
                way.q,
                way.stick_fraction.sel(joint=2),
                mark,
                ms=4,
                mfc="none",
                color=colour,
            )
        upper.set_title(rf"$\tau_s$ = {s:g}, $\tau_k$ = {k:g}", loc="left")
        lower.set_xlabel("load $q = Fl/k$")
    axes[0, 0].set_ylabel(r"largest $|\varphi_2 - \varphi_1|$ (rad)")
    axes[1, 0].set_ylabel("stick fraction, joint 2")
    axes[0, 0].legend(title="load goes")
    for ax in axes.flat:
        ax.spines[["top", "right"]].set_visible(False)
    figure.tight_layout()
    style.save(figure, __file__)


if __name__ == "__main__":
    main()
