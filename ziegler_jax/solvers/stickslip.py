r"""Stick and slip: an explicit solver whose steps end where a joint changes its mode.

Between events the modes are frozen and the field is smooth. Each joint has a guard that
is positive as long as its mode holds:

$$g_i = m_i u_i \text{ (slips in direction } m_i\text{)}, \qquad
g_i = \frac{\tau_{s,i}^2 - \lambda_i^2}{2\tau_{s,i}} \text{ (sticks)}.$$

A step in which a guard falls below zero is cut there: the state on the first such event
is that of the method's own interpolant, no step is repeated. There the joint's rate is
made exactly zero, the friction law chooses new modes for all joints, and the solve
goes on.

`Taylor` is the other engine for stick and slip, and the usual one where there are
series: its tangents share them (`along`), and a cycle takes two thirds of the steps at
1e-10, with multipliers ten times as close. This one is for friction on the joints'
reactions, and for damping laws of your own. There Taylor's method took half the time,
but at 1e-10 two of 96 motions err by 1e-5 in energy where a joint's reaction nearly
vanishes.
"""

from collections.abc import Sequence
from functools import reduce
from typing import Generic, NamedTuple

import jax
import jax.numpy as jnp

from ..model.chain import joint_angles, welded
from ..model.coulomb_torques import CoulombInModes, MassAndForces
from ..model.state import PhasePoint
from ..model.stick_slip_modes import modes_of
from ..model.system import System
from ..numerics.hermite import (
    HermiteQuartic,
    chord_root,
    place,
    probe_point,
    through,
)
from ..numerics.materialise import if_any_lane, materialise, tree_where
from ..numerics.numbers import Count, Flag, Flags, Numbers, Scalar, any_of
from .control import Signals
from .explicit import Explicit
from .fold import AbstractFold, AbstractLaneSolver, State, Step
from .guards import brackets_of, guard_of, rate_courses, sliding_guards

EVENT_SHARE = 0.01  # an event's tolerance against that of a step
FINEST = 64  # and the least, in units of rounding
# Events that follow each other within SAME_TIME, in a row: then time does not go on.
SAME_TIME, MOST_AT_ONCE = 1e-9, 40
# for each joint whether a step ends on its event, and whether its guard falls there
Passed = tuple[Flags, ...]


class StickSlipState(NamedTuple, Generic[State]):
    """Where a stick-slip solve is."""

    y: PhasePoint
    accelerations: Numbers  # at y in the modes
    folded: State
    modes: Numbers
    guard: Numbers  # the guards of sticking joints
    guard_rate: Numbers  # and their slopes in time
    last_event: Scalar
    at_once: Scalar  # how many events have followed each other without time between

    @property
    def slope(self) -> PhasePoint:
        """The right-hand side at y."""
        return PhasePoint.of(self.y.omega, self.accelerations)


