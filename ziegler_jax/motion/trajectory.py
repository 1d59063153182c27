"""`trajectory`: the states of a motion at given times, and its events.

Nothing is interpolated between steps, which end on both.
"""

from typing import Any, NamedTuple

import diffrax as dfx
import equinox as eqx
import jax.numpy as jnp

from ..context import overridden_solver
from ..model.column import Column, State
from ..numerics.numbers import keeps, whole_number
from ..results import OUTCOME
from ..solvers import AbstractFold, Explicit
from . import not_finite
from .integrate import FIRST_STEP, Method, Motion, follow
from .scene import (
    Solver,
    check_scene,
    float_state,
    increasing_times,
    method_of,
    nan_where,
    tolerances,
    usual_method,
    valid_scene,
)


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

    events: Events | None
    ys: Any  # (4, n): the states at `ts`, NaN where the lane has not been
    seen: Any  # how many of them are there
    outcome: Any


class Record(AbstractFold):
    """The states at given times, on which steps end, and room for `size` events.

    There are none without stick and slip.
    """

    ts: Any
    size: int

    def init(self, column, t0, y0):
        """The start, with the modes that it begins in."""
        n, dtype, events = self.size, jnp.result_type(y0[0]), None
        if column.sticks:
            none = Events(
                jnp.full(n, jnp.nan, dtype),
                jnp.zeros(n, jnp.int32),
                jnp.zeros((n, 2), jnp.int32),
                jnp.zeros((), jnp.int32),
                column.friction.release,
            )
            events = _with(none, True, t0, 0, column.friction.modes)
        ys = jnp.full((4, self.ts.shape[0]), jnp.nan, dtype)
        ys = ys.at[:, 0].set(jnp.stack(y0))
        none = jnp.asarray(OUTCOME.not_computed, jnp.int32)
        return Recorded(events, ys, jnp.array(1, jnp.int32), none)

    def step(self, column, state, step):
        """Add the event on which the step ended, and the state if it was waited for."""
        del column
        events = state.events
        if step.modes:
            joint, modes = step.event
            events = _with(events, joint > 0, step.t1, joint, modes)
        due = step.t1 >= self.ts[state.seen]
        place = jnp.where(due, state.seen, self.ts.shape[0])  # beyond: dropped
        ys = state.ys.at[:, place].set(jnp.stack(step.y1), mode="drop")
        seen = state.seen + due.astype(jnp.int32)
        over = seen >= self.ts.shape[0]
        following = self.ts[jnp.minimum(seen, self.ts.shape[0] - 1)]
        outcome = jnp.where(over, OUTCOME.complete, state.outcome).astype(jnp.int32)
        return Recorded(events, ys, seen, outcome), following, over


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


class Trajectory(eqx.Module):
    """A time history: `ts` (n,), `phi` and `omega` (n, 2), `outcome`.

    Where the motion ended early, times after it are NaN and `outcome` says why;
    otherwise it is `complete`. With set-valued friction `events` lists the changes of
    modes; else it is None.
    """

    ts: Any
    phi: Any
    omega: Any
    steps: Any
    outcome: Any
    events: Events | None = None


@not_finite.motion
def trajectory(
    column: Column,
    start: State,
    ts: Any,
    *,
    rtol: Any = 1e-8,
    atol: Any = 1e-8,
    solver: Solver = None,
    max_steps: int = 1_000_000,
    max_events: int = 1000,
) -> Trajectory:
    r"""The motion at given times.

    Steps end on every one of `ts`: nothing is interpolated.

    **Arguments:**

    - `column`, `start`: the scene; the start is the state at `ts[0]`.
    - `ts`: increasing times in $\sqrt{m l^2/k}$, shape (n,), at least two.
    - `rtol`, `atol`: tolerances of each step.
    - `solver`: as `settle`, but None is Dopri8 without set-valued friction.
    - `max_steps`: the step budget.
    - `max_events`: how many events there is room for, with set-valued friction.

    **Returns:** `Trajectory`.

    **Raises:** `ValueError` as `settle`, and for times that do not increase.
    """
    check_scene(column, start)
    rtol, atol = tolerances(rtol, atol)
    solver = overridden_solver(solver)
    y0 = float_state(start)
    ts = increasing_times(ts, y0[0].dtype)
    good = valid_scene(column, y0) & keeps("positive", rtol, atol)
    good &= jnp.all(jnp.diff(ts) > 0) & jnp.all(jnp.isfinite(ts))
    # diffrax refuses bad times, and a span of none; nothing moves on from NaN
    ts = jnp.where(good, ts, jnp.arange(ts.size, dtype=ts.dtype))
    y0 = nan_where(~good, y0)
    usual = usual_method(column) if column.sticks else Explicit(dfx.Dopri8.tableau)
    solver = method_of(solver, column, usual)
    run = follow(
        Motion(
            column,
            y0,
            Record(ts, whole_number("max_events", max_events)),
            Method(solver, rtol, atol, whole_number("max_steps", max_steps)),
            valid=good,
            start=ts[0],
            first_step=jnp.minimum(FIRST_STEP, ts[1] - ts[0]),
            first_stop=ts[1],
            end=ts[-1],
        )
    )
    ys = run.folded.ys.T
    return Trajectory(
        ts=ts,
        phi=ys[:, :2],
        omega=ys[:, 2:],
        steps=run.steps,
        outcome=run.outcome.astype(jnp.int8),
        events=run.folded.events,
    )
