r"""Stick and slip by Taylor's method: power series from event to event.

With its modes frozen the motion is analytic. The equations of motion themselves give
its series (see `_series`), and with it those of what tells whether the modes hold: each
sliding joint's rate, each sticking joint's torque. So nothing is evaluated twice,
nothing is interpolated and no step is rejected:

- A step is as long as the last two terms of the series allow, which together are to be
    within a few tolerances: what is left out is then within about one.
- A polynomial lies within the hull of its Bernstein coefficients and crosses zero no
    more often than they do. They tell that a mode holds over the whole step, or that it
    ends there once. Where they tell neither, the step is halved until they do.
- The step ends on the first such place, a root of a polynomial. There a joint that
    slid is at rest, the friction law chooses new modes, and the motion goes on.
"""

import math
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax

from .._materialise import if_any_lane, materialise
from .._series import Series, cauchy, sum_of, value
from .._types import Pair, Scalar, Vector4
from ..column import Column, joint_balance
from ..set_valued import Balance
from .control import ControlState, Signals, StepControl
from .explicit import OKAY, dense
from .observed import AbstractFold, AbstractObserved, Step
from .stickslip import SAME_TIME, at_rest, chattering, chosen, event_tolerance, in_modes

LAST_TERMS = 3.0  # tolerances that the series' last two terms may come to
HALVINGS = 6
MOST_ROOTS = 60  # iterations: bisection alone would need about 50
HOLDS, ENDS, ENDS_IN_DOUBT, DOUBT = 0.0, 1.0, 2.0, 3.0
NODES = 5  # of Gauss' rule for integrals over a step


class Taylor(eqx.Module):
    """Taylor's method for set-valued friction, of a given order.

    **Arguments:** `order`: of the last term that is kept, at least 3. Steps grow with
    it, and their cost with its square: 8 is the cheapest at tolerances around 1e-5,
    and within a fifth of the cheapest at 1e-11.

    **Raises:** `ValueError` for an order that is no whole number of at least 3.
    """

    degree: int = eqx.field(static=True)

    def __init__(self, order: int = 8):
        """Check and keep the order."""
        if isinstance(order, bool) or not isinstance(order, int) or order < 3:
            raise ValueError(
                "Argument `order` of `Taylor` must be a whole number of at least 3, "
                f"but is {order!r}."
            )
        self.degree = order

    @property
    def name(self) -> str:
        """For the record."""
        return f"Taylor{self.degree}"

    def order(self, terms: Any) -> int:
        """The order of convergence."""
        del terms
        return self.degree

    def error_order(self, terms: Any) -> int:
        """The power of h that the error falls with."""
        return self.order(terms)

    def func(self, terms, t0, y0, args):
        """The right-hand side."""
        return terms.vf(t0, y0, args)


class Motion(NamedTuple):
    """The series of a motion in frozen modes: lists of coefficients."""

    y: tuple[list, list, list, list]
    accelerations: tuple[list, list]
    watched: tuple[
        list, list
    ]  # a sliding joint's rate forwards, a sticking one's torque


class TaylorState(NamedTuple):
    """Where a solve is."""

    y: Vector4
    slope: Vector4  # the right-hand side at y, in the modes that led there
    folded: Any
    modes: Pair
    last_event: Scalar
    at_once: Scalar  # how many events have followed each other without time between


class Reached(StepControl):
    """The steps' lengths are the solver's own; none is rejected.

    A lane whose step is NaN ends with `dt_min_reached`.
    """

    def start(self, t0: Any, dt0: Any, stop: Any) -> ControlState:
        """The state before the first step, which may be as long as it likes."""
        del dt0
        return super().start(t0, jnp.inf, stop)

    def adapt_step_size(
        self, t0, t1, y0, y1_candidate, args, y_error, error_order, controller_state
    ):
        """Go on from where the step ended."""
        del t1, y0, y1_candidate, args, error_order
        signals, left = y_error, controller_state.left - 1
        keep = signals.reached > t0
        t = jnp.where(keep, signals.reached, t0)
        stop = jnp.where(keep, signals.stop, controller_state.stop)
        result = self.ending((left <= 0) | (keep & (signals.done > 0)), ~keep)
        state = ControlState(t, stop, stop, left, controller_state.h)
        return keep, t, stop, False, state, result


