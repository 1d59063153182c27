"""The list of a motion's events: when which joint came to rest or broke loose."""

from typing import Any

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


class EventLog(AbstractFold):
    """Room for `size` events."""

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
        return _with(none, True, t0, 0, column.friction.modes)

    def step(self, column, state, step):
        """Add the event on which the step ended, if any."""
        del column
        joint, modes = step.event
        state = _with(state, joint > 0, step.t1, joint, modes)
        return state, jnp.inf, False


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
