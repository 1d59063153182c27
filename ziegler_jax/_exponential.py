"""Exponential and hyperbolic tangent by one polynomial, with few divisions.

XLA's own are vectorised, but spend a division each; the friction law evaluates four of
them a stage, and they were half of a step's time.
"""

import jax
import jax.numpy as jnp
from jax import lax
from jax.typing import ArrayLike

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
# Added to a whole number, it leaves that number's last bits on view.
_BITS = 1.5 * 2.0**52


@jax.custom_jvp
def exp(x: ArrayLike) -> jax.Array:
    r"""$e^x$ for $x \le 700$; zero below -700, which is 1e-304.

    float64: the error is below 1 unit in the last place. float32 uses `jnp.exp`.
    """
    x = jnp.asarray(x)
    if x.dtype != jnp.float64:
        return jnp.exp(x)
    power, part = _split(jnp.where(x < -700.0, -700.0, x))
    return jnp.where(x < -700.0, 0.0, power + power * part)


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
    size = less_one / (less_one + 2.0)
    return jnp.where(x < 0.0, -size, size)


@tanh.defjvp
def _tanh_jvp(primals, tangents):
    y = tanh(primals[0])
    return y, (1.0 - y * y) * tangents[0]


def _split(x: jax.Array) -> tuple[jax.Array, jax.Array]:
    """2^n and e^r - 1 with x = n ln 2 + r."""
    n = jnp.round(x * 1.44269504088896338700)
    r = (x - n * _LN2[0]) - n * _LN2[1]
    series = jnp.full_like(x, _SERIES[0])
    for term in _SERIES[1:]:
        series = series * r + term
    exponent = lax.bitcast_convert_type(n + _BITS, jnp.int64) + 1023
    power = lax.bitcast_convert_type(exponent << 52, jnp.float64)
    return power, r + r * r * series
