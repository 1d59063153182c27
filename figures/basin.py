"""One basin: which starts come to rest and which end on the flutter cycle."""

import matplotlib.pyplot as plt
import numpy as np
import onset_style as style

import ziegler_jax as zj


def main():
    tau, n = 0.05, 201
    column = style.dry(1.8, tau)
    axes = {"phi2": np.linspace(-1.0, 1.0, n), "omega2": np.linspace(-1.4, 1.4, n)}
    ds = zj.basin(column, axes, transient=0.0, rtol_settle=1e-3, max_windows=100)
    print(dict(zip(ds.reached.values, ds.fraction.values, strict=True)))
    print(ds.attrs["run_seconds"])
    figure, ax = plt.subplots(figsize=(7.5, 5))
    held = ds.joint_amplitude.sel(joint=2).where(ds.outcome == zj.OUTCOME.stuck)
    mesh = ax.pcolormesh(ds.phi2, ds.omega2, held.T, cmap="cividis")
    figure.colorbar(
        mesh, ax=ax, label=r"joint angle held at rest $|\varphi_2 - \varphi_1|$ (rad)"
    )
    ax.set_facecolor("#D9E8F4")
    share = ds.fraction.sel(reached="stuck").item()
    ax.set_title(
        rf"q = 1.8, $\tau$ = {tau:g} k: {share:.0%} of these starts come to rest",
        loc="left",
    )
    ax.text(-0.95, 1.2, "flutter cycle", color=style.BLUE)
    ax.set_xlabel(r"angle of rod 2 at the start $\varphi_2(0)$ (rad)")
    ax.set_ylabel(r"its rate $\dot\varphi_2(0)$ ($\sqrt{k/(ml^2)}$)")
    style.save(figure, __file__)


if __name__ == "__main__":
    main()
