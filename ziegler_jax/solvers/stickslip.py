r"""Stick and slip: an explicit solver whose steps end where a joint changes its mode.

Between events the modes are frozen and the field is smooth. Each joint has a guard that
is positive as long as its mode holds:

$$g_i = m_i u_i \text{ (slips in direction } m_i\text{)}, \qquad
g_i = \frac{\tau_{s,i}^2 - \lambda_i^2}{2\tau_{s,i}} \text{ (sticks)}.$$

A step in which a guard falls below zero is cut there: the state on the first such event
is that of the method's own interpolant, no step is repeated. There the joint's rate is
made exactly zero, the friction law chooses new modes for both joints, and the solve
goes on.

`Taylor` is the other engine for stick and slip, and the faster one for motions alone.
It was tried in place of this one. For tangents its multipliers err 6 to 12 times as
much at equal tolerances, a shot compiles 1.5 times as long, and it gains below 1e-10
alone. For friction on the joints' reactions it took half the time, but at 1e-10 two of
96 motions err by 1e-5 in energy where a joint's reaction nearly vanishes.
"""

from typing import Generic, NamedTuple, cast

import diffrax as dfx
import jax
import jax.numpy as jnp

from ..model.column import Column, joint_balance, vector_field
from ..model.release_layer import FAR
from ..model.set_valued import Dynamics, FrozenCoulomb, in_modes
from ..numerics.hermite import (
    HermiteQuartic,
    chord_root,
    place,
    probe_point,
    through,
)
from ..numerics.materialise import if_any_lane, materialise, tree_where
from ..numerics.numbers import Flag, Flags, Pair, Scalar, Traced, Traced4, Vector4
from .control import Signals
from .explicit import OKAY, Explicit, dense
from .fold import AbstractFold, AbstractObserved, State, Step
from .guards import brackets_of, guard_of, rate_courses, sliding_guards

EVENT_SHARE = 0.01  # an event's tolerance against that of a step
FINEST = 64  # and the least, in units of rounding
# Events that follow each other within SAME_TIME, in a row: then time does not go on.
SAME_TIME, MOST_AT_ONCE = 1e-9, 40
# for each joint whether a step ends on its event, and whether its guard falls there
Passed = tuple[Flags, Flags]


class StickSlipState(NamedTuple, Generic[State]):
    """Where a stick-slip solve is."""

    y: Traced4
    accelerations: Pair  # at y in the modes
    folded: State
    modes: Pair
    guard: Pair  # the guards of sticking joints
    guard_rate: Pair  # and their slopes in time
    last_event: Scalar
    at_once: Scalar  # how many events have followed each other without time between

    @property
    def slope(self) -> Traced4:
        """The right-hand side at y."""
        return cast(Traced4, (*self.y[2:], *self.accelerations))


