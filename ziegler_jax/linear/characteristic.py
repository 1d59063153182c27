r"""The characteristic polynomial of the linear column, each coefficient one in q.

$$\det(M s^2 + C s + K(q)) = p_0 s^4 + p_1 s^3 + p_2(q) s^2 + p_3(q) s + p_4(q)$$

p_2 and p_3 are linear in q, p_4 quadratic, the others constant. All that `regime` and
`critical_load` say follows from these numbers.

Hurwitz' determinant over $p_1^2$, with $r = p_3/p_1$, is

$$f(q) = r (p_2 - p_0 r) - p_4 = f_0 + f_1 q + f_2 q^2$$

At small q its terms nearly cancel where one joint is much softer or much less damped
than the other, and what is left is the answer. In the joints' rates
$(\omega_1, \omega_2 - \omega_1)$ the inertia is [[A, B], [B, d]] with A = a + 2b + d,
B = b + d, and K is diag(kappa, 1) + q K'; with h the damping there over $p_1$, its
antisymmetric part $h_a$, and $\det h_s$ that of the symmetric part,

$$f_0 = \det h_s\, D_0 + m_0^2 + r_0 \det C,\quad
f_1 = \det h_s\, D_1 + 2 m_0 m_1 + r_1 \det C + h_a \eta (p_2^0 - 2 p_0 r_0)$$

with $D_0 + D_1 q + \dots$ the discriminant of the undamped column, $p_2^0$ its p_2 at
q = 0, and $m_0 + m_1 q$ the determinant of the symmetric parts of M, K, h as three
vectors (the Gram determinant of M, K, h). In f_0 nothing is subtracted.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from ..model.column import Column
from ..model.damping import joint_matrix
from ..numerics.numbers import Pair, Scalar, equals
from ..numerics.series import value


class Damped(NamedTuple):
    """What damping adds; it depends on ratios of C and on det C alone.

    `p1`: positive where the polynomial's is; `ratio`: r, and `boundary`: f, lowest
    power of q first; `none`: p1 = p3 = 0 at every load; `reached`: no mode of the
    unloaded column is left undamped.
    """

    p1: jax.Array
    ratio: tuple[jax.Array, jax.Array]
    boundary: tuple[jax.Array, jax.Array, jax.Array]
    none: jax.Array
    reached: jax.Array


class Characteristic(NamedTuple):
    """The coefficients; those that depend on q lowest power first.

    `p1`, `p3` and `damped` are None where the column has no damping law. `valid`:
    whether the numbers keep the column's rules and are finite.
    """

    p0: jax.Array
    p1: jax.Array | None
    p2: tuple[jax.Array, jax.Array]
    p3: tuple[jax.Array, jax.Array] | None
    p4: tuple[jax.Array, jax.Array, jax.Array]
    damped: Damped | None
    valid: jax.Array


def slope(p: tuple[Scalar, ...], q: Scalar) -> Scalar:
    """The slope of the polynomial p, lowest power first, at q."""
    return value(tuple(k * p[k] for k in range(1, len(p))), q)


def inertia(column: Column) -> tuple[Pair, Pair]:
    """The rows of M at D = 0."""
    return (column.a, column.b), (column.b, column.d)


def stiffness(column: Column) -> tuple[Pair, Pair]:
    """The rows of K: springs and follower load, linear in q."""
    q, kappa, eta = column.q, column.kappa, column.follower
    lever = column.l2 * (1 - eta)
    return (kappa + 1 - q, q * eta - 1), (-1.0, 1 - q * lever)


def characteristic(column: Column) -> Characteristic:
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
        return Characteristic(p0, None, p2, None, p4, None, valid)
    g = tuple(jnp.asarray(x, dtype=float) for x in joint_matrix(column.damping))
    # unit damping before dividing: derivatives of p3/p1 square p1, and would underflow
    size = lax.stop_gradient(functools.reduce(jnp.maximum, map(jnp.abs, g)))
    scale = 1 / jnp.where(size > 0, size, 1.0)
    big, off = a + 2 * b + d, b + d
    n1, n3 = _damping_terms([x * scale for x in g], big, off, d, kappa, eta, l2)
    none = (n1 == 0) & (n3[0] == 0) & (n3[1] == 0)
    positive = jnp.where(n1 > 0, n1, 1.0)
    h11, h12, h21, h22 = (x * scale / positive for x in g)
    r0, r1 = n3[0] / positive, n3[1] / positive
    det, skew, both = g[0] * g[3] - g[1] * g[2], (h12 - h21) / 2, (h12 + h21) / 2
    det_s, stiff = h11 * h22 - both * both, big - kappa * d
    m0 = stiff * both - off * (h11 - kappa * h22)
    m1 = (
        -both * (big * lever - d * (dead + lever))
        - (eta / 2 - lever) * (big * h22 - d * h11)
        + off * (lever * h11 - (dead + lever) * h22)
    )
    d0 = stiff * stiff + 4 * kappa * off * off
    d1 = 2 * p2[0] * p2[1] - 4 * p0 * p4[1]
    f0 = det_s * d0 + m0 * m0 + r0 * det
    f1 = det_s * d1 + 2 * m0 * m1 + r1 * det + skew * eta * (p2[0] - 2 * p0 * r0)
    f2 = r1 * (p2[1] - p0 * r1) - p4[2]
    # f0 is zero up to its own rounding where a mode is missed
    noise = 64 * jnp.finfo(p0.dtype).eps
    rounding = noise * (jnp.abs(stiff * both) + (jnp.abs(b) + d) * jnp.abs(r0))
    reached = f0 > rounding * rounding + noise * d0 * both * both
    damped = Damped(n1, (r0, r1), (f0, f1, f2), none, reached)
    p1, p3 = n1 * size, (n3[0] * size, n3[1] * size)
    p2 = (p2[0] + det, p2[1])
    valid &= jnp.isfinite(p1 + p2[0] + p3[0] + p3[1])
    return Characteristic(p0, p1, p2, p3, p4, damped, valid)


def _damping_terms(g, big, off, d, kappa, eta, l2):
    """p1 and p3 of the damping g in the joints' rates."""
    g11, g12, g21, g22 = g
    p1 = big * g22 + d * g11 - off * (g12 + g21)
    first = g11 + g22 - g12 - g21  # c11
    return p1, (
        g11 + kappa * g22,
        -((1 - eta) * (l2 * first + g22) + eta * g21),
    )