class TaylorSlip(AbstractObserved):
    """Taylor's method for set-valued friction, with a fold over the steps.

    Needs `Reached`. The column among diffrax's `args` must have been prepared: its
    friction is `Torques` without `JointReaction`.

    **Arguments:** `solver`; `fold`; `rtol`, `atol`: of a step; events are met when the
    guard is within a hundredth of `atol`.
    """

    solver: Taylor
    fold: AbstractFold
    rtol: Scalar
    atol: Scalar

    def init(self, terms, t0, t1, y0, args):
        """The modes of the start, and the fold's."""
        del t1
        tol, zero = event_tolerance(self.atol, y0[0]), 0.0 * y0[0]
        rest = jnp.abs(y0[2]) <= tol, jnp.abs(y0[3] - y0[2]) <= tol
        y = at_rest(y0, rest)
        u = y[2], y[3] - y[2]
        modes = args.friction.begin(joint_balance(args, y), u, rest)
        modes = tuple(m + zero for m in modes)
        column = in_modes(args, modes)
        slope = terms.vf(t0, y, column)
        folded = self.fold.init(column, t0, y)
        return TaylorState(y, slope, folded, modes, t0 - 1.0 + zero, zero)

    def chatters(self, state: TaylorState) -> Any:
        """Whether the lane cannot go on, because events follow without time between."""
        return chattering(state.at_once)

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        """One step in frozen modes, to the first event, and the change of modes."""
        del terms, made_jump
        modes, folded = solver_state.modes, solver_state.folded
        column = in_modes(args, modes)
        law, eps = column.friction, jnp.finfo(jnp.result_type(t0)).eps
        tol = event_tolerance(self.atol, t0)
        motion = expand(column, y0, self.solver.degree, t0)

        def longest():
            h = _allowed(motion.y, self.rtol, self.atol)
            return lax.stop_gradient(jnp.minimum(h, t1 - t0))

        whole = materialise(t0, longest)
        slips = tuple(m != 0 for m in modes)
        limits = tuple(
            jnp.where(s, 0.0, most) for s, most in zip(slips, law.static, strict=True)
        )
        joints = list(zip(motion.watched, limits, slips, strict=True))
        s, ends = _first_look(joints, whole, tol, t0)
        found, mine = _first_event(joints, ends, s, tol, t0)
        cut = mine[0] | mine[1]

        def span():
            """The step's length and end: an event is no earlier than can be told."""
            soonest = 16 * eps * jnp.maximum(jnp.abs(t0), eps)
            length = jnp.where(cut, jnp.maximum(found, soonest), s)
            return length, jnp.where(cut | (s < t1 - t0), t0 + length, t1)

        length, t_end = materialise(t0, span)

        def arrive():
            p1, p2, w1, w2 = (value(c, length) for c in motion.y)
            return _arrival(law, (p1, p2, w1, w2), joints, length, mine, cut, tol)

        y, rest, landed = materialise(t0, arrive)
        event = landed[0] | landed[1]

        def ending():
            return tuple(value(c, length) for c in motion.accelerations)

        f0 = (y0[2], y0[3], motion.accelerations[0][0], motion.accelerations[1][0])
        f_end = (y[2], y[3], *materialise(t0, ending))

        def change(modes):
            balance = joint_balance(column, y)
            new = chosen(law, balance, rest, landed, (tol, tol))
            pairs = zip(new, modes, strict=True)
            return tuple(jnp.where(event, a, b) for a, b in pairs)

        after = if_any_lane(event, change, modes)
        last_event, at_once = solver_state.last_event, solver_state.at_once
        same = t_end - last_event <= SAME_TIME * jnp.maximum(1.0, jnp.abs(t_end))
        at_once = jnp.where(event, jnp.where(same, at_once + 1.0, 0.0), at_once)
        last_event = jnp.where(event, t_end, last_event)
        joint = jnp.where(landed[0], 1, 0) + jnp.where(landed[1], 2, 0)
        integrals = _integrals(self.fold.integrand(column), motion.y, length, t0)
        seen = Step(t0, t_end, y0, y, f0, f_end, integrals, modes, (joint, after))
        folded, stop, done = self.fold.step(column, folded, seen)
        state = TaylorState(y, f_end, folded, after, last_event, at_once)
        done = done | self.chatters(state)
        dtype = jnp.result_type(t1)
        signals = Signals(y, jnp.asarray(stop, dtype), jnp.asarray(done, dtype), t_end)
        return y, signals, dense(t0, t_end, y0, y, f0, f_end), state, OKAY


