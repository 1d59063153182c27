"""Motions of a column: a time history to look at, and the long run as numbers."""

from typing import Any, NamedTuple

import diffrax as dfx
import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ._events import EventLog, Events
from ._legs import current_legs
from ._scene import (
    budget,
    check_scene,
    float_state,
    increasing_times,
    nan_where,
    outcome_of,
    prepared,
    rate_cut_of,
    recorded,
    tolerances,
    valid_scene,
    whole_number,
    with_amplitude,
)
from ._types import number
from ._variables import Variable
from ._windows import Windows
from .column import Column, State, vector_field
from .observers import TIME, AbstractObserver
from .outcome import OUTCOME
from .set_valued import SetValuedCoulomb
from .solvers import Explicit, GoingOn, LandingControl, Observed, StepControl, StickSlip

FIRST_STEP = 0.01


class Settled(eqx.Module):
    """The long-run motion of one lane, as numbers.

    Beside the fields, each observer adds an attribute of its name: `amplitude` always,
    and `period`, `stick_fraction`, `mean`, `power` where asked for.
    """

    observed: dict[str, Any]
    drift: Any  # relative change of the amplitudes between the last two windows
    final: State  # the state at the end
    time: Any  # when it ended
    steps: Any  # attempted steps, rejected ones included
    windows: Any  # windows observed
    outcome: Any  # a code of OUTCOME
    observers: tuple[AbstractObserver, ...]
    settings: tuple[tuple[str, Any], ...] = eqx.field(static=True)

    def __getattr__(self, name: str) -> Any:
        """What an observer of that name found."""
        observed = self.__dict__.get("observed", {})
        if name in observed:
            return observed[name]
        raise AttributeError(
            f"`settle` did not observe `{name}`: it was asked for "
            f"{', '.join(observed)} only."
        )

    def variables(self) -> dict[str, Variable]:
        """All numbers with their names, units and dimensions, for `sweep`."""
        named: dict[str, Variable] = {}
        for observer in self.observers:
            named |= observer.variables(self.observed[observer.name])
        named |= {
            "drift": Variable(
                self.drift, "relative change of the amplitudes over the last window"
            ),
            "time": Variable(self.time, "time at the end", TIME),
            "steps": Variable(self.steps, "attempted steps"),
            "windows": Variable(self.windows, "observed windows"),
            "outcome": Variable(self.outcome, "how the motion ended", codes=OUTCOME),
        }
        return named

    def attributes(self) -> dict[str, Any]:
        """How it was computed: the options that are the same at every point."""
        return dict(self.settings)


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


