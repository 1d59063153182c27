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
from .._series import Series, cauchy, sum_of, value, value_and_slope
from .._types import Pair, Scalar, Vector4
from ..column import Column, joint_balance
from ..set_valued import Balance
from .control import ControlState, Signals, StepControl
from .explicit import OKAY, dense
from .observed import AbstractFold, AbstractObserved, Step
from .stickslip import SAME_TIME, at_rest, chattering, chosen, event_tolerance, in_modes

LAST_TERMS = 6.0  # tolerances that each of the last two terms may come to
HALVINGS = 6
NEWTON_STEPS, MOST_ROUNDS = 3, 20  # of them
IN_DOUBT, MORE_DOUBT = 2.0, 3.0
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

        def ending():
            p1, p2, w1, w2 = (value(c, length) for c in motion.y)
            return (p1, p2, *law.hold(w1, w2)), [
                value(c, length) for c in motion.accelerations
            ]

        end, rates = materialise(t0, ending)
        ended = materialise(
            t0,
            lambda: [
                _ends_here(joint, length, here, tol)
                for joint, here in zip(joints, mine, strict=True)
            ],
        )
        y, rest = materialise(t0, lambda: _arrival(end, ended, slips, cut, tol))
        event = ended[0] | ended[1]

        f0 = (y0[2], y0[3], motion.accelerations[0][0], motion.accelerations[1][0])
        f_end = (y[2], y[3], *rates)

        def change(modes):
            balance = joint_balance(column, y)
            new = chosen(law, balance, rest, ended, (tol, tol))
            pairs = zip(new, modes, strict=True)
            return tuple(jnp.where(event, a, b) for a, b in pairs)

        after = if_any_lane(event, change, modes)
        last_event, at_once = solver_state.last_event, solver_state.at_once
        same = t_end - last_event <= SAME_TIME * jnp.maximum(1.0, jnp.abs(t_end))
        at_once = jnp.where(event, jnp.where(same, at_once + 1.0, 0.0), at_once)
        last_event = jnp.where(event, t_end, last_event)
        joint = jnp.where(ended[0], 1, 0) + jnp.where(ended[1], 2, 0)
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
    w1, w2 = Series(at, known=(y[2],)), Series(at, known=(y[3],))
    phi1, phi2 = w1.integral(y[0]), w2.integral(y[1])
    a1, a2 = w1.derivative(), w2.derivative()
    law: Any = column.friction
    # the forces of each order rest on the motion up to that order
    forces = joint_balance(column, (phi1, phi2, w1, w2))
    h, r1, r2 = forces.h, forces.r1, forces.r2
    for x in (h, r1, r2):
        x.ready(0)
    still = Balance(forces.a, h[0], forces.d, r1[0], r2[0])
    mobility = materialise(at, law.mobility, still)
    watched: tuple[list, list] = [], []
    for k in range(order + 1):
        held: Any = (0.0, 0.0)
        rates = w1[k], w2[k] - w1[k]
        if k < order:
            for x in (h, r1, r2):
                x.ready(k)

            def driven(k=k):
                """The forces of this order, but for the accelerations of this order."""
                if k > 0:
                    return r1[k] - cauchy(h, a2, k, 1), r2[k] - cauchy(h, a1, k, 1)
                (m1, m2), (k1, k2) = law.modes, law.kinetic
                return r1[0] - m1 * k1 + m2 * k2, r2[0] - m2 * k2

            left1, left2 = materialise(at, driven)
            now = still._replace(r1=left1, r2=left2)

            def move(k=k, now=now):
                moved = law.moved(now, 0.0, 0.0, mobility)
                return tuple(a / (k + 1) for a in moved)

            for w, new in zip((w1, w2), materialise(at, move), strict=True):
                w.append(new)
            held = law.carried(now, a1[k], a2[k])
        rows = zip(watched, law.modes, rates, held, strict=True)
        for row, m, u, torque in rows:
            row.append(jnp.where(m == 0, torque, m * u))
    states = tuple([x[k] for k in range(order + 1)] for x in (phi1, phi2, w1, w2))
    rates = tuple([x[k] for k in range(order)] for x in (a1, a2))
    return Motion(states, rates, watched)  # pyright: ignore


def _allowed(y: tuple, rtol: Scalar, atol: Scalar) -> Any:
    """How long a step may be by the last two terms of its series."""
    order, h = len(y[0]) - 1, None

    def brief(x):  # seven digits are plenty, and XLA vectorises float32's log
        return jnp.asarray(x).astype(jnp.float32)

    weights = [brief(1e-30) + brief(atol + rtol * jnp.abs(c[0])) for c in y]
    weights = [1 / w for w in weights]
    for k in (order - 1, order):
        sizes = [jnp.abs(brief(c[k])) * w for c, w in zip(y, weights, strict=True)]
        worst = jnp.maximum(jnp.maximum(*sizes[:2]), jnp.maximum(*sizes[2:]))
        root = jnp.log(jnp.clip(worst, 1e-30, 1e38)) / -k
        h = root if h is None else jnp.minimum(h, root)
    h = LAST_TERMS ** (1 / order) * jnp.exp(h)
    return h.astype(y[0][0].dtype)