def expand(column: Column, y: Vector4, order: int, at: Scalar) -> Motion:
    """The series of the motion from y, in the modes of the column's friction."""
    phi1, phi2, w1, w2 = (Series(at, known=(x,)) for x in y)
    law: Any = column.friction
    # the forces of each order rest on the motion up to that order
    forces = joint_balance(column, (phi1, phi2, w1, w2))
    h, r1, r2 = forces.h, forces.r1, forces.r2
    now = Balance(forces.a, h[0], forces.d, r1[0], r2[0])
    mobility = materialise(at, law.mobility, now)
    a1, a2 = Series(at), Series(at)
    watched: tuple[list, list] = [], []
    t1, t2 = (m * k for m, k in zip(law.modes, law.kinetic, strict=True))
    for k in range(order + 1):
        rates = w1[k], w2[k] - w1[k]
        held: Any = (0.0, 0.0)
        if k < order:
            # what the inertia's own change takes of them
            left1, left2 = r1[k] - cauchy(h, a2, k, 1), r2[k] - cauchy(h, a1, k, 1)
            now = now._replace(r1=left1, r2=left2)
            torques = (t1, t2) if k == 0 else (0.0, 0.0)

            def move(now=now, torques=torques):
                return law.moved(now, *torques, mobility)

            for x, a in zip((a1, a2), materialise(at, move), strict=True):
                x.append(a)
            held = law.carried(now, a1[k], a2[k])
            for x, v in ((phi1, w1), (phi2, w2), (w1, a1), (w2, a2)):
                x.append(v[k] / (k + 1))
        rows = zip(watched, law.modes, rates, held, strict=True)
        for row, m, u, torque in rows:
            row.append(jnp.where(m == 0, torque, m * u))
    states = (phi1.known, phi2.known, w1.known, w2.known)
    return Motion(states, (a1.known, a2.known), watched)


def _allowed(y: tuple, rtol: Scalar, atol: Scalar) -> Any:
    """How long a step may be by the last two terms of its series."""
    order, worst = len(y[0]) - 1, 0.0
    for k in (order - 1, order):
        parts = [(c[k] / (atol + rtol * jnp.abs(c[0]))) ** 2 for c in y]
        square = jnp.clip(sum_of(parts) / len(y), 1e-100, 1e100)
        # XLA vectorises float32's log, to which the root's root is in range
        root = jnp.log(jnp.sqrt(jnp.sqrt(square)).astype(jnp.float32))
        worst = jnp.maximum(worst, jnp.exp(2 / k * root))
    h = LAST_TERMS ** (1 / order) / worst
    broken = sum_of([c[order] for c in y]) * 0.0  # NaN stays NaN
    return h.astype(y[0][0].dtype) + broken


def _look(watched: list, limit: Any, slips: Any, s: Any, tol: Any) -> Any:
    """Whether a joint's mode holds over the time s, by its Bernstein coefficients.

    **Returns:** HOLDS; or, with the sign of the side on which the torque passes its
    limit (-1 where the joint slips), ENDS once, or in doubt, or DOUBT that it ends.
    """
    n, power, terms = len(watched) - 1, s, [watched[0]]
    for j, c in enumerate(watched[1:], 1):
        terms.append(c * power / math.comb(n, j))
        power = power * s
    above: Any = False
    below: Any = False
    was, plain = None, True
    for i in range(n + 1):
        b = sum_of([math.comb(i, j) * terms[j] for j in range(i + 1)])
        up, down = ~slips & (b > limit + tol), b < -limit - tol
        above, below = above | up, below | down
        low = up | down
        plain = plain if was is None else plain & (~was | low)
        was = low
    kind = jnp.where(was, ENDS_IN_DOUBT, DOUBT)
    plain &= ~(above & below)
    kind = jnp.where(plain, jnp.where(was, ENDS, HOLDS), kind)
    side = jnp.where(jnp.where(was, up, above), 1.0, -1.0)  # pyright: ignore
    return side * kind


def _first_look(joints: list, s: Any, tol: Any, at: Any) -> tuple[Any, list]:
    """A time over which both joints' ends are plain, and which they are."""

    def look(s):
        return [_look(*joint, s, tol) for joint in joints]

    def doubtful(state):
        _, (one, two), count = state
        worst = jnp.maximum(jnp.abs(one), jnp.abs(two))
        return (worst > ENDS) & (count < HALVINGS)

    def halve(state):
        s, _, count = state
        return 0.5 * s, materialise(at, look, 0.5 * s), count + 1

    begin = s, materialise(at, look, s), jnp.zeros((), jnp.int32)
    s, ends, _ = lax.while_loop(doubtful, halve, begin)
    # what is still in doubt grazes: it counts as an end where the mode is left for good
    return s, [jnp.where(jnp.abs(e) > ENDS_IN_DOUBT, HOLDS, e) for e in ends]


