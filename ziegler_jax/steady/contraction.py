r"""Return maps of three numbers near a fixed point: do they contract?

A map of the section $H(x)$ has the fixed point $x^*$ and there the derivative $M$ with
spectral radius $\rho$. Where $\rho < 1$ there is a norm in which $M$ contracts at once,

$$|v|_P^2 = v^T P\,v, \qquad P = \sum_{j \ge 0} (A^T)^j A^j, \qquad A = \frac{2 M}{1 +
\rho}, \qquad |M|_P \le \frac{1 + \rho}{2} \sqrt{1 - \frac{1}{\mathrm{tr} P}},$$

for $|A v|_P^2 = |v|_P^2 - |v|^2$. Sums and products only: a batch needs no LAPACK.
"""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from ..numerics.numbers import Scalar

Vector3 = Float[Array, "3"]
Matrix3 = Float[Array, "3 3"]
Number = Float[Array, ""]

SQUARINGS = 24  # of M for its radius: what is left of its shape is 2^-24 of a logarithm
DOUBLINGS = 16  # of the sum for P
TINY = 1e-12  # of a point: no motion returns from there
SLOWEST = 0.9995  # no norm is worked out for a radius above: none is asked for


def times(a: Matrix3, b: Matrix3) -> Matrix3:
    """The product A B."""
    return jnp.sum(a[:, :, None] * b[None, :, :], axis=1)


def image(a: Matrix3, v: Vector3) -> Vector3:
    """A v."""
    return jnp.sum(a * v[None, :], axis=1)


def largest(v: Float[Array, "..."]) -> Number:
    """The largest component's size."""
    return jnp.max(jnp.abs(v))


def fixed_point_move(a: Matrix3, residual: Vector3) -> Vector3:
    """(I - A)^-1 r: Newton's step from x to the fixed point, of r = H(x) - x."""
    adjugate = _adjugate(jnp.eye(3, dtype=a.dtype) - a)
    m = jnp.eye(3, dtype=a.dtype) - a
    determinant = jnp.sum(m[0] * adjugate[:, 0])
    safe = jnp.where(determinant == 0, jnp.nan, determinant)
    return image(adjugate, residual) / safe


def _adjugate(m: Matrix3) -> Matrix3:
    """Determinant times inverse: its columns are cross products of rows."""
    after, before = jnp.roll(m, -1, axis=0), jnp.roll(m, -2, axis=0)
    crossed = jnp.roll(after, -1, axis=1) * jnp.roll(before, -2, axis=1)
    crossed -= jnp.roll(after, -2, axis=1) * jnp.roll(before, -1, axis=1)
    return crossed.T


def spectral_radius(a: Matrix3) -> Number:
    """The largest modulus of an eigenvalue, by squaring: |A^N|^(1/N), N = 2^24."""

    def square(i, now):
        a, total = now
        size = largest(a)
        there = size > 0
        size = jnp.where(there, size, 1.0)
        a, share = a / size, jnp.where(there, jnp.log(size), -jnp.inf)
        return times(a, a), total + share * 0.5**i

    _, total = lax.fori_loop(0, SQUARINGS, square, (a, jnp.zeros((), a.dtype)))
    return jnp.exp(total)


def contraction_norm(a: Matrix3, radius: Scalar) -> Matrix3:
    """P of the norm in which A contracts, where its radius is below 1."""
    scaled = a * (2 / (1 + jnp.minimum(radius, SLOWEST)))

    def double(_, now):
        p, a = now
        return p + times(times(a.T, p), a), times(a, a)

    first = jnp.eye(3, dtype=a.dtype), scaled
    return lax.fori_loop(0, DOUBLINGS, double, first)[0]


def contraction_rate(p: Matrix3, radius: Scalar) -> Number:
    """A bound of |A|_P."""
    trace = p[0, 0] + p[1, 1] + p[2, 2]
    return (1 + radius) / 2 * jnp.sqrt(jnp.maximum(1 - 1 / trace, 0.0))


def length(p: Matrix3, v: Vector3) -> Number:
    """|v|_P."""
    return jnp.sqrt(jnp.maximum(jnp.sum(v * image(p, v)), 0.0))


def contracts(p: Matrix3, a: Matrix3) -> Bool[Array, ""]:
    """Whether |A|_P < 1: P - A^T P A is positive definite, by its leading minors."""
    m = p - times(times(a.T, p), a)
    second = m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0]
    third = jnp.sum(m[0] * _adjugate(m)[:, 0])
    return (m[0, 0] > 0) & (second > 0) & (third > 0)
