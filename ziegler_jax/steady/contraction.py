r"""Return maps of a few numbers near a fixed point: do they contract?

A map of the section $H(x)$ has the fixed point $x^*$ and there the derivative $M$ with
spectral radius $\rho$. Where $\rho < 1$ there is a norm in which $M$ contracts at once,

$$|v|_P^2 = v^T P\,v, \qquad P = \sum_{j \ge 0} (A^T)^j A^j, \qquad A = \frac{2 M}{1 +
\rho}, \qquad |M|_P \le \frac{1 + \rho}{2} \sqrt{1 - \frac{1}{\mathrm{tr} P}},$$

for $|A v|_P^2 = |v|_P^2 - |v|^2$. Sums and products only: of two rods, and so of three
numbers, a batch needs no LAPACK.

Vectors and matrices are arrays: what is seldom asked for would be many more
instructions to compile as single numbers.
"""

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float

from ..motion.implicit import solve
from ..numerics.numbers import Scalar

Vector = Float[Array, " m"]
Matrix = Float[Array, "m m"]

SQUARINGS = 24  # of M for its radius: what is left of its shape is 2^-24 of a logarithm
DOUBLINGS = 16  # of the sum for P
TINY = 1e-12  # of a point: no motion returns from there
SLOWEST = 0.9995  # no norm is worked out for a radius above: none is asked for


def unit(a: Matrix) -> Matrix:
    """The unit matrix of the same size."""
    return jnp.asarray(np.eye(len(a)), a.dtype)


def times(a: Matrix, b: Matrix) -> Matrix:
    """The product A B, without the libraries that `@` would call."""
    return jnp.sum(a[:, :, None] * b[None], axis=1)


def image(a: Matrix, v: Vector) -> Vector:
    """A v."""
    return jnp.sum(a * v[None], axis=1)


def largest(v: Vector) -> Scalar:
    """The largest component's size."""
    return jnp.max(jnp.abs(v))


def size_of(x: Vector) -> Scalar:
    """The size of a point of the section, to divide by."""
    return jnp.maximum(largest(x), TINY)


def fixed_point_move(a: Matrix, residual: Vector) -> Vector:
    """(I - A)^-1 r: Newton's step from x to the fixed point, of r = H(x) - x."""
    m = unit(a) - a
    if len(a) != 3:
        return solve(m, residual)
    cofactors = _cofactors(m)
    determinant = jnp.sum(m[0] * cofactors[0])
    safe = jnp.where(determinant == 0, jnp.nan, determinant)
    return image(cofactors.T, residual) / safe


def _cofactors(m: Matrix) -> Matrix:
    """Determinant times inverse, transposed: cross products of two rows each."""
    one, other = jnp.roll(m, -1, 0), jnp.roll(m, -2, 0)
    turned = jnp.roll(one, -1, 1) * jnp.roll(other, -2, 1)
    return turned - jnp.roll(one, -2, 1) * jnp.roll(other, -1, 1)


def spectral_radius(a: Matrix) -> Scalar:
    r"""The largest modulus of an eigenvalue, by squaring: |A^N|^(1/N), N = 2^24.

    Of the sizes $s_i$ that are divided out before each squaring, with square roots
    alone: $s_0 \sqrt{s_1 \sqrt{s_2 \dots}}$.
    """

    def square(power, _):
        size = jnp.max(jnp.abs(power))
        power = power / jnp.where(size > 0, size, 1.0)
        return times(power, power), size

    _, sizes = lax.scan(square, a, None, length=SQUARINGS)
    one = 1.0 + 0.0 * a[0, 0]
    return lax.scan(lambda x, s: (s * jnp.sqrt(x), None), one, sizes, reverse=True)[0]


def contraction_norm(a: Matrix, radius: Scalar) -> Matrix:
    """P of the norm in which A contracts, where its radius is below 1."""
    share = 2 / (1 + jnp.minimum(radius, SLOWEST))

    def double(_, now):
        p, power = now
        return p + times(times(power.T, p), power), times(power, power)

    first = a * share
    one = unit(a) + 0.0 * first
    return lax.fori_loop(0, DOUBLINGS, double, (one, first))[0]


def contraction_rate(p: Matrix, radius: Scalar) -> Scalar:
    """A bound of |A|_P."""
    return (1 + radius) / 2 * jnp.sqrt(jnp.maximum(1 - 1 / jnp.trace(p), 0.0))


def length(p: Matrix, v: Vector) -> Scalar:
    """|v|_P."""
    return jnp.sqrt(jnp.maximum(jnp.sum(v * image(p, v)), 0.0))


def contracts(p: Matrix, a: Matrix) -> Bool[Array, ""]:
    """Whether |A|_P < 1: P - A^T P A is positive definite, by its leading minors.

    Of more than three numbers by its Cholesky factor.
    """
    m = p - times(times(a.T, p), a)
    if len(a) != 3:
        return jnp.all(jnp.isfinite(jnp.linalg.cholesky(m)))
    second = m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0]
    third = jnp.sum(m[0] * _cofactors(m)[0])
    return (m[0, 0] > 0) & (second > 0) & (third > 0)
