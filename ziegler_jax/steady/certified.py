r"""A motion that is followed until its end is certain.

A cycle is certified when

1. its returns have drawn near (`returns`) and Newton's method, from the motion's own
    return on, has found an orbit that closes (`shots`), first with steps ten times
    finer than the motion's own, at last a hundred times;
2. the orbit is stable: its section map has a spectral radius below 1;
3. the motion contracts towards it: at once, if the first shot's derivative contracts in
    the orbit's norm and its return follows the orbit's linear map; else the motion goes
    on until its own returns do. With set-valued friction its joints must stick and slip
    in the orbit's own order, too (`lane.checked`).

A motion without a certificate is followed further, to the horizon at most. After the
horizon its exponents, where requested, tell a torus from chaos (`exponents`). Motions
without tangents and with tangents are separate programs: phases of one loop, between
which each lane changes at its own pace.
"""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from ..model.chain_of_rods import AbstractChain
from ..model.state import PhasePoint, State
from ..motion.checks import float_state, valid_scene, with_amplitude
from ..motion.integrate import Motion
from ..motion.method import method_of, rate_cut_of, usual_method
from ..motion.observation import Observation, Record
from ..motion.observers import AbstractObserver, Period
from ..motion.options import Method, Windows, windows_for
from ..motion.spans import SpanState
from ..numerics.materialise import replaced, tree_where
from ..numerics.numbers import Count, Flag, Option, Scalar
from ..numerics.resumable import Decision, Phase, Stop, phase_of, resumable
from ..numerics.rules import instance, keeps
from ..results import CODE, Variable
from ..solvers import Explicit
from .contraction import contraction_norm, spectral_radius
from .exponents import Naming, Witness, exponent_variables, name_of
from .growth import Growth
from .lane import (
    GROWTH,
    MARCH,
    SHOTS,
    Certifying,
    Orbit,
    checked,
    comes_at_once,
    going_on,
)
from .oddness import is_odd
from .rest import Rest, decays
from .returns import (
    A_SHOT,
    ACCEPTANCE,
    ENDURES,
    NOTHING,
    REST,
    Candidate,
    Lookout,
    March,
    ask_no_more,
    no_returns,
    span_of,
    with_candidate,
    with_return,
)
from .shots import (
    COARSE,
    Attempt,
    ShotState,
    after_shot,
    attempt_at,
    blank_attempt,
    run_that_is_over,
    shooting,
    shot_motion,
    start_of,
    to_be_begun,
)

LONGEST_CHUNK = 256  # steps in one phase, outside of sweeps
# of a batch, until what has ended or returned is looked at; fewer where steps are long
STEPS_AT_ONCE = 16
MARGIN = 1e-3  # of the radius below 1, a return
COST = 2.5  # of a step with three tangents, against one without
AT_REST = 2.0  # time units for which a motion that creeps is observed