class StickSlip(AbstractObserved[StickSlipState, Explicit]):
    """An explicit solver for set-valued friction, with a fold over accepted steps.

    Needs `StepControl`. The column among diffrax's `args` must have been prepared:
    its friction is `FrozenCoulomb`.

    **Arguments:** `solver`; `fold`; `tolerance`: of a step, to which that of events is
    bound: they are met when the guard is within a hundredth of it.
    """

    solver: Explicit
    fold: AbstractFold
    tolerance: Scalar

    def init(  # pyright: ignore[reportIncompatibleMethodOverride]
        self, terms: dfx.AbstractTerm, t0: Traced, t1: Traced, y0: Traced4, args: Column
    ) -> StickSlipState:
        """The modes of the start, and the fold's."""
        del terms, t1
        tol, zero = event_tolerance(self.tolerance, y0[0]), 0.0 * y0[0]
        y, modes = begun(args, y0, tol)
        column = in_modes(args, modes)
        slope = cast(Traced4, vector_field(t0, y, column))
        guard, guard_rate = _holding(column, y, slope, tol)
        folded = self.fold.init(column, t0, y)
        return StickSlipState(
            y, slope[2:], folded, modes, guard, guard_rate, t0 - 1.0 + zero, zero
        )

    def chatters(self, state: StickSlipState) -> Flag:
        """Whether the lane cannot go on, because events follow without time between."""
        return chattering(state.at_once)

    def try_step(self, terms, t0, t1, y0, args, solver_state, judge=None):
        """One step in frozen modes, cut on the first event, and the change of modes."""
        _, _, folded, modes, guard, guard_rate, last_event, at_once = solver_state
        column = in_modes(args, modes)
        law, h, f0 = cast(FrozenCoulomb, column.friction), t1 - t0, solver_state.slope
        least = event_tolerance(self.tolerance, t1)
        watched = self.fold.integrand(column)

        y1, error, f1, whole, stages = self.solver.advance(
            terms, t0, t1, y0, column, f0, watched
        )
        y1 = (*y1[:2], *law.hold(y1[2], y1[3]))
        bends = materialise(t0, self.solver.bends, h, stages.slopes)
        motion = rate_courses(y0, y1, h, f0, f1, bends)
        tol = self._tolerances(t1, modes, f1, guard_rate)
        guards = guard, guard_rate, materialise(t0, guard_of, column, y1, least)
        x, forced, passed = self._first_event(column, motion, t0, h, guards, tol)
        cut = x < 1

        def arrive():
            pairs = zip(motion, y1, strict=True)
            y = tuple(jnp.where(cut, course(x), end) for course, end in pairs)
            y = cast(Traced4, y)
            return _arrival(law, y, passed, cut, tol)

        y, rest, landed, met = materialise(t0, arrive)

        def release():
            balance = joint_balance(column, y)
            return balance, *_released(law, balance, passed, tol, least)

        balance, freed, close = materialise(t0, release)
        landed = tuple(a | b for a, b in zip(landed, freed, strict=True))
        event = landed[0] | landed[1]
        met = (met & close) | forced
        # else as large as the state: repeated with a far shorter step, and with finite
        # slopes
        pairs = zip(error, y, strict=True)
        error = tuple(jnp.where(met, e, 1.0 + jnp.abs(x)) for e, x in pairs)

        def change(modes):
            new = chosen(law, balance, rest, cast(Flags, landed), tol)
            after = (jnp.where(event, a, b) for a, b in zip(new, modes, strict=True))
            return cast(Pair, tuple(after))

        modes_after = if_any_lane(event, change, modes)
        now = in_modes(args, modes_after)

        def slopes():
            """At the end, in the modes before and after."""
            return [
                cast(Traced4, (y[2], y[3], *friction.accelerations(balance)))
                for friction in (law, cast(FrozenCoulomb, now.friction))
            ]

        f_end, slope = materialise(t0, slopes)
        guard, guard_rate = materialise(t0, _holding, now, y, slope, least)

        t_end = materialise(t0, lambda: jnp.where(cut, t0 + x * h, t1))
        at_same = t_end - last_event <= SAME_TIME * jnp.maximum(1.0, jnp.abs(t_end))
        at_once = jnp.where(event, jnp.where(at_same, at_once + 1.0, 0.0), at_once)
        last_event = jnp.where(event, t_end, last_event)
        joint = jnp.where(landed[0], 1, 0) + jnp.where(landed[1], 2, 0)
        integrals = ()
        if watched is not None:
            rows = stages.integrands
            bends = self.solver.bends(h, rows)
            zero = tuple(0.0 * w for w in whole)
            parts = rate_courses(zero, whole, h, rows[0], rows[-1], bends)
            integrals = tuple(part(x) for part in parts)
        step = Step(t0, t_end, y0, y, f0, f_end, integrals, modes, (joint, modes_after))
        verdict = None if judge is None else judge(y, error, t_end)
        folded, stop, done = self.fold.accepted(column, folded, step, verdict)
        state = StickSlipState(
            y, slope[2:], folded, modes_after, guard, guard_rate, last_event, at_once
        )
        when = stop, done | self.chatters(state)
        stop, done = (jnp.asarray(x, jnp.result_type(t1)) for x in when)
        signals = Signals(error, stop, done, t_end, verdict)
        return y, signals, dense(t0, t1, y0, y, f0, f_end), state, OKAY

    def _tolerances(
        self, t: Scalar, modes: Pair, slope: Vector4, guard_rate: Pair
    ) -> Pair:
        """How closely each guard can be met: no more than a time can be told."""
        least = event_tolerance(self.tolerance, t)
        eps = jnp.finfo(jnp.result_type(t)).eps
        speeds = [
            jnp.where(m == 0, e, f)
            for m, e, f in zip(modes, guard_rate, _rates(slope), strict=True)
        ]
        return cast(Pair, tuple(least + 8 * eps * jnp.abs(t * v) for v in speeds))

    def _first_event(
        self,
        column: Column,
        motion: list[HermiteQuartic],
        t0: Scalar,
        h: Scalar,
        guards: tuple[Pair, Pair, Pair],
        tol: Pair,
    ) -> tuple[Scalar, Flag, Passed]:
        """Where in (0, 1] the step must end, and which guards fall there.

        **Returns:** the place; whether it is as early as can be told; and for each
        joint whether this is its event, and whether its guard falls there.
        """
        law = cast(FrozenCoulomb, column.friction)
        assert law.modes is not None
        guard, guard_rate, guard1 = guards
        stuck = tuple(m == 0 for m in law.modes)

        def look():
            """A place within the step, for the torques that hold."""
            rows = zip(guard, guard_rate, guard1, strict=True)
            (x1, low1), (x2, low2) = [probe_point(g, h * v, g1) for g, v, g1 in rows]
            low1 = jnp.where(stuck[0], low1, jnp.inf)
            low2 = jnp.where(stuck[1], low2, jnp.inf)
            x = jnp.where(low1 <= low2, x1, x2)
            return jnp.where((low1 < 0) & (low2 < 0), jnp.minimum(x1, x2), x)

        inner = materialise(t0, look)

        def within():
            p1, p2, w1, w2 = (course(inner) for course in motion)
            return guard_of(
                column, (p1, p2, *law.hold(w1, w2)), event_tolerance(self.tolerance, t0)
            )

        inside = materialise(t0, within)

        def guard_courses():
            rows = zip(guard, guard_rate, inside, guard1, strict=True)
            holding = [through(g, h * v, inner, gx, g1) for g, v, gx, g1 in rows]
            sliding = sliding_guards(cast(Pair, law.modes), motion)
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
            second = about[1] < about[0]
            each = zip(courses, tol, brackets, about, strict=True)
            row = [(*c, e, *b, x) for c, e, b, x in each]
            return second, [jnp.where(second, b, a) for a, b in zip(*row, strict=True)]

        second, (*course, e, passes, left, right, about) = materialise(t0, choose)

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
            mine = passes & ~second, passes & second
            return (
                x,
                root <= soonest,
                cast(Passed, tuple(zip(mine, falls, strict=True))),
            )

        return materialise(t0, verdict)


