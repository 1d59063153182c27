"""The forces that the joints transmit, and the friction loop that rests on them.

`column` is a `Column`, `forces` what `column.py` computes of one state: its y, the sine
and cosine of D, the right-hand sides r1, r2 without friction, and `solve`.
"""

from typing import Any

import jax.numpy as jnp

from ._sincos import sincos
from ._types import Pair


def joint_reactions(column: Any, forces: Any, a1: Any, a2: Any) -> tuple[Pair, Pair]:
    """Both reactions in rod 2's frame: (along, across), affine in a1 and a2."""
    phi2, w1, w2 = forces.y[1], forces.y[2], forces.y[3]
    s, c = forces.sin_d, forces.cos_d
    # the second derivatives of the rods' directions, which lie at D and 0 in this frame
    along1, across1 = -a1 * s - w1 * w1 * c, a1 * c - w1 * w1 * s
    along2, across2 = -w2 * w2, a2
    m2, b = column.m2, column.b
    along = m2 * along1 + b * along2
    across = m2 * across1 + b * across2
    if column.tangential:
        along = along + column.q
    else:
        sin_f, cos_f = sincos((1 - column.follower) * phi2)
        along, across = along + column.q * cos_f, across - column.q * sin_f
    joint2 = (along, across)
    return (along + column.s1 * along1, across + column.s1 * across1), joint2


def reaction_loads(column: Any, forces: Any, g1: Any, g2: Any, steps: int) -> Pair:
    """Solve N_i = |R_i(N)| by Newton: R is affine in N (see `JointReaction`)."""
    free = forces.solve(forces.r1, forces.r2)
    by1 = forces.solve(-g1, 0.0 * g1)  # accelerations per unit of N1, and of N2
    by2 = forces.solve(g2, -g2)
    base = joint_reactions(column, forces, *free)

    def slope(by):
        moved = joint_reactions(column, forces, free[0] + by[0], free[1] + by[1])
        return [
            tuple(m - r for m, r in zip(*mr, strict=True))
            for mr in zip(moved, base, strict=True)
        ]

    p1, p2 = slope(by1), slope(by2)
    tiny = 1e-30  # a reaction of exactly zero has no direction: let its slope be zero

    def magnitude(i, n1, n2):
        along, across = (base[i][k] + p1[i][k] * n1 + p2[i][k] * n2 for k in (0, 1))
        size = jnp.sqrt(along * along + across * across + tiny)
        d1 = (along * p1[i][0] + across * p1[i][1]) / size
        d2 = (along * p2[i][0] + across * p2[i][1]) / size
        return size, d1, d2

    n1, n2 = magnitude(0, 0.0, 0.0)[0], magnitude(1, 0.0, 0.0)[0]
    for _ in range(steps):
        f1, d11, d12 = magnitude(0, n1, n2)
        f2, d21, d22 = magnitude(1, n1, n2)
        e1, e2 = f1 - n1, f2 - n2
        det = (1 - d11) * (1 - d22) - d12 * d21
        n1, n2 = (
            n1 + ((1 - d22) * e1 + d12 * e2) / det,
            n2 + (d21 * e1 + (1 - d11) * e2) / det,
        )
    left = jnp.abs(magnitude(0, n1, n2)[0] - n1) + jnp.abs(magnitude(1, n1, n2)[0] - n2)
    solved = left <= 1e-6 * (1 + jnp.abs(n1) + jnp.abs(n2))
    return jnp.where(solved, n1, jnp.nan), jnp.where(solved, n2, jnp.nan)
