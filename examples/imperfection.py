"""An imperfection: springs at rest in bent joints, and where the column rests."""

import jax
import numpy as np

import ziegler_jax as zj

jax.config.update("jax_enable_x64", True)
BENT = (0.02, 0.03)  # of joints 1 and 2, rad


def rest(q):
    damping = zj.Viscous(0.2, 0.2)
    column = zj.uniform_rods(q, damping=damping, rest_angles=BENT)
    return zj.settle(column, zj.State(), observers=(zj.Mean(),)).mean_angle


for q in (0.0, 0.4, 0.8):  # joint 1 bears q sin(phi_2 - phi_1), joint 2 nothing
    first = BENT[0] - q * np.sin(BENT[1])
    print(f"q = {q}: at rest at", rest(q), "by hand", (first, first + BENT[1]))
