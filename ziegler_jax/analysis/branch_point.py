"""The problem that a branch of cycles poses, and its points: see `continuation`."""

from collections.abc import Callable
from typing import NamedTuple, cast

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..model.column import Column
from ..motion.implicit import fixed, solve
from ..motion.options import Method
from ..motion.scene import (
    check_maker,
    float_state,
    made,
    valid_scene,
)
from ..numerics.numbers import (
    Count,
    Flag,
    Pair,
    Scalar,
    Traced,
    Vector4,
    instance,
    is_concrete,
    keeps,
    number,
    whole_number,
)
from ..results import ORBIT
from .periodic_orbit import PeriodicOrbit, cycle_method
from .shooting import Shot, blank_shot, newton, shot_motion, shot_of

NEWTON_STEPS = 10  # more say that the step was too long


class Arc(eqx.Module):
    r"""How far and how finely a branch is followed along its arc.

    **Arguments:**

    - `direction`: 1 or -1, in which the parameter moves at first; None is 1 for a
        branch, -1 for a fold.
    - `step`: the longest on the arc: rad for the state, the first cycle's period for T,
        the first value for the parameter.
    - `points`: at most so many; None is 400 for a branch, 200 on the way to a fold.
    - `bounds`: around the first value; the branch ends where the parameter leaves them.
    - `error`: how far a point may lie from the tangent at the one before, in angle,
        period and parameter, measured as on the arc; where it lies farther the step is
        shorter. The line through both points is about a quarter of that off the branch.
        Not on the way to a fold.

    **Raises:** `ValueError` for numbers that break a rule.
    """

    direction: int | None = eqx.field(static=True)
    step: Scalar
    points: int | None = eqx.field(static=True)
    bounds: tuple[Scalar, Scalar]
    error: Scalar

    def __init__(
        self,
        direction: int | None = None,
        step: Scalar = 0.1,
        points: int | None = None,
        bounds: tuple[Scalar, Scalar] = (-np.inf, np.inf),
        error: Scalar = 1.5e-4,
    ):
        """Check and keep them."""
        known = direction is None or isinstance(direction, int | np.integer)
        if not known or isinstance(direction, bool) or direction not in (1, -1, None):
            raise ValueError(
                f"Argument `direction` must be 1 or -1, but is {direction!r}."
            )
        self.direction = direction
        self.step = number("step", step, "positive")
        self.points = None if points is None else whole_number("points", points)
        try:
            low, high = bounds
        except (TypeError, ValueError):
            raise ValueError(
                f"Argument `bounds` must be two numbers, but is {bounds!r}."
            ) from None
        for bound in (low, high):
            if is_concrete(bound) and not _is_real(bound):
                raise ValueError(
                    f"Argument `bounds` must be two numbers, but is {bounds!r}."
                )
        if is_concrete(low) and is_concrete(high) and not low < high:
            raise ValueError(f"Argument `bounds` must increase, but is {bounds!r}.")
        self.bounds = low, high
        self.error = number("error", error, "positive")


def _is_real(x: object) -> bool:
    """Whether it is a number, infinite ones too."""
    return isinstance(x, int | float | np.number) and x == x


_ARCS = {"continue_cycle": (1, 400), "cycle_fold": (-1, 200)}


class BranchPoint(NamedTuple):
    """A point of a branch, or arrays (n, ...) of them."""

    x: Float[Array, "*n 5"]  # scaled
    tangent: Float[Array, "*n 5"]
    extent: Float[Array, "*n 3"]
    moved: Float[Array, "*n 4 4"]
    matrix: Float[Array, "*n 4 5"]  # of R in z and the parameter
    tests: Float[Array, "*n 4"]


