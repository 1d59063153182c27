"""A motion with stick and slip: its states at given times, and its events.

Nothing is interpolated between steps, which end on both.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp

from .solvers import AbstractFold


class Events(eqx.Module):
    """Changes of modes with set-valued friction, in order; the first is the start.

    `times` (n,), NaN where there is no event; `joints` (n,): 1 or 2, 3 for both at
    once, 0 for the start; `modes` (n, 2) after the event: 1 and -1 slip, 0 sticks;
    `count`: how many there were, which may be more than there is room for; `release`:
    the rule that chose the modes.
    """

    times: Any
    joints: Any
    modes: Any
    count: Any
    release: str = eqx.field(static=True)


class Recorded(NamedTuple):
    """What `Record` keeps."""

    events: Events
    ys: Any  # (4, n): the states at `ts`, NaN where the lane has not been
    seen: Any  # how many of them are there


class Record(AbstractFold):
    """The states at given times, on which steps end, and room for `size` events."""

    ts: Any
    size: int

    def integrand(self, column):
        """Nothing."""
        del column
        return None

    def init(self, column, t0, y0):
        """The start, with the modes that it begins in."""
        n, dtype = self.size, jnp.result_type(y0[0])
        none = Events(
            jnp.full(n, jnp.nan, dtype),
            jnp.zeros(n, jnp.int32),
            jnp.zeros((n, 2), jnp.int32),
            jnp.zeros((), jnp.int32),
            column.friction.release,
        )
        events = _with(none, True, t0, 0, column.friction.modes)
        ys = jnp.full((4, self.ts.shape[0]), jnp.nan, dtype)
        return Recorded(events, ys.at[:, 0].set(jnp.stack(y0)), jnp.array(1, jnp.int32))

    def step(self, column, state, step):
        """Add the event on which the step ended, and the state if it was waited for."""
        del column
        joint, modes = step.event
        events = _with(state.events, joint > 0, step.t1, joint, modes)
        due = step.t1 >= self.ts[state.seen]
        place = jnp.where(due, state.seen, self.ts.shape[0])  # beyond: dropped
        ys = state.ys.at[:, place].set(jnp.stack(step.y1), mode="drop")
        seen = state.seen + due.astype(jnp.int32)
        over = seen >= self.ts.shape[0]
        following = self.ts[jnp.minimum(seen, self.ts.shape[0] - 1)]
        return Recorded(events, ys, seen), following, over


def _with(log: Events, happened: Any, t: Any, joint: Any, modes: Any) -> Events:
    place = jnp.where(happened, log.count, log.times.shape[0])  # beyond: dropped
    row = jnp.stack(modes).astype(jnp.int32)
    return Events(
        log.times.at[place].set(t, mode="drop"),
        log.joints.at[place].set(joint, mode="drop"),
        log.modes.at[place].set(row, mode="drop"),
        log.count + jnp.where(happened, 1, 0),
        log.release,
    )
