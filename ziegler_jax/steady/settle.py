"""`settle`: the long-run motion of a column, as numbers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Shaped

from ..model.chain_of_rods import AbstractChain
from ..model.column import check_autonomous
from ..model.state import State
from ..motion import not_finite
from ..motion.checks import check_scene
from ..motion.ending import ending, nan_where
from ..motion.implicit import fixed, forward_only, lost
from ..motion.integrate import Run, follow
from ..motion.observation import Record
from ..motion.observers import AbstractObserver
from ..motion.options import Method, Windows, recorded
from ..motion.spans import SpanState
from ..numerics.materialise import tree_where
from ..numerics.rules import instance
from ..results import (
    CODE,
    KINDS,
    TIME,
    UNSETTLED,
    AbstractDescribed,
    AbstractMotionResult,
    Variable,
    quantity,
    without_values,
)
from ..solvers import Rosenbrock
from .certified import CertifiedMotion
from .derivative import Place, carried, floats, with_zeros
from .growth import Grown, growth_variables
from .lane import Certifying
from .rest import Rest
from .window_rule import SettleProblem, WindowState


class Settled(AbstractDescribed, AbstractMotionResult[State]):
    """The long-run motion of a column, as numbers.

    Beside the fields, each observer adds attributes: `rod_amplitude` and
    `joint_amplitude` always, and `stick_fraction`, `mean_angle`, `follower_power`, ...
    where asked for. A certificate adds `period`, `returns`, `largest_multiplier`,
    `undecided` and `shot_steps`, and, where exponents were asked for, those, their
    `errors` and `kind`; the rule of windows adds `windows`.
    """

    numbers: dict[str, Shaped[Array, "..."]]
    quantities: tuple[tuple[str, Variable], ...] = eqx.field(static=True)
    drift: Float[Array, "*lanes"] = eqx.field(
        metadata=quantity(
            "certified: by how much the orbit does not close; else the largest change "
            "of a joint's swing over the last window; relative"
        )
    )

    def coordinates(self) -> dict[str, Sequence[object]]:
        """The exponents' numbers, from 1, where they were asked for."""
        if "exponents" not in self.numbers:
            return {}
        return {"exponent": tuple(range(1, self.exponents.shape[-1] + 1))}


_FIELDS = {*Settled.__dataclass_fields__, "windows"}
_EXPONENTS = {"exponents", "errors", "kind"}
_CERTIFICATE = {
    "period", "returns", "largest_multiplier", "undecided", "shot_steps", "growth",
    "sensitive",
}  # fmt: skip