class StickSlip(AbstractLaneSolver[StickSlipState]):
    """An explicit solver for set-valued friction, with a fold over accepted steps.

    Needs `StepControl`. diffrax's `args` are the system, no modes chosen yet.

    **Arguments:** `solver`; `fold`; `tolerance`: of a step, to which that of events is
    bound: they are met when the guard is within a hundredth of it.
    """

    solver: Explicit
    fold: AbstractFold
    tolerance: Scalar

    @property
    def degree(self) -> int:
        """The method's order."""
        return self.solver.order

    def begin(self, system, t0, y0):
        """The modes of the start, and the fold's."""
        tol, zero = event_tolerance(self.tolerance, y0[0]), 0.0 * y0[0]
        y, modes = begun(system.at(t0), y0, tol)
        system = system.in_modes(modes)
        slope = system.field(t0, y)
        when = None if system.autonomous else t0
        guard, guard_rate = _holding(system, when, y, slope, tol)
        folded = self.fold.init(system, t0, y)
        return StickSlipState(
            y, slope.omega, folded, modes, guard, guard_rate, t0 - 1.0 + zero, zero
        )

    def chatters(self, state: StickSlipState) -> Flag:
        """Whether the lane cannot go on, because events follow without time between."""
        return chattering(state.at_once)

    def attempt(self, system, t0, t1, where, judge):
        """One step in frozen modes, cut on the first event, and the change of modes."""
        y0, _, folded, modes, guard, guard_rate, last_event, at_once = where
        system = system.in_modes(modes)
        law, h, f0 = system.law, t1 - t0, where.slope
        least = event_tolerance(self.tolerance, t1)
        watched = self.fold.integrand(system)

        y1, error, f1, whole, stages = self.solver.advance(
            system.right_hand_side, t0, t1, y0, f0, watched
        )
        y1 = PhasePoint.of(y1.phi, law.hold(y1.omega))
        bends = materialise(t0, self.solver.bends, h, stages.slopes)
        motion = rate_courses(y0, y1, h, f0, f1, bends)
        tol = self._tolerances(t1, modes, f1, guard_rate)
        guards = guard, guard_rate, materialise(t0, guard_of, system.at(t1), y1, least)
        x, forced, passed = self._first_event(system, motion, t0, h, guards, tol)
        cut = x < 1

        def arrive():
            pairs = zip(motion, y1, strict=True)
            y = PhasePoint(jnp.where(cut, course(x), end) for course, end in pairs)
            return _arrival(law, y, passed, cut, tol)

        y, rest, landed, met = materialise(t0, arrive)

        def end() -> jax.Array:
            return jnp.where(cut, t0 + x * h, t1)

        t_event = None if system.autonomous else end()

        def release():
            balance = system.at(t_event).balance(y)
            return balance, *_released(law, balance, passed, tol, least)

        balance, freed, close = materialise(t0, release)
        landed = tuple(a | b for a, b in zip(landed, freed, strict=True))
        event = any_of(landed)
        met = (met & close) | forced
        # else as large as the state: repeated with a far shorter step, and with finite
        # slopes
        pairs = zip(error, y, strict=True)
        error = PhasePoint(jnp.where(met, e, 1.0 + jnp.abs(x)) for e, x in pairs)

        def change(modes):
            new = chosen(law, balance, rest, landed, tol)
            pairs = zip(new, modes, strict=True)
            return tuple(jnp.where(event, a, b) for a, b in pairs)

        modes_after = if_any_lane(event, change, modes)
        now = system.in_modes(modes_after)

        def slopes():
            """At the end, in the modes before and after."""
            each = (friction.accelerations(balance) for friction in (law, now.law))
            return [PhasePoint.of(y.omega, rates) for rates in each]

        f_end, slope = materialise(t0, slopes)
        guard, guard_rate = materialise(t0, _holding, now, t_event, y, slope, least)

        t_end = materialise(t0, end)
        at_same = t_end - last_event <= SAME_TIME * jnp.maximum(1.0, jnp.abs(t_end))
        at_once = jnp.where(event, jnp.where(at_same, at_once + 1.0, 0.0), at_once)
        last_event = jnp.where(event, t_end, last_event)
        joint = joints_number(landed)
        integrals = ()
        if watched is not None:
            rows = stages.integrands
            bends = self.solver.bends(h, rows)
            zero = tuple(0.0 * w for w in whole)
            parts = rate_courses(zero, whole, h, rows[0], rows[-1], bends)
            integrals = tuple(part(x) for part in parts)
        step = Step(t0, t_end, y0, y, f0, f_end, integrals, modes, (joint, modes_after))
        verdict = judge(y, error, t_end)
        folded, stop, done = self.fold.accepted(system, folded, step, verdict)
        state = StickSlipState(
            y, slope.omega, folded, modes_after, guard, guard_rate, last_event, at_once
        )
        when = stop, done | self.chatters(state)
        stop, done = (jnp.asarray(x, jnp.result_type(t1)) for x in when)
        return state, Signals(verdict, stop, done, t_end)

    def _tolerances(
        self, t: Scalar, modes: Numbers, slope: PhasePoint, guard_rate: Numbers
    ) -> Numbers:
        """How closely each guard can be met: no more than a time can be told."""
        least = event_tolerance(self.tolerance, t)
        eps = jnp.finfo(jnp.result_type(t)).eps
        each = zip(modes, guard_rate, joint_angles(slope.omega), strict=True)
        speeds = (jnp.where(m == 0, e, f) for m, e, f in each)
        return tuple(least + 8 * eps * jnp.abs(t * v) for v in speeds)

    def _first_event(
        self,
        system: System,
        motion: list[HermiteQuartic],
        t0: Scalar,
        h: Scalar,
        guards: tuple[Numbers, Numbers, Numbers],
        tol: Numbers,
    ) -> tuple[Scalar, Flag, Passed]:
        """Where in (0, 1] the step must end, and which guards fall there.

        **Returns:** the place; whether it is as early as can be told; and for each
        joint whether this is its event, and whether its guard falls there.
        """
        law = system.law
        guard, guard_rate, guard1 = guards
        stuck = law.stuck

        def look():
            """A place within the step, for the torques that hold."""
            rows = zip(stuck, guard, guard_rate, guard1, strict=True)
            places = []
            for still, g, v, g1 in rows:
                x, low = probe_point(g, h * v, g1)
                places.append((x, jnp.where(still, low, jnp.inf)))

            def lower(one, other):
                """The lower of two places, of such below zero the earlier."""
                (x1, low1), (x2, low2) = one, other
                x = jnp.where(low1 <= low2, x1, x2)
                x = jnp.where((low1 < 0) & (low2 < 0), jnp.minimum(x1, x2), x)
                return x, jnp.minimum(low1, low2)

            return reduce(lower, places)[0]

        inner = materialise(t0, look)

        def within():
            y = PhasePoint(course(inner) for course in motion)
            at = PhasePoint.of(y.phi, law.hold(y.omega))
            now = system if system.autonomous else system.at(t0 + inner * h)
            return guard_of(now, at, event_tolerance(self.tolerance, t0))

        inside = materialise(t0, within)

        def guard_courses():
            rows = zip(guard, guard_rate, inside, guard1, strict=True)
            holding = [through(g, h * v, inner, gx, g1) for g, v, gx, g1 in rows]
            sliding = sliding_guards(law.modes, motion)
            return [
                tree_where(s, one, other)
                for s, one, other in zip(stuck, holding, sliding, strict=True)
            ]

        courses = materialise(t0, guard_courses)
        brackets = brackets_of(courses, tol, t0)

        def choose():
            """The joint whose guard falls first."""
            about = [
                jnp.where(falls, chord_root(course, left, right), jnp.inf)
                for course, (falls, left, right) in zip(courses, brackets, strict=True)
            ]
            each = zip(courses, tol, brackets, about, strict=True)
            first, *others = [(*c, e, *b, x) for c, e, b, x in each]
            which: list[Flag] = [jnp.ones_like(t0, bool)]
            for other in others:
                sooner = other[-1] < first[-1]
                pairs = zip(first, other, strict=True)
                first = [jnp.where(sooner, b, a) for a, b in pairs]
                which = [*(w & ~sooner for w in which), sooner]
            return which, first

        which, (*course, e, passes, left, right, about) = materialise(t0, choose)

        def locate():
            begin = jnp.where(passes, about, 0.5)
            x = place(HermiteQuartic(*course), -0.5 * e, begin, left, right)
            return jnp.where(passes, x, 1.0)

        root = materialise(t0, locate)

        def verdict():
            eps = jnp.finfo(jnp.result_type(t0)).eps
            soonest = 16 * eps * jnp.maximum(jnp.abs(t0), eps) / h
            x = jnp.minimum(jnp.maximum(root, soonest), 1.0)
            falls = tuple(course.slope(x) < 0 for course in courses)
            mine = tuple(passes & w for w in which)
            return x, root <= soonest, tuple(zip(mine, falls, strict=True))

        return materialise(t0, verdict)


