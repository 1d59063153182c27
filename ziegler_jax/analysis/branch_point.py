"""The problem that a branch of cycles poses, and its points: see `continuation`."""

from __future__ import annotations

import abc
import copy
from collections.abc import Callable
from typing import ClassVar, Literal, NamedTuple, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float, Int

from ..model.chain_of_rods import AbstractChain
from ..model.state import PhasePoint
from ..motion.checks import check_maker, float_state, made, valid_scene
from ..motion.implicit import fixed, solve
from ..motion.options import Method
from ..motion.section import SectionPlane
from ..numerics.eigenvalues import eigenvalues
from ..numerics.numbers import Count, Flag, Pair, Scalar, is_concrete
from ..numerics.rules import instance, keeps, number, whole_number
from ..results import CODE, Codes
from ..steady.oddness import is_odd
from .periodic_orbit import PeriodicOrbit, check_orbit, cycle_method
from .shooting import (
    Shot,
    blank_shot,
    is_mirrored,
    newton,
    shot_motion,
    shot_of,
    turned,
)

NEWTON_STEPS = 10  # more say that the step was too long
BESIDE = 1e-3  # the first parameter, of its size: where oddness is looked at once more
TESTS = CODE.fold, CODE.torus, CODE.flip, CODE.pitchfork  # zero there, in this order


Direction = int | Literal["both"]


class Arc(eqx.Module):
    r"""How far and how finely a branch is followed along its arc.

    **Arguments:**

    - `direction`: 1 or -1, in which the parameter moves at first; `"both"` of a
        branch; None is 1 for a branch, -1 on the way to a bifurcation.
    - `step`: the longest on the arc: rad for the state, the first cycle's period for T,
        the first value for the parameter.
    - `points`: at most so many in each direction; None is 400 for a branch, 200 on the
        way to a bifurcation.
    - `bounds`: around the first value; the branch ends where the parameter leaves them.
    - `error`: how far a point may lie from the tangent at the one before, in angle,
        period and parameter, measured as on the arc; where it lies farther the step is
        shorter. The line through both points is about a quarter of that off the branch.
        Not on the way to a bifurcation.

    **Raises:** `ValueError` for numbers that break a rule.
    """

    # bounds are in the parameter's own unit, which `SI.scaled` leaves alone
    units: ClassVar = {"step": "1", "bounds": "1", "error": "1"}

    direction: Direction | None = eqx.field(static=True)
    step: Scalar
    points: int | None = eqx.field(static=True)
    bounds: tuple[Scalar, Scalar]
    error: Scalar

    def __init__(
        self,
        direction: Direction | None = None,
        step: Scalar = 0.1,
        points: int | None = None,
        bounds: tuple[Scalar, Scalar] = (-np.inf, np.inf),
        error: Scalar = 1.5e-4,
    ):
        """Check and keep them."""
        known = direction is None or isinstance(direction, int | np.integer | str)
        allowed = (1, -1, "both", None)
        if not known or isinstance(direction, bool) or direction not in allowed:
            raise ValueError(
                f'Argument `direction` must be 1, -1 or "both", but is {direction!r}.'
            )
        self.direction = direction
        self.step = number("step", step, "positive")
        self.points = None if points is None else whole_number("points", points)
        self.bounds = increasing("bounds", bounds)
        self.error = number("error", error, "positive")


def _is_real(x: object) -> bool:
    """Whether it is a number, infinite ones too."""
    return isinstance(x, int | float | np.number) and x == x


_ARCS = {"continue_cycle": (1, 400), "bifurcation": (-1, 200), "branch_off": (1, 1)}


class BranchPoint(NamedTuple):
    """A point of a branch, or arrays (n, ...) of them."""

    x: Float[Array, "*n k"]  # scaled
    tangent: Float[Array, "*n k"]
    extent: Float[Array, "*n a"]
    moved: Float[Array, "*n s s"]
    matrix: Float[Array, "*n s m"]  # of R in z and the parameters
    tests: Float[Array, "*n t"]
    modes: Float[Array, "*n"]  # a number of the sequence of modes


