"""Where motions are cycles, quasi-periodic or chaotic."""

import numpy as np

import ziegler_jax as zj

POINTS = 5  # along each axis
WINDOWS = zj.Windows(length=25, max_windows=16, escape=60)


def point(q, mu_k):
    friction = zj.SetValuedCoulomb(4 * mu_k, mu_k, pin_radius=0.1)
    column = zj.uniform_rods(q, friction=friction)
    return zj.settle(column, zj.State(omega=(0, 0.3)), windows=WINDOWS, exponents=2)


q, mu_k = np.linspace(3.7, 4.3, POINTS), np.linspace(0.11, 0.15, POINTS)
ds = zj.sweep(point, q=q, mu_k=mu_k)
ds.pipe(zj.plot.map, "kind", x="q", y="mu_k").figure.savefig("chaos.png")
