r"""Stick and slip by Taylor's method: power series from event to event.

With its modes frozen the motion is analytic. The equations of motion themselves give
its series (`expansion`), and with it those of what tells whether the modes hold: each
sliding joint's rate, each sticking joint's torque (`bernstein`). So nothing is
interpolated and no step is rejected: it is as long as the series allows, or ends on the
first end of a mode. There a joint that slid is at rest, the friction law chooses new
modes, and the motion goes on.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Generic, NamedTuple

import equinox as eqx
import jax.numpy as jnp

from ..model.chain import joint_angles
from ..model.state import PhasePoint
from ..numerics.bernstein import ends_here, first_event, first_look
from ..numerics.materialise import if_any_lane, materialise
from ..numerics.numbers import Flag, Numbers, Scalar, any_of
from ..numerics.series import value
from .along import Moved, along_to
from .control import ControlState, Signals, StepControl, Verdict
from .expansion import Coefficients
from .explicit import Integrand
from .fold import AbstractFold, AbstractLaneSolver, State, Step
from .stickslip import (
    FINEST,
    SAME_TIME,
    at_rest,
    begun,
    chattering,
    chosen,
    event_tolerance,
    joints_number,
)

# Gauss' rule of five nodes for integrals over a step, in closed form: what LAPACK gives
# depends on the processor in the last bit, and a scene's digest would with it
_OUTER, _INNER = (math.sqrt(5 + i * 2 * math.sqrt(10 / 7)) / 3 for i in (1, -1))
_LESS, _MORE = ((322 + i * 13 * math.sqrt(70)) / 900 for i in (-1, 1))
_GAUSS = (-_OUTER, _LESS), (-_INNER, _MORE), (0.0, 128 / 225), (_INNER, _MORE)
_GAUSS += ((_OUTER, _LESS),)


class Taylor(eqx.Module):
    r"""Taylor's method for set-valued friction, of a given order.

    $$y(t_0 + s) \approx \sum_{k=0}^{p} y_k s^k, \qquad
    (k + 1)\, y_{k+1} = f_k(y_0, \dots, y_k)$$

    with f the equations of motion in frozen modes. What slips and what sticks are
    polynomials too, whose first roots are the events.

    **Arguments:** `order`: p, at least 3. Steps grow with it, and their cost with its
    square: from 7 to 10 a cycle costs the same within 4 % at a tolerance of 1e-5.

    Not for other friction than `SetValuedCoulomb`, its load `JointReaction()`, or
    damping laws of your own: `settle` says so.

    **Raises:** `ValueError` for an order that is no whole number of at least 3.
    """

    order: int = eqx.field(static=True)

    def __init__(self, order: int = 8):
        """Check and keep the order."""
        if isinstance(order, bool) or not isinstance(order, int) or order < 3:
            raise ValueError(
                "Argument `order` of `Taylor` must be a whole number of at least 3, "
                f"but is {order!r}."
            )
        self.order = order

    @property
    def name(self) -> str:
        """For the record."""
        return f"Taylor{self.order}"


class TaylorState(NamedTuple, Generic[State]):
    """Where a solve is."""

    y: PhasePoint
    folded: State
    modes: Numbers
    last_event: Scalar
    at_once: Scalar  # how many ends have followed each other without time between
    accelerations: Numbers = ()  # at y in the modes, where the fold needs the slope

    @property
    def slope(self) -> PhasePoint:
        """The right-hand side at y; else the state, which is finite where that is."""
        if not self.accelerations:
            return self.y
        return PhasePoint.of(self.y.omega, self.accelerations)


class TaylorStepControl(StepControl):
    """The steps' lengths are the solver's own; none is rejected.

    A lane whose step is NaN ends as `VANISHED`.
    """

    def start(self, t0: Scalar, dt0: Scalar, stop: Scalar) -> ControlState:
        """The state before the first step, which may be as long as it likes."""
        del dt0
        return super().start(t0, jnp.inf, stop)

    def verdict(
        self, t0, t1, y0, y1, error, error_order, reached=None, moves=True
    ) -> Verdict:
        """What is no number was not reached."""
        del t1, y0, y1, error, error_order
        assert reached is not None  # steps may be cut
        # a NaN compares as false
        keep = (reached > t0) & jnp.isfinite(reached)
        return Verdict(jnp.where(moves & keep, 1.0, 0.0), 1.0)

    def after(
        self, t0: Scalar, t1: Scalar, signals: Signals, state: ControlState
    ) -> tuple[ControlState, Scalar]:
        """Go on from where the step ended."""
        del t1
        assert signals.reached is not None  # steps may be cut
        left, keep = state.left - 1, signals.verdict.accepts > 0
        t = jnp.where(keep, signals.reached, t0)
        stop = jnp.where(keep, signals.stop, state.stop)
        pause = (left <= 0) | (keep & (signals.done > 0))
        t_next = jnp.minimum(stop, self.end)
        following = ControlState(t, stop, t_next, left, state.h)
        return following, self.halt(t, pause, jnp.logical_not(keep))


class TaylorSlip(AbstractLaneSolver[TaylorState]):
    """Taylor's method for set-valued friction, with a fold over the steps.

    Needs `TaylorStepControl`. diffrax's `args` are the system, no modes chosen yet.

    **Arguments:** `solver`; `fold`; `rtol`, `atol`: of a step; events are met when the
    guard is within a hundredth of `atol`.
    """

    solver: Taylor
    fold: AbstractFold
    rtol: Scalar
    atol: Scalar

    @property
    def degree(self) -> int:
        """The method's order."""
        return self.solver.order

    def begin(self, system, t0, y0):
        """The modes of the start, and the fold's."""
        y, modes = begun(system, y0, event_tolerance(self.atol, y0[0]))
        zero = 0.0 * y0[0]
        folded = self.fold.init(system.in_modes(modes), t0, y)
        state = TaylorState(y, folded, modes, t0 - 1.0 + zero, zero)
        if not self.fold.needs_slope:
            return state
        return state._replace(accelerations=system.in_modes(modes).field(t0, y).omega)

    def chatters(self, state: TaylorState) -> Flag:
        """Whether the lane cannot go on, because events follow without time between."""
        return chattering(state.at_once)

    def attempt(self, system, t0, t1, where, judge):
        """One step in frozen modes, to the first event, and the change of modes."""
        y0, modes, folded = where.y, where.modes, where.folded
        system = system.in_modes(modes)
        law = system.law
        eps = jnp.finfo(jnp.result_type(t0)).eps
        tol = event_tolerance(self.atol, t0)
        motion, along = self.fold.expand(system, y0, self.solver.order, t0, folded)

        def longest():
            within = self.fold.allowed(motion, along, self.rtol, self.atol)
            return jnp.minimum(within, t1 - t0)

        whole = materialise(t0, longest)
        slips = tuple(m != 0 for m in modes)
        limits = tuple(
            jnp.where(s, 0.0, most) for s, most in zip(slips, law.static, strict=True)
        )
        # a torque cannot be met more closely than it is known
        tols = tuple(tol + FINEST * eps * limit for limit in limits)
        joints = list(zip(motion.watched, limits, slips, tols, strict=True))
        s, ends = first_look(joints, whole, t0)
        event_time, mine = first_event(joints, ends, s, t0)
        cut = any_of(mine)

        def span():
            """The step's length and end: an event is no earlier than can be told."""
            soonest = 16 * eps * jnp.maximum(jnp.abs(t0), eps)
            length = jnp.where(cut, jnp.maximum(event_time, soonest), s)
            entire = length >= t1 - t0  # not so where the series is not finite
            length = jnp.where(entire, t1 - t0, length)
            return length, jnp.where(entire, t1, t0 + length)

        length, t_end = materialise(t0, span)

        def ending():
            y = PhasePoint(value(c, length) for c in motion.y)
            rates = [value(c, length) for c in motion.accelerations]
            return PhasePoint.of(y.phi, law.hold(y.omega)), rates

        end, rates = materialise(t0, ending)
        ended = materialise(
            t0,
            lambda: [
                ends_here(joint, length, here)
                for joint, here in zip(joints, mine, strict=True)
            ],
        )
        y, rest = materialise(t0, lambda: _arrival(end, ended, slips, cut, tol))

        f0 = PhasePoint.of(y0.omega, [a[0] for a in motion.accelerations])
        f_end = PhasePoint.of(y.omega, rates)

        asked = any_of(ended)

        def change(modes):
            new = chosen(law, system.balance(y), rest, ended, tols)
            pairs = zip(new, modes, strict=True)
            return tuple(jnp.where(asked, a, b) for a, b in pairs)

        after = if_any_lane(asked, change, modes)
        # the state itself has the last word on a torque, whose series is the shortest
        rows = zip(ended, slips, after, strict=True)
        ended = [here & (m | (new != 0)) for here, m, new in rows]
        counted = _counted(where, asked, t_end)
        joint = joints_number(ended)
        integrals = _integrals(self.fold.integrand(system), motion.y, length, t0)
        moved = tuple(
            Moved(one, materialise(t0, along_to, one, length)) for one in along
        )
        event, series = (joint, after), motion.y
        step = Step(t0, t_end, y0, y, f0, f_end, integrals, modes, event, series, moved)
        verdict = judge(y, (), t_end)
        folded, stop, done = self.fold.accepted(system, folded, step, verdict)
        accelerations = ()
        if self.fold.needs_slope:
            now = system.in_modes(after)
            accelerations = materialise(t0, now.field, t_end, y).omega
        state = TaylorState(y, folded, after, *counted, accelerations)
        when = stop, done | self.chatters(state)
        stop, done = (jnp.asarray(x, jnp.result_type(t1)) for x in when)
        return state, Signals(verdict, stop, done, t_end)