def settle(
    column: Column,
    start: State,
    *,
    transient: Any = 100.0,
    window: Any = 40.0,
    max_windows: int = 40,
    rtol_settle: Any = 2e-4,
    observers: tuple[AbstractObserver, ...] = (),
    rtol: Any = 1e-6,
    atol: Any = 1e-6,
    solver: Explicit | None = None,
    escape: Any = np.pi,
    rate_cut: Any = None,
    max_steps: int = 1_000_000,
) -> Settled:
    r"""Kick the column and wait: what its motion settles to.

    After `transient` time units, windows of length `window` follow each other until
    the amplitudes of two consecutive ones agree,
    $\max_j |A_j - A_j'| \le$ `rtol_settle` $\max_j A_j$ over the largest
    $|\phi_1|, |\phi_2|, |\phi_2 - \phi_1|$, until both joint rates stayed below
    `rate_cut` for a whole window and were no faster than in the window before, or until
    `max_windows` are over. The result is that of the last window.

    **Arguments:** (times in $\sqrt{m l^2/k}$)

    - `column`, `start`: the scene.
    - `transient`, `window`, `max_windows`, `rtol_settle`: as above. With one window
        there is nothing to compare: the outcome is `unsettled` or `stuck`. Near a
        threshold motions decide slowly: of the 105 780 points of the main job's map 10
        windows leave 7972 unsettled and 40 leave 2556, for 15 % more steps, where
        `rtol_settle` is 1e-3. But then 248 lanes passed for cycles that a finer one
        finds more than 1 % away, on the slow way past an unstable cycle; at 2e-4 (14 %
        more steps) 3468 are unsettled.
    - `observers`: what to watch beside `Amplitude()`, e.g. `(Period(),
        StickFraction())`. What is not asked for is not in the program.
    - `rtol`, `atol`: tolerances of each step. On friction cycles (q = 2.6,
        $\tau$ = 0.026, v_smooth from 0.3 to 0.003) 1e-6 leaves up to 7e-5 rad in an
        amplitude, 1e-7 6e-6 for 1.4 times the steps.
    - `solver`: `Explicit(tableau)`; None is Tsit5.
    - `escape`: a rod's angle beyond which the lane ends as `escaped`.
    - `rate_cut`: the joint rate below which a joint rests. None is the friction law's
        (`v_smooth`; with set-valued friction what sticks rests); without friction 1e-6.
    - `max_steps`: the step budget.

    **Returns:** `Settled`. Where the outcome is a failure (before `unsettled` in
    `OUTCOME`), observed numbers and `drift` are NaN.

    **Raises:** `ValueError` for arguments that break a rule, and for tolerances finer
    than 1e-5 in a 32-bit session. `jax.jvp` passes through, `jax.grad` does not (the
    number of steps is not known beforehand).
    """
    check_scene(column, start)
    rtol, atol = tolerances(rtol, atol)
    solver = Explicit() if solver is None else solver
    watch = Windows(
        transient=number("transient", transient, "nonnegative"),
        window=number("window", window, "positive"),
        max_windows=budget("max_windows", max_windows),
        rtol_settle=number("rtol_settle", rtol_settle, "positive"),
        escape=number("escape", escape, "positive"),
        rate_cut=rate_cut_of(column, rate_cut),
        observers=with_amplitude(observers, column),
    )
    args = prepared(column)
    watching, control = _machine(column, solver, watch, rtol, atol)
    terms = dfx.ODETerm(vector_field)
    max_steps = budget("max_steps", max_steps)
    y0 = float_state(start)
    zero = jnp.zeros((), y0[0].dtype)
    good = valid_scene(column, y0) & watch.valid() & (rtol > 0) & (atol > 0)
    invalid = jnp.where(good, OUTCOME.not_computed, OUTCOME.invalid)
    begin = _Run(
        solver=watching.init(terms, zero, zero, y0, args),
        control=control.start(zero, FIRST_STEP, watch.first_stop()),
        steps=jnp.zeros((), jnp.int32),
        outcome=invalid.astype(jnp.int32),
    )
    legs = current_legs()
    run = begin if legs is None else legs.enter(begin)
    left = max_steps - run.steps
    left = left if legs is None else jnp.minimum(left, legs.quota)
    # the watch ends a lane before this; one that has ended does not move
    end = watch.transient + watch.window * (watch.max_windows + 1)
    t = run.control.t
    solution = dfx.diffeqsolve(
        terms,
        watching,
        t0=t,
        t1=jnp.where(run.outcome == OUTCOME.not_computed, zero + end, t),
        dt0=None,
        y0=run.solver.y,
        args=args,
        stepsize_controller=GoingOn(control, run.control.t_next),
        solver_state=run.solver,
        controller_state=run.control._replace(left=left.astype(jnp.int32)),
        saveat=dfx.SaveAt(solver_state=True, controller_state=True),
        max_steps=None,  # the controller counts
        throw=False,
        adjoint=dfx.ForwardMode(),
    )
    after: Any = solution.solver_state
    where: Any = solution.controller_state
    watched, y1 = after.folded, after.y
    steps = run.steps + solution.stats["num_steps"]
    spent = (watched.outcome == OUTCOME.not_computed) & (steps >= max_steps)
    ended = jnp.where(spent, OUTCOME.budget_spent, watched.outcome)
    if isinstance(watching, StickSlip):
        ended = _unless_chattering(watching, after, ended)
    ended = outcome_of(solution.result, after.slope, ended)
    outcome = jnp.where(run.outcome == OUTCOME.not_computed, ended, run.outcome)
    if legs is not None:
        paused = _Run(after, where, steps, outcome)
        legs.leave(paused, outcome == OUTCOME.not_computed, steps)
    failed = outcome < OUTCOME.unsettled
    observed = {
        observer.name: nan_where(
            failed, observer.result(column, state, watch.window, y1)
        )
        for observer, state in zip(watch.observers, watched.observed, strict=True)
    }
    return Settled(
        observed=observed,
        drift=nan_where(failed | ~jnp.isfinite(watched.drift), watched.drift),
        final=State(y1[:2], y1[2:]),
        time=where.t,
        steps=steps,
        windows=watched.windows,
        outcome=outcome.astype(jnp.int8),
        observers=watch.observers,
        settings=recorded(
            solver=solver.name,
            rtol=rtol,
            atol=atol,
            transient=watch.transient,
            window=watch.window,
            max_windows=watch.max_windows,
            max_steps=max_steps,
            rtol_settle=watch.rtol_settle,
            escape=watch.escape,
            rate_cut="by modes" if watch.by_modes else watch.rate_cut,
            **_rule(column),
        ),
    )