def event_tolerance(tolerance: Scalar, x: Scalar) -> Scalar:
    """How closely events are met: a share of a step's tolerance, above rounding."""
    least = FINEST * jnp.finfo(jnp.result_type(x)).eps
    return jnp.maximum(EVENT_SHARE * tolerance, least)


def begun(column: Column, y0: Traced4, tol: Scalar) -> tuple[Traced4, Pair]:
    """The start, with the rates of resting joints exactly zero, and its modes."""
    rest = cast(Flags, tuple(jnp.abs(u) <= tol for u in _rates(y0)))
    y = at_rest(y0, rest)
    law = cast(FrozenCoulomb, column.friction)
    m1, m2 = law.begin(joint_balance(column, y), _rates(y), rest)
    zero = 0.0 * y0[0]
    return y, (m1 + zero, m2 + zero)


def chattering(at_once: Scalar) -> Flag:
    """Whether so many events without time between say that time does not go on."""
    return at_once > MOST_AT_ONCE


def _rates(y: Vector4) -> Pair:
    return y[2], y[3] - y[2]


def at_rest(y: Traced4, rest: Flags) -> Traced4:
    """The state with the rates of resting joints exactly zero."""
    w1 = jnp.where(rest[0], 0.0, y[2])
    return y[0], y[1], w1, jnp.where(rest[1], w1, y[3])


