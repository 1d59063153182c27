r"""Tangents: how small differences go along with a motion, through stick and slip.

Between events a small difference v, and one dp of the column's numbers, follow the
variational equations along the motion,

$$\dot v = J(y)\, v + \partial_p f\, dp, \qquad J = \partial f / \partial y,$$

integrated by the motion's own steps and stages: v is the derivative of the computed
motion. Where set-valued friction changes its modes v jumps (`saltation`). A joint that
sticks has no rate to differ in: v keeps none, a dimension of the tangents is lost, and
with it goes an exponent to minus infinity.
"""

import abc
import math
from collections.abc import Sequence
from functools import reduce
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from ..model.coulomb_torques import CoulombInModes
from ..model.state import PhasePoint
from ..model.system import System
from ..numerics.materialise import if_any_lane, materialise
from ..numerics.numbers import Flag, Numbers, Scalar
from ..numerics.series import sum_of
from ..solvers import AbstractFold, Explicit, Step, Taylor
from ..solvers.along import expand_along, leaves
from ..solvers.expansion import allowed
from ..solvers.fold import State
from ..solvers.saltation import saltation

Vectors = tuple[PhasePoint, ...]

# of the motion's tolerance: looser, so that it seldom shortens a step
TANGENT_SHARE = 1000.0
LOST = 2**16  # units of rounding: what is left of a vector that has lost its dimension
# products of lengths stay within these before their logarithm is taken
LEAST, MOST = 1e-100, 1e100
HADAMARD = (
    (0.5, 0.5, 0.5, 0.5),
    (0.5, -0.5, 0.5, -0.5),
    (0.5, 0.5, -0.5, -0.5),
    (0.5, -0.5, -0.5, 0.5),
)


# ---- along a step, and past the event at its end


def push(
    solver: Explicit,
    system: System,
    t0: Scalar,
    t1: Scalar,
    y0: PhasePoint,
    vectors: Sequence[PhasePoint],
    dp: System | None = None,
) -> list[tuple[PhasePoint, Vectors]]:
    """A step from y0, and its derivative along each vector, its length frozen.

    **Arguments:** `system`: in the modes of the step, where friction is set-valued;
    `dp`: how its numbers differ with the vectors, see `leaves`.

    **Returns:** the first slope, y1, the error estimate and the last slope, each with
    its differences.
    """

    def field(t, both):
        numbers, change, system_of = leaves(system, dp)
        y, vectors = apart(both, len(y0))
        slope, along = jax.linearize(
            lambda y, numbers: system_of(numbers).field(t, y), y, numbers
        )
        return joined(slope, [along(v, change) for v in vectors])

    both = joined(y0, vectors)
    first = materialise(t0, field, t0, both)
    y1, error, last, *_ = solver.advance(field, t0, t1, both, first)
    return [apart(x, len(y0)) for x in (first, y1, error, last)]


def joined(y: PhasePoint, vectors: Sequence[PhasePoint]) -> Numbers:
    """A state with vectors behind it, in a row."""
    return tuple(x for each in (y, *vectors) for x in each)


def apart(both: Numbers, size: int) -> tuple[PhasePoint, Vectors]:
    """A state of so many numbers, and the vectors that stand behind it."""
    y, *vectors = (PhasePoint(both[i : i + size]) for i in range(0, len(both), size))
    return y, tuple(vectors)


def past(
    system: System, step: Step, vectors: Vectors, dp: System | None = None
) -> Vectors:
    """The vectors past the event on which a step may have ended, in the modes there."""
    if not step.modes:
        return vectors
    assert step.event
    event = step.event[0] > 0

    def across(before):
        after = tuple(map(saltation(system, step, dp), before))
        return jax.tree.map(lambda a, b: jnp.where(event, a, b), after, before)

    after = if_any_lane(event, across, vectors)
    law = system.coulomb.in_modes(step.event[1])
    return tuple(_without_stuck(law, v) for v in after)


def _without_stuck(law: CoulombInModes, v: PhasePoint) -> PhasePoint:
    """A tangent without the rates of joints that stick."""
    return PhasePoint.of(v.phi, law.hold(v.omega))


# ---- growth


class TangentFrame(NamedTuple):
    """Orthonormal tangents and how much they have grown."""

    vectors: Vectors
    factors: tuple[Scalar, ...]  # products of lengths since the last logarithm
    logs: tuple[Scalar, ...]


