"""Sine, cosine, powers of two and hyperbolic tangent without library calls.

XLA on a CPU calls the C library's `sin` and `cos` lane by lane for float64, which costs
more than all the rest of the column's field. Here both are polynomials of what is left
of the angle by half turns, and XLA vectorises them. Its exponential and hyperbolic
tangent are vectorised, but spend a division each; the friction law evaluates four of
them a stage, and they were half of a step's time. Here both are quotients of powers of
two, whose whole exponent leaves an exact rest, and a law divides but once.
"""

from typing import overload

import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike

from .materialise import materialise, traced_once
from .numbers import Scalar
from .series import Series, sincos_series

# pi in two parts: the first has 31 significant bits, so that its products with a number
# of half turns below 2^22 are exact; both together leave 7e-27 of pi
_PI = (3.1415926534682512, 1.2154201013012384e-10)
# Added to a whole number, it leaves that number's last bits on view.
_BITS = 1.5 * 2.0**52
# (sin r / r - 1) / r^2 and (cos r - 1) / r^2 in powers of r^2 on |r| <= pi/2, highest
# first: interpolation at the eight Chebyshev points, computed with 60 digits; they
# leave 3.6e-17 of the sine and 1.7e-17 of the cosine
_SIN = (
    2.7314447669074988e-15,
    -7.643970296792245e-13,
    1.605897731246389e-10,
    -2.505210761699618e-08,
    2.7557319219163234e-06,
    -0.00019841269841254974,
    0.008333333333333316,
    -0.16666666666666666,
)
_COS = (
    4.6276759848687014e-14,
    -1.1464689885708041e-11,
    2.0876630867422618e-09,
    -2.755731776732052e-07,
    2.4801587292446213e-05,
    -0.0013888888888860709,
    0.04166666666666634,
    -0.5,
)


@overload
def sincos(x: Series) -> tuple[Series, Series]: ...
@overload
def sincos(x: ArrayLike) -> tuple[jax.Array, jax.Array]: ...
def sincos(
    x: Series | ArrayLike,
) -> tuple[Series, Series] | tuple[jax.Array, jax.Array]:
    r"""$\sin x$ and $\cos x$.

    float64: the error is at most 3.3e-16 for $|x| \le 10^6$ (measured 2.8e-16, and
    3.2e-16 on a processor that rounds products before it adds them), and of a small
    angle's sine 2 units in its last place. Beyond, the reduction's products round, and
    the error is at most $2^{-52} |x|$, what a change of x in its own last place makes;
    where every digit is lost ($|x| > 2^{50}$) the result is NaN. float32 uses
    `jnp.sin` and `jnp.cos`.

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
    if isinstance(x, jax.core.Tracer):
        return _reduced(x)
    # as one traced call: op by op, `debug_nans` would stop at the NaN of no digits
    return traced_once(_reduced, x)(x)


def _reduced(x: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Sine and cosine by half turns."""
    n = jnp.round(x * 0.3183098861837907)
    n = jnp.where(jnp.abs(x) <= 2.0**50, n, jnp.nan)
    return materialise(x, _kernels, x, n)


