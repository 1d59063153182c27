r"""The series of a motion with those of small differences beside it.

Small differences v of the state and dp of the system's numbers move each coefficient of
the motion's series,

$$v_k = \frac{\partial y_k}{\partial y_0}\, v + \frac{\partial y_k}{\partial p}\, dp,
\qquad \sum_k v_k s^k = \frac{d}{d\varepsilon}\, y(s;\, y_0 + \varepsilon v,\, p +
\varepsilon\, dp) \Big|_{\varepsilon = 0}$$

to the series' own order: that is the derivative of the computed step, its length
frozen. The recurrences that give $y_k$, linearised, give $v_k$, and the motion's own
coefficients are those of the step itself: a difference costs about one series more.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap

from ..model.state import PhasePoint
from ..model.system import System
from ..numerics.numbers import Scalar
from ..numerics.series import value
from .expansion import Coefficients, Expansion, expand

StateSeries = tuple[Coefficients, ...]  # of a state or a difference, by its numbers


class Moved(NamedTuple):
    """A difference over a step: its series, and what it is at the end."""

    series: StateSeries
    y1: PhasePoint


def leaves(
    system: System, dp: System | None
) -> tuple[System, System | None, Callable[[System], System]]:
    """Those numbers of a system that differ, by how much, and the system of such.

    **Arguments:** `system`: in the modes of the step; `dp`: the differences, of a
    system without modes, None for what does not differ; None alone: nothing does.
    """
    if dp is not None and system.sticks:  # modes do not differ a little
        dp = dp.in_modes((None,) * len(system.law.modes))  # pyright: ignore
    none = {"is_leaf": lambda x: x is None}
    numbers = jax.tree.map(lambda d, x: d if d is None else x, dp, system, **none)
    return numbers, dp, lambda numbers: eqx.combine(numbers, system)


def expand_along(
    system: System,
    y: PhasePoint,
    order: int,
    token: Scalar,
    vectors: Sequence[PhasePoint],
    moves: System | None = None,
) -> tuple[Expansion, list[StateSeries]]:
    """The series of the motion from y, and of each difference that begins as a vector.

    **Arguments:** `system`: in the modes of the step; `token`: see `materialise`;
    `moves`: how the system's numbers differ, of shape (k,) for k vectors, see `leaves`.
    """
    arrays, still = eqx.partition(system, eqx.is_array)
    k = len(vectors)

    def of_lanes_behind(arrays, token, y, vectors, moves):
        """Numbers are scalars, or of many lanes; differences stand in front of them."""
        at = jnp.ravel(token)[0]
        system = eqx.combine(arrays, still)
        numbers, moves, system_of = leaves(system, moves)
        # one that all lanes share may move in each of them
        numbers = jax.tree.map(_of_each_lane, numbers, moves)
        columns = jax.tree.map(lambda *x: jnp.stack(x), *vectors)

        def series(y, numbers):
            motion = expand(system_of(numbers), y, order, at)
            return motion.y, motion

        def along(v, dp):
            begin, direction = (y, numbers), (v, dp)
            _, moved, motion = jax.jvp(series, begin, direction, has_aux=True)
            return motion, moved

        # one program for all of them; the motion's own coefficients are worked out once
        run = jax.vmap(along, out_axes=(None, 0))
        motion, moved = run(columns, moves)
        # numbers of their own again: their lanes lie side by side
        apart = [jax.tree.map(lambda x, i=i: x[i], moved) for i in range(k)]
        return motion, apart

    @custom_vmap
    def of_lanes(*inputs):
        return of_lanes_behind(*inputs)

    @of_lanes.def_vmap
    def _of_a_batch(size, batched, arrays, *own):
        own = jax.tree.map(partial(_lanes_behind, size), own, tuple(batched[1:]))
        results = of_lanes_behind(arrays, *own)
        results = jax.tree.map(lambda x: jnp.broadcast_to(x, (size,)), results)
        return results, jax.tree.map(lambda _: True, results)

    # JAX derives no batch of which some numbers move and others do not
    run = jax.custom_jvp(of_lanes)
    run.defjvp(partial(jax.jvp, of_lanes_behind))
    return run(arrays, token, y, list(vectors), moves)


def _of_each_lane(x: jax.Array, moves: jax.Array) -> jax.Array:
    return jnp.broadcast_to(x, moves.shape[1:])


def _lanes_behind(size: int, x: jax.Array, moves: bool) -> jax.Array:
    x = x if moves else jnp.broadcast_to(x, (size, *x.shape))
    return jnp.moveaxis(x, 0, -1)


def along_to(series: StateSeries, h: Scalar) -> PhasePoint:
    """The state, or a difference, a time h after the series' start."""
    return PhasePoint(value(c, h) for c in series)
