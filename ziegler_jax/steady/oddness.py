"""Whether the mirror image of each motion is a motion: f(-y) = -f(y)."""

from collections.abc import Sequence
from functools import reduce

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from ..model.state import PhasePoint
from ..model.system import System, field
from ..numerics.numbers import Flag, Scalar

SAMPLES = 24
ROUNDING = 1e-9


def is_odd(system: System) -> Flag:
    """Whether the field is odd at states of all sizes: evaluated, not by its name."""
    dtype = jnp.result_type(float)
    source = np.random.default_rng(20)
    n = system.joints
    lows = (-3,) * n + (-5,) * n
    scale = 10.0 ** np.stack([source.uniform(low, 0.3, SAMPLES) for low in lows])
    samples = source.uniform(-1, 1, (2 * n, SAMPLES)) * scale
    # all slip alike, every other one the other way, the first sticks
    turns = [(-1.0) ** j for j in range(n)]
    modes = np.array([(1.0,) * n, turns, (0.0, *(1.0,) * (n - 1))])
    modes = modes if system.sticks else modes[:1]
    each = np.repeat(np.arange(len(modes)), SAMPLES)
    rows = np.concatenate([np.tile(samples, len(modes)), modes[each].T])
    # a power's last bit is the processor's own, and a scene's digest would be with it
    rows = rows.astype(np.float32).astype(float)
    zero = jnp.zeros((), dtype)

    def slope(row: Float[Array, " numbers"]) -> list[Array]:
        turned = system.in_modes(tuple(row[2 * n :])) if system.sticks else system
        return [jnp.asarray(x) for x in field(zero, PhasePoint(row[: 2 * n]), turned)]

    def turn(odd: Flag, row: Float[Array, " numbers"]) -> tuple[Flag, None]:
        both = jax.vmap(slope)(jnp.stack([row, -row]))
        # number by number: XLA hands an array's sum to a library
        apart = [jnp.abs(one + other) for one, other in both]
        size = [jnp.abs(one) for one, _ in both]
        over = _sum(apart) > ROUNDING * (1 + _sum(size))
        return odd & jnp.logical_not(over), None

    # sample by sample: with all at once XLA would compute while it compiles
    return lax.scan(turn, jnp.asarray(True), jnp.asarray(rows.T, dtype))[0]


def _sum(numbers: Sequence[Scalar]) -> Scalar:
    return reduce(jnp.add, numbers)
