"""Sine and cosine of one angle together, without a library call: XLA vectorises it.

XLA on a CPU calls the C library's `sin` and `cos` lane by lane for float64, which costs
more than all the rest of the column's field. Here one range reduction serves both.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jax.typing import ArrayLike

from ._materialise import materialise
from ._series import Series, sincos_series

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


def sincos(x: Any) -> tuple[Any, Any]:
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
    # a batch's worth of both kernels is kept: each use only picks and signs them
    s, c = materialise(x, _kernels, x, n)
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
    s = jnp.full_like(x, _SIN[0])
    c = jnp.full_like(x, _COS[0])
    for sin_term, cos_term in zip(_SIN[1:], _COS[1:], strict=True):
        s = s * z + sin_term
        c = c * z + cos_term
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
