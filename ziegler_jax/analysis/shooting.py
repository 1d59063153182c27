r"""Shooting: where a motion returns, Newton's method, and what carries derivatives."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax

from ..model.column import Column
from ..motion.integrate import Method, Motion, Run, follow
from ..motion.section import Plane, passage
from ..motion.sequence import in_turn
from ..motion.variational import Flow, flow_of, varied_motion
from ..numerics.numbers import Scalar, Vector4
from ..results import OUTCOME
from ..solvers import AbstractFold
from .implicit import implicit, moving

TOLERANCE = 1e-8  # of the last Newton step; what is left is its square, and rounding
LARGEST_MOVE = 0.3  # of a Newton step: more is cut
SHORTEST = 1e-3  # a period below it is none


class Passages(AbstractFold):
    """Upward passages of phi1 through a section, until `loops` returns are over."""

    section: Scalar
    loops: int

    def init(self, column, t0, y0):
        """No passage yet: their number, when the first was, when and where the last."""
        del column
        zero = 0.0 * y0[0]
        return zero, t0 + zero, t0 + zero, y0

    def outcome(self, state):
        """`complete` once they are over."""
        over = jnp.where(state[0] > self.loops, OUTCOME.complete, OUTCOME.not_computed)
        return over.astype(jnp.int32)

    def step(self, column, state, step):
        """Count the step's passage."""
        del column
        count, first, last, where = state
        found = passage(Plane(level=self.section), step)
        there = found.there
        first = jnp.where(there & (count == 0), found.time, first)
        last = jnp.where(there, found.time, last)
        pairs = zip(found.y, where, strict=True)
        where = tuple(jnp.where(there, a, b) for a, b in pairs)
        count = count + jnp.where(there, 1.0, 0.0)
        return (count, first, last, where), jnp.inf, count > self.loops


def first_return(
    column: Column,
    start: Vector4,
    section: Any,
    loops: int,
    patience: Any,
    method: Method,
) -> tuple[Any, Any, Any]:
    """Where a motion from `start` closes roughly: z, whether it does in time, steps."""
    y0: Any = tuple(lax.stop_gradient(jnp.asarray(x)) for x in start)
    span = jnp.asarray(patience, y0[0].dtype)
    run = follow(Motion(column, y0, Passages(section, loops), method, end=span))
    count, first, last, place = run.folded
    z = jnp.stack([*place[1:], last - first])
    return z, count > loops, run.steps


class Found(NamedTuple):
    """Where Newton's method ended."""

    z: Any
    move: Any  # the last step
    size: Any  # and its largest component before it was cut
    count: Any  # iterations
    shot: "Shot"  # the last one
    left: Any  # of the steps

    @property
    def converged(self) -> Any:
        """Whether it ended where it should."""
        return self.size <= TOLERANCE


def newton(
    shot: Callable[[Any, Any], Motion],
    equations: Callable[[Any, Flow], tuple[Any, Any, "Shot"]],
    z0: Any,
    blank: "Shot",
    max_iterations: int,
    left: Any,
) -> Found:
    """Solve r(z) = 0 by Newton's method, one motion an iteration.

    **Arguments:**

    - `shot`: the motion from z, and at most so many steps.
    - `equations`: r, its Jacobian and the shot, from z and its motion's flow.
    - `z0`: the first approximation. Steps from it are cut to `LARGEST_MOVE`, and NaN
        ends it.
    - `blank`: a shot of the same shape.
    - `left`: how many steps there are for all motions.
    """
    # without a first approximation there is nothing to do
    far, none = jnp.max(z0 - z0) + jnp.inf, jnp.zeros((), jnp.int32)
    left = jnp.asarray(left, jnp.int32)
    begin = Found(z0, jnp.zeros_like(z0), far, none, blank, left)

    def goes_on(now: Found):
        unsettled = now.size > TOLERANCE  # not for NaN
        return unsettled & (now.count < max_iterations) & (now.left > 0)

    def improve(now: Found, motion: Motion, run: Run):
        del motion
        r, jacobian, shot = equations(now.z, flow_of(run))
        move = -solve(jacobian, r)
        size = jnp.max(jnp.abs(move))
        move = move * jnp.minimum(1.0, LARGEST_MOVE / jnp.where(size > 0, size, 1.0))
        left = now.left - shot.flow.steps
        return Found(now.z + move, move, size, now.count + 1, shot, left)

    return in_turn(lambda now: shot(now.z, now.left), improve, goes_on, begin)[0]


def solve(matrix: Any, right: Any) -> Any:
    """Solve a small linear system; NaN where it is not finite."""
    bad = ~jnp.all(jnp.isfinite(matrix))
    safe = jnp.where(bad, jnp.eye(matrix.shape[0], dtype=matrix.dtype), matrix)
    return jnp.where(bad, jnp.nan, jnp.linalg.solve(safe, right))


class Shot(NamedTuple):
    """One period tried: what is left to close, and its derivatives."""

    residual: Any  # (4,)
    jacobian: Any  # (4, 4) in z = (phi2, omega1, omega2, T)
    flow: Flow


def shot_motion(
    make: Callable[[Any], Column],
    parameters: Any,
    section: Any,
    z: Any,
    method: Method,
    vary: bool = True,
) -> Motion:
    """The motion from phi1 = `section` for a period."""
    y0, span = start_of(section, z), jnp.maximum(z[3], SHORTEST)
    return varied_motion(make, parameters, y0, span, method, vary)


def shot_of(section: Any, z: Any, flow: Flow) -> Shot:
    """What such a motion leaves to close."""
    residual = jnp.where(flow.arrived, flow.y - start_of(section, z), jnp.nan)
    return Shot(residual, closing(flow.moved, flow.slope), flow)


def start_of(section: Any, z: Any) -> Any:
    """The state (4,) on the section."""
    return jnp.concatenate([jnp.asarray(section, z.dtype)[None], z[:3]])


def blank_shot(n: int, dtype: Any) -> Shot:
    """A shot of n parameters that has not been made."""

    def none(*shape):
        return jnp.zeros(shape, dtype)

    moves = none(4, 4 + n), none(3, 4 + n), jnp.asarray(False), jnp.zeros((), jnp.int32)
    return Shot(none(4), none(4, 4), Flow(none(4), none(4), none(3), *moves))


def closing(moved: Any, slope: Any) -> Any:
    """The Jacobian of the residual in z."""
    return jnp.concatenate(
        [moved[:, 1:4] - jnp.eye(4, dtype=moved.dtype)[:, 1:], slope[:, None]], axis=1
    )


def attached(
    size: int,
    column: Column,
    y0: Any,
    span: Any,
    method: Method,
    linear: Callable,
    *extra: Any,
) -> Any:
    """Zeros (size,) that carry derivatives in the column's traced leaves p.

    The derivative is `linear(flow, *extra)`, an array (size, n), times dp, where `flow`
    is the motion from y0 over the span with its derivatives in all n leaves: one
    product with a Jacobian, forward or reverse.
    """
    p, make = moving(column, y0.dtype)
    if not p.size:
        return jnp.zeros(size, y0.dtype)

    def slope(p, y0, span, *extra):
        motion = varied_motion(make, p, y0, span, method)
        return linear(flow_of(motion.advance(motion.begin())), *extra)

    return implicit((size,), slope, p, y0, span, *extra)
