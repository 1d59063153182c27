r"""Stick and slip: an explicit solver whose steps end where a joint changes its mode.

Between events the modes are frozen and the field is smooth. Each joint has a guard that
is positive as long as its mode holds:

$$g_i = m_i u_i \text{ (slips in direction } m_i\text{)}, \qquad
g_i = \frac{\tau_{s,i}^2 - \lambda_i^2}{2\tau_{s,i}} \text{ (sticks)}.$$

A step in which a guard falls below zero is rejected and shortened until it ends on the
first such event within a tolerance. There the joint's rate is made exactly zero, the
friction law chooses new modes for both joints, and the solve goes on.
"""

from typing import Any, ClassVar, NamedTuple

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp

from .._layer import FAR
from .._materialise import if_any_lane, materialise
from .._types import Pair, Scalar, Vector4
from ..column import Column, joint_balance, vector_field
from .crossing import extrema, falls_below, place
from .explicit import OKAY, Explicit, dense
from .landing import LandingSignals
from .observed import AbstractFold, Step

EVENT_SHARE = 0.01  # an event's tolerance against that of a step
FINEST = 64  # and the least, in units of rounding
NEARLY = 0.05  # of a step: an event this close behind its end is aimed at
# Events that follow each other within SAME_TIME, in a row: then time does not go on.
SAME_TIME, MOST_AT_ONCE = 1e-9, 40


class Guards(NamedTuple):
    """Per joint: the guard, its slope in time, and the friction torque."""

    value: Pair
    slope: Pair
    torque: Pair


class StickSlipState(NamedTuple):
    """Where a stick-slip solve is."""

    y: Vector4
    slope: Vector4  # the right-hand side at y in the modes
    folded: Any
    modes: Pair
    guards: tuple[Pair, Pair]  # values and slopes
    last_event: Scalar
    at_once: Scalar  # how many events have followed each other without time between


class StickSlip(dfx.AbstractSolver):
    """An explicit solver for set-valued friction, with a fold over accepted steps.

    Needs `LandingControl`. The column among diffrax's `args` must have been prepared:
    its friction is `Torques`.

    **Arguments:** `solver`; `fold`; `tolerance`: of a step, to which that of events is
    bound: they are met when the guard is within a hundredth of it.
    """

    solver: Explicit
    fold: AbstractFold
    tolerance: Scalar

    term_structure: ClassVar = dfx.AbstractTerm
    interpolation_cls: ClassVar = dfx.ThirdOrderHermitePolynomialInterpolation

    def order(self, terms):
        """The solver's."""
        return self.solver.order(terms)

    def error_order(self, terms):
        """The solver's."""
        return self.solver.error_order(terms)

    def func(self, terms, t0, y0, args):
        """The right-hand side."""
        return self.solver.func(terms, t0, y0, args)

    def init(self, terms, t0, t1, y0, args):
        """The modes of the start, and the fold's."""
        del terms, t1
        tol, zero = self._tolerance(y0[0]), 0.0 * y0[0]
        rest = tuple(jnp.abs(u) <= tol for u in _rates(y0))
        y = _at_rest(y0, rest)
        modes = args.friction.begin(joint_balance(args, y), _rates(y), rest)
        modes = tuple(m + zero for m in modes)
        column = _in_modes(args, modes)
        slope = vector_field(t0, y, column)
        value, fall, _ = _guards(column, y, slope)
        folded = self.fold.init(column, t0, y)
        return StickSlipState(
            y, slope, folded, modes, (value, fall), t0 - 1.0 + zero, zero
        )

    def chatters(self, state: StickSlipState) -> Any:
        """Whether the lane cannot go on, because events follow without time between."""
        return state.at_once > MOST_AT_ONCE

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        """One step in frozen modes, and the change of modes if it ends on an event."""
        del made_jump
        _, f0, folded, modes, (g0, v0), last_event, at_once = solver_state
        column = _in_modes(args, modes)
        y1, error, f1, integrals = self.solver.advance(
            terms, t0, t1, y0, column, f0, self.fold.integrand(column)
        )
        y1 = (*y1[:2], *column.friction.hold(y1[2], y1[3]))
        g1, v1, torque = _guards(column, y1, f1)
        land, landed, tol = self._events(t0, t1, (g0, v0), (g1, v1))
        event = landed[0] | landed[1]

        def change(old):
            return _changed(args, old, torque, landed, tol)

        moved = if_any_lane(event, change, (y1, f1, modes, (g1, v1)))
        after, f_after, modes_after, guards = moved
        at_same = t1 - last_event <= SAME_TIME * jnp.maximum(1.0, jnp.abs(t1))
        at_once = jnp.where(event, jnp.where(at_same, at_once + 1.0, 0.0), at_once)
        last_event = jnp.where(event, t1, last_event)
        joint = jnp.where(landed[0], 1, 0) + jnp.where(landed[1], 2, 0)
        seen = Step(t0, t1, y0, after, f0, f1, integrals, modes, (joint, modes_after))
        folded, stop, done = self.fold.step(column, folded, seen)
        state = StickSlipState(
            after, f_after, folded, modes_after, guards, last_event, at_once
        )
        done = done | self.chatters(state)
        done = jnp.asarray(done, jnp.result_type(t1))
        signals = LandingSignals(error, jnp.asarray(stop, land.dtype), done, land)
        return after, signals, dense(t0, t1, y0, after, f0, f1), state, OKAY

    def _tolerance(self, x: Any) -> Any:
        least = FINEST * jnp.finfo(jnp.result_type(x)).eps
        return jnp.maximum(EVENT_SHARE * self.tolerance, least)

    def _events(self, t0, t1, start, end):
        """Where the step should have ended, which joints it landed on, tolerances."""
        h = t1 - t0
        eps = jnp.finfo(jnp.result_type(t1)).eps
        least = self._tolerance(t1)
        # a guard cannot be met more closely than a time can be told
        tol = tuple(least + 8 * eps * jnp.abs(t1 * v) for v in end[1])
        pieces = [
            (start[0][i], h * start[1][i], end[0][i], h * end[1][i]) for i in (0, 1)
        ]

        turns = materialise(t0, lambda: [extrema(*p) for p in pieces])

        def search():
            each = zip(pieces, tol, turns, strict=True)
            return [falls_below(*p, e, x) for p, e, x in each]

        found = materialise(t0, search)
        passed = tuple(f[0] for f in found)

        def locate(places):
            del places
            return tuple(
                jnp.where(f[0], place(*p, -0.5 * e, f[1:]), jnp.inf)
                for p, e, f in zip(pieces, tol, found, strict=True)
            )

        nowhere = jnp.full_like(h, jnp.inf)
        places = if_any_lane(passed[0] | passed[1], locate, (nowhere, nowhere))

        def verdict():
            # a step that cannot be shortened any more has landed where it ends
            soonest = t0 + 16 * eps * jnp.maximum(jnp.abs(t0), eps)
            cut = jnp.maximum(t0 + jnp.minimum(*places) * h, soonest)
            too_late = cut >= t1
            cut = jnp.where(too_late, jnp.inf, cut)
            landed, ahead = [], []
            for (_, _, g, v), p, e in zip(pieces, passed, tol, strict=True):
                on = jnp.where(p, too_late, (g <= e) & (v < 0))
                landed.append(on & ~(cut < t1))
                share = (g + 0.5 * e) / jnp.where(v < 0, -v, 1.0)
                near = (v < 0) & (g > e) & (share < NEARLY)
                ahead.append(jnp.where(near, t1 + share * h, jnp.inf))
            aim = jnp.minimum(ahead[0], ahead[1])
            event = landed[0] | landed[1]
            land = jnp.where(cut < t1, cut, jnp.where(event, jnp.inf, aim))
            return land, tuple(landed), tol

        return materialise(t0, verdict)