def _kernels(x: jax.Array, n: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Sine and cosine from those of x - n pi, which lies within +-pi/2."""
    r = (x - n * _PI[0]) - n * _PI[1]
    z = r * r
    s, c = r + r * z * _polynomial(_SIN, z), 1.0 + z * _polynomial(_COS, z)
    odd = lax.bitcast_convert_type(n + _BITS, jnp.int64) << 63  # onto the sign
    return _signed(s, odd), _signed(c, odd)


@_sincos.defjvp
def _sincos_jvp(primals, tangents):
    s, c = _sincos(primals[0])
    return (s, c), (c * tangents[0], -s * tangents[0])


# 2^r = (Q + r P) / (Q - r P) on |r| <= 1/2, P and Q in powers of r^2, highest first:
# r P / Q is tanh(r ln(2) / 2), of whose quotient by r it is the rational function that
# meets it at five Chebyshev points, computed with 60 digits; it leaves 6e-18 of 2^r
_P = (0.02309439945381985, 20.20167064946754, 1513.8607506709043)
_Q = (1.0, 233.17775197529696, 4368.078795178714)
LOG2_E = 1.4426950408889634
_LN_2 = 0.6931471805599453


@jax.custom_jvp
def half_to_the(x: ArrayLike) -> tuple[jax.Array, jax.Array]:
    r"""Numerator and denominator of $2^{-x}$ for $x \ge -1000$.

    Above 1000 it is $2^{-1000}$. float64: the quotient's error is below 3 units in the
    last place. float32 uses `jnp.exp2`. Derivatives are those of the quotient.
    """
    x = jnp.asarray(x)
    if x.dtype != jnp.float64:
        return jnp.exp2(-x), jnp.ones_like(x)
    x = jnp.where(x > 1000.0, 1000.0, x)
    n = jnp.round(x)
    even, odd = _even_and_odd(n - x)
    exponent = lax.bitcast_convert_type(n + _BITS, jnp.int64) << 52
    bits = lax.bitcast_convert_type(even + odd, jnp.int64) - exponent
    return lax.bitcast_convert_type(bits, jnp.float64), even - odd


@half_to_the.defjvp
def _half_to_the_jvp(primals, tangents):
    numerator, denominator = half_to_the(primals[0])
    moved = -_LN_2 * numerator * tangents[0]
    moved = jnp.where(primals[0] > 1000.0, 0.0, moved)
    return (numerator, denominator), (moved, jnp.zeros_like(moved))


@jax.custom_jvp
def tanh2(x: ArrayLike) -> tuple[jax.Array, jax.Array, jax.Array]:
    r"""Numerator n and denominator d of $(2^x - 1) / (2^x + 1)$, and $d^2 - n^2$.

    That is $\tanh(\tfrac12 x \ln 2)$; $(d^2 - n^2) / d^2$ is one less its square, and
    zero where it is 1. float64: the quotient's error is below 5 units in the last
    place, near zero too. float32 uses `jnp.tanh`. Derivatives are those of quotients.
    """
    x = jnp.asarray(x)
    if x.dtype != jnp.float64:
        rise = jnp.tanh(x * np.float32(0.5 * _LN_2))
        return rise, jnp.ones_like(x), 1.0 - rise * rise
    far = jnp.abs(x) > 60.0  # there the quotient is 1 to the last place
    x = jnp.where(x > 60.0, 60.0, x)
    x = jnp.where(x < -60.0, -60.0, x)
    n = jnp.round(x)
    even, odd = _even_and_odd(x - n)
    exponent = lax.bitcast_convert_type(n + (_BITS + 1023.0), jnp.int64)
    power = lax.bitcast_convert_type(exponent << 52, jnp.float64)
    above, below = even + odd, even - odd
    # not the difference of the two: near zero that would lose digits
    less = (power - 1.0) * even + (power + 1.0) * odd
    product = jnp.where(far, 0.0, 4.0 * (power * above) * below)
    return less, power * above + below, product


@tanh2.defjvp
def _tanh2_jvp(primals, tangents):
    """With the denominator as it is; nothing cancels."""
    n, d, product = tanh2(primals[0])
    moved = 0.5 * _LN_2 * tangents[0] / d
    slopes = product * moved, jnp.zeros_like(moved), -2.0 * n * product * moved
    return (n, d, product), slopes


def _even_and_odd(r: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Q and r P."""
    z = r * r
    return _polynomial(_Q, z), r * _polynomial(_P, z)


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


def _signed(x: jax.Array, sign: jax.Array) -> jax.Array:
    """x, or -x where `sign` has its first bit set."""
    bits = lax.bitcast_convert_type(x, jnp.int64) ^ sign
    return lax.bitcast_convert_type(bits, jnp.float64)
