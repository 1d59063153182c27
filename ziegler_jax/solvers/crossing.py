r"""Where a guard first falls below zero within a step, on its cubic Hermite.

A guard g is positive while the modes of a step hold. With its values and slopes at both
ends the step's cubic is known, with its extrema, and so a guard that falls below zero
and rises again within the step is seen. The place is found to the cubic's accuracy,
$O(h^4)$; each shorter step that ends near it finds it more closely.
"""

from typing import Any

import jax.numpy as jnp

from .._types import Scalar

ITERATIONS = 6  # of a Newton method that is kept in a bracket


def extrema(g0: Scalar, v0: Scalar, g1: Scalar, v1: Scalar) -> tuple[Any, Any]:
    """Where in (0, 1) the cubic has its extrema, in order; 1 for one that is absent.

    **Arguments:** values and slopes, per step, at both ends.
    """
    rise = g1 - g0
    c2, c3 = 3 * rise - 2 * v0 - v1, v0 + v1 - 2 * rise
    square = c2 * c2 - 3 * c3 * v0
    root = jnp.sqrt(jnp.maximum(square, 0.0))
    sum_ = -(c2 + jnp.where(c2 < 0, -root, root))  # nothing cancels

    def inside(top, bottom):
        x = top / jnp.where(bottom == 0, 1.0, bottom)
        there = (square > 0) & (bottom != 0) & (x > 0) & (x < 1)
        return jnp.where(there, x, 1.0)

    x1, x2 = inside(sum_, 3 * c3), inside(v0, sum_)
    return jnp.minimum(x1, x2), jnp.maximum(x1, x2)


def falls_below(
    g0: Scalar, v0: Scalar, g1: Scalar, v1: Scalar, tol: Scalar, turns: Any
) -> Any:
    """Whether the guard falls below -tol, and the bracket of that.

    **Arguments:** values and slopes, per step, at both ends; `tol`; `turns`: the
    extrema.

    **Returns:** the verdict, and the two places in [0, 1] between which it falls.
    """
    rise = g1 - g0
    c2, c3 = 3 * rise - 2 * v0 - v1, v0 + v1 - 2 * rise
    a, b = turns

    def below(x):
        return g0 + x * (v0 + x * (c2 + x * c3)) < -tol

    below_a, below_b = below(a), below(b)
    left = jnp.where(below_a, 0.0, jnp.where(below_b, a, b))
    right = jnp.where(below_a, a, jnp.where(below_b, b, 1.0))
    return below_a | below_b | (g1 < -tol), left, right


def place(
    g0: Scalar, v0: Scalar, g1: Scalar, v1: Scalar, level: Scalar, between: Any
) -> Any:
    """Where the cubic passes `level` in the bracket, between 0 and 1."""
    left, right = between
    rise = g1 - g0
    c2, c3 = 3 * rise - 2 * v0 - v1, v0 + v1 - 2 * rise

    def cubic(x):
        return g0 - level + x * (v0 + x * (c2 + x * c3))

    at_left, at_right = cubic(left), cubic(right)
    drop = at_left - at_right
    share = jnp.where(drop > 0, at_left / jnp.where(drop > 0, drop, 1.0), 0.5)
    x = left + jnp.clip(share, 0.0, 1.0) * (right - left)
    for _ in range(ITERATIONS):
        value = cubic(x)
        slope = v0 + x * (2 * c2 + 3 * x * c3)
        left = jnp.where(value > 0, x, left)
        right = jnp.where(value > 0, right, x)
        newton = x - value / jnp.where(slope < 0, slope, -1.0)
        good = (slope < 0) & (newton >= left) & (newton <= right)
        x = jnp.where(good, newton, 0.5 * (left + right))
    return x
