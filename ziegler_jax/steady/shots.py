r"""Shots at a cycle: motions of known length from the section, with tangents.

From $y_0 = (0, x)$ the motion is followed for a span T, and with it the tangents of the
numbers x, three of two rods, $2 n - 1$ of n. With the sign $\sigma$ (-1 where an odd
number of half returns closes a symmetric orbit, else 1) and $a = \sigma\,y(T)$, $F =
\sigma f(y(T))$, $V = \sigma\, \partial y(T) / \partial x$, the section is met $\delta t
= -a_1 / F_1$ later, and

$$H(x) = a + \delta t\,F, \qquad DH = V - \frac{F\,V_1}{F_1}, \qquad x \leftarrow x + (I
- DH)^{-1} (H - x), \qquad T \leftarrow T + \delta t - \frac{V_1\,\delta x}{F_1}.$$

(Components from the second on.) No passage has to be found: as x converges the span
does, too. Steps are ten, at last a hundred times finer than the motion's own (Taylor's
a thousand times).
"""

from collections.abc import Callable
from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int

from ..model.state import PhasePoint
from ..model.system import System
from ..motion.integrate import Folded, Motion, Run
from ..motion.observation import Observation
from ..motion.options import Method
from ..motion.tangents import Vectors, apart, joined, past
from ..motion.variational import events_number
from ..numerics.materialise import materialise, tree_where
from ..numerics.numbers import Flag, Scalar
from ..results import CODE
from ..solvers import AbstractFold, Explicit, Taylor
from ..solvers.along import expand_along
from ..solvers.taylor import TaylorState
from .contraction import (
    Matrix,
    Vector,
    fixed_point_move,
    largest,
    size_of,
)
from .push_along import push_along, tangent_field

COARSE, FINE = 0.1, 0.01  # tolerances against the motion's own
FINEST = 1e-12
SHORTEST = 1e-3  # a span below it is none
# Relative moves of Newton's method: from one above the first the orbit is too far, one
# below the second is followed by a fine shot, and one below the third verifies.
TOO_FAR, CLOSE, VERIFIED = 0.3, 3e-3, 1e-5
MOST_SHOTS = 5  # of one attempt
# On Taylor's steps multipliers are good to 2e-7 by these (233 cycles against shots at
# 1e-12; by the two above to 2e-4, as they move by several times what x moves), for 4 %
# more steps in all. Of order 10 or 12 shots cost the same within a tenth (steps times
# order squared). And an early shot may meet other events than the orbit.
TAYLOR_FINE, TAYLOR_VERIFIED, MOST_DRY_SHOTS = 1e-3, 2e-8, 8


class Attempt(NamedTuple):
    """Newton's method, from a return of the motion on."""

    x: Vector
    span: Scalar
    sign: Scalar
    size: Scalar  # of the last move
    shots: Int[Array, ""]  # so far
    fine: Bool[Array, ""]
    verified: Bool[Array, ""]
    start: Vector  # the motion's own return
    image: Vector  # where it returns next
    first_slope: Matrix  # with which derivative
    slope: Matrix  # the derivative at the last shot's start
    modes: Scalar  # of the last shot: a number of its events
    first_modes: Scalar  # and of the first
    checks: Bool[Array, ""]  # one shot, to see whether the motion's events are those
    level: Scalar | tuple[()] = ()  # of the section; (): 0


class ShotState(NamedTuple):
    """The running numbers of a shot."""

    tangents: Vectors  # along phi2, ..., omega1, ...
    slopes: Vectors  # theirs; () where events turn them
    record: tuple  # of the observers
    modes: Scalar | tuple[()]  # set-valued friction: a number of the events so far


