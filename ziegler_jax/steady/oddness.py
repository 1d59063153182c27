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
    samples = jnp.asarray(source.uniform(-1, 1, (4, SAMPLES)) * scale, dtype)
    # XLA would compute with known numbers while it compiles, for minutes
    samples = lax.optimization_barrier(samples)
    whole = prepared(column)

    def slope(
        sign: Float[Array, ""], modes: Float[Array, " 2"], y: Float[Array, " 4"]
    ) -> Float[Array, " 4"]:
        turned = whole
        if column.sticks:
            turned = in_modes(whole, cast(Pair, tuple(sign * modes)))
        y4 = cast(Traced4, tuple(sign * y))
        return jnp.stack(field(jnp.zeros((), dtype), y4, turned))

    everywhere = jax.vmap(slope, (None, None, 1))
    everywhere = jax.vmap(everywhere, (None, 0, None))
    everywhere = jax.vmap(everywhere, (0, None, None))
    signs, modes = jnp.asarray((1.0, -1.0), dtype), jnp.asarray(MODES, dtype)
    one, other = everywhere(signs, modes if column.sticks else modes[:1], samples)
    apart, size = jnp.abs(one + other).sum(-1), 1 + jnp.abs(one).sum(-1)
    return ~jnp.any(apart > ROUNDING * size)