class AbstractContinuation(abc.ABC):
    """The problem of a walk: a curve R(x) = 0, its tests, and its ends.

    `arc`, `method`; `first`: where it starts, scaled, and `failure`: a `CODE`
    where it cannot; `scale`: of the unknowns; `along`: the place of the one along which
    the walk begins, in the `direction` 1 or -1; `crossing`: the test, counted from 1,
    that is zero where another curve crosses and Newton's method is singular; 0: none.
    """

    arc: Arc
    method: Method
    first: Float[Array, " n"]
    failure: Int[Array, ""]
    scale: Float[Array, " n"]
    along: int
    crossing: int = 0
    direction: Scalar = 1.0
    kink: float = 0.0  # steps below it may turn where the sequence of modes changes
    spent: Count = 0  # of the step budget, before the walk

    @property
    def left(self) -> Int[Array, ""]:
        """Of the step budget."""
        return jnp.asarray(self.method.max_steps, jnp.int32) - self.spent

    def heading(self, direction: Scalar) -> Self:
        """The same problem, walked the way in which that unknown rises (1) or falls."""
        other = copy.copy(self)
        other.direction = direction
        return other

    def forward(self) -> Float[Array, " n"]:
        """The direction in which the walk begins."""
        return jnp.zeros_like(self.first).at[self.along].set(self.direction)

    @abc.abstractmethod
    def correct(
        self, x0: Float[Array, " n"], row: Float[Array, " n"], left: Count
    ) -> tuple[BranchPoint, Bool[Array, ""], Int[Array, ""], Int[Array, ""]]:
        """The point of the curve on the plane through x0 across `row`.

        **Returns:** the point, whether it is one, Newton's iterations, and how many
        steps are left.
        """

    @abc.abstractmethod
    def blank(self) -> BranchPoint:
        """A point of NaNs."""

    @abc.abstractmethod
    def smooth(self) -> Int[Array, " k"]:
        """The unknowns that have no kinks along the curve."""

    @abc.abstractmethod
    def real_changes(
        self, changed: Bool[Array, " k"], before: BranchPoint, after: BranchPoint
    ) -> Bool[Array, " k"]:
        """Changes of the tests' signs without those that mean nothing."""

    @abc.abstractmethod
    def confirms(self, kind: Int[Array, ""], point: BranchPoint) -> Flag:
        """Whether a zero of the test `kind`, counted from 1, is a special point."""

    @abc.abstractmethod
    def collapsed(self, point: BranchPoint, points: BranchPoint) -> Flag:
        """Whether the cycle is none any more; `points`: those before."""

    @abc.abstractmethod
    def left_bounds(self, point: BranchPoint) -> Flag:
        """Whether it lies beyond the bounds."""