def event_tolerance(tolerance: Scalar, x: Scalar) -> Scalar:
    """How closely events are met: a share of a step's tolerance, above rounding."""
    least = FINEST * jnp.finfo(jnp.result_type(x)).eps
    return jnp.maximum(EVENT_SHARE * tolerance, least)


def joints_number(ended: Sequence[Flag]) -> Count:
    """The joints whose modes ended, in one number: the sum of 2^(i - 1)."""
    numbers = [jnp.where(here, 2**i, 0) for i, here in enumerate(ended)]
    return sum(numbers[1:], numbers[0])


def begun(system: System, y0: PhasePoint, tol: Scalar) -> tuple[PhasePoint, Numbers]:
    """The start, with the rates of resting joints exactly zero, and its modes."""
    rest = [jnp.abs(u) <= tol for u in joint_angles(y0.omega)]
    y, zero = at_rest(y0, rest), 0.0 * y0[0]
    u = joint_angles(y.omega)
    law = system.coulomb.at_state(system.balance(y), u, rest)
    return y, tuple(m + zero for m in law.modes)


def chattering(at_once: Scalar) -> Flag:
    """Whether so many events without time between say that time does not go on."""
    return at_once > MOST_AT_ONCE


def at_rest(y: PhasePoint, rest: Sequence[Flag]) -> PhasePoint:
    """The state with the rates of resting joints exactly zero."""
    return PhasePoint.of(y.phi, welded(rest, y.omega))


