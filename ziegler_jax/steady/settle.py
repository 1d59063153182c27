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
    """The long-run motion of one lane, as numbers.

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
    r"""Kick the column and wait: what its motion settles to, with a certificate.

    **Certified** (`certify=True`), a motion is a cycle if

    - Newton's method, from one of its own returns to $\phi_1 = 0$ on, has found an
        orbit that closes to 1e-5, with tolerances of a hundredth of the motion's own
        (on Taylor's steps to 2e-8, of a thousandth);
    - that is stable: the largest multiplier of a return is below 0.999;
    - and the motion contracts towards it: its own returns follow the orbit's linear
        map, in the norm in which that contracts, to within 2.5 % of the orbit
        (`steady/returns.py`); with set-valued friction its joints stick and slip in the
        orbit's own order.

    It is at rest where both joints stay below `rate_cut`, or below what the steps' own
    error leaves (100 atol), for 20 time units, are no faster in the second half of
    them, and the linear column about the state is damped, with the slopes of friction
    from rest to the motion's rate (set-valued friction: where both stick), and
    `unsettled` if neither came by the horizon, `transient +
    length * max_windows` (`undecided` says of which kind it is). What observers give
    is, of a cycle, of exactly one turn of the orbit (of half a turn where the cycle is
    its own mirror image, and all observers say that this is enough); at rest, of the
    next 2 time units (set-valued: of `length`); else of the last `length`. Of 20 178
    such cycles of the main job's map none was false, followed on by another code
    (`benchmarks/a5_certificates.py`); 3.7 % of the map stay undecided. Of 6181 of the
    same map with `SetValuedCoulomb` none was false, and 12.7 % stay undecided, 11.7 %
    by windows: half of these lanes settle by t = 16 000.

    **By windows** (`certify=False`, the default where `certify` says so): after the
    transient, windows follow each other until two consecutive ones agree: the swing
    $S_j$ (largest minus smallest angle) of each joint that moves, over at least one
    whole return of it,

    $$|S_j - S_j'| \le \mathrm{agreement}\; S_j + \mathrm{atol},$$

    and the load pays for what friction and damping take out, to three quarters of it at
    least, by the energies where the joints turn (`steady/repeats.py`). Then the outcome
    is `repeats`: no certificate. Where so little dissipates that the steps' error hides
    it, or the load's work to and fro, windows never tell; a finer tolerance does. Where
    nothing dissipates in what moves it is `conservative`. Rest is asked for as above,
    over two windows. After `max_windows` a motion is `unsettled`. The result is that of
    the last window, means to within a turn's share of it. With one window there is
    nothing to compare: the outcome is `unsettled` or `stuck`. Of 1457 random cells of
    the main job's map that repeat so a finer run does not confirm 6
    (`benchmarks/a13_certified_truth.py share`).

    **Forces that depend on time** (`AbstractForce`, `LoadHistory`) leave windows alone,
    and no rest: what sticks or has decayed may move again. Where a motion does not
    repeat within two windows it is `unsettled` at the horizon, with the numbers of the
    last window. A ramp wants one window after it (`Windows(transient=..., length=...,
    max_windows=1)`), a pulsating load windows of whole periods.

    **Torus or chaos** (`exponents=2`): a certified motion that ends `unsettled` goes on
    as long again, after another `transient` over `max_windows` of `length`, with
    tangents: `exponents` are its first Lyapunov exponents, with `errors`, as
    `lyapunov_exponents` has them, NaN of every other motion. By them `undecided` says
    `chaotic`, `quasi_periodic`, `periodic` or `conservative` where that is sure
    (`steady/exponents.py`): chaos that ends after the time of looking on is chaotic.
    `kind` is that, or the outcome of a motion that has settled. Nothing else of the
    result changes but `steps`, and a motion that settles pays for nothing. The steps
    are of the same budget, `max_steps`: where it is spent, exponents are NaN.

    **Arguments:**

    - `column`, `start`: the scene.
    - `windows`: as above, see `Windows`.
    - `observers`: what to watch beside `Amplitude()`, e.g. `(StickFraction(),)`. What
        is not asked for is not in the program.
    - `method`: any, see `Method`. On friction cycles (q = 2.6, $\tau$ = 0.026, v_smooth
        from 0.3 to 0.003) windows at the default tolerance 1e-6 leave up to 7e-5 rad in
        an amplitude; a certificate's orbit has a hundred times finer ones. With
        friction the default, Tsit5, is the cheapest down to what its tolerance gives,
        an error of 4e-5 after 100 time units (`benchmarks/b0_work_precision.py`); from
        there Calvo7 is, with Vern9 from 1e-9 on (in layers of 1e-4 and thinner Calvo7
        is not to be trusted, see `solvers.tableaus`).
    - `exponents`: how many, 0 to 2 a rod, as above: two name tori, one chaos alone.
        None of `certify` is then True.
    - `certify`: None certifies, with `SetValuedCoulomb` on Taylor's steps, whose series
        the tangents of shots share. It has to be asked for where set-valued friction
        has no series (the load `JointReaction()`, a damping law or forces of one's
        own): there shots run on an explicit method, event by event, far slower. Not
        with `Rosenbrock()`. It fits no column that dissipates nothing: there no cycle
        attracts.

    **Returns:** `Settled`. Where the outcome stands before `unsettled` in `CODE`,
    observed numbers and `drift` are NaN.

    **Derivatives:** forward (`jax.jvp`, `jax.jacfwd`), first order; second ones are
    refused (`ValueError`). Of a certified cycle they are those of its fixed point, see
    `steady/derivative.py`; on the start and the options it does not depend. Its `final`
    state and `time` depend on when the verdict came, which no derivative says, as do,
    where cycles are certified, all numbers of a motion that came to rest under a
    smoothed law or without friction: theirs are NaN, and so are those of `drift`,
    `growth`, `exponents` and `errors`. Else they are those of the motion's steps (by
    windows, at rest too: of the last window), whose size does not follow the tangents'
    error: it grows with the time, and at the usual tolerance the first digit can be
    wrong. With `certify=False` ask for `Method(rtol=1e-10)`, and compare with
    differences. Reverse mode is refused (`ValueError`): the number of steps is not
    known beforehand.

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
    """What a motion that has ended amounts to."""
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
