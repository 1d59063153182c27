r"""Tangents of a motion: how small differences grow, through stick and slip too.

Between events a small difference v follows the variational equations along the motion,

$$\dot v = J(y)\, v, \qquad J = \partial f / \partial y,$$

integrated by the motion's own steps and stages: v is the derivative of the computed
motion. The motion's error bounds the steps; where it says little, as at rest, that of
the tangents does. Where set-valued friction changes its modes v jumps (`saltation`). A
joint that sticks has no rate to differ in: v keeps none, a dimension of the tangents is
lost, and with it goes an exponent to minus infinity.
"""

from typing import Any, NamedTuple

import diffrax as dfx
import jax
import jax.numpy as jnp

from ..model.column import vector_field
from ..model.set_valued import Torques
from ..numerics.materialise import if_any_lane, materialise
from ..numerics.numbers import Scalar, Vector4
from ..solvers import Explicit, Step
from .saltation import saltation

Vectors = tuple[Vector4, ...]

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


class Growing(NamedTuple):
    """Orthonormal tangents and how much they have grown."""

    vectors: Vectors
    factors: tuple[Scalar, ...]  # products of lengths since the last logarithm
    logs: tuple[Scalar, ...]


def unit_tangents(column: Any, y: Vector4, count: int) -> Growing:
    """`count` orthonormal vectors, without the rates of joints that stick.

    Hadamard's: where joints stick, the last ones are those that are lost.
    """
    zero = 0.0 * y[0]
    vectors = tuple(tuple(zero + x for x in row) for row in HADAMARD[:count])
    if column.sticks:
        vectors = tuple(_held(column.friction, v) for v in vectors)
    vectors, _ = orthonormal(vectors)  # type: ignore[arg-type]
    return Growing(vectors, (zero + 1.0,) * count, (zero,) * count)


def grow(
    solver: Explicit, column: Any, growing: Growing, step: Step, rtol: Scalar
) -> tuple[Growing, Scalar]:
    """The tangents after a step, orthonormal again, and how long the next may be.

    **Arguments:** `column`: in the modes of the step, where friction is set-valued;
    `rtol`: of the motion.
    """
    moved, error = _along(solver, column, growing.vectors, step)

    def allowed():
        square = sum((_dot(e, e) for e in error), 0.0 * step.t0)
        square = square / (len(error) * (TANGENT_SHARE * rtol) ** 2)
        clipped = jnp.clip(square, 1e-30, 1e30).astype(jnp.float32)
        factor = 0.9 * jnp.exp(-0.5 / solver.method_order * jnp.log(clipped))
        return (step.t1 - step.t0) * factor.astype(square.dtype)

    longest = materialise(step.t0, allowed)
    if column.sticks:
        event = step.event[0] > 0

        def passed(before):
            jump, law = saltation(column, step), column.friction.in_modes(step.event[1])
            after = tuple(_held(law, jump(v)) for v in before)
            return jax.tree.map(lambda a, b: jnp.where(event, a, b), after, before)

        moved = if_any_lane(event, passed, moved)
    vectors, lengths = materialise(step.t0, orthonormal, moved)
    factors = tuple(f * x for f, x in zip(growing.factors, lengths, strict=True))
    extreme = jnp.zeros_like(step.t0, bool)
    for factor in factors:
        extreme |= ~((factor > LEAST) & (factor < MOST))
    grown = Growing(vectors, factors, growing.logs)
    return if_any_lane(extreme, lambda g: in_logs(g, extreme), grown), longest


def in_logs(growing: Growing, when: Any) -> Growing:
    """All growth so far as logarithms, in the lanes asked for."""
    vectors, factors, logs = growing
    pairs = zip(factors, logs, strict=True)
    logs = tuple(jnp.where(when, x + jnp.log(f), x) for f, x in pairs)
    return Growing(vectors, tuple(jnp.where(when, 1.0, f) for f in factors), logs)


def orthonormal(vectors: Vectors) -> tuple[Vectors, tuple[Scalar, ...]]:
    """Gram-Schmidt (modified), written out: the vectors, and their lengths before.

    One that depends on those before it becomes zero, of length zero.
    """
    done, lengths = [], []
    for v in vectors:
        whole = _dot(v, v)
        for e in done:
            share = _dot(v, e)
            v = tuple(x - share * y for x, y in zip(v, e, strict=True))
        square = _dot(v, v)
        least = (LOST * jnp.finfo(square.dtype).eps) ** 2
        length = jnp.where(square > least * whole, jnp.sqrt(square), 0.0)
        # a vector that is no number stays one: the motion's own end says why
        inverse = jnp.where(length == 0, 0.0, 1 / jnp.where(length == 0, 1.0, length))
        done.append(tuple(x * inverse for x in v))
        lengths.append(length)
    return tuple(done), tuple(lengths)


def _along(solver: Explicit, column: Any, vectors: Vectors, step: Step) -> Any:
    """The vectors' images under the derivative of the computed step, and errors."""

    def field(t, both, column):
        slope, push = jax.linearize(lambda y: vector_field(t, y, column), both[:4])
        return sum((push(both[i : i + 4]) for i in range(4, len(both), 4)), slope)

    both = sum(vectors, step.y0)
    first = materialise(step.t0, field, step.t0, both, column)
    moved, error, *_ = solver.advance(
        dfx.ODETerm(field), step.t0, step.t1, both, column, first
    )
    places = range(4, len(both), 4)
    return tuple(moved[i : i + 4] for i in places), [error[i : i + 4] for i in places]


def _held(law: Torques, v: tuple) -> Vector4:
    """A tangent without the rates of joints that stick."""
    return v[0], v[1], *law.hold(v[2], v[3])


def _dot(v: tuple, e: tuple) -> Scalar:
    return v[0] * e[0] + v[1] * e[1] + v[2] * e[2] + v[3] * e[3]