def trajectory(
    column: Column,
    start: State,
    ts: Any,
    *,
    rtol: Any = 1e-8,
    atol: Any = 1e-8,
    solver: Explicit | None = None,
    max_steps: int = 1_000_000,
    max_events: int = 1000,
) -> Trajectory:
    r"""The motion at given times.

    Steps end on every one of `ts`: nothing is interpolated.

    **Arguments:**

    - `column`, `start`: the scene; the start is the state at `ts[0]`.
    - `ts`: increasing times in $\sqrt{m l^2/k}$, shape (n,), at least two.
    - `rtol`, `atol`: tolerances of each step.
    - `solver`: `Explicit(tableau)`; None is Dopri8; with set-valued friction Tsit5,
        whose shorter steps show events more closely.
    - `max_steps`: the step budget.
    - `max_events`: how many events there is room for, with set-valued friction.

    **Returns:** `Trajectory`.

    **Raises:** `ValueError` as `settle`, and for times that do not increase.
    """
    check_scene(column, start)
    rtol, atol = tolerances(rtol, atol)
    y0 = float_state(start)
    ts = increasing_times(ts, y0[0].dtype)
    good = valid_scene(column, y0)
    control = StepControl(rtol, atol)  # pyright: ignore[reportCallIssue]
    if isinstance(column.friction, SetValuedCoulomb):
        log = EventLog(whole_number("max_events", max_events))
        solver = Explicit() if solver is None else solver
        method, control = _machine(column, solver, log, rtol, atol)
    else:
        method = Explicit(dfx.Dopri8.tableau) if solver is None else solver
    solution = dfx.diffeqsolve(
        dfx.ODETerm(vector_field),
        method,
        t0=ts[0],
        t1=jnp.where(good, ts[-1], ts[0]),
        dt0=jnp.minimum(FIRST_STEP, ts[1] - ts[0]),
        y0=y0,
        args=prepared(column),
        stepsize_controller=dfx.ClipStepSizeController(
            control,
            step_ts=ts,
        ),
        saveat=dfx.SaveAt(ts=ts, solver_state=True),
        max_steps=whole_number("max_steps", max_steps),
        throw=False,
        adjoint=dfx.ForwardMode(),
    )
    assert solution.ys is not None
    # diffrax leaves infinity where nothing was saved
    ys = [jnp.where(jnp.isfinite(y), y, jnp.nan) for y in solution.ys]
    after: Any = solution.solver_state
    events, slope, ended = None, after, OUTCOME.complete
    if isinstance(method, StickSlip):
        events, slope = after.folded, after.slope
        ended = _unless_chattering(method, after, ended)
    outcome = outcome_of(solution.result, slope, ended)
    return Trajectory(
        ts=ts,
        phi=jnp.stack(ys[:2], axis=-1),
        omega=jnp.stack(ys[2:], axis=-1),
        steps=solution.stats["num_steps"],
        outcome=jnp.where(good, outcome, OUTCOME.invalid).astype(jnp.int8),
        events=events,
    )


class _Run(NamedTuple):
    """Where a lane is: what a leg hands to the next."""

    solver: Any
    control: Any
    steps: Any
    outcome: Any


def _machine(column: Column, solver: Explicit, fold: Any, rtol: Any, atol: Any) -> Any:
    """The observing solver and the controller that the friction law needs."""
    if isinstance(column.friction, SetValuedCoulomb):
        control = LandingControl(rtol, atol)  # pyright: ignore[reportCallIssue]
        return StickSlip(solver, fold, atol), control
    control = StepControl(rtol, atol)  # pyright: ignore[reportCallIssue]
    return Observed(solver, fold), control


def _unless_chattering(solver: StickSlip, state: Any, otherwise: Any) -> Any:
    return jnp.where(solver.chatters(state), OUTCOME.chattering, otherwise)


def _rule(column: Column) -> dict[str, str]:
    """The name of the friction law's rule, where it has one."""
    law = column.friction
    return {"release": law.release} if isinstance(law, SetValuedCoulomb) else {}
