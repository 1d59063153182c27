r"""Shooting: where a motion returns, Newton's method, and the flow as JAX sees it."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from ..model.column import Column
from ..motion.scene import prepared
from ..motion.variational import Flow, Method, flow
from ..numerics.numbers import Scalar, Vector4
from ..solvers import AbstractFold

TOLERANCE = 1e-8  # of the last Newton step; what is left is its square, and rounding
LARGEST_MOVE = 0.3  # of a Newton step: more is cut
SHORTEST = 1e-3  # a period below it is none


class Passages(AbstractFold):
    """Upward passages of phi1 through a section, until `loops` returns are over."""

    section: Scalar
    loops: int

    def integrand(self, column):
        """Nothing."""
        del column
        return None

    def init(self, column, t0, y0):
        """No passage yet: their number, when the first was, when and where the last."""
        del column
        zero = 0.0 * y0[0]
        return zero, t0 + zero, t0 + zero, y0

    def step(self, column, state, step):
        """Find the passage on the step's cubic, by Newton from the secant."""
        del column
        count, first, last, place = state
        h = step.t1 - step.t0

        def cubic(i):
            x0, x1 = step.y0[i], step.y1[i]
            v0, v1 = h * step.f0[i], h * step.f1[i]
            return x0, v0, 3 * (x1 - x0) - 2 * v0 - v1, v0 + v1 - 2 * (x1 - x0)

        passed = (step.y0[0] < self.section) & (step.y1[0] >= self.section)
        x0, v0, c2, c3 = cubic(0)
        rise = jnp.where(passed, step.y1[0] - x0, 1.0)
        s = (self.section - x0) / rise
        for _ in range(2):
            value = x0 - self.section + s * (v0 + s * (c2 + s * c3))
            slope = v0 + s * (2 * c2 + 3 * s * c3)
            s = jnp.clip(s - value / jnp.where(slope > 0, slope, rise), 0.0, 1.0)
        here = tuple(
            x + s * (v + s * (c + s * d)) for x, v, c, d in map(cubic, range(4))
        )
        time = step.t0 + s * h
        first = jnp.where(passed & (count == 0), time, first)
        last = jnp.where(passed, time, last)
        place = tuple(jnp.where(passed, a, b) for a, b in zip(here, place, strict=True))
        count = count + jnp.where(passed, 1.0, 0.0)
        return (count, first, last, place), jnp.inf, count > self.loops


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
    (count, first, last, place), *_, steps = method.run(
        prepared(column), Passages(section, loops), y0, span
    )
    z = jnp.stack([*place[1:], last - first])
    return z, count > loops, steps.astype(jnp.int32)


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
    function: Callable, z0: Any, blank: "Shot", max_iterations: int, left: Any
) -> Found:
    """Solve r(z) = 0, given a function of z that returns r, its Jacobian and its shot.

    Steps are cut to `LARGEST_MOVE`; NaN ends it. `blank`: a shot of the same shape.
    `left`: how many steps there are for all shots; the function gets what is left.
    """
    far, none = jnp.full((), jnp.inf, z0.dtype), jnp.zeros((), jnp.int32)
    left = jnp.asarray(left, jnp.int32)
    begin = Found(z0, jnp.zeros_like(z0), far, none, blank, left)

    def goes_on(now: Found):
        unsettled = now.size > TOLERANCE  # not for NaN
        return unsettled & (now.count < max_iterations) & (now.left > 0)

    def improve(now: Found):
        r, jacobian, shot = function(now.z, now.left)
        move = -solve(jacobian, r)
        size = jnp.max(jnp.abs(move))
        move = move * jnp.minimum(1.0, LARGEST_MOVE / jnp.where(size > 0, size, 1.0))
        left = now.left - shot.flow.steps
        return Found(now.z + move, move, size, now.count + 1, shot, left)

    return lax.while_loop(goes_on, improve, begin)


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


def shoot(
    make: Callable[[Any], Column],
    parameters: Any,
    section: Any,
    z: Any,
    method: Method,
    vary: bool = True,
) -> Shot:
    """Follow the motion from phi1 = `section` for a period."""
    y0 = jnp.concatenate([jnp.asarray(section, z.dtype)[None], z[:3]])
    seen = flow(make, parameters, y0, jnp.maximum(z[3], SHORTEST), method, vary)
    residual = jnp.where(seen.arrived, seen.y - y0, jnp.nan)
    return Shot(residual, closing(seen.moved, seen.slope), seen)


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
    leaves, tree = jax.tree.flatten(column)
    traced = [i for i, x in enumerate(leaves) if isinstance(x, jax.Array)]
    if not traced:
        return jnp.zeros(size, y0.dtype)

    def make(p):
        new = list(leaves)
        for i, x in zip(traced, p, strict=True):
            new[i] = x
        return jax.tree.unflatten(tree, new)

    def slope(p, y0, span, *extra):
        return linear(flow(make, p, y0, span, method), *extra)

    @jax.custom_jvp
    def zeros(p, *fixed):
        del fixed
        return jnp.zeros(size, p.dtype)

    @zeros.defjvp
    def rule(primals, tangents):
        return zeros(*primals), first_order(slope(*primals)) @ tangents[0]

    p = jnp.stack([jnp.asarray(leaves[i], y0.dtype) for i in traced])
    return zeros(p, *fixed((y0, span, *extra)))


@jax.custom_jvp
def first_order(x: Any) -> Any:
    """The same; a derivative of it is refused."""
    return x


@first_order.defjvp
def _refuse_second(primals, tangents):
    raise ValueError(
        "Periodic orbits, their folds and thresholds have first derivatives only: "
        "the second ones would need second variations. Take differences of the first."
    )


@jax.custom_jvp
def undifferentiated(x: Any) -> Any:
    """The same; a derivative of it is refused."""
    return x


@undifferentiated.defjvp
def _refuse_first(primals, tangents):
    raise ValueError(
        "The monodromy matrix, its multipliers and `stable` have no derivatives here: "
        "they would need second variations. Read them outside of what is "
        "differentiated, or take differences."
    )


def fixed(tree: Any) -> Any:
    """The same numbers without derivatives; concrete ones stay concrete."""
    return jax.tree.map(
        lambda x: lax.stop_gradient(x) if isinstance(x, jax.Array) else x, tree
    )
