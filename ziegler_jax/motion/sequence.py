"""Motions one after the other in one lane, each decided by the motions before it.

A search and a quasi-static sweep are such sequences. Each lane goes through its own at
its own pace. In a sweep it runs in chunks of steps, and is refilled when its sequence
ends; elsewhere in a loop whose turns are chunks, so that no motion waits for those of
other lanes.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Generic, NamedTuple, Protocol, TypeVar

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Int

from ..numerics.materialise import if_any_lane, replaced
from ..numerics.resumable import ENDED, Phase, resumable

# The rest of a chunk in which a motion ends is lost. A call costs about 10 steps.
LONGEST_CHUNK = 256


class Running(Protocol):
    """Where a motion is."""

    @property
    def running(self) -> Bool[Array, ""]:
        """Whether it has no verdict yet."""
        ...

    @property
    def steps(self) -> Int[Array, ""]:
        """Attempted so far."""
        ...

    @property
    def phase(self) -> Int[Array, ""]:
        """The one it is in, or `ENDED`."""
        ...


Where = TypeVar("Where", bound=Running)


class Followed(Protocol[Where]):
    """A motion, as a sequence follows it."""

    def begin(self) -> Where:
        """Before its first step."""
        ...

    @property
    def phases(self) -> Sequence[Phase[Where]]:
        """How it goes on."""
        ...


State = TypeVar("State")  # what the motions so far amount to
Next = TypeVar("Next", bound=Followed)


class _Sequence(NamedTuple, Generic[State]):
    """Where a lane is."""

    state: State
    run: Running  # the present motion
    fresh: Bool[Array, ""]  # whether the next one begins
    steps: Int[Array, ""]


def run_in_sequence(
    motion: Callable[[State], Next],
    update: Callable[..., State],
    running: Callable[[State], Bool[Array, ""]],
    state: State,
    at_once: int = LONGEST_CHUNK,
) -> tuple[State, Int[Array, ""]]:
    """Follow motions until there is no next one.

    **Arguments:**

    - `motion`: the next motion, from the state.
    - `update`: the state after it, from the state, the motion and its ended run.
    - `running`: whether there is a next one.
    - `state`: the first state, a pytree of scalars and arrays.
    - `at_once`: after how many steps of the first phase motions that have ended make
        room for the next ones. Few where most motions are short.

    **Returns:** the last state and the number of steps of all motions.
    """
    zero = jnp.zeros((), jnp.int32)
    begun = motion(state)
    first = _Sequence(state, begun.begin(), jnp.asarray(False), zero)

    def chunk(
        number: int, now: _Sequence[State], max_steps: Int[Array, ""]
    ) -> _Sequence[State]:
        most = jnp.minimum(max_steps, LONGEST_CHUNK)
        if number or at_once == LONGEST_CHUNK:
            return part(number, now, most)
        steps = jnp.asarray(at_once, jnp.int32)
        turns = jnp.maximum(most // at_once, 1)
        return lax.fori_loop(0, turns, lambda _, now: part(0, now, steps), now)

    def part(
        number: int, now: _Sequence[State], max_steps: Int[Array, ""]
    ) -> _Sequence[State]:
        present, run, fresh = motion(now.state), now.run, now.fresh
        if number == 0:
            run, fresh = replaced(fresh, present.begin(), run), jnp.zeros_like(fresh)
        before = run.steps
        run = present.phases[number].advance(run, max_steps)
        steps = now.steps + (run.steps - before).astype(jnp.int32)
        ended = ~run.running & running(now.state) & ~fresh
        state = if_any_lane(
            ended,
            lambda state: replaced(ended, update(state, present, run), state),
            now.state,
        )
        return _Sequence(state, run, fresh | (ended & running(state)), steps)

    def status(now: _Sequence[State]) -> tuple[Int[Array, ""], Int[Array, ""]]:
        phase = jnp.where(now.fresh, 0, now.run.phase)
        return jnp.where(running(now.state), phase, ENDED).astype(jnp.int32), now.steps

    phases = [
        Phase(partial(chunk, i), phase.cost) for i, phase in enumerate(begun.phases)
    ]
    last = resumable(first, phases, status, LONGEST_CHUNK)
    return last.state, last.steps
