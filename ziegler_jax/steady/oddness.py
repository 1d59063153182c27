"""Whether the mirror image of each motion is a motion: f(-y) = -f(y)."""

from typing import cast

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from ..model.column import Column, vector_field
from ..model.set_valued import in_modes
from ..motion.scene import prepared
from ..numerics.numbers import Flag, Pair, Traced4

SAMPLES = 24
ROUNDING = 1e-9


def is_odd(column: Column) -> Flag:
    """Whether the field is odd at states of all sizes: evaluated, not by its name."""
    dtype = jnp.result_type(float)
    source = np.random.default_rng(20)
    scale = 10.0 ** np.stack(
        [source.uniform(low, 0.3, SAMPLES) for low in (-3, -3, -5, -5)]
    )
    samples = jnp.asarray(source.uniform(-1, 1, (4, SAMPLES)) * scale, dtype)
    # XLA would compute with known numbers while it compiles, for minutes
    samples = lax.optimization_barrier(samples)
    whole = prepared(column)

    def uneven(y: Traced4, modes: tuple[float, float]) -> jax.Array:
        mirrored = cast(Traced4, tuple(-x for x in y))
        here, there = whole, whole
        if column.sticks:
            here, there = (in_modes(whole, _turned(s, modes)) for s in (1.0, -1.0))
        one = vector_field(jnp.zeros((), dtype), y, here)
        other = vector_field(jnp.zeros((), dtype), mirrored, there)
        size = sum((jnp.abs(x) for x in one), jnp.ones((), dtype))
        apart = sum((jnp.abs(a + b) for a, b in zip(one, other, strict=True)), 0.0)
        return apart > ROUNDING * size

    odd = jnp.asarray(True)
    for modes in ((1.0, 1.0), (1.0, -1.0), (0.0, 1.0)) if column.sticks else ((1, 1),):
        apart = jax.vmap(lambda *y: uneven(y, modes))(*samples)  # noqa: B023
        odd &= ~jnp.any(apart)
    return odd


def _turned(sign: float, modes: tuple[float, float]) -> Pair:
    dtype = jnp.result_type(float)
    m1, m2 = (jnp.asarray(sign * m, dtype) for m in modes)
    return m1, m2