def _rates(y: Vector4) -> Pair:
    return y[2], y[3] - y[2]


def _at_rest(y: Vector4, rest: Pair) -> Vector4:
    """The state with the rates of resting joints exactly zero."""
    w1 = jnp.where(rest[0], 0.0, y[2])
    return y[0], y[1], w1, jnp.where(rest[1], w1, y[3])


def _in_modes(column: Column, modes: Pair) -> Any:
    friction: Any = column.friction
    return eqx.tree_at(lambda c: c.friction, column, friction.in_modes(modes))


def _guards(column: Any, y: Vector4, slope: Vector4) -> Guards:
    """The guards in the column's modes."""
    law = column.friction

    def forces():
        return jax.jvp(lambda y: joint_balance(column, y), (y,), (slope,))

    balance, moving = materialise(y[0], forces)

    def guards():
        torque, change = jax.jvp(law.torques, (balance,), (moving,))
        rates, faster = _rates(y), _rates(slope)
        values, slopes = [], []
        for i, m in enumerate(law.modes):
            stuck = m == 0
            most = jnp.maximum(law.static[i], 1e-30)
            held = (most * most - torque[i] * torque[i]) / (2 * most)
            values.append(jnp.where(stuck, held, m * rates[i]))
            loosening = -torque[i] * change[i] / most
            slopes.append(jnp.where(stuck, loosening, m * faster[i]))
        return Guards(tuple(values), tuple(slopes), torque)  # type: ignore[arg-type]

    return materialise(y[0], guards)


def _changed(column: Column, old: Any, torque: Pair, landed: Pair, tol: Pair) -> Any:
    """The state after an event: rates at rest, new modes, the field in them."""
    y, _, modes, _ = old
    law: Any = column.friction
    stuck = tuple(m == 0 for m in modes)
    rest = tuple(
        s | on | (jnp.abs(u) <= e)
        for s, on, u, e in zip(stuck, landed, _rates(y), tol, strict=True)
    )
    slack = tuple(
        jnp.where(s & on, 2 * e, 0.0)
        for s, on, e in zip(stuck, landed, tol, strict=True)
    )
    layer = []
    for i, m in enumerate(modes):
        inside = jnp.clip(torque[i] / jnp.maximum(law.static[i], 1e-30), -1.0, 1.0)
        # one that breaks loose is just beyond its peak
        inside = jnp.where(landed[i], 1.001 * jnp.sign(torque[i]), inside)
        layer.append(jnp.where(stuck[i], inside, FAR * m))
    y = _at_rest(y, rest)
    balance = materialise(y[0], joint_balance, column, y)
    event = landed[0] | landed[1]
    parts = balance, modes, rest, slack, tuple(layer), event
    modes = materialise(y[0], law.chosen, *parts)
    now = _in_modes(column, modes)
    slope = (y[2], y[3], *materialise(y[0], now.friction.accelerations, balance))
    value, fall, _ = _guards(now, y, slope)
    new = (y, slope, modes, (value, fall))
    return jax.tree.map(lambda a, b: jnp.where(event, a, b), new, old)