def _first_event(joints: list, ends: list, s: Any, tol: Any, at: Any) -> Any:
    """When the first joint's mode ends, and which joint it is."""
    first, second = (e != HOLDS for e in ends)

    def root(which):
        """Of the guard limit - side x watched."""
        rows = [
            [limit * jnp.abs(jnp.sign(e)) - jnp.sign(e) * c[0]]
            + [-jnp.sign(e) * x for x in c[1:]]
            for (c, limit, _), e in zip(joints, ends, strict=True)
        ]
        return [jnp.where(which, b, a) for a, b in zip(*rows, strict=True)]

    def place(which, asked):
        guard = materialise(at, root, which)
        return _root(guard, -0.5 * tol, s, asked, at)

    found = place(~first, first | second)
    twice = first & second

    def other(found):
        return jnp.where(twice, jnp.minimum(found, place(twice, twice)), found)

    sooner = if_any_lane(twice, other, found)
    second &= ~first | (sooner < found)
    return sooner, (first & ~second, second)


def _root(guard: list, level: Any, s: Any, asked: Any, at: Any) -> Any:
    """Where a guard falls to a level within s: Newton's method, kept in a bracket."""
    slopes = [k * c for k, c in enumerate(guard)][1:]
    start, end = guard[0] - level, value(guard, s) - level
    # it begins below, or ends there
    asked = asked & (start > 0)
    drop = jnp.where(start > end, start - end, 1.0)
    x = jnp.where(asked, jnp.clip(start / drop, 0.0, 1.0) * s, 0.0)

    def newton(x):
        miss, slope = value(guard, x) - level, value(slopes, x)
        return miss, x - miss / jnp.where(slope < 0, slope, -1.0), slope < 0

    def going(state):
        _, left, right, miss, count = state
        apart = right - left > 4 * jnp.finfo(jnp.result_type(s)).eps * s
        return asked & apart & (jnp.abs(miss) > -0.5 * level) & (count < MOST_ROOTS)

    def closer(state):
        def go():
            x, left, right, _, count = state
            miss, new, falls = newton(x)
            left, right = jnp.where(miss > 0, x, left), jnp.where(miss > 0, right, x)
            inside = falls & (new >= left) & (new <= right)
            x_new = jnp.where(inside, new, 0.5 * (left + right))
            near = jnp.abs(miss) <= -0.5 * level
            return jnp.where(near, x, x_new), left, right, miss, count + 1

        return materialise(at, go)

    none = jnp.zeros((), jnp.int32)
    start_state = x, 0.0 * s, s, jnp.inf * jnp.ones_like(s), none
    x, left, right, _, _ = lax.while_loop(going, closer, start_state)

    def last():
        """Once more, by which the place has its derivative."""
        where = lax.stop_gradient(x)
        _, new, falls = newton(where)
        good = falls & (new >= left) & (new <= right)
        return jnp.where(asked & good, new, where)

    return materialise(at, last)


def _arrival(
    law: Any, y: Vector4, joints: list, s: Any, mine: Pair, cut: Any, tol: Any
) -> Any:
    """The step's end: the state, which joints rest, and whose mode ended there."""
    w1, w2 = law.hold(y[2], y[3])
    rest, landed = [], []
    rows = zip(joints, (w1, w2 - w1), mine, strict=True)
    for (watched, limit, slips), u, here in rows:
        now = value(watched, s)
        slope = value([k * c for k, c in enumerate(watched)][1:], s)
        guard = jnp.where(slips, now, limit - jnp.abs(now))
        falls = jnp.where(slips, slope, -jnp.sign(now) * slope) < 0
        on = here | ((guard <= tol) & falls)
        landed.append(on)
        rest.append(~slips | on | (cut & (jnp.abs(u) <= tol)))
    return at_rest((y[0], y[1], w1, w2), tuple(rest)), tuple(rest), tuple(landed)


def _integrals(integrand: Any, y: tuple, s: Any, at: Any) -> tuple:
    """The integrals of a function of the state over the step, by Gauss' rule."""
    if integrand is None:
        return ()
    totals = None
    for x, weight in zip(*np.polynomial.legendre.leggauss(NODES), strict=True):

        def part(x=float(x)):
            place = s * (1 + x) / 2
            return integrand(tuple(value(c, place) for c in y))

        parts = [float(weight) / 2 * s * p for p in materialise(at, part)]
        totals = parts if totals is None else [a + b for a, b in zip(totals, parts)]
    assert totals is not None
    return tuple(totals)
