"""Motions one after the other in one lane, where each is decided by those before.

A search and a quasi-static sweep are such sequences. Every lane goes through its own at
its own pace: in a sweep in chunks of steps, so that a lane is refilled when its
sequence ends; else in a loop whose turns are chunks, so that no motion waits for those
of other lanes.
"""

from collections.abc import Callable
from typing import Generic, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Int

from ..context import resumable
from ..numerics.materialise import Tree, if_any_lane, tree_where
from ..numerics.numbers import Count, Flag
from .integrate import Motion, Run

# The rest of a chunk in which a motion ends is lost. A call costs about 10 steps.
LONGEST_CHUNK = 256


State = TypeVar("State")  # what the motions so far amount to
Next = TypeVar("Next", bound=Motion)


class _Sequence(NamedTuple, Generic[State]):
    """Where a lane is."""

    state: State
    run: Run  # the present motion
    fresh: Bool[Array, ""]  # whether the next one begins
    steps: Int[Array, ""]


def run_in_sequence(
    motion: Callable[[State], Next],
    update: Callable[[State, Next, Run], State],
    running: Callable[[State], Bool[Array, ""]],
    state: State,
) -> tuple[State, Int[Array, ""]]:
    """Follow motions until there is no next one.

    **Arguments:**

    - `motion`: the next motion, from the state.
    - `update`: the state after it, from the state, the motion and its ended run.
    - `running`: whether there is a next one.
    - `state`: the first state, a pytree of scalars and arrays.

    **Returns:** the last state and the number of steps of all motions.
    """
    zero = jnp.zeros((), jnp.int32)
    first = _Sequence(state, motion(state).begin(), jnp.asarray(False), zero)

    def chunk(now: _Sequence[State], max_steps: Count) -> _Sequence[State]:
        present = motion(now.state)
        run = _where(now.fresh, present.begin(), now.run)
        before = run.steps
        run = present.advance(run, jnp.minimum(max_steps, LONGEST_CHUNK))
        ended = ~run.running & running(now.state)
        state = if_any_lane(
            ended,
            lambda state: _where(ended, update(state, present, run), state),
            now.state,
        )
        steps = now.steps + (run.steps - before).astype(jnp.int32)
        return _Sequence(state, run, ended & running(state), steps)

    last = resumable(first, chunk, lambda now: (running(now.state), now.steps))
    if last is None:
        last = lax.while_loop(
            lambda now: running(now.state), lambda now: chunk(now, LONGEST_CHUNK), first
        )
    return last.state, last.steps


def _where(flag: Flag, new: Tree, old: Tree) -> Tree:
    same = jax.tree.map(lambda a, b: jnp.asarray(a, jnp.result_type(b)), new, old)
    return tree_where(flag, same, old)
