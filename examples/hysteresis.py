"""Hysteresis: the load up and down, and the unstable cycles between."""

import jax
import numpy as np

import ziegler_jax as zj

jax.config.update("jax_enable_x64", True)  # outside of a sweep
LOADS, ARC = (
    np.linspace(1.4, 2.2, 5),
    zj.Arc(direction=-1, points=50, bounds=(1.4, 2.6)),
)


def column(q):
    friction = zj.SmoothCoulomb(0.1, pin_radius=0.1, v_smooth=0.1)
    return zj.uniform_rods(q, friction=friction, damping=zj.Viscous(0.02, 0.02))


both = zj.sweep_up_down(column, LOADS, kick=zj.State(omega=(0, 0.1)))
settled = zj.settle(column(1.62), zj.State(omega=(0, 0.6)))
orbit = zj.periodic_orbit(column(1.62), settled.final)
branch = zj.continue_cycle(column, orbit, 1.62, arc=ARC)
ax = zj.plot.up_down(both, branch=branch)
ax.figure.savefig("hysteresis.png")
