"""Motions of a column: a time history to look at, and the long run as numbers."""

from typing import Any

import diffrax as dfx
import equinox as eqx
import jax.numpy as jnp
import numpy as np

from . import _not_finite
from ._context import overridden_solver
from ._events import Events, Record
from ._motion import FIRST_STEP, Run, follow, machine, unless_chattering
from ._scene import (
    check_scene,
    float_state,
    increasing_times,
    layer_of,
    method_of,
    nan_where,
    outcome_of,
    prepared,
    recorded,
    tolerances,
    usual_method,
    valid_scene,
    whole_number,
)
from ._settling import Settling
from ._types import keeps
from ._variables import Variable, checked
from .column import Column, State, vector_field
from .observers import TIME, AbstractObserver
from .outcome import OUTCOME
from .set_valued import SetValuedCoulomb
from .solvers import Explicit, Rosenbrock, StepControl, Taylor

Solver = Explicit | Rosenbrock | Taylor | None


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
            found = observer.variables(self.observed[observer.name])
            named |= checked(f"the observer `{observer.name}`", found)
        return named | {
            "drift": Variable(
                self.drift, "relative change of the amplitudes over the last window"
            ),
            "time": Variable(self.time, "time at the end", TIME),
            "steps": Variable(self.steps, "attempted steps"),
            "windows": Variable(self.windows, "observed windows"),
            "outcome": Variable(self.outcome, "how the motion ended", codes=OUTCOME),
        }

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


@_not_finite.motion
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
    solver: Solver = None,
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
        threshold motions decide slowly. Of 10 000 random points of the main job's map
        10 windows leave 7.5 % unsettled and 40 leave 2.4 % for 14 % more steps, where
        `rtol_settle` is 1e-3. Then 1.7 % pass for cycles that a run of 160 windows at
        2e-5 does not confirm within 1 %: most are on their slow way past an unstable
        cycle. At 2e-4 these are 0.9 % (3.2 % unsettled, 13 % more steps), at 5e-5 0.6 %
        (4.0 %, 21 % more again): `benchmarks/a4_settling.py`.
    - `observers`: what to watch beside `Amplitude()`, e.g. `(Period(),
        StickFraction())`. What is not asked for is not in the program.
    - `rtol`, `atol`: tolerances of each step. On friction cycles (q = 2.6,
        $\tau$ = 0.026, v_smooth from 0.3 to 0.003) 1e-6 leaves up to 7e-5 rad in an
        amplitude, 1e-7 6e-6 for 1.4 times the steps.
    - `solver`: `Explicit(tableau)`; `Rosenbrock()` for stiff lanes (`is_stiff` says
        which are); None is Tsit5, with friction the cheapest down to what the default
        tolerances give, an error of 4e-5 after 100 time units
        (`benchmarks/b0_work_precision.py`); from there Calvo7 is, and Dopri8 from 1e-9
        on. With set-valued friction None is `Taylor()`, but Tsit5 with the load
        `JointReaction()`.
    - `escape`: a rod's angle beyond which the lane ends as `escaped`.
    - `rate_cut`: the joint rate below which a joint rests. None is the friction law's
        (`v_smooth`; with set-valued friction what sticks rests); without friction 1e-6.
    - `max_steps`: the step budget.

    **Returns:** `Settled`. Where the outcome is a failure (before `unsettled` in
    `OUTCOME`), observed numbers and `drift` are NaN.

    **Raises:** `ValueError` for arguments that break a rule, and in a 32-bit
    session. `jax.jvp` passes through, `jax.grad` does not (the number of steps is not
    known beforehand).
    """
    motion = Settling(
        column,
        start,
        transient=transient,
        window=window,
        max_windows=max_windows,
        rtol_settle=rtol_settle,
        observers=observers,
        rtol=rtol,
        atol=atol,
        solver=solver,
        escape=escape,
        rate_cut=rate_cut,
        max_steps=max_steps,
    )
    return settled(motion, follow(motion))


def settled(motion: Settling, run: Run) -> Settled:
    """What a motion that has ended amounts to."""
    watch, watched, y1 = motion.watch, run.folded, run.y
    failed = run.outcome < OUTCOME.unsettled
    observed = {
        observer.name: nan_where(
            failed, observer.result(motion.column, state, watch.window, y1)
        )
        for observer, state in zip(watch.observers, watched.observed, strict=True)
    }
    return Settled(
        observed=observed,
        drift=nan_where(failed | ~jnp.isfinite(watched.drift), watched.drift),
        final=State(y1[:2], y1[2:]),
        time=run.time,
        steps=run.steps,
        windows=watched.windows,
        outcome=run.outcome.astype(jnp.int8),
        observers=watch.observers,
        settings=recorded(**motion.settings()),
    )


@_not_finite.motion
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