def _holding(
    column: Column, y: Vector4, slope: Vector4, least: Scalar
) -> tuple[Pair, Pair]:
    """The guards of joints that stick, and their slopes in time."""
    return jax.jvp(lambda y: guard_of(column, y, least), (y,), (slope,))


def _arrival(
    law: FrozenCoulomb, y: Traced4, passed: Passed, cut: Flag, tol: Pair
) -> tuple[Traced4, Flags, Flags, Flag]:
    """The step's end: the state with landed rates at rest, which rest, which landed.

    Last: whether the rates are as close to their event as the tolerances ask.
    """
    assert law.modes is not None
    w1, w2 = law.hold(y[2], y[3])
    rest, landed, met = [], [], True
    rows = zip(law.modes, (w1, w2 - w1), passed, tol, strict=True)
    for m, u, here, e in rows:
        slips, (ends, close) = m != 0, _at_event(m * u, here, e)
        landed.append(slips & ends)
        rest.append(~slips | ends | (cut & (jnp.abs(u) <= e)))
        met &= ~slips | close
    rest, landed = cast(Flags, tuple(rest)), cast(Flags, tuple(landed))
    y = cast(Traced4, (y[0], y[1], w1, w2))
    return at_rest(y, rest), rest, landed, cast(Flag, met)


def _released(
    law: FrozenCoulomb, balance: Dynamics, passed: Passed, tol: Pair, least: Scalar
) -> tuple[Flags, Flag]:
    """Which sticking joints reach their most, and whether as close as asked."""
    assert law.modes is not None
    freed, met = [], True
    rows = zip(law.modes, law.guard(balance, least), passed, tol, strict=True)
    for m, guard, here, e in rows:
        sticks, (ends, close) = m == 0, _at_event(guard, here, e)
        freed.append(sticks & ends)
        met &= ~sticks | close
    return cast(Flags, tuple(freed)), cast(Flag, met)


def _at_event(guard: Scalar, passed: Flags, tol: Scalar) -> Flags:
    """Whether a mode ends here by its guard, and whether as close as the tolerance."""
    mine, falls = passed
    low = guard <= tol
    return mine | (low & falls), cast(Flag, (guard >= -tol) & (~mine | low))


def chosen(
    law: FrozenCoulomb, balance: Dynamics, rest: Flags, landed: Flags, tol: Pair
) -> Pair:
    """The modes after an event."""
    assert law.modes is not None
    here = law.loaded(balance)
    torque = here.torques(balance)
    slack, layer = [], []
    for i, m in enumerate(law.modes):
        sticks = m == 0
        slack.append(jnp.where(sticks & landed[i], 2 * tol[i], 0.0))
        inside = jnp.clip(torque[i] / jnp.maximum(here.static[i], 1e-30), -1.0, 1.0)
        # one that breaks loose is just beyond its peak
        inside = jnp.where(landed[i], 1.001 * jnp.sign(torque[i]), inside)
        layer.append(jnp.where(sticks, inside, FAR * m))
    event = landed[0] | landed[1]

    def packed():
        """Both modes in one number, that they are not chosen twice."""
        sides = cast(Pair, tuple(slack)), cast(Pair, tuple(layer))
        parts = balance, cast(Pair, law.modes), rest, *sides, event
        m1, m2 = law.chosen(*parts)
        return 3 * m1 + m2

    both = materialise(balance.r1, packed)
    m1 = jnp.round(both / 3)
    return m1, both - 3 * m1
