r"""Return maps of three numbers near a fixed point: do they contract?

A map of the section $H(x)$ has the fixed point $x^*$ and there the derivative $M$ with
spectral radius $\rho$. Where $\rho < 1$ there is a norm in which $M$ contracts at once,

$$|v|_P^2 = v^T P\,v, \qquad P = \sum_{j \ge 0} (A^T)^j A^j, \qquad A = \frac{2 M}{1 +
\rho}, \qquad |M|_P \le \frac{1 + \rho}{2} \sqrt{1 - \frac{1}{\mathrm{tr} P}},$$

for $|A v|_P^2 = |v|_P^2 - |v|^2$. Sums and products only: a batch needs no LAPACK.

Vectors and matrices are tuples of numbers, a matrix one of its rows: in a batch each of
these is an array of lanes. What is seldom asked for, powers of a matrix and what they
sum up to, is worked out with arrays of nine: as single numbers it would be many more
instructions to compile.
"""

from collections.abc import Sequence
from functools import reduce
from typing import cast

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from ..numerics.numbers import Scalar, Traced

Vector3 = tuple[Traced, Traced, Traced]
Matrix3 = tuple[Vector3, Vector3, Vector3]

SQUARINGS = 24  # of M for its radius: what is left of its shape is 2^-24 of a logarithm
DOUBLINGS = 16  # of the sum for P
TINY = 1e-12  # of a point: no motion returns from there
SLOWEST = 0.9995  # no norm is worked out for a radius above: none is asked for
UNIT = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def dot(v: Vector3, w: Vector3) -> Traced:
    """The product of two vectors."""
    return v[0] * w[0] + v[1] * w[1] + v[2] * w[2]


def minus(v: Vector3, w: Vector3) -> Vector3:
    """The difference."""
    return cast(Vector3, tuple(a - b for a, b in zip(v, w, strict=True)))


def transposed(a: Matrix3) -> Matrix3:
    """Rows as columns."""
    return cast(Matrix3, tuple(zip(*a, strict=True)))


def as_array(a: Matrix3) -> Float[Array, "3 3"]:
    """The same matrix as one array."""
    return jnp.stack([jnp.stack(row) for row in a])


def as_numbers(a: Float[Array, "3 3"]) -> Matrix3:
    """The same matrix as nine numbers."""
    return cast(Matrix3, tuple(tuple(row) for row in a))


def times(a: Float[Array, "3 3"], b: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
    """The product A B."""
    return jnp.sum(a[:, :, None] * b[None], axis=1)


def image(a: Matrix3, v: Vector3) -> Vector3:
    """A v."""
    return cast(Vector3, tuple(dot(row, v) for row in a))


def largest(v: Sequence[Scalar]) -> Traced:
    """The largest component's size."""
    return reduce(jnp.maximum, map(jnp.abs, v))


def fixed_point_move(a: Matrix3, residual: Vector3) -> Vector3:
    """(I - A)^-1 r: Newton's step from x to the fixed point, of r = H(x) - x."""
    rows = zip(UNIT, a, strict=True)
    m = cast(Matrix3, tuple(minus(cast(Vector3, e), row) for e, row in rows))
    adjugate = _adjugate(m)
    determinant = dot(m[0], transposed(adjugate)[0])
    safe = jnp.where(determinant == 0, jnp.nan, determinant)
    return cast(Vector3, tuple(x / safe for x in image(adjugate, residual)))


def _cross(v: Vector3, w: Vector3) -> Vector3:
    return (
        v[1] * w[2] - v[2] * w[1],
        v[2] * w[0] - v[0] * w[2],
        v[0] * w[1] - v[1] * w[0],
    )


def _adjugate(m: Matrix3) -> Matrix3:
    """Determinant times inverse: its columns are cross products of rows."""
    return transposed((_cross(m[1], m[2]), _cross(m[2], m[0]), _cross(m[0], m[1])))


def spectral_radius(a: Matrix3) -> Traced:
    r"""The largest modulus of an eigenvalue, by squaring: |A^N|^(1/N), N = 2^24.

    Of the sizes $s_i$ that are divided out before each squaring, with square roots
    alone: $s_0 \sqrt{s_1 \sqrt{s_2 \dots}}$.
    """

    def square(power, _):
        size = jnp.max(jnp.abs(power))
        power = power / jnp.where(size > 0, size, 1.0)
        return times(power, power), size

    _, sizes = lax.scan(square, as_array(a), None, length=SQUARINGS)
    one = 1.0 + 0.0 * a[0][0]
    return lax.scan(lambda x, s: (s * jnp.sqrt(x), None), one, sizes, reverse=True)[0]


def contraction_norm(a: Matrix3, radius: Scalar) -> Matrix3:
    """P of the norm in which A contracts, where its radius is below 1."""
    share = 2 / (1 + jnp.minimum(radius, SLOWEST))

    def double(_, now):
        p, power = now
        return p + times(times(power.T, p), power), times(power, power)

    first = as_array(a) * share
    one = jnp.asarray(UNIT, first.dtype) + 0.0 * first
    return as_numbers(lax.fori_loop(0, DOUBLINGS, double, (one, first))[0])


def trace(p: Matrix3) -> Traced:
    """The sum of the diagonal."""
    return p[0][0] + p[1][1] + p[2][2]


def contraction_rate(p: Matrix3, radius: Scalar) -> Traced:
    """A bound of |A|_P."""
    return (1 + radius) / 2 * jnp.sqrt(jnp.maximum(1 - 1 / trace(p), 0.0))


def length(p: Matrix3, v: Vector3) -> Traced:
    """|v|_P."""
    return jnp.sqrt(jnp.maximum(dot(v, image(p, v)), 0.0))


def contracts(p: Matrix3, a: Matrix3) -> Bool[Array, ""]:
    """Whether |A|_P < 1: P - A^T P A is positive definite, by its leading minors."""
    by = as_array(a)
    m = as_numbers(as_array(p) - times(times(by.T, as_array(p)), by))
    second = m[0][0] * m[1][1] - m[0][1] * m[1][0]
    third = dot(m[0], transposed(_adjugate(m))[0])
    return (m[0][0] > 0) & (second > 0) & (third > 0)