class Continuation(AbstractContinuation):
    r"""A continuation's problem, its scales, and where it starts.

    Its motions last one period (`sign` = 1), or half of one, to the mirror image (-1):
    where the first cycle is its own. With the multipliers $\nu$ of the half map those
    of the period are $\nu^2$; at a pitchfork one is -1, and Newton's method regular.
    """

    sign: Scalar = 1.0
    crossing = 1 + TESTS.index(CODE.pitchfork)

    def __init__(
        self,
        question: str,
        make_column: Callable[[Scalar], AbstractChain],
        orbit: PeriodicOrbit,
        parameter: Scalar,
        arc: Arc,
        method: Method,
    ):
        """Check it, see whether the cycle is symmetric, and set the scales."""
        dtype = jnp.result_type(float)
        check_maker(make_column)
        instance("orbit", orbit, PeriodicOrbit)
        instance("arc", arc, Arc)
        start = number("parameter", parameter)
        check_bounds(arc.bounds, start)
        at = fixed(jnp.asarray(start, dtype))
        direction, points = _ARCS[question]
        direction = direction if arc.direction is None else arc.direction
        if direction == "both" and question != "continue_cycle":
            raise ValueError(
                "Argument `direction` must be 1 or -1 on the way to a bifurcation, but "
                "is 'both'."
            )
        self.direction = -1.0 if direction == -1 else 1.0
        points = points if arc.points is None else arc.points
        self.arc = Arc(direction, arc.step, points, arc.bounds, arc.error)
        column = made(make_column, at)
        self.rods = column.joints
        check_orbit("orbit", orbit, self.rods)
        self.along = 2 * self.rods
        self.method = cycle_method(question, method, column)
        # what the function closes over, without its derivatives
        self.live = eqx.filter_closure_convert(make_column, at)
        self.make = fixed(self.live)
        self.section = fixed(orbit.section)
        y0 = fixed(float_state(orbit.state))
        good = keeps("finite", start) & keeps("positive", arc.step, arc.error)
        good &= keeps("positive", self.method.rtol, self.method.atol)
        still = PhasePoint((0.0 * at,) * self.along)
        good &= _hold(arc.bounds, at) & valid_scene(self.make(at), still)
        failure = jnp.where(orbit.outcome == CODE.found, 0, orbit.outcome)
        self.failure = jnp.where(good, failure, CODE.invalid)
        one = jnp.ones((), dtype)
        size = jnp.where(at == 0, one, jnp.abs(at))
        span = jnp.asarray(fixed(orbit.period), dtype)
        if question != "branch_off":  # which seeks what is not symmetric any more
            # beside it, too: where the parameter is an imperfection, 0 is no answer
            odd = jnp.all(jax.vmap(self._odd)(jnp.stack([at, at + BESIDE * size])))
            scene = self.make(at).system(), y0, span / 2
            image, self.spent = is_mirrored(
                *scene, self.method.budget, self.failure == 0
            )
            self.sign = jnp.where(odd & image, -one, one)
        z = [*(y0[i] for i in self.section.free(self.rods)), span / self.turns]
        z = jnp.stack([jnp.asarray(x, dtype) for x in z])
        ones = jnp.ones(z.size - 1, dtype)
        sizes = jnp.stack([jnp.maximum(z[-1], 1e-3), size])
        self.scale = jnp.concatenate([ones, sizes])
        self.first = jnp.concatenate([z, at[None]]) / self.scale

    def _odd(self, parameter: Scalar) -> Flag:
        """Whether the mirror image of each motion is a motion."""
        return is_odd(self.make(parameter).system())

    @property
    def symmetric(self) -> Bool[Array, ""]:
        """Whether each cycle is its own mirror image, half a period later."""
        return jnp.asarray(self.sign) < 0

    @property
    def turns(self) -> Float[Array, ""]:
        """How many of its motions are a period."""
        return jnp.where(self.symmetric, 2.0, 1.0)

    def whole(self, moved: Float[Array, "*n s s"]) -> Float[Array, "*n s s"]:
        """The monodromy matrix of the period."""
        return jnp.where(self.symmetric, moved @ moved, moved)

    def blank(self) -> BranchPoint:
        """A point of NaNs."""
        s = 2 * self.rods
        shapes = (s + 1,), (s + 1,), (s - 1,), (s, s), (s, s + 1), (4,), ()
        return BranchPoint(*(jnp.full(s, jnp.nan, self.first.dtype) for s in shapes))

    def smooth(self) -> Int[Array, " n"]:
        """The places of angles, T and the parameter.

        The rates have kinks where, as the branch goes on, a joint begins to stick at
        the section; angle and period have none.
        """
        free, s = self.section.free(self.rods), 2 * self.rods
        angles = [place for place, i in enumerate(free) if i < self.rods]
        return jnp.array([*angles, s - 1, s])

    def real_changes(
        self, changed: Bool[Array, "4"], before: BranchPoint, after: BranchPoint
    ) -> Bool[Array, "4"]:
        """Without those where two real multipliers are reciprocal, and at folds.

        There the torus' test vanishes, too, and the pitchfork's but of the half map.
        Which pair it was is asked at the zero: on the way to it another one, of real
        multipliers, may lie nearer to the circle.
        """
        torus, pitchfork = TESTS.index(CODE.torus), TESTS.index(CODE.pitchfork)
        pair = self._has_pair(before) | self._has_pair(after)
        changed = changed.at[torus].set(changed[torus] & pair)
        regular = self.symmetric | ~changed[0]
        return changed.at[pitchfork].set(changed[pitchfork] & regular)

    def confirms(self, kind: Int[Array, ""], point: BranchPoint) -> Flag:
        """A torus has a complex pair."""
        return (kind != 1 + TESTS.index(CODE.torus)) | circles(self._others(point))

    def _has_pair(self, point: BranchPoint) -> Bool[Array, ""]:
        """Whether multipliers are complex."""
        return jnp.any(jnp.imag(self._others(point)) != 0)

    def _others(self, point: BranchPoint) -> Complex[Array, " k"]:
        return other_multipliers(self.section, point.moved, point.matrix)

    def collapsed(self, point: BranchPoint, points: BranchPoint) -> Flag:
        """Whether it passes its section the other way than the first cycle, or not."""
        i, turn = self.section.place(self.rods), 2 * self.rods - 1
        return point.matrix[i, turn] * points.matrix[0, i, turn] <= 0

    def left_bounds(self, point: BranchPoint) -> Flag:
        """Whether the parameter has."""
        low, high = (jnp.asarray(b, point.x.dtype) for b in self.arc.bounds)
        value = point.x[-1] * self.scale[-1]
        return (value < low) | (value > high)

    def correct(
        self, x0: Float[Array, " n"], row: Float[Array, " n"], left: Count
    ) -> tuple[BranchPoint, Bool[Array, ""], Int[Array, ""], Int[Array, ""]]:
        """The point of the branch on the plane through x0 across `row`."""

        def motion(x, left):
            z, share = x * self.scale, self.method.at_most(left)
            return shot_motion(
                lambda p: self.make(p[0]), z[-1:], self.section, z[:-1], share
            )

        def equations(x, flow):
            z = (x * self.scale)[:-1]
            shot = shot_of(self.section, z, turned(flow, self.sign))
            matrix = _matrix(shot) * self.scale[None]
            r = jnp.concatenate([shot.residual, (row @ (x - x0))[None]])
            return r, jnp.concatenate([matrix, row[None]]), shot

        blank = blank_shot(1, x0.dtype, self.rods)
        solution = newton(motion, equations, x0, blank, NEWTON_STEPS, left)
        shot = solution.shot
        matrix = _matrix(shot)
        whole = jnp.concatenate([matrix * self.scale[None], row[None]])
        tangent = solve(whole, jnp.zeros_like(x0).at[-1].set(1.0))
        tangent = tangent / jnp.sqrt(tangent @ tangent)
        moved = shot.flow.moved[:, :-1]
        torus, flip, pitchfork = products(
            other_multipliers(self.section, moved, matrix)
        )
        # of the half map: a pitchfork, and a symmetric cycle has no flip
        pitchfork = jnp.where(self.symmetric, flip, pitchfork)
        flip = jnp.where(self.symmetric, 1.0, flip)
        tests = jnp.stack([tangent[-1], torus, flip, pitchfork])
        ends = moved, matrix, tests, shot.flow.modes
        point = BranchPoint(solution.z, tangent, shot.flow.extent, *ends)
        good = solution.converged & jnp.all(jnp.isfinite(tangent))
        good &= ~self.symmetric | self._odd(solution.z[-1] * self.scale[-1])
        return point, good, solution.iterations, solution.left