class CertifiedMotion:
    """The motion that `settle(certify=True)` asks for.

    **Arguments:** those of `settle`, a scene that has been checked; `question`: whose
    defaults hold; `observers`: None for a verdict alone, without `exponents`.
    """

    def __init__(
        self,
        column: AbstractChain,
        start: State,
        question: str,
        windows: Windows,
        observers: Sequence[AbstractObserver] | None,
        method: Method,
        odd: Flag | None = None,
        exponents: int = 0,
    ):
        """Set it up; `odd`: whether it is its own mirror image, if known."""
        instance("windows", windows, Windows)
        if windows.agreement is not None:
            raise ValueError(
                "Argument `agreement` of `windows` must be None where cycles are "
                "certified, as no windows are compared there, but is "
                f"{windows.agreement}."
            )
        self.column, self.y0 = column, float_state(start)
        self.system = system = column.system()
        self.watches = observers is not None
        given = with_amplitude(observers, system) if observers is not None else ()
        self.grows = any(isinstance(o, Growth) for o in given)
        self.method = method_of(question, method, system, usual_method(system))
        windows = windows_for(question, windows, rate_cut_of(system))
        self.windows = eqx.tree_at(  # those of `settle` by windows alone
            lambda w: w.agreement, windows, None, is_leaf=lambda x: x is None
        )
        given = tuple(o for o in given if not isinstance(o, Growth | Period))
        self.observation = Observation(given)
        atol = self.method.tolerances[1]
        self.rest = Rest(self.windows.rate_cut, at_once=True, atol=atol)
        solver = self.method.solver
        coarse = isinstance(solver, Explicit) and solver.order <= 5
        self.at_once = STEPS_AT_ONCE if coarse else STEPS_AT_ONCE // 4
        halves = all(observer.mirrored for observer in given)
        halves &= not system.displaced  # its section is no mirror image's
        self.odd: Flag = halves and (is_odd(system) if odd is None else odd)
        transient, length, most = self.windows.spans
        self.exponents = exponents
        self.naming = Naming(
            transient=transient,
            span=length,
            most=most,
            escape=self.windows.bound,
            solver=shooting(self.method),
            rtol=COARSE * self.method.tolerances[0],
            count=exponents,
        )
        self.last = length  # the span that is observed where nothing is certain
        self.horizon = transient + length * (most - 1)
        self.chosen_at = transient + length  # where the section is not phi1 = 0
        good = keeps("nonnegative", transient)
        good &= keeps("positive", length, self.windows.escape, self.windows.rate_cut)
        good &= keeps("positive", self.method.rtol, self.method.atol)
        if exponents:
            good &= self.naming.valid()
        self.valid = good & valid_scene(column, self.y0) & self.observation.valid()

    # ---- the loop

    def begin(self) -> Certifying:
        """Before the first step."""
        zero, none = 0.0 * self.y0[0], jnp.zeros((), jnp.int32)
        size, no = 2 * self.system.joints - 1, jnp.asarray(False)
        attempt = blank_attempt(zero, size, self.system.displaced)
        blank = Candidate(no, none, attempt.x, attempt.slope, attempt.slope, zero, zero)
        march = self._march(none).begin()
        shot = run_that_is_over(lambda: self._shot(self.y0, attempt, none).begin())
        states = self.observation.init(self.system, zero, self.y0)
        record = Record(states, zero, self.y0)
        outcome = jnp.where(march.running, CODE.not_computed, march.outcome)
        lane = Certifying(
            stage=none + MARCH,
            march=march,
            returns=no_returns(zero, size),
            shot=shot,
            attempt=attempt,
            candidate=blank,
            orbit=Orbit(self.y0, zero, zero + jnp.nan, record),
            observing=none,
            unstable=no,
            spent=none,
            outcome=outcome.astype(jnp.int32),
        )
        if not self.exponents:
            return lane
        return lane._replace(
            growth=run_that_is_over(lambda: self._growth(lane).begin())
        )

    @property
    def phases(self) -> list[Phase[Certifying]]:
        """The programs; each decides where a lane goes that has ended there."""
        march = [
            Decision(self._has_returned, self._after_return),
            Decision(self._march_is_over, self._after_march),
        ]
        observed = [Decision(self._has_observed, self._after_observation)]
        shots = [
            Decision(self._has_shot, self._after_shot),
            # a lane that is to shoot again has no shot now, and is not judged
            Decision(self._has_shot, self._judged),
            *(observed if self.watches else []),
            Decision(self._is_to_begin, self._next_shot),
        ]
        growth = [
            Decision(self._has_grown, self._after_growth),
            Decision(self._is_to_grow, self._begin_growth),
        ]
        every = self.at_once
        phases = [
            phase_of(Stop(self.march_on, march, every)),
            phase_of(Stop(self.shoot_on, shots, every), COST),
        ]
        if self.exponents:
            phases.append(phase_of(Stop(self.grow_on, growth, every), COST))
        return phases

    def follow(self) -> Certifying:
        """The last state."""

        def status(now: Certifying) -> tuple[Int[Array, ""], Int[Array, ""]]:
            return now.phase, now.steps

        return resumable(self.begin(), self.phases, status, LONGEST_CHUNK)

    def march_on(self, now: Certifying, max_steps: Count) -> Certifying:
        """The motion itself."""
        run = self._march(now.spent).advance(now.march, max_steps)
        return now._replace(march=run)

    def _has_returned(self, now: Certifying) -> Bool[Array, ""]:
        return now.running & (now.stage == MARCH) & (now.march.folded.waits > 0)

    def _after_return(self, now: Certifying) -> Certifying:
        """The state after the pending return is evaluated."""
        run, lookout = now.march, now.march.folded
        after = with_return(
            now.returns, lookout, self.odd, now.candidate, not self.watches
        )
        lookout = lookout._replace(waits=0.0 * run.time)
        run = run.paused(after.asks != NOTHING, lookout)
        return now._replace(march=run, returns=after)

    def _march_is_over(self, now: Certifying) -> Bool[Array, ""]:
        return now.running & (now.stage == MARCH) & ~now.march.running

    def shoot_on(self, now: Certifying, max_steps: Count) -> Certifying:
        """A shot."""
        shot = self._shot(self.y0, now.attempt, self._left(now))
        return now._replace(shot=shot.advance(now.shot, max_steps))

    def _shot_is_over(self, now: Certifying) -> Bool[Array, ""]:
        # one to be begun stands where the last has ended: it is over only in name
        over = ~now.shot.running & (now.shot.steps >= 0)
        return now.running & now.shoots & over

    def _has_shot(self, now: Certifying) -> Bool[Array, ""]:
        return self._shot_is_over(now) & (now.observing == CODE.not_computed)

    def _has_observed(self, now: Certifying) -> Bool[Array, ""]:
        return self._shot_is_over(now) & (now.observing != CODE.not_computed)

    def _is_to_begin(self, now: Certifying) -> Bool[Array, ""]:
        return now.running & now.shoots & (now.shot.steps < 0)

    def _after_shot(self, now: Certifying) -> Certifying:
        """Newton's step; the next shot begins if it is worth it."""
        attempt, goes_on = after_shot(now.attempt, now.shot)
        spent = (now.spent + now.shot.steps).astype(jnp.int32)
        shot = tree_where(goes_on, to_be_begun(now.shot), now.shot)
        return now._replace(attempt=attempt, spent=spent, shot=shot)

    def _next_shot(self, now: Certifying) -> Certifying:
        """A shot before its first step."""
        observes = now.observing != CODE.not_computed
        y0 = tree_where(observes, now.march.y, start_of(now.attempt))
        return now._replace(shot=self._shot(y0, now.attempt, self._left(now)).begin())

    def grow_on(self, now: Certifying, max_steps: Count) -> Certifying:
        """A motion that is given up, with the tangents of its exponents."""
        run = self._growth(now).advance(now.growing, max_steps)
        return now._replace(growth=run)

    def _has_grown(self, now: Certifying) -> Bool[Array, ""]:
        run = now.growing
        return now.running & now.grows & ~run.running & (run.steps >= 0)

    def _after_growth(self, now: Certifying) -> Certifying:
        """Name the motion's kind; its outcome stays."""
        return now._replace(outcome=now.observing)

    def _is_to_grow(self, now: Certifying) -> Bool[Array, ""]:
        return now.running & now.grows & (now.growing.steps < 0)

    def _begin_growth(self, now: Certifying) -> Certifying:
        """Before its first step."""
        return now._replace(growth=self._growth(now).begin())

    def _growth(self, now: Certifying) -> Motion[SpanState[Witness]]:
        """The motion on from the horizon: as long again, with tangents."""
        scene = self.system, now.orbit.y, self.method
        return self.naming.motion(*scene, self._left(now))

    def _march(self, spent: Count) -> Motion[Lookout]:
        carrier = shooting(self.method) if self.grows else None
        until = self.chosen_at if self.system.displaced else None
        fold = March(self.odd, self.rest, self.windows.bound, carrier, until)
        left = self.method.budget - spent
        return Motion(
            self.system, self.y0, fold, self.method.at_most(left),
            end=self.horizon, valid=self.valid,
        )  # fmt: skip

    def _shot(self, y0: PhasePoint, attempt: Attempt, left: Count) -> Motion[ShotState]:
        method = self.method.at_most(left)
        return shot_motion(self.system, y0, attempt, method, self.observation)

    def _left(self, now: Certifying) -> Count:
        return self.method.budget - now.march.steps - now.spent

    # ---- at the end of a phase

    def _after_march(self, now: Certifying) -> Certifying:
        """The motion's next phase, or how it has failed."""
        run, state = now.march, now.returns
        last = jnp.maximum(state.asks, run.folded.asks)
        well = run.outcome == CODE.complete
        tries = well & (last == A_SHOT)
        accepted = well & (last == ACCEPTANCE)
        rests, refused = well & (last == REST), False
        if run.folded.calm:
            refused = rests & ~decays(self.system, run.y, run.folded.calm.late)
        over = well & ((last == NOTHING) | (last == ENDURES))
        count, checks = state.returns, False
        if self.system.sticks:  # the orbit's map is that of its own events alone
            checks, accepted = accepted, False
            tries |= checks
            count = jnp.where(checks, now.candidate.returns, count)
        x, zero = state.points[0], 0.0 * run.time
        shoots = tries | rests | over if self.watches else tries
        span = self.last + zero
        if not self.rest.by_modes:
            span = jnp.where(rests, AT_REST, span)
        span = jnp.where(tries, span_of(state, count), span)
        attempt = attempt_at(now.attempt, x, span, self._sign(count), checks)
        attempt = attempt._replace(level=run.folded.level)
        watched = jnp.where(rests, self.rest.outcome(self.system), CODE.unsettled)
        watched = jnp.where(rests | over, watched, CODE.not_computed)
        failed = jnp.where(last > REST, CODE.escaped, run.outcome)
        ended = jnp.where(rests | over, watched, failed)
        outcome = jnp.where(shoots, CODE.not_computed, ended)
        outcome = jnp.where(accepted, CODE.cycle, outcome)
        after = now._replace(
            stage=jnp.where(shoots, SHOTS, now.stage).astype(jnp.int32),
            shot=tree_where(shoots, to_be_begun(now.shot), now.shot),
            attempt=attempt,
            observing=watched.astype(jnp.int32),
            outcome=outcome.astype(jnp.int32),
        )
        return replaced(refused, going_on(now), after)

    def _after_observation(self, now: Certifying) -> Certifying:
        """The state after the observation."""
        run, span = now.shot, now.attempt.span
        well = run.outcome == CODE.complete
        record = Record(run.folded.record, span, run.y)
        outcome = jnp.where(well, now.observing, run.outcome)
        after = now._replace(
            orbit=Orbit(run.y, span, span + jnp.nan, record),
            spent=(now.spent + run.steps).astype(jnp.int32),
            outcome=outcome.astype(jnp.int32),
        )
        if not now.growth:
            return after
        unsettled = after.outcome == CODE.unsettled
        growing = after._replace(
            stage=jnp.full_like(now.stage, GROWTH),
            outcome=jnp.zeros_like(after.outcome),
            growth=to_be_begun(now.growth),
        )
        return replaced(unsettled, growing, after)

    def _sign(self, returns: Count) -> Scalar:
        """-1 where an odd number of half returns closes."""
        odd = self.odd & (jnp.asarray(returns) % 2 == 1)
        return jnp.where(odd, -1.0, 1.0)

    def _judged(self, now: Certifying) -> Certifying:
        """The verdict on an orbit that closes; what does not is forgotten."""
        run, state, attempt = now.shot, now.returns, now.attempt
        radius = spectral_radius(attempt.slope)
        margin = MARGIN * state.returns.astype(jnp.result_type(radius))
        stable = attempt.verified & (radius < 1 - margin)
        unstable = attempt.verified & (radius > 1 + margin)
        norm = contraction_norm(attempt.slope, radius)
        numbers = attempt.x, attempt.slope, norm, radius, attempt.modes
        orbit = Candidate(stable, state.returns, *numbers)
        at_once = stable & comes_at_once(orbit, attempt, self.system.sticks)
        record = Record(run.folded.record, attempt.span, run.y)
        closed = Orbit(start_of(attempt), attempt.span, attempt.size, record)
        returns = tree_where(stable, with_candidate(state), ask_no_more(state))
        if self.system.sticks:
            returns, alike = checked(now, returns)
            at_once |= alike
        outcome = jnp.where(at_once, CODE.cycle, CODE.not_computed)
        return now._replace(
            stage=jnp.full_like(now.stage, MARCH),
            march=now.march.resumed(),
            returns=returns,
            candidate=tree_where(stable, orbit, now.candidate),
            orbit=tree_where(stable, closed, now.orbit),
            unstable=now.unstable | unstable,
            outcome=outcome.astype(jnp.int32),
        )

    # ---- what it amounts to

    def kind(self, now: Certifying) -> Int[Array, ""]:
        """Of which kind an undecided lane is."""
        kind = now.returns.trend.kind(now.returns.nearest, now.unstable)
        if now.growth:
            name = name_of(now.growth.folded, self.last)
            named = self.measured(now) & (name != CODE.not_computed)
            kind = jnp.where(named, name, kind)
        kind = jnp.where(now.outcome == CODE.unsettled, kind, CODE.decided)
        return kind.astype(jnp.int8)

    def measured(self, now: Certifying) -> Bool[Array, ""]:
        """Whether it has exponents: of one that turned over there are none."""
        whole = now.growing.outcome == CODE.complete
        return whole & (now.outcome == CODE.unsettled)

    def exponents_of(self, now: Certifying) -> dict[str, Variable]:
        """The exponents with their errors, NaN where none were measured."""
        if not now.growth:
            return {}
        return exponent_variables(now.growth.folded, ~self.measured(now))

    def settings(self) -> dict[str, Option]:
        """The options, for the record."""
        return {
            **self.method.settings(),
            **self.windows.settings(),
            **({"exponents": self.exponents} if self.exponents else {}),
            "rate_cut": self.rest.setting(),
        }
