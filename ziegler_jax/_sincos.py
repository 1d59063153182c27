"""Sine and cosine of one angle together, without a library call: XLA vectorises it.

XLA on a CPU calls the C library's `sin` and `cos` lane by lane for float64, which costs
more than all the rest of the column's field. Here one range reduction serves both.
"""

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

# pi/2 in three parts of at most 33 significant bits, so that their products with a
# quadrant number below 2**20 are exact (Cody & Waite; the split is fdlibm's).
_HALF_PI = (1.57079632673412561417e00, 6.07710050630396597660e-11)
_HALF_PI_REST = 2.02226624879595063154e-21
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


@jax.custom_jvp
def sincos(x: ArrayLike) -> tuple[jax.Array, jax.Array]:
    r"""$\sin x$ and $\cos x$.

    float64: the error is below 1 unit in the last place for $|x| \le 10^5$ (measured
    0.76), and stays there up to $|x| = 2^{20} \pi/2$. Beyond, the reduction's
    products round and the absolute error is at most $2^{-52} |x|$, what a change of x
    in its own last place makes; a result that has lost every digit
    ($|x| > 2^{50}$) is NaN. float32 uses `jnp.sin` and `jnp.cos`.

    **Arguments:** `x`: an angle in radians, any shape.

    **Returns:** `(sin x, cos x)`.
    """
    x = jnp.asarray(x)
    if x.dtype != jnp.float64:
        return jnp.sin(x), jnp.cos(x)
    n = jnp.round(x * 0.63661977236758134308)
    first = x - n * _HALF_PI[0]  # exact: both are multiples of one small power of two
    second = n * _HALF_PI[1]
    r = first - second
    # what the subtraction rounded off (Knuth's two-sum), and the third part of pi/2
    part = r - first
    rest = (first - (r - part)) - (second + part) - n * _HALF_PI_REST
    hi = r + rest
    lo = (r - hi) + rest
    z = hi * hi
    s = jnp.full_like(x, _SIN[0])
    c = jnp.full_like(x, _COS[0])
    for sin_term, cos_term in zip(_SIN[1:], _COS[1:], strict=True):
        s = s * z + sin_term
        c = c * z + cos_term
    half = 0.5 * z
    one = 1.0 - half
    s = hi + (hi * (z * s) + lo * one)
    c = one + (((1.0 - one) - half) + (z * z * c - hi * lo))
    turn = n * 0.25 - jnp.floor(n * 0.25)  # 0, 1/4, 1/2, 3/4 of a turn
    odd = (turn == 0.25) | (turn == 0.75)
    s, c = jnp.where(odd, c, s), jnp.where(odd, s, c)
    s = jnp.where(turn >= 0.5, -s, s)
    c = jnp.where((turn == 0.25) | (turn == 0.5), -c, c)
    lost = jnp.abs(x) > 2.0**50
    return jnp.where(lost, jnp.nan, s), jnp.where(lost, jnp.nan, c)


@sincos.defjvp
def _sincos_jvp(primals, tangents):
    s, c = sincos(primals[0])
    return (s, c), (c * tangents[0], -s * tangents[0])