def _look(watched: list, limit: Any, slips: Any, s: Any, tol: Any) -> Any:
    """Whether a joint's mode holds over the time s, by its Bernstein coefficients.

    **Returns:** 0 if it does. Else, with the sign of the side on which the torque
    passes its limit (minus where the joint slips): 1 + about where in s it ends, once;
    IN_DOUBT, if it is left at the end; MORE_DOUBT, if it is not.
    """
    n, power, terms = len(watched) - 1, s, [watched[0]]
    for j, c in enumerate(watched[1:], 1):
        terms.append(c * power / math.comb(n, j))
        power = power * s
    above = below = was = jnp.zeros((), bool)
    plain, count = ~was, 0.0
    up = was
    for i in range(n + 1):
        b = sum_of([math.comb(i, j) * terms[j] for j in range(i + 1)])
        up, down = ~slips & (b > limit + tol), b < -limit - tol
        above, below = above | up, below | down
        low = up | down
        plain &= ~was | low
        count += jnp.where(low, 1.0, 0.0)
        was = low
    plain &= ~(above & below)
    # all before it are fine
    about = 1 + jnp.clip((n + 0.5 - count) / n, 0.0, 0.999)
    ends = jnp.where(plain, about, IN_DOUBT)
    kind = jnp.where(was, ends, jnp.where(plain, 0.0, MORE_DOUBT))
    return jnp.where(jnp.where(was, up, above), kind, -kind)


def _first_look(joints: list, s: Any, tol: Any, at: Any) -> tuple[Any, list]:
    """A time over which both joints' ends are plain, and which they are."""

    def look(s):
        return [_look(*joint, s, tol) for joint in joints]

    def doubtful(state):
        _, (one, two), count = state
        worst = jnp.maximum(jnp.abs(one), jnp.abs(two))
        return (worst >= IN_DOUBT) & (count < HALVINGS)

    def halve(state):
        s, _, count = state
        return 0.5 * s, materialise(at, look, 0.5 * s), count + 1

    begin = s, materialise(at, look, s), jnp.zeros((), jnp.int32)
    s, ends, _ = lax.while_loop(doubtful, halve, begin)
    # what is still in doubt grazes: it counts as an end where the mode is left for good
    return s, [jnp.where(jnp.abs(e) > IN_DOUBT, 0.0, e) for e in ends]


def _first_event(joints: list, ends: list, s: Any, tol: Any, at: Any) -> Any:
    """When the first joint's mode ends, and which joint it is."""
    first, second = (e != 0 for e in ends)

    def guard(which):
        """Of one of the joints: limit - side x watched."""
        rows = []
        for (watched, limit, _), e in zip(joints, ends, strict=True):
            side = jnp.sign(e)
            rows.append((limit * jnp.abs(side), [-side * c for c in watched]))
        (limit1, row1), (limit2, row2) = rows
        row = [jnp.where(which, y, x) for x, y in zip(row1, row2, strict=True)]
        return [jnp.where(which, limit2, limit1) + row[0], *row[1:]]

    asked = first | second
    about1, about2 = (jnp.abs(e) - 1 for e in ends)
    which = second & (~first | (about2 < about1))
    about = jnp.where(asked, s * jnp.clip(jnp.where(which, about2, about1), 0, 1), 0.0)
    found = _root(lambda: guard(which), -0.5 * tol, about, s, asked, at)

    def late():
        return first & second & (value(guard(~which), found) < -tol)

    sooner = materialise(at, late)

    def correct(found):
        other = _root(lambda: guard(~which), -0.5 * tol, 0.5 * found, s, sooner, at)
        return jnp.where(sooner, other, found)

    found = if_any_lane(sooner, correct, found)
    which = which ^ sooner
    return found, (first & asked & ~which, second & which)


def _root(guard: Any, level: Any, about: Any, s: Any, asked: Any, at: Any) -> Any:
    """Where a guard falls to a level within s: Newton's method, kept in a bracket."""

    def nearer(x, times):
        row = guard()
        left, right = 0.0 * s, s
        for _ in range(times):
            height, slope = value_and_slope(row, x)
            miss = height - level
            left, right = jnp.where(miss > 0, x, left), jnp.where(miss > 0, right, x)
            new = x - miss / jnp.where(slope < 0, slope, -1.0)
            good = (slope < 0) & (new >= left) & (new <= right)
            x = jnp.where(good, new, 0.5 * (left + right))
        # it begins below, or ends there
        return jnp.where(asked & (row[0] > level), x, 0.0)

    def pair(x):
        """After some steps and one more, by which the place has its derivative."""
        x = materialise(at, lambda: nearer(x, NEWTON_STEPS))
        return x, materialise(at, lambda: nearer(lax.stop_gradient(x), 1))

    def far(state):
        x, new, count = state
        return (jnp.abs(new - x) > near * s) & (count < MOST_ROUNDS)

    # what the last step moved is squared by the next
    near = jnp.sqrt(-level)
    begin = *pair(about), jnp.zeros((), jnp.int32)
    _, x, _ = lax.while_loop(far, lambda now: (*pair(now[1]), now[2] + 1), begin)
    return x


def _ends_here(joint: Any, s: Any, mine: Any, tol: Any) -> Any:
    """Whether a joint's mode ends at s: as found, or as near as can be told."""
    watched, limit, slips = joint
    now, slope = value_and_slope(watched, s)
    guard = jnp.where(slips, now, limit - jnp.abs(now))
    falls = jnp.where(slips, slope, jnp.where(now > 0, -slope, slope)) < 0
    return mine | ((guard <= tol) & falls)


def _arrival(y: Vector4, ended: Pair, slips: Pair, cut: Any, tol: Any) -> Any:
    """The step's end: the state, and which joints are at rest there."""
    rows = zip((y[2], y[3] - y[2]), ended, slips, strict=True)
    rest = [~m | e | (cut & (jnp.abs(u) <= tol)) for u, e, m in rows]
    return at_rest(y, tuple(rest)), tuple(rest)


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