class Shot(AbstractFold[ShotState]):
    """Carries the tangents and observers along."""

    needs_slope: ClassVar[bool] = True

    solver: Explicit | Taylor
    observation: Observation

    def init(self, system, t0, y0):
        """Unit vectors, and nothing seen."""
        zero = 0.0 * y0[0]
        unit = np.eye(len(y0) - 1, len(y0), k=1)
        tangents = tuple(PhasePoint(zero + x for x in row) for row in unit)
        record = self.observation.init(system, t0, y0)
        return ShotState(tangents, (), record, 0.0 * y0[0] if system.sticks else ())

    def with_slope(self, t0, y0, system):
        """All slopes by one evaluation."""
        state = self.init(system, t0, y0)
        both = joined(y0, state.tangents)
        first, slopes = apart(
            materialise(y0[0], tangent_field, t0, both, system), len(y0)
        )
        return first, state._replace(slopes=slopes)

    def integrand(self, system):
        """The observers'."""
        return self.observation.integrand(system)

    def outcome(self, state):
        """None: it only watches."""
        del state
        return jnp.asarray(CODE.not_computed, jnp.int32)

    def advance(self, solver, t0, t1, y0, system, first, state):
        """A step, the images of the tangents, and the observers' integrals."""
        known = joined(first, state.slopes) if state.slopes else None
        both, error, last, integrals = push_along(
            solver, system, t0, t1, y0, state.tangents, self.integrand(system), known
        )
        (y1, images), (slope, slopes) = apart(both, len(y0)), apart(last, len(y0))
        slopes = slopes if state.slopes else ()
        return y1, error, slope, (images, slopes, integrals), None

    def expand(self, system, y0, order, token, state):
        """The series of a step, and of the tangents."""
        return expand_along(system, y0, order, token, state.tangents)

    def step(self, system, state, step):
        """After a step, and past the event at its end."""
        modes, slopes, integrals = state.modes, (), step.integrals
        if step.moved:
            images = tuple(each.y1 for each in step.moved)
        elif step.modes:  # it may have been cut
            assert isinstance(self.solver, Explicit)
            ends = step.t0, step.t1, step.y0
            both, *_ = push_along(self.solver, system, *ends, state.tangents)
            images = apart(both, len(step.y0))[1]
        else:
            images, slopes, integrals = integrals
        if step.modes:
            images = past(system, step, images)
            modes = events_number(modes, step)
        step = step._replace(integrals=integrals)
        record = self.observation.step(system, state.record, step)
        return ShotState(images, slopes, record, modes), jnp.inf, False


def shot_motion(
    system: System,
    y0: PhasePoint,
    attempt: Attempt,
    method: Method,
    observation: Observation,
) -> Motion[ShotState]:
    """The next shot of an attempt; `method`: that of the motion itself."""
    solver = shooting(method)
    fine = TAYLOR_FINE if isinstance(solver, Taylor) else FINE
    share = jnp.where(attempt.fine, fine, COARSE)
    rtol, atol = (jnp.maximum(share * x, FINEST) for x in method.tolerances)
    fold = Shot(solver, observation)
    finer = Method(solver, rtol, atol).at_most(method.budget)
    span = jnp.maximum(attempt.span, SHORTEST)
    return Motion(system, y0, fold, finer, end=span)


def shooting(method: Method) -> Explicit | Taylor:
    """The solver with which tangents go along."""
    solver = method.solver
    assert isinstance(solver, Explicit | Taylor)  # `settling` saw to it
    return solver


def after_shot(attempt: Attempt, run: Run[ShotState]) -> tuple[Attempt, Flag]:
    """Newton's step after a shot, and whether another one is worth it."""
    back = materialise(attempt.span, return_of, run, attempt)
    size = largest(back.move) / size_of(attempt.x)
    first, count = attempt.shots == 0, attempt.shots + 1
    arrived = run.outcome == CODE.complete
    on_series = isinstance(run.solver, TaylorState)
    near, most = TAYLOR_VERIFIED if on_series else VERIFIED, MOST_SHOTS
    verified = arrived & attempt.fine & (size < near)
    modes = attempt.modes
    if not isinstance(run.folded.modes, tuple):
        most, modes = MOST_DRY_SHOTS, run.folded.modes
        verified &= modes == attempt.modes
    good = arrived & (size < TOO_FAR) & (first | (size < attempt.size))
    span = attempt.span + back.longer
    after = Attempt(
        x=attempt.x + back.move,
        # the orbit is the one that the last shot ran
        span=jnp.where(verified, attempt.span, span),
        sign=attempt.sign,
        size=size,
        shots=count,
        fine=attempt.fine | (size < CLOSE),
        verified=verified,
        start=attempt.start,
        image=tree_where(first, back.image, attempt.image),
        first_slope=tree_where(first, back.slope, attempt.first_slope),
        slope=back.slope,
        modes=modes,
        first_modes=jnp.where(first, modes, attempt.first_modes),
        checks=attempt.checks,
        level=attempt.level,
    )
    return after, good & ~verified & (count < most) & ~attempt.checks