@not_finite.motion
def settle(
    column: AbstractChain,
    start: State,
    *,
    windows: Windows = Windows(),
    observers: Sequence[AbstractObserver] = (),
    method: Method = Method(),
    certify: bool | None = None,
    exponents: int = 0,
) -> Settled:
    r"""The long-run motion of a column after a kick: rest, a cycle, or neither.

    **With certificates** (`certify=True`) a motion ends as a `cycle` if

    - Newton's method, started at one of its returns to $\phi_1 = 0$, has found a
        closed orbit, to 1e-5 with tolerances of a hundredth of the motion's (on
        Taylor's steps to 2e-8, of a thousandth);
    - that orbit is stable: the largest multiplier of a return is below 0.999;
    - and the motion contracts towards it: its returns follow the linear map of the
        orbit, in a norm in which this map contracts, to within 2.5 % of the orbit
        (`steady/returns.py`). With set-valued friction the joints also stick and slip
        in the order of the orbit.

    A motion ends as `rest` or `stuck` if, for 20 time units, both joints stay below
    `rate_cut` or below 100 atol, they are no faster in the second half of these, and
    the linear column about the state is damped with every slope of friction from rest
    to the motion's rate. With set-valued friction it is `stuck` once all joints stick.
    It is `unsettled` if neither holds by the horizon, `transient + length *
    max_windows`; then `undecided` names its kind.

    Observers are computed over one turn of the cycle (half a turn if the cycle is its
    own mirror image and all observers allow it), over 2 time units after rest (with
    set-valued friction `length`), else over the last `length`. The page *Certificates*
    of the documentation has the measured share of false and of missing certificates.

    **By windows** (`certify=False`, the default where `certify` says so) a motion is
    compared over consecutive windows after the transient. It ends as `repeats`, which
    is no certificate, once the swing $S_j$ of each moving joint (largest minus smallest
    angle, over at least one return) agrees in two of them,

    $$|S_j - S_j'| \le \mathrm{agreement}\; S_j + \mathrm{atol},$$

    and the work of the load covers at least three quarters of the loss by friction and
    damping (`steady/repeats.py`). It ends as `conservative` if no moving part
    dissipates, as `stuck` by the criterion of rest above over two windows, and as
    `unsettled` after `max_windows`. Numbers are those of the last window. One window
    cannot be compared: the outcome is then `unsettled` or `stuck`. A slow passage of an
    unstable cycle can look as if it repeats: of 1457 random cells of the main job's map
    that repeat, a finer run does not confirm 6 (`benchmarks/a13_certified_truth.py
    share`). Windows cannot decide where dissipation is
    smaller than the error of the steps: a finer tolerance can.

    **Forces that depend on time** (`AbstractForce`, `LoadHistory`) are settled by
    windows, and never to rest, as a column that sticks may move again. For a ramp take
    one window after it (`Windows(transient=..., length=..., max_windows=1)`), for a
    pulsating load windows of a multiple of its period.

    **Torus or chaos** (`exponents=2`): an `unsettled` motion is followed for another
    `transient` and `max_windows` windows, with tangents. `exponents` are its first
    Lyapunov exponents with `errors`, as in `lyapunov_exponents`; other motions have
    NaN. `undecided` is then `chaotic`, `quasi_periodic`, `periodic` or `conservative`
    where the exponents are sure (`steady/exponents.py`), and `kind` is this or the
    outcome. Chaos that ends after that time counts as chaotic. These steps are part of
    the budget `max_steps`; where it is spent, exponents are NaN. Motions that settle
    take no more steps than without exponents.

    **Arguments:**

    - `column`, `start`: the column or chain, and the state in which its motion starts.
    - `windows`: transient, length and number of windows, see `Windows`.
    - `observers`: further observers beside `Amplitude()`, e.g. `(StickFraction(),)`.
        An observer that is not named is not in the compiled program.
    - `method`: any, see `Method`. With friction the default, Tsit5, is the cheapest
        down to an error of 4e-5 after 100 time units; for smaller errors Calvo7, from
        1e-9 on Vern9 (`benchmarks/b0_work_precision.py`). Do not use Calvo7 in layers
        of 1e-4 and thinner (`solvers.tableaus`).
    - `exponents`: the number of exponents, 0 to 2 a rod: two tell tori, one tells chaos
        alone. `certify=None` then certifies.
    - `certify`: None certifies where tangents are cheap and the column is the same at
        all times. It does not with `Rosenbrock()`, which True refuses, nor where
        set-valued friction has no series: with the load `JointReaction()`, and with
        damping laws or forces of your own. There True uses an explicit method, event by
        event, which is far slower. True does not suit a column that dissipates nothing:
        no cycle attracts there.

    **Returns:** `Settled`. For outcomes before `unsettled` in `CODE`, observed numbers
    and `drift` are NaN.

    **Derivatives:** forward (`jax.jvp`, `jax.jacfwd`), first order. Reverse mode is
    refused (`ValueError`), since the number of steps is not known beforehand; so are
    second derivatives.

    - Of a certified cycle they are the derivatives of its fixed point
        (`steady/derivative.py`), which do not depend on the start and the options.
    - By windows they are the derivatives of the last window's steps. Their error grows
        with time, as the step size does not control it; at the usual tolerance the
        first digit can be wrong. Use `Method(rtol=1e-10)` there, and compare with
        differences.
    - With certificates they are NaN for `final` and `time`, which depend on when the
        verdict came, for `drift`, `growth`, `exponents` and `errors`, and for all
        numbers of a motion that came to rest under a smoothed law or without friction.

    **Raises:** `ValueError` for arguments that break a rule, and in a 32-bit session.
    """
    scene = column, start, "settle", windows, observers, method
    motion = settling(*scene, certify, exponents)
    if not isinstance(motion, CertifiedMotion):
        return forward_only("settle", settled(motion, follow(motion)), once=True)
    fixed_scene = (*fixed((column, start)), "settle", *fixed(scene[3:]))
    still = CertifiedMotion(*fixed_scene, fixed(motion.odd), exponents)
    return forward_only("settle", settled(motion, still.follow()), once=True)


