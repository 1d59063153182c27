"""One basin: which starts come to rest and which end on the flutter cycle."""

import colours
import matplotlib.pyplot as plt
import numpy as np
import style

import ziegler_jax as zj

TAU = 0.05


def point(phi2, omega2):
    start = zj.State((0.0, phi2), (0.0, omega2))
    return zj.settle(
        style.dry(1.8, TAU),
        start,
        windows=zj.Windows(transient=0.0, agreement=1e-3, max_windows=100),
        certify=False,
    )


def main():
    n = 201
    ds = zj.sweep(point, phi2=np.linspace(-1, 1, n), omega2=np.linspace(-1.4, 1.4, n))
    stuck = ds.outcome == zj.CODE.stuck
    share = float(stuck.mean())
    print({"stuck": share, "repeats": float((ds.outcome == zj.CODE.repeats).mean())})
    print(ds.attrs["run_seconds"])
    figure, ax = plt.subplots(figsize=(7.5, 5))
    held = ds.joint_amplitude.sel(joint=2).where(stuck)
    held.attrs["long_name"] = r"$|\varphi_2 - \varphi_1|$ held at rest"
    zj.plot.map(held.to_dataset(), held.name, "phi2", "omega2", ax=ax, cmap="cividis")
    ax.set_facecolor(colours.PALE_BLUE)
    ax.set_title(
        rf"Dry friction, $q = 1.8$, $\tau$ = {TAU:g} $k$: {share:.0%} come to rest",
        loc="left",
    )
    ax.text(-0.95, 1.2, "flutter cycle", color=colours.BLUE)
    ax.set_xticks(np.linspace(-1, 1, 5))
    ax.set_xlabel(r"angle of rod 2 at the start $\varphi_2(0)$ (rad)")
    ax.set_ylabel(r"its rate $\dot\varphi_2(0)$ ($\sqrt{k/(ml^2)}$)")
    style.save(figure, __file__)


if __name__ == "__main__":
    main()