class Return(NamedTuple):
    """The result of a shot from x."""

    image: Vector  # H(x)
    slope: Matrix  # DH(x)
    move: Vector  # Newton's step to the fixed point
    longer: Scalar  # and what to add to the span


def return_of(run: Run[ShotState], attempt: Attempt) -> Return:
    """The return that a shot has come to."""
    columns = run.y, run.solver.slope, *run.folded.tangents
    rows = attempt.sign * jnp.stack([jnp.stack(column) for column in columns], axis=1)
    a, f, v = rows[:, 0], rows[:, 1], rows[:, 2:]
    speed = jnp.where(f[0] == 0, jnp.nan, f[0])
    above = a[0] if isinstance(attempt.level, tuple) else a[0] - attempt.level
    late, first = -above / speed, v[0] / speed
    reached, slope = a[1:] + late * f[1:], v[1:] - f[1:, None] * first[None]
    slope = materialise(attempt.span, lambda: slope)
    move = fixed_point_move(slope, reached - attempt.x)
    return Return(reached, slope, move, late - jnp.sum(first * move))


def to_be_begun(run: Run[Folded]) -> Run[Folded]:
    """A run that is over, marked so that the next one begins in its own phase.

    There lanes are looked at before their first step (`steps_of_turn`), so that this
    one takes none.
    """
    return run._replace(
        steps=jnp.full_like(run.steps, -1),
        outcome=jnp.full_like(run.outcome, CODE.not_computed),
    )


def run_that_is_over(begin: Callable[[], Run[Folded]]) -> Run[Folded]:
    """A run of that kind that is over, in place of one to come."""
    shapes = jax.eval_shape(begin)
    run = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes)
    return run._replace(outcome=run.outcome + CODE.complete)


def start_of(attempt: Attempt) -> PhasePoint:
    """Where its next shot begins: the state of its point of the section."""
    level, x = attempt.level, attempt.x
    height = 0.0 * x[0]
    return PhasePoint((height if isinstance(level, tuple) else height + level, *x))


def blank_attempt(zero: Scalar, size: int = 3, displaced: bool = False) -> Attempt:
    """An attempt that has not begun.

    **Arguments:** `size`: of a point of the section; `displaced`: whether that has a
    level of its own.
    """
    point, no = jnp.zeros(size, jnp.result_type(zero)) + zero, jnp.asarray(False)
    matrix = jnp.zeros((size, size), jnp.result_type(zero)) + zero
    return Attempt(
        x=point,
        span=zero,
        sign=zero + 1.0,
        size=zero + jnp.inf,
        shots=jnp.zeros((), jnp.int32),
        fine=no,
        verified=no,
        start=point,
        image=point,
        first_slope=matrix,
        slope=matrix,
        modes=zero,
        first_modes=zero,
        checks=no,
        level=zero if displaced else (),
    )


def attempt_at(
    before: Attempt, x: Vector, span: Scalar, sign: Scalar, checks: Flag = False
) -> Attempt:
    """Newton's method before its first shot, in place of an attempt that is over."""
    none, no = jnp.zeros_like(before.shots), jnp.zeros_like(before.fine)
    anew = {"shots": none, "fine": no, "verified": no, "checks": no | checks}
    return before._replace(x=x, start=x, span=span, sign=sign, **anew)