Settling = CertifiedMotion | SettleProblem


def settling(
    column: AbstractChain,
    start: State,
    question: str,
    windows: Windows,
    observers: Sequence[AbstractObserver],
    method: Method,
    certify: bool | None,
    exponents: int = 0,
) -> Settling:
    """The motion that is followed until it has settled.

    **Raises:** `ValueError` where a certificate is asked for that cannot be given, or
    exponents without one.
    """
    scene = column, start, question, windows, observers, method
    check_scene(column, start)
    check_autonomous(question, column)
    instance("method", method, Method)
    exponents = _exponents(exponents, certify, 2 * column.joints)
    if certify is None:
        certify = exponents > 0 or may_certify(column, method)
    if certify is True and not column.autonomous:
        raise ValueError(
            "Argument `forces` of the column must not depend on time where cycles are "
            "certified, but does: write `certify=False`, and no `exponents`."
        )
    if not isinstance(certify, bool):
        raise ValueError(
            f"Argument `certify` must be True, False or None, but is {certify!r}."
        )
    if certify and isinstance(method.solver, Rosenbrock):
        wrong = (
            "`exponents` must be 0" if exponents else "`certify` must be False or None"
        )
        raise ValueError(
            f"Argument {wrong} with `Rosenbrock()`, whose steps carry no tangents, but "
            f"is {exponents or certify}."
        )
    if certify:
        return CertifiedMotion(*scene, exponents=exponents)
    return SettleProblem(*scene)


def _exponents(count: int, certify: bool | None, most: int) -> int:
    whole = isinstance(count, (int, np.integer)) and not isinstance(count, bool)
    if not whole or not 0 <= count <= most:
        raise ValueError(
            f"Argument `exponents` must be a whole number from 0 to {most}, "
            f"but is {count!r}."
        )
    if count and certify is False:
        raise ValueError(
            "Argument `exponents` must be 0 with `certify=False`, where no motion is "
            f"given up, but is {count}."
        )
    return int(count)


def may_certify(column: AbstractChain, method: Method) -> bool:
    """Whether cycles are certified by default."""
    if isinstance(method.solver, Rosenbrock) or not column.autonomous:
        return False
    # event by event on an explicit method shots take far longer than Taylor's steps
    return not column.sticks or column.system().has_series


def settled(motion: Settling, run: Run[SpanState[WindowState]] | Certifying) -> Settled:
    """The result of a motion that has ended."""
    if isinstance(motion, CertifiedMotion):
        return _certified(motion, cast(Certifying, run))
    return _windowed(motion, cast(Run[SpanState[WindowState]], run))


def _windowed(motion: SettleProblem, run: Run[SpanState[WindowState]]) -> Settled:
    fold, watch = motion.watch, run.folded.watch
    record = Record(watch.observed, fold.span, run.y)
    system = motion.system.at(run.time)
    named = fold.observation.variables(system, record, _FIELDS)
    failed = run.outcome < CODE.unsettled
    named = nan_where_failed(failed, named)
    named["windows"] = Variable(run.folded.spans, "observed windows")
    how, scene = ending(run), (motion.column, motion.y0, motion.windows)
    # a failure is noticed at the end of a step: when that is, no derivative says
    ends = how["final"], how["time"]
    how["final"], how["time"] = tree_where(failed, lost(ends, scene), ends)
    return Settled(
        numbers={name: jnp.asarray(v.value) for name, v in named.items()},
        quantities=without_values(named),
        drift=jnp.asarray(nan_where(failed | ~jnp.isfinite(watch.drift), watch.drift)),
        settings=recorded(**motion.settings()),
        **how,
    )


