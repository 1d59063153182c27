"""A stick-slip cycle just above the linear critical load, into time_history.png.

q = 2.6 and tau = 0.026 in both joints (mu_s = mu_k, the load carried by both pins).
Shaded: joint 2 sticks, its rate is below v_smooth.
"""

from pathlib import Path

import colours
import jax
import numpy as np

import ziegler_jax as zj

Q, TAU, V_SMOOTH = 2.6, 0.026, 0.01
START, SHOWN = 300.0, 24.0  # the transient is left out


def main():
    jax.config.update("jax_enable_x64", True)
    friction = zj.SmoothCoulomb(TAU / Q, pin_radius=1.0, v_smooth=V_SMOOTH)
    column = zj.uniform_rods(q=Q, friction=friction)
    ts = np.concatenate([[0.0], START + np.linspace(0, SHOWN, 2400)])
    motion = zj.trajectory(column, zj.State(omega=(0.0, 0.2)), ts)
    shown = zj.Trajectory(
        ts=motion.ts[1:] - START,
        phi=motion.phi[1:],
        omega=motion.omega[1:],
        steps=motion.steps,
        outcome=motion.outcome,
    )
    history, _ = zj.plot.time_history(shown)
    rate = np.asarray(shown.omega[:, 1] - shown.omega[:, 0])
    history.fill_between(
        shown.ts,
        0,
        1,
        where=np.abs(rate) < V_SMOOTH,
        transform=history.get_xaxis_transform(),
        color=colours.SKY,
        lw=0,
        zorder=0,
        label="joint 2 sticks",
    )
    history.set(xlim=(0, SHOWN), ylim=(-1.4, 1.8))
    history.legend(loc="upper right", ncols=3, frameon=False)
    title = rf"Uniform rods, tanh friction: $q = {Q}$, $\tau = {TAU}\,k$"
    history.set_title(title, loc="left")
    history.figure.savefig(Path(__file__).with_suffix(".png"), dpi=200)


if __name__ == "__main__":
    main()
