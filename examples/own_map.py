"""A map of your own column: how large its motions are, over load and friction."""

import numpy as np

import ziegler_jax as zj

POINTS = 12  # along each axis


def point(q, mu):  # Ziegler's masses 2m and m, with dry friction in both joints
    friction = zj.SetValuedCoulomb(mu, pin_radius=0.1)
    column = zj.point_masses(2, 1, q=q, friction=friction)
    return zj.settle(column, zj.State(omega=(0, 0.3)))


ds = zj.sweep(point, q=np.linspace(1, 3, POINTS), mu=np.linspace(0.01, 0.2, POINTS))
ax = ds.sel(joint=2).pipe(zj.plot.map, "joint_amplitude", x="q", y="mu")
ax.figure.savefig("own_map.png")