def _arrival(
    y: PhasePoint, ended: Sequence[Flag], slips: Sequence[Flag], cut: Flag, tol: Scalar
) -> tuple[PhasePoint, list[Flag]]:
    """The step's end: the state, and which joints are at rest there."""
    rows = zip(joint_angles(y.omega), ended, slips, strict=True)
    rest: list[Flag] = [
        jnp.logical_not(m) | e | (cut & (jnp.abs(u) <= tol)) for u, e, m in rows
    ]
    return at_rest(y, rest), rest


def _counted(where: TaylorState, asked: Flag, t: Scalar) -> tuple[Scalar, Scalar]:
    """When the last event was, and how many have followed at once; `asked`: one has."""
    same = t - where.last_event <= SAME_TIME * jnp.maximum(1.0, jnp.abs(t))
    at_once = jnp.where(same, where.at_once + 1.0, 0.0)
    at_once = jnp.where(asked, at_once, where.at_once)
    return jnp.where(asked, t, where.last_event), at_once


def _integrals(
    integrand: Integrand | None, y: tuple[Coefficients, ...], s: Scalar, at: Scalar
) -> Numbers:
    """The integrals of a function of the state over the step, by Gauss' rule."""
    if integrand is None:
        return ()
    parts = []
    for x, weight in _GAUSS:

        def node(share=(1 + x) / 2):
            return integrand(at, PhasePoint(value(c, share * s) for c in y))

        parts.append([weight / 2 * s * p for p in materialise(at, node)])
    return tuple(sum(row[1:], row[0]) for row in zip(*parts, strict=True))