def _certified(motion: CertifiedMotion, end: Certifying) -> Settled:
    orbit, candidate = end.orbit, end.candidate
    taken = _FIELDS | _CERTIFICATE | (_EXPONENTS if motion.exponents else set())
    named = motion.observation.variables(fixed(motion.system), orbit.record, taken)
    closed = end.outcome == CODE.cycle
    twice = fixed(motion.odd) & (candidate.returns % 2 == 1)
    unsettled = end.outcome == CODE.unsettled
    sticks = motion.rest.by_modes & (end.outcome == motion.rest.outcome(motion.system))
    place = Place(
        closed=closed,
        known=unsettled | sticks,
        z=jnp.stack([*orbit.y[1:], orbit.span]),
        sign=jnp.where(twice, -1.0, 1.0),
        before=end.march.time,
        span=orbit.span,
        rest=Rest(motion.windows.rate_cut, at_once=False),
        method=motion.method,
        level=fixed(end.attempt.level),
    )
    move = carried(motion, place, floats(named).size)
    # a cycle does not depend on options, the end of another motion does
    options = motion.windows.transient, motion.windows.length
    move = tree_where(closed, move, lost(move, options))
    named = nan_where_failed(
        end.outcome < CODE.unsettled, with_zeros(named, move.observed)
    )
    period = jnp.where(twice, 2, 1) * (orbit.span + move.span)
    radius = candidate.radius + move.radius
    radius = jnp.where(twice, radius**2, radius)
    halves = jnp.where(fixed(motion.odd) & ~twice, 2, 1)
    returns = jnp.where(closed, candidate.returns // halves, 0)
    certificate = {
        "period": Variable(nan_where(~closed, period), "period of the cycle", TIME),
        "returns": Variable(returns, "upward passages of phi1 = 0 in a period"),
        "largest_multiplier": Variable(
            nan_where(~closed, radius), "largest modulus of a multiplier of the cycle"
        ),
        "undecided": Variable(
            motion.kind(end),
            "of which kind an undecided lane is",
            codes=UNSETTLED,
        ),
        "shot_steps": Variable(end.spent, "steps of shots, with tangents"),
    }
    named |= certificate
    scene = motion.column, motion.y0, motion.windows
    for name, variable in motion.exponents_of(end).items():
        named[name] = variable._replace(value=lost(variable.value, scene))
    if motion.exponents:
        kind = jnp.where(unsettled, motion.kind(end), end.outcome.astype(jnp.int8))
        named["kind"] = Variable(kind, "what the motion is", codes=KINDS)
    if motion.grows:
        largest = cast(Grown, end.march.folded.grown).largest
        largest = lost(largest, (motion.column, motion.y0))
        failed = end.outcome < CODE.unsettled
        named |= growth_variables(largest, failed, motion.method.tolerances[0])
    how, scene = ending(end), (motion.column, motion.y0, *options)
    y = jnp.stack(how["final"].y) + move.y
    n = motion.system.joints
    how["final"] = State(y[:n], y[n:])
    # the horizon is no matter of the scene, when another verdict came is one
    horizon, verdict = (lost(how["time"], of) for of in (options, scene))
    how["time"] = jnp.where(unsettled, horizon, verdict)
    return Settled(
        numbers={name: jnp.asarray(v.value) for name, v in named.items()},
        quantities=without_values(named),
        drift=jnp.asarray(lost(nan_where(~closed, orbit.residual), scene)),
        settings=recorded(**motion.settings()),
        **how,
    )


def nan_where_failed(
    failed: jax.Array, named: dict[str, Variable]
) -> dict[str, Variable]:
    """Observed numbers, lost where a motion failed."""

    def lost(variable: Variable) -> Variable:
        value = jnp.asarray(variable.value)
        nothing = jnp.asarray(0 if variable.codes is not None else jnp.nan, value.dtype)
        return variable._replace(value=jnp.where(failed, nothing, value))

    return {name: lost(variable) for name, variable in named.items()}
