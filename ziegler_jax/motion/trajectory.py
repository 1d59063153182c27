"""`trajectory`: the states of a motion at given times, and its events.

With stick and slip nothing is interpolated between steps, which end on both.
"""

from typing import Any, NamedTuple

import diffrax as dfx
import equinox as eqx
import jax.numpy as jnp

from ..context import overridden_solver
from ..model.column import Column, State, vector_field
from ..model.set_valued import SetValuedCoulomb
from ..numerics.numbers import keeps
from ..results import OUTCOME
from ..solvers import AbstractFold, Explicit, StepControl
from . import not_finite
from .integrate import FIRST_STEP, machine, unless_chattering
from .scene import (
    Solver,
    check_scene,
    float_state,
    increasing_times,
    layer_of,
    method_of,
    nan_where,
    outcome_of,
    prepared,
    tolerances,
    usual_method,
    valid_scene,
    whole_number,
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
    limit = whole_number("max_steps", max_steps)
    if isinstance(column.friction, SetValuedCoulomb):
        method = method_of(solver, column, usual_method(column))
        return _stick_slip(column, y0, ts, good, rtol, atol, method, limit, max_events)
    method = method_of(solver, column, Explicit(dfx.Dopri8.tableau))
    control = StepControl(rtol, atol, layer_of(column, method))  # pyright: ignore
    solution = dfx.diffeqsolve(
        dfx.ODETerm(vector_field),
        method,
        t0=ts[0],
        t1=ts[-1],
        dt0=jnp.minimum(FIRST_STEP, ts[1] - ts[0]),
        y0=y0,
        args=prepared(column),
        stepsize_controller=dfx.ClipStepSizeController(
            control,
            step_ts=ts,
        ),
        saveat=dfx.SaveAt(ts=ts, solver_state=True),
        max_steps=limit,
        throw=False,
        adjoint=dfx.ForwardMode(),
    )
    assert solution.ys is not None
    # diffrax leaves infinity where nothing was saved
    ys = [jnp.where(jnp.isfinite(y), y, jnp.nan) for y in solution.ys]
    outcome = outcome_of(solution.result, solution.solver_state, OUTCOME.complete)
    return Trajectory(
        ts=ts,
        phi=jnp.stack(ys[:2], axis=-1),
        omega=jnp.stack(ys[2:], axis=-1),
        steps=jnp.where(good, solution.stats["num_steps"], 0),
        outcome=jnp.where(good, outcome, OUTCOME.invalid).astype(jnp.int8),
    )


def _stick_slip(
    column, y0, ts, good, rtol, atol, solver, max_steps, max_events
) -> Trajectory:
    """`trajectory` with set-valued friction: the solver itself records."""
    record = Record(ts, whole_number("max_events", max_events))
    method, control = machine(column, solver, record, rtol, atol)
    args = prepared(column)
    terms = dfx.ODETerm(vector_field)
    first = jnp.minimum(FIRST_STEP, ts[1] - ts[0])
    begin = control.start(ts[0], first, ts[1])
    solution = dfx.diffeqsolve(
        terms,
        method,
        t0=ts[0],
        t1=jnp.where(good, ts[-1], ts[0]),
        dt0=begin.t_next - ts[0],
        y0=y0,
        args=args,
        stepsize_controller=control,
        solver_state=method.init(terms, ts[0], ts[-1], y0, args),
        controller_state=begin,
        saveat=dfx.SaveAt(solver_state=True),
        max_steps=max_steps,
        throw=False,
        adjoint=dfx.ForwardMode(),
    )
    after: Any = solution.solver_state
    ended = unless_chattering(method, after, OUTCOME.complete)
    outcome = outcome_of(solution.result, after.slope, ended)
    ys = after.folded.ys.T
    return Trajectory(
        ts=ts,
        phi=ys[:, :2],
        omega=ys[:, 2:],
        steps=solution.stats["num_steps"],
        outcome=jnp.where(good, outcome, OUTCOME.invalid).astype(jnp.int8),
        events=after.folded.events,
    )