class AbstractGrowth(AbstractFold[State]):
    """A fold that lets tangents go along with the motion.

    The motion's error bounds the steps; where it says little, as at rest, that of the
    tangents does.
    """

    solver: eqx.AbstractVar[Explicit | Taylor]
    rtol: eqx.AbstractVar[Scalar]  # of the motion

    @abc.abstractmethod
    def tangents(self, state: State) -> "TangentFrame":
        """Where the fold's state has them."""

    def advance(self, solver, t0, t1, y0, system, first, state):
        """A step, and the images of the tangents with their errors."""
        del first
        _, (y1, images), (error, errors), (last, _) = push(
            solver, system, t0, t1, y0, self.tangents(state).vectors
        )
        return y1, error, last, (images, errors), None

    def expand(self, system, y0, order, token, state):
        """The series of a step, and of the tangents."""
        vectors = self.tangents(state).vectors
        return expand_along(system, y0, order, token, vectors)

    def allowed(self, motion, along, rtol, atol):
        """As long as the series of the motion and of its tangents allow."""
        coarse = TANGENT_SHARE * self.rtol
        each = [allowed(motion.y, rtol, atol)]
        each += [allowed(one, 0.0, coarse) for one in along]
        return reduce(jnp.minimum, each)

    def advance_frame(
        self, system: System, state: State, step: Step
    ) -> tuple[TangentFrame, Scalar]:
        """The tangents after a step, orthonormal again, and how long the next may be.

        **Arguments:** `system`: in the modes of the step.
        """
        frame = self.tangents(state)
        longest = jnp.inf
        if step.moved:  # its length was as both allow
            images = tuple(each.y1 for each in step.moved)
        elif step.modes:  # it may have been cut
            assert isinstance(self.solver, Explicit)
            ends = step.t0, step.t1, step.y0
            _, (_, images), (_, errors), _ = push(
                self.solver, system, *ends, frame.vectors
            )
            longest = materialise(step.t0, self._longest, step, errors)
        else:
            images, errors = step.integrals
            longest = materialise(step.t0, self._longest, step, errors)
        images = past(system, step, images)
        vectors, lengths = materialise(step.t0, orthonormal, images)
        factors = tuple(f * x for f, x in zip(frame.factors, lengths, strict=True))
        extreme = jnp.zeros_like(step.t0, bool)
        for factor in factors:
            extreme |= ~((factor > LEAST) & (factor < MOST))
        grown = TangentFrame(vectors, factors, frame.logs)
        return if_any_lane(extreme, lambda g: in_logs(g, extreme), grown), longest

    def _longest(self, step: Step, errors: Vectors) -> Scalar:
        """How long the next step may be by the tangents' errors in this one."""
        square = sum((dot(e, e) for e in errors), 0.0 * step.t0)
        square = square / (len(errors) * (TANGENT_SHARE * self.rtol) ** 2)
        clipped = jnp.clip(square, 1e-30, 1e30).astype(jnp.float32)
        factor = 0.9 * jnp.exp(-0.5 / self.solver.order * jnp.log(clipped))
        return (step.t1 - step.t0) * factor.astype(jnp.result_type(square))


def unit_tangents(system: System, y: PhasePoint, count: int) -> TangentFrame:
    """`count` orthonormal vectors, without the rates of joints that stick.

    Hadamard's, for more than two rods those of the cosine transform: where joints
    stick, the last ones are those that are lost.
    """
    zero, size = 0.0 * y[0], len(y)
    matrix = HADAMARD if size == 4 else _cosines(size)
    vectors = tuple(PhasePoint(zero + x for x in row) for row in matrix[:count])
    if system.sticks:
        vectors = tuple(_without_stuck(system.law, v) for v in vectors)
    vectors, _ = orthonormal(vectors)
    return TangentFrame(vectors, (zero + 1.0,) * count, (zero,) * count)


def _cosines(size: int) -> list[list[float]]:
    """The rows of the cosine transform, which are orthonormal."""
    rows = [
        [math.cos(math.pi * k * (2 * j + 1) / (2 * size)) for j in range(size)]
        for k in range(size)
    ]
    return [
        [x * math.sqrt((2 if k else 1) / size) for x in r] for k, r in enumerate(rows)
    ]


def in_logs(frame: TangentFrame, when: Flag) -> TangentFrame:
    """All growth so far as logarithms, in the lanes asked for."""
    vectors, factors, logs = frame
    pairs = zip(factors, logs, strict=True)
    logs = tuple(jnp.where(when, x + jnp.log(f), x) for f, x in pairs)
    return TangentFrame(vectors, tuple(jnp.where(when, 1.0, f) for f in factors), logs)


def orthonormal(vectors: Vectors) -> tuple[Vectors, tuple[Scalar, ...]]:
    """Gram-Schmidt (modified), written out: the vectors, and their lengths before.

    One that depends on those before it becomes zero, of length zero.
    """
    done, lengths = [], []
    for v in vectors:
        whole = dot(v, v)
        for e in done:
            share = dot(v, e)
            v = PhasePoint(x - share * y for x, y in zip(v, e, strict=True))
        square = dot(v, v)
        least = (LOST * jnp.finfo(jnp.result_type(square)).eps) ** 2
        length = jnp.where(square > least * whole, jnp.sqrt(square), 0.0)
        # a vector that is no number stays one: the motion's own end says why
        inverse = jnp.where(length == 0, 0.0, 1 / jnp.where(length == 0, 1.0, length))
        done.append(PhasePoint(x * inverse for x in v))
        lengths.append(length)
    return tuple(done), tuple(lengths)


def dot(v: Numbers, e: Numbers) -> Scalar:
    """The sum of products."""
    return sum_of([x * y for x, y in zip(v, e, strict=True)])
