"""Motions of a column: a time history to look at, and the long run as numbers."""

from typing import Any, NamedTuple

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ._events import EventLog, Events
from ._legs import current_legs
from ._types import Scalar, Vector4, is_concrete, number
from ._variables import Variable
from ._windows import Windows
from .column import Column, State, vector_field
from .observers import TIME, AbstractObserver, Amplitude
from .outcome import OUTCOME
from .set_valued import SetValuedCoulomb
from .solvers import Explicit, LandingControl, Observed, StepControl, StickSlip

FIRST_STEP = 0.01
REST_RATE = 1e-6  # without friction there is no rate of the column's own
FINEST_IN_FLOAT32 = 1e-5


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
    `rate_cut` for a whole window, or until `max_windows` are over. The result is that
    of the last window.

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
    _check_scene(column, start)
    rtol, atol = _tolerances(rtol, atol)
    solver = Explicit() if solver is None else solver
    watch = Windows(
        transient=number("transient", transient, "nonnegative"),
        window=number("window", window, "positive"),
        max_windows=_whole("max_windows", max_windows),
        rtol_settle=number("rtol_settle", rtol_settle, "positive"),
        escape=number("escape", escape, "positive"),
        rate_cut=_rate_cut(column, rate_cut),
        observers=_with_amplitude(observers, column),
    )
    args = _prepared(column)
    watching, control = _machine(column, solver, watch, rtol, atol)
    terms = dfx.ODETerm(vector_field)
    max_steps = _whole("max_steps", max_steps)
    y0 = _float_state(start)
    zero = jnp.zeros((), y0[0].dtype)
    invalid = jnp.where(_valid(column, y0), OUTCOME.not_computed, OUTCOME.invalid)
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
        # t + (t_next - t) is t_next to the last bit as soon as t >= t_next / 2
        # (Sterbenz), and a leg is many steps long: a pause changes nothing
        dt0=run.control.t_next - t,
        y0=run.solver.y,
        args=args,
        stepsize_controller=control,
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
    ended = _outcome(solution.result, after.slope, ended)
    outcome = jnp.where(run.outcome == OUTCOME.not_computed, ended, run.outcome)
    if legs is not None:
        paused = _Run(after, where, steps, outcome)
        legs.leave(paused, outcome == OUTCOME.not_computed, steps)
    failed = outcome < OUTCOME.unsettled
    observed = {
        observer.name: _nan_where(
            failed, observer.result(column, state, watch.window, y1)
        )
        for observer, state in zip(watch.observers, watched.observed, strict=True)
    }
    return Settled(
        observed=observed,
        drift=_nan_where(failed | ~jnp.isfinite(watched.drift), watched.drift),
        final=State(y1[:2], y1[2:]),
        time=where.t,
        steps=steps,
        windows=watched.windows,
        outcome=outcome.astype(jnp.int8),
        observers=watch.observers,
        settings=_settings(
            solver=solver.name,
            rtol=rtol,
            atol=atol,
            transient=watch.transient,
            window=watch.window,
            max_windows=watch.max_windows,
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
    _check_scene(column, start)
    rtol, atol = _tolerances(rtol, atol)
    y0 = _float_state(start)
    ts = _times(ts, y0[0].dtype)
    good = _valid(column, y0)
    control = StepControl(rtol, atol)  # pyright: ignore[reportCallIssue]
    if isinstance(column.friction, SetValuedCoulomb):
        log = EventLog(_whole("max_events", max_events))
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
        args=_prepared(column),
        stepsize_controller=dfx.ClipStepSizeController(
            control,
            step_ts=ts,
        ),
        saveat=dfx.SaveAt(ts=ts, solver_state=True),
        max_steps=_whole("max_steps", max_steps),
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
    outcome = _outcome(solution.result, slope, ended)
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


def _outcome(result: Any, last_slope: Any, otherwise: Any) -> jax.Array:
    """The code of a lane: what stopped the solver, or otherwise."""
    finite = True
    for slope in jax.tree.leaves(last_slope):
        finite &= jnp.isfinite(slope)
    stopped = result == dfx.RESULTS.dt_min_reached
    reason = jnp.where(finite, OUTCOME.step_vanished, OUTCOME.not_finite)
    outcome = jnp.where(stopped, reason, otherwise)
    spent = result == dfx.RESULTS.max_steps_reached
    return jnp.where(spent, OUTCOME.budget_spent, outcome)


def _settings(**options: Any) -> tuple[tuple[str, Any], ...]:
    """Options for the record; what differs from point to point says so."""
    record = []
    for name, value in options.items():
        if isinstance(value, np.floating):
            value = float(value)
        elif not isinstance(value, (int, str)):
            value = "set at each point"
        record.append((name, value))
    return tuple(record)


def _nan_where(failed: Any, values: Any) -> Any:
    return jax.tree.map(lambda x: jnp.where(failed, jnp.nan, x), values)


def _prepared(column: Column) -> Column:
    """The column for one motion: what does not change along it is worked out."""
    if column.friction is not None:
        friction = column.friction.prepared(column.q)
        column = eqx.tree_at(lambda c: c.friction, column, friction)
    if column.tangential:
        column = eqx.tree_at(lambda c: c.follower, column, None)
    return column


def _valid(column: Column, y0: Vector4) -> jax.Array:
    good = column.valid()
    for x in y0:
        good &= jnp.isfinite(x)
    return good


def _float_state(start: State) -> Vector4:
    dtype = jnp.result_type(float)
    return tuple(jnp.asarray(x, dtype) for x in start.y)  # type: ignore[return-value]


def _check_scene(column: Any, start: Any) -> None:
    if not isinstance(column, Column):
        raise ValueError(f"Argument `column` must be a `Column`, but is {column!r}.")
    if not isinstance(start, State):
        raise ValueError(f"Argument `start` must be a `State`, but is {start!r}.")


def _tolerances(rtol: Any, atol: Any) -> tuple[Scalar, Scalar]:
    rtol, atol = number("rtol", rtol, "positive"), number("atol", atol, "positive")
    if jnp.result_type(float) == jnp.float32:
        for name, tol in (("rtol", rtol), ("atol", atol)):
            if is_concrete(tol) and tol < FINEST_IN_FLOAT32:
                raise ValueError(
                    f"Argument `{name}` must be at least {FINEST_IN_FLOAT32:g} in "
                    f"32-bit arithmetic, but is {tol:g}; enable 64 bits with "
                    '`jax.config.update("jax_enable_x64", True)`, or use `sweep`.'
                )
    return rtol, atol


def _whole(name: str, x: Any) -> int:
    if isinstance(x, bool) or not isinstance(x, (int, np.integer)) or x < 1:
        raise ValueError(
            f"Argument `{name}` must be a whole number of at least 1, but is {x!r}."
        )
    return int(x)


def _times(ts: Any, dtype: Any) -> jax.Array:
    if np.ndim(ts) != 1 or np.shape(ts)[0] < 2:
        raise ValueError(
            "Argument `ts` must be at least two times in one dimension, but has shape "
            f"{np.shape(ts)}."
        )
    if is_concrete(ts) and not np.all(np.diff(np.asarray(ts, dtype=float)) > 0):
        raise ValueError("Argument `ts` must increase, but does not.")
    return jnp.asarray(ts, dtype)


def _rate_cut(column: Column, rate_cut: Any) -> Scalar | None:
    if rate_cut is not None:
        return number("rate_cut", rate_cut, "positive")
    return REST_RATE if column.friction is None else column.friction.rate_cut()


def _with_amplitude(observers: Any, column: Column) -> tuple[AbstractObserver, ...]:
    """The observers, `Amplitude()` first: the windows are compared by it."""
    try:
        chosen = [o for o in observers if not isinstance(o, Amplitude)]
    except TypeError:
        chosen = [observers]
    names = set()
    for observer in chosen:
        if not isinstance(observer, AbstractObserver):
            raise ValueError(
                "Argument `observers` must be a sequence of observers such as "
                f"`Period()`, but contains {observer!r}."
            )
        if observer.name in names:
            raise ValueError(
                f"Argument `observers` must name each once, but has `{observer.name}` "
                "twice."
            )
        names.add(observer.name)
        observer.check(column)
    return (Amplitude(), *chosen)