def _holding(
    system: System,
    t: Scalar | None,
    y: PhasePoint,
    slope: PhasePoint,
    least: Scalar,
) -> tuple[Numbers, Numbers]:
    """The guards of joints that stick, and their slopes in time.

    **Arguments:** `t`: the time; None, where that does not matter.
    """
    if t is None:
        return jax.jvp(lambda y: guard_of(system, y, least), (y,), (slope,))

    def guard(t, y):
        return guard_of(system.at(t), y, least)

    return jax.jvp(guard, (t, y), (jnp.ones_like(t), slope))


def _arrival(
    law: CoulombInModes, y: PhasePoint, passed: Passed, cut: Flag, tol: Numbers
) -> tuple[PhasePoint, list[Flag], list[Flag], Flag]:
    """The step's end: the state with landed rates at rest, which rest, which landed.

    Last: whether the rates are as close to their event as the tolerances ask.
    """
    rates = law.hold(y.omega)
    rest: list[Flag] = []
    landed: list[Flag] = []
    met: Flag = True
    rows = zip(law.modes, joint_angles(rates), passed, tol, strict=True)
    for m, u, here, e in rows:
        slips, (ends, close) = m != 0, _at_event(m * u, here, e)
        landed.append(slips & ends)
        sticks = jnp.logical_not(slips)
        rest.append(sticks | ends | (cut & (jnp.abs(u) <= e)))
        met &= sticks | close
    return at_rest(PhasePoint.of(y.phi, rates), rest), rest, landed, met


def _released(
    law: CoulombInModes,
    balance: MassAndForces,
    passed: Passed,
    tol: Numbers,
    least: Scalar,
) -> tuple[list[Flag], Flag]:
    """Which sticking joints reach their most, and whether as close as asked."""
    freed: list[Flag] = []
    met: Flag = True
    rows = zip(law.modes, law.guard(balance, least), passed, tol, strict=True)
    for m, guard, here, e in rows:
        sticks, (ends, close) = m == 0, _at_event(guard, here, e)
        freed.append(sticks & ends)
        met &= jnp.logical_not(sticks) | close
    return freed, met


def _at_event(guard: Scalar, passed: Flags, tol: Scalar) -> Flags:
    """Whether a mode ends here by its guard, and whether as close as the tolerance."""
    mine, falls = passed
    low = guard <= tol
    return mine | (low & falls), (guard >= -tol) & (jnp.logical_not(mine) | low)


def chosen(
    law: CoulombInModes,
    balance: MassAndForces,
    rest: Sequence[Flag],
    landed: Sequence[Flag],
    tol: Sequence[Scalar],
) -> Numbers:
    """The modes after an event."""
    each = zip(law.stuck, landed, tol, strict=True)
    slack = [jnp.where(stuck & ends, 2 * e, 0.0) for stuck, ends, e in each]
    number = materialise(
        balance.right[0], lambda: law.chosen(balance, law.modes, rest, slack)
    )
    return modes_of(number, len(law.modes))
