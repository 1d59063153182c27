"""Whether the mirror image of each motion is a motion: f(-y) = -f(y)."""

from typing import cast

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from ..model.column import Column
from ..model.set_valued import in_modes
from ..motion.scene import field, prepared
from ..numerics.numbers import Flag, Pair, Traced4

SAMPLES = 24
MODES = ((1.0, 1.0), (1.0, -1.0), (0.0, 1.0))  # of joints with set-valued friction
ROUNDING = 1e-9


def is_odd(column: Column) -> Flag:
    """Whether the field is odd at states of all sizes: evaluated, not by its name."""
    dtype = jnp.result_type(float)
    source = np.random.default_rng(20)
    scale = 10.0 ** np.stack(
        [source.uniform(low, 0.3, SAMPLES) for low in (-3, -3, -5, -5)]
    )
    samples = source.uniform(-1, 1, (4, SAMPLES)) * scale
    modes = np.array(MODES if column.sticks else MODES[:1])
    each = np.repeat(np.arange(len(modes)), SAMPLES)
    half = np.concatenate([np.tile(samples, len(modes)), modes[each].T])
    # XLA would compute with known numbers while it compiles, for minutes
    rows = lax.optimization_barrier(jnp.asarray(np.hstack([half, -half]), dtype))
    whole = prepared(column)

    def slope(row: Float[Array, " 6"]) -> Float[Array, " 4"]:
        y4, sliding = cast(Traced4, tuple(row[:4])), cast(Pair, tuple(row[4:]))
        turned = in_modes(whole, sliding) if column.sticks else whole
        return jnp.stack(field(jnp.zeros((), dtype), y4, turned))

    one, other = jnp.split(jax.vmap(slope, 1)(rows), 2)
    apart, size = jnp.abs(one + other).sum(-1), 1 + jnp.abs(one).sum(-1)
    return ~jnp.any(apart > ROUNDING * size)
