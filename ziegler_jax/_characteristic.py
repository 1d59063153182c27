r"""The characteristic polynomial of the linear column, each coefficient one in q.

$$\det(M s^2 + C s + K(q)) = p_0 s^4 + p_1 s^3 + p_2(q) s^2 + p_3(q) s + p_4(q)$$

p_2 and p_3 are linear in q, p_4 quadratic, the others constant. All that `regime` and
`critical_load` say follows from these numbers.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ._types import Scalar, equals


class Characteristic(NamedTuple):
    """The coefficients; those that depend on q lowest power first.

    `p1` and `p3` are None where the column has no damping law. `valid`: whether the
    numbers keep the column's rules and are finite.
    """

    p0: jax.Array
    p1: jax.Array | None
    p2: tuple[jax.Array, jax.Array]
    p3: tuple[jax.Array, jax.Array] | None
    p4: tuple[jax.Array, jax.Array, jax.Array]
    valid: jax.Array


def value(p: tuple[Scalar, ...], q: Scalar) -> Any:
    """The polynomial p, lowest power first, at q."""
    total = p[-1]
    for coefficient in p[-2::-1]:
        total = total * q + coefficient
    return total


def slope(p: tuple[Scalar, ...], q: Scalar) -> Any:
    """Its derivative."""
    return value(tuple(k * p[k] for k in range(1, len(p))), q)


def inertia(column: Any) -> tuple[tuple[Any, Any], tuple[Any, Any]]:
    """The rows of M at D = 0."""
    return (column.a, column.b), (column.b, column.d)


def stiffness(column: Any) -> tuple[tuple[Any, Any], tuple[Any, Any]]:
    """The rows of K: springs and follower load, linear in q."""
    q, kappa, eta = column.q, column.kappa, column.follower
    lever = column.l2 * (1 - eta)
    return (kappa + 1 - q, q * eta - 1), (-1.0, 1 - q * lever)


def characteristic(column: Any) -> Characteristic:
    """The polynomial of a column without friction. Its `q` enters `valid` alone."""
    a, b, d, kappa, eta, l2 = (
        jnp.asarray(x, dtype=float)
        for x in (
            column.a,
            column.b,
            column.d,
            column.kappa,
            column.follower,
            column.l2,
        )
    )
    dead = 1 - eta
    lever = l2 * dead
    p0 = a * d - b * b
    p2 = (a + d * (kappa + 1) + 2 * b, -(a * lever + d + b * eta))
    p4 = (kappa, -dead * (l2 * (kappa + 1) + 1), lever)
    valid = column.valid() & (p0 > 0) & jnp.isfinite(p0 + p2[0])
    if not equals(column.follower, 1.0):
        valid = valid & jnp.isfinite(lever) & (l2 > 0)
    if column.damping is None:
        return Characteristic(p0, None, p2, None, p4, valid)
    (c11, c12), (c21, c22) = (
        tuple(jnp.asarray(x, dtype=float) for x in row)
        for row in column.damping.matrix(1.0)
    )
    p1 = a * c22 + d * c11 - b * (c12 + c21)
    p2 = (p2[0] + (c11 * c22 - c12 * c21), p2[1])
    p3 = (c11 + c22 * (kappa + 1) + c12 + c21, -(c11 * lever + c22 + c21 * eta))
    return Characteristic(
        p0, p1, p2, p3, p4, valid & jnp.isfinite(p1 + p2[0] + p3[0] + p3[1])
    )
