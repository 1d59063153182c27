"""Sine, cosine, exponential and hyperbolic tangent without library calls.

XLA on a CPU calls the C library's `sin` and `cos` lane by lane for float64, which costs
more than all the rest of the column's field. Here one range reduction serves both, and
XLA vectorises it. Its exponential and hyperbolic tangent are vectorised, but spend a
division each; the friction law evaluates four of them a stage, and they were half of a
step's time. Here one polynomial serves both, with few divisions.
"""

from typing import overload

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike

from .materialise import materialise
from .numbers import Scalar
from .series import Series, sincos_series

# pi/2 in three parts; the first two have at most 33 significant bits, so that their
# products with a quadrant number below 2**20 are exact (Cody & Waite; the split is
# fdlibm's).
_HALF_PI = (
    1.57079632673412561417e00,
    6.07710050630396597660e-11,
    2.02226624879595063154e-21,
)
# Added to a whole number, it leaves that number's last bits on view.
_BITS = 1.5 * 2.0**52
# Kernels on |r| <= pi/4, highest power first (fdlibm's minimax coefficients).
_SIN = (
    1.58969099521155010221e-10,
    -2.50507602534068634195e-08,
    2.75573137070700676789e-06,
    -1.98412698298579493134e-04,
    8.33333333332248946124e-03,
    -1.66666666666666324348e-01,
)
_COS = (
    -1.13596475577881948265e-11,
    2.08757232129817482790e-09,
    -2.75573143513906633035e-07,
    2.48015872894767294178e-05,
    -1.38888888888741095749e-03,
    4.16666666666666019037e-02,
)


@overload
def sincos(x: Series) -> tuple[Series, Series]: ...
@overload
def sincos(x: ArrayLike) -> tuple[jax.Array, jax.Array]: ...
def sincos(
    x: Series | ArrayLike,
) -> tuple[Series, Series] | tuple[jax.Array, jax.Array]:
    r"""$\sin x$ and $\cos x$.

    float64: the error is about 1 unit in the last place for $|x| \le 10^5$ (measured
    1.0), about 6 up to $|x| = 2^{20} \pi/2$. Beyond, the reduction's products
    round and the absolute error is at most $2^{-52} |x|$, what a change of x in its own
    last place makes; where every digit is lost ($|x| > 2^{50}$) the result is NaN.
    float32 uses `jnp.sin` and `jnp.cos`.

    **Arguments:** `x`: an angle in radians, any shape; or a `Series`.

    **Returns:** `(sin x, cos x)`.
    """
    if isinstance(x, Series):
        return sincos_series(x, _sincos)
    return _sincos(x)


@jax.custom_jvp
def _sincos(x: ArrayLike) -> tuple[jax.Array, jax.Array]:
    x = jnp.asarray(x)
    if x.dtype != jnp.float64:
        return jnp.sin(x), jnp.cos(x)
    n = jnp.round(x * 0.63661977236758134308)
    s, c = materialise(x, _kernels, x, n)  # else each is computed twice
    return materialise(x, _picked, n, s, c)


