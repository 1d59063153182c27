"""Hysteresis with the unstable branch between: rest, cycles, and what parts them.

Uniform rods with smoothed friction and a little viscous damping: the load goes up and
down by steps, the last state and a kick carried on, and the cycle that is left at the
lower end of the way down is continued through its folds.
"""

import matplotlib.pyplot as plt
import numpy as np
import style

import ziegler_jax as zj

MU, DAMPING, KICK, HIGH = 0.1, 0.02, 0.1, 2.6


def column(q):
    friction = zj.SmoothCoulomb(MU, pin_radius=0.1, v_smooth=0.1)
    return zj.uniform_rods(q, friction=friction, damping=zj.Viscous(DAMPING, DAMPING))


def main():
    kick = zj.State(omega=(0.0, KICK))
    both = zj.sweep_up_down(column, np.linspace(1.4, HIGH, 41), kick=kick)
    ds = both.to_dataset()
    settled = zj.settle(column(HIGH), zj.State(omega=(0.0, 0.6)))
    orbit = zj.periodic_orbit(column(HIGH), settled.final)
    arc = zj.Arc(direction=-1, bounds=(1.4, HIGH + 0.01))
    branch = zj.continue_cycle(column, orbit, HIGH, arc=arc).to_dataset()
    folds = branch.special_parameter.values
    print(branch.outcome.values, branch["count"].values, folds)
    figure, ax = plt.subplots(figsize=(7.5, 4.6), layout="constrained")
    zj.plot.bifurcation_diagram(
        ds.sel(joint=2), along="q", branch=branch.sel(joint=2), ax=ax
    )
    ax.set_ylabel(r"largest $|\varphi_2 - \varphi_1|$ (rad)")
    ax.set_xlabel("follower load $q = F l/k$")
    ax.set_title(
        rf"Uniform rods, tanh friction $\mu$ = {MU}, pins of 0.1 l, damping {DAMPING} "
        r"$\sqrt{k m l^2}$;"
        "\n"
        rf"at each load a kick of {KICK} $\sqrt{{k/(m l^2)}}$ to $\dot\varphi_2$",
        loc="left",
        fontsize=11,
    )
    ax.spines[["top", "right"]].set_visible(False)
    style.save(figure, __file__)


if __name__ == "__main__":
    main()