class Continuation:
    """What a continuation needs: the problem, its scales, and where it starts."""

    def __init__(
        self,
        question: str,
        make_column: Callable[[Scalar], Column],
        orbit: PeriodicOrbit,
        parameter: Scalar,
        arc: Arc,
        method: Method,
    ):
        """Check it, and set the scales."""
        dtype = jnp.result_type(float)
        check_maker(make_column)
        instance("orbit", orbit, PeriodicOrbit)
        instance("arc", arc, Arc)
        start = number("parameter", parameter)
        check_bounds(arc.bounds, start)
        at = fixed(jnp.asarray(start, dtype))
        direction, points = _ARCS[question]
        direction = direction if arc.direction is None else arc.direction
        points = points if arc.points is None else arc.points
        self.arc = Arc(direction, arc.step, points, arc.bounds, arc.error)
        self.method = cycle_method(question, method, made(make_column, at))
        # what the function closes over, without its derivatives
        self.make = fixed(eqx.filter_closure_convert(make_column, at))
        self.section = fixed(orbit.section)
        y0 = fixed(float_state(orbit.state))
        z = [*(y0[i] for i in self.section.others), fixed(orbit.period)]
        z = jnp.stack([jnp.asarray(x, dtype) for x in z])
        good = keeps("finite", start) & keeps("positive", arc.step, arc.error)
        good &= keeps("positive", self.method.rtol, self.method.atol)
        still = cast(Vector4, (0.0 * at,) * 4)
        good &= _hold(arc.bounds, at) & valid_scene(self.make(at), still)
        failure = jnp.where(orbit.outcome == ORBIT.found, 0, orbit.outcome)
        self.failure = jnp.where(good, failure, ORBIT.invalid)
        one = jnp.ones((), dtype)
        size = jnp.where(at == 0, one, jnp.abs(at))
        self.scale = jnp.stack([one, one, one, jnp.maximum(z[3], 1e-3), size])
        self.first = jnp.concatenate([z, at[None]]) / self.scale

    def correct(
        self, x0: Float[Array, "5"], row: Float[Array, "5"], left: Count
    ) -> tuple[BranchPoint, Bool[Array, ""], Int[Array, ""], Int[Array, ""]]:
        """The point of the branch on the plane through x0 across `row`.

        **Returns:** the point, whether it is one, Newton's iterations, and how many
        steps are left.
        """

        def motion(x, left):
            z, share = x * self.scale, self.method.at_most(left)
            make = lambda p: self.make(p[0])  # noqa: E731
            return shot_motion(make, z[4:], self.section, z[:4], share)

        def equations(x, flow):
            shot = shot_of(self.section, (x * self.scale)[:4], flow)
            matrix = _matrix(shot) * self.scale[None]
            r = jnp.concatenate([shot.residual, (row @ (x - x0))[None]])
            return r, jnp.concatenate([matrix, row[None]]), shot

        blank = blank_shot(1, x0.dtype)
        solution = newton(motion, equations, x0, blank, NEWTON_STEPS, left)
        shot = solution.shot
        matrix = _matrix(shot)
        whole = jnp.concatenate([matrix * self.scale[None], row[None]])
        tangent = solve(whole, jnp.eye(5, dtype=x0.dtype)[4])
        tangent = tangent / jnp.sqrt(tangent @ tangent)
        moved = shot.flow.moved[:, :4]
        tests = jnp.stack([tangent[4], *products(moved)])
        point = BranchPoint(solution.z, tangent, shot.flow.extent, moved, matrix, tests)
        good = solution.converged & jnp.all(jnp.isfinite(tangent))
        return point, good, solution.count, solution.left


def check_bounds(bounds: Pair, start: Scalar) -> None:
    """Refuse bounds that do not hold the start, as far as all is known."""
    low, high = bounds
    known = [float(x) for x in (low, start, high) if is_concrete(x)]
    if known != sorted(known):
        raise ValueError(
            f"Argument `bounds` must hold `parameter`, but is {bounds!r} with "
            f"`parameter` = {start}."
        )


def _hold(bounds: Pair, start: Scalar) -> Flag:
    """Whether traced bounds increase and hold the start; they may be infinite."""
    low, high = bounds
    if is_concrete(low) and is_concrete(high):
        return True
    return (low <= start) & (start <= high) & (low < high)


def _matrix(shot: Shot) -> Float[Array, "4 5"]:
    """R's derivatives in z and the parameter, (4, 5)."""
    return jnp.concatenate([shot.jacobian, shot.flow.moved[:, 4:]], axis=1)


def characteristic_cubic(moved: Float[Array, "4 4"]) -> tuple[Traced, Traced, Traced]:
    """b2, b1, b0 of the cubic whose roots are the multipliers other than 1."""
    square = moved @ moved
    t1, t2, t3 = jnp.trace(moved), jnp.trace(square), jnp.trace(square @ moved)
    e2 = (t1 * t1 - t2) / 2
    e3 = (t1**3 - 3 * t1 * t2 + 2 * t3) / 6
    b2 = 1 - t1
    b1 = e2 + b2
    return b2, b1, b1 - e3


def products(moved: Float[Array, "4 4"]) -> tuple[Traced, Traced, Traced]:
    """The products over the multipliers: torus, flip, pitchfork."""
    b2, b1, b0 = characteristic_cubic(moved)
    return b0 * b0 - b2 * b0 + b1 - 1, 1 - b2 + b1 - b0, 1 + b2 + b1 + b0