def _picked(n: jax.Array, s: jax.Array, c: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Sine and cosine of x from those of x - n pi/2."""
    quadrant = lax.bitcast_convert_type(n + _BITS, jnp.int64)
    odd = (quadrant & 1) == 1
    s, c = jnp.where(odd, c, s), jnp.where(odd, s, c)
    return _negate_if(quadrant & 2, s), _negate_if((quadrant + 1) & 2, c)


def _kernels(x: jax.Array, n: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Sine and cosine of x - n pi/2, which lies within +-pi/4."""
    first = x - n * _HALF_PI[0]  # exact
    second = n * _HALF_PI[1]  # exact
    r = first - second
    tail = ((first - r) - second) - n * _HALF_PI[2]  # what r rounded off
    r = jnp.where(jnp.abs(x) <= 2.0**50, r, jnp.nan)
    z = r * r
    s, c = _polynomial(_SIN, z), _polynomial(_COS, z)
    s = r + (r * (z * s) + tail)
    c = 1.0 - (0.5 * z - (z * z * c - r * tail))
    return s, c


def _negate_if(two: jax.Array, x: jax.Array) -> jax.Array:
    """-x where `two` is 2, x where it is 0: its bit moves onto the sign."""
    bits = lax.bitcast_convert_type(x, jnp.int64) ^ (two << 62)
    return lax.bitcast_convert_type(bits, jnp.float64)


@_sincos.defjvp
def _sincos_jvp(primals, tangents):
    s, c = _sincos(primals[0])
    return (s, c), (c * tangents[0], -s * tangents[0])


# ln 2 in two parts, the first with 32 trailing zeros: n times it is exact (fdlibm's)
_LN2 = (6.93147180369123816490e-01, 1.90821492927058770002e-10)
# (e^r - 1 - r) / r^2 on |r| <= ln(2)/2, highest power first: interpolation at the ten
# Chebyshev points, computed with 60 digits; it leaves 1.3e-17 of e^r
_SERIES = (
    2.510038549551032e-08,
    2.7620088445409746e-07,
    2.7557268459997064e-06,
    2.4801521295954376e-05,
    0.00019841269863053618,
    0.0013888888917213717,
    0.008333333333330062,
    0.04166666666662413,
    0.16666666666666669,
    0.5000000000000001,
)


@jax.custom_jvp
def exp(x: ArrayLike) -> jax.Array:
    r"""$e^x$ for $x \le 700$; below -700 it is $e^{-700}$, 1e-304.

    float64: the error is below 1 unit in the last place. float32 uses `jnp.exp`.
    """
    x = jnp.asarray(x)
    if x.dtype != jnp.float64:
        return jnp.exp(x)
    power, part = _split(jnp.where(x < -700.0, -700.0, x))
    return power + power * part


@exp.defjvp
def _exp_jvp(primals, tangents):
    y = exp(primals[0])
    return y, y * tangents[0]


@jax.custom_jvp
def tanh(x: ArrayLike) -> jax.Array:
    r"""$\tanh x = \frac{e^{2x} - 1}{e^{2x} + 1}$.

    float64: the error is below 3 units in the last place, near zero too, because
    $e^{2x} - 1$ is computed as such. float32 uses `jnp.tanh`.
    """
    x = jnp.asarray(x)
    if x.dtype != jnp.float64:
        return jnp.tanh(x)
    y = 2.0 * jnp.abs(x)  # from 40 on the result is 1 to the last place
    power, part = _split(jnp.where(y > 40.0, 40.0, y))
    less_one = power * part + (power - 1.0)
    return _signed(less_one / (less_one + 2.0), x)


@tanh.defjvp
def _tanh_jvp(primals, tangents):
    y = tanh(primals[0])
    return y, (1.0 - y * y) * tangents[0]


# log2(1 + m) / m for 0 <= m <= 1 and (2^r - 1) / r for |r| <= 1/2, highest power first,
# interpolated at Chebyshev points (the first also at m = 1): within 1e-5 and 7e-6
_LOG2 = (
    *(-0.0335643524155375, 0.143951318244504, -0.3012792159529009),
    *(0.4685605964065022, -0.7203496863399088, 1.442681340057341),
)
_EXP2 = (
    *(0.009656710288544356, 0.055838282946219855),
    *(0.24022530097412242, 0.6931367338836215),
)


def short_power(x: jax.Array, exponent: ArrayLike) -> jax.Array:
    r"""$x^p$ to five digits, for positive numbers that are not subnormal.

    float64: the error is below $7 \cdot 10^{-6} (1 + |p|)$, where $|p| \le 1$, and
    there is no derivative. float32 uses `jnp.exp` and `jnp.log`.
    """
    if x.dtype != jnp.float64:
        return jnp.exp(exponent * jnp.log(x))
    bits = lax.bitcast_convert_type(x, jnp.int64)
    fraction = (bits & np.int64(2**52 - 1)) | np.int64(1023 << 52)
    m = lax.bitcast_convert_type(fraction, jnp.float64) - 1.0
    # 2^52 and a whole number below it: that number's bits are the last
    biased = lax.bitcast_convert_type((bits >> 52) | np.int64(1075 << 52), jnp.float64)
    log2 = (biased - (2.0**52 + 1023.0)) + m * _polynomial(_LOG2, m)
    y = jnp.asarray(exponent * log2)
    n = jnp.round(y)
    r = y - n
    power = lax.bitcast_convert_type(n + (_BITS + 1023.0), jnp.int64) << 52
    part = 1.0 + r * _polynomial(_EXP2, r)
    return lax.bitcast_convert_type(power, jnp.float64) * part


def _polynomial(coefficients: tuple[float, ...], x: ArrayLike) -> jax.Array:
    """Highest power first."""
    value = jnp.full_like(x, coefficients[0])
    for term in coefficients[1:]:
        value = value * x + term
    return value


def larger(a: Scalar, b: Scalar) -> jax.Array:
    """The larger number, or b where one is NaN; `jnp.maximum` looks for NaN besides."""
    return jnp.where(a > b, a, b)


def smaller(a: Scalar, b: Scalar) -> jax.Array:
    """The smaller number, or b where one is NaN."""
    return jnp.where(a < b, a, b)


def _signed(size: jax.Array, x: jax.Array) -> jax.Array:
    """A size with the sign of x: that bit alone."""
    sign = lax.bitcast_convert_type(x, jnp.int64) & np.int64(-(2**63))
    bits = lax.bitcast_convert_type(size, jnp.int64) | sign
    return lax.bitcast_convert_type(bits, jnp.float64)


def _split(x: jax.Array) -> tuple[jax.Array, jax.Array]:
    """2^n and e^r - 1 with x = n ln 2 + r."""
    n = jnp.round(x * 1.44269504088896338700)
    r = (x - n * _LN2[0]) - n * _LN2[1]
    series = _polynomial(_SERIES, r)
    exponent = lax.bitcast_convert_type(n + (_BITS + 1023.0), jnp.int64)
    power = lax.bitcast_convert_type(exponent << 52, jnp.float64)
    return power, r + r * r * series