def codes_of(kind: Int[Array, "*n"], tests: Codes) -> Int[Array, "*n"]:
    """The codes of special points where tests are zero, counted from 1; 0: none."""
    return jnp.asarray([CODE.ordinary, *tests], jnp.int8)[kind]


def increasing(name: str, bounds: Pair) -> Pair:
    """Two numbers, perhaps infinite, of which the second is larger.

    **Raises:** `ValueError` for others, as far as they are known.
    """
    try:
        low, high = bounds
    except (TypeError, ValueError):
        raise ValueError(
            f"Argument `{name}` must be two numbers, but is {bounds!r}."
        ) from None
    for bound in (low, high):
        if is_concrete(bound) and not _is_real(bound):
            raise ValueError(
                f"Argument `{name}` must be two numbers, but is {bounds!r}."
            )
    if is_concrete(low) and is_concrete(high) and not low < high:
        raise ValueError(f"Argument `{name}` must increase, but is {bounds!r}.")
    return low, high


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


def _matrix(shot: Shot) -> Float[Array, "s m"]:
    """R's derivatives in z and the parameter, (2n, 2n + 1)."""
    return jnp.concatenate([shot.jacobian, shot.flow.moved[:, -1:]], axis=1)


def other_multipliers(
    section: SectionPlane, moved: Float[Array, "s s"], matrix: Float[Array, "s m"]
) -> Complex[Array, " k"]:
    """Multipliers of the return to the section, without the trivial 1, (2n - 1,).

    Of the derivative of the motion over the period what goes along the motion is taken
    away, so that it ends on the section again.
    """
    rods = moved.shape[0] // 2
    i, free = section.place(rods), jnp.asarray(section.free(rods))
    slope = matrix[:, 2 * rods - 1]
    back = moved - jnp.outer(slope, moved[i] / slope[i])
    return eigenvalues(back[free][:, free])


def circles(values: Complex[Array, " k"]) -> Bool[Array, ""]:
    """Whether of all pairs that whose product is nearest to 1 is a complex one."""
    i, j = np.triu_indices(values.size, 1)
    nearest = jnp.argmin(jnp.abs(values[i] * values[j] - 1))
    return jnp.imag(values[i] - values[j])[nearest] != 0


def products(values: Complex[Array, " k"]) -> tuple[Scalar, Scalar, Scalar]:
    """The products over the multipliers: torus, flip, pitchfork."""
    i, j = np.triu_indices(values.size, 1)
    factors = values[i] * values[j] - 1, 1 + values, 1 - values
    torus, flip, pitchfork = (jnp.real(jnp.prod(each)) for each in factors)
    return torus, flip, pitchfork
