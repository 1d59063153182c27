"""The problem that a curve of bifurcations poses to a walk, and its points."""

import copy
from collections.abc import Callable
from typing import NamedTuple, Self

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..analysis.branch_point import (
    AbstractContinuation,
    Arc,
    BranchPoint,
)
from ..analysis.shooting import newton, start_of
from ..model.column import Column
from ..motion.implicit import solve
from ..motion.options import Method
from ..motion.section import SectionPlane
from ..numerics.numbers import Count, Flag, Pair, Scalar
from ..results import CODE
from ..steady.jets import Bundle, Jet, blank_jet, jet_of
from .degeneracy import AbstractDegeneracy, Torus, closing_of

NEWTON_STEPS = 10  # more say that the step was too long
ON_A_BOUND = 1e-12  # what lies so little outside is on it
KINK = 1e-3  # a step below it may turn where the sequence of modes changes
N = 6  # unknowns of the cycle and the two parameters
WITHIN = CODE.cusp, CODE.unit, CODE.minus, CODE.pair  # zero there, in this order
TESTS = (*WITHIN, *(CODE.beyond,) * 4)  # two bounds of each parameter
Row = Float[Array, " n"]


class Bounds(NamedTuple):
    """Of the first and the second parameter."""

    first: Pair
    second: Pair


class Cycle(NamedTuple):
    """A cycle near the bifurcation: where the curve is sought."""

    section: SectionPlane
    z: Float[Array, "4"]  # three coordinates and the span
    sign: Float[Array, ""]  # -1 where the span is half a period, else 1
    parameters: Float[Array, "2"]
    failure: Int[Array, ""]  # a `CODE`, 0 for none


class CurveProblem(AbstractContinuation):
    r"""R = 0 and a degeneracy's equations, in $x = (z, p_1, p_2)$ and its own unknowns.

    **Arguments:** `make`: the column of both parameters, without derivatives; `kind`;
    `cycle`; `arc`: step, points and error; `bounds`; `method`.
    """

    kink = KINK
    along = N - 1  # the second parameter

    def __init__(
        self,
        make: Callable[[Scalar, Scalar], Column],
        kind: AbstractDegeneracy,
        cycle: Cycle,
        arc: Arc,
        bounds: Bounds,
        method: Method,
    ):
        """Set the scales."""
        self.make, self.kind, self.cycle = make, kind, cycle
        self.arc, self.bounds, self.method = arc, bounds, method
        self.section, self.failure = cycle.section, cycle.failure
        dtype = cycle.z.dtype
        one = jnp.ones(3, dtype)
        sizes = jnp.where(cycle.parameters == 0, 1.0, jnp.abs(cycle.parameters))
        self.scale = jnp.concatenate([one, jnp.maximum(cycle.z[3:], 1e-3), sizes])
        x = jnp.concatenate([cycle.z, cycle.parameters]) / self.scale
        self.first = jnp.concatenate([x, jnp.zeros(kind.extra, dtype)])
        # how (y0, T, p) move with x
        basis = jnp.zeros((7, N), dtype)
        places = [*self.section.others, 4, 5, 6]
        for column, row in enumerate(places):
            basis = basis.at[row, column].set(self.scale[column])
        self.basis = basis

    def beginning(self, closing: Float[Array, "4 7"]) -> Self:
        """The same problem with the null vectors of a first shot."""
        other = copy.copy(self)
        extra = self.kind.begin(closing, self.basis)
        other.first = self.first.at[N:].set(extra)
        return other

    def blank(self) -> BranchPoint:
        """A point of NaNs."""
        n = self.first.size
        shapes = (n,), (n,), (3,), (4, 4), (n - 1, n), (len(TESTS),), ()
        return BranchPoint(*(jnp.full(s, jnp.nan, self.first.dtype) for s in shapes))

    def smooth(self) -> Int[Array, " k"]:
        """Angles, T and the parameters."""
        angles = [place for place, i in enumerate(self.section.others) if i < 2]
        return jnp.array([*angles, 3, 4, 5])

    def real_changes(
        self, changed: Bool[Array, " k"], before: BranchPoint, after: BranchPoint
    ) -> Bool[Array, " k"]:
        """Another sequence of modes may jump over zero."""
        same = before.modes == after.modes
        met = len(WITHIN)
        return changed.at[:met].set(changed[:met] & same)

    def confirms(self, kind: Int[Array, ""], point: BranchPoint) -> Flag:
        """All are."""
        del point
        return kind > 0

    def collapsed(self, point: BranchPoint, points: BranchPoint) -> Flag:
        """Whether it passes its section the other way than the first cycle, or not."""
        i = self.section.index
        return point.matrix[i, 3] * points.matrix[0, i, 3] <= 0

    def left_bounds(self, point: BranchPoint) -> Flag:
        """Whether a parameter has, or the angle of a torus."""
        out = jnp.any(self._inside(point.x) < 0)
        if isinstance(self.kind, Torus):
            out |= jnp.sin(point.x[-1]) < 0
        return out

    def ambient(self, x: Float[Array, " n"]) -> Float[Array, "7"]:
        """y0, T and the parameters."""
        x = x[:N] * self.scale
        return jnp.concatenate([start_of(self.section, x[:4]), x[3:]])

    def bundle(self, x: Float[Array, " n"], left: Count) -> Bundle:
        """The motions from x."""
        directions = self.kind.directions(x[N:], self.basis)
        method = self.method.at_most(left)

        def make(p: Float[Array, "2"]) -> Column:
            return self.make(p[0], p[1])

        return Bundle(make, self.ambient(x), directions, method, self.kind.contact)

    def system(
        self, jet: Jet, x: Float[Array, " n"], reference: Float[Array, " n"]
    ) -> tuple[Float[Array, " m"], Float[Array, "m n"]]:
        """The equations and their Jacobian, without the plane's."""
        residual = jet.y - self.ambient(x)[:4] * 1.0
        residual = jnp.where(jet.arrived, residual, jnp.nan)
        matrix = closing_of(jet) @ self.basis
        block = self.kind.block(jet, x[N:], reference[N:], self.basis)
        zero = jnp.zeros((4, self.kind.extra), x.dtype)
        rows = [
            jnp.concatenate([matrix, zero], axis=1),
            jnp.concatenate([block.in_x, block.in_extra], axis=1),
        ]
        return jnp.concatenate([residual, block.residual]), jnp.concatenate(rows)

    def correct(
        self,
        x0: Float[Array, " n"],
        row: Row,
        left: Count,
        closed: float = jnp.inf,
    ) -> tuple[BranchPoint, Bool[Array, ""], Int[Array, ""], Int[Array, ""]]:
        """The point of the curve on the plane through x0 across `row`."""
        point, good, count, left, _ = self.corrected(x0, row, left, closed)
        return point, good, count, left

    def corrected(
        self, x0: Float[Array, " n"], row: Row, left: Count, closed: float
    ) -> tuple[
        BranchPoint, Bool[Array, ""], Int[Array, ""], Int[Array, ""], Float[Array, ""]
    ]:
        """The same, with the largest of the equations where the last step begins."""
        plane = row.at[N:].set(0.0)

        def equations(x: Row, jet: Jet) -> tuple[Row, Float[Array, "n n"], Jet]:
            r, matrix = self.system(jet, x, x0)
            r = jnp.concatenate([r, (plane @ (x - x0))[None]])
            return r, jnp.concatenate([matrix, plane[None]]), jet

        blank = blank_jet(self.kind.vectors, 7, x0.dtype, self.kind.contact)
        solution = newton(
            self.bundle,
            equations,
            x0,
            blank,
            NEWTON_STEPS,
            left,
            lambda run: jet_of(run, self.cycle.sign),
            closed,
        )
        jet, x = solution.shot, solution.z
        _, matrix = self.system(jet, x, x0)
        whole = jnp.concatenate([matrix, plane[None]])
        tangent = solve(whole, jnp.zeros_like(x0).at[-1].set(1.0))
        tangent = tangent / jnp.sqrt(tangent[:N] @ tangent[:N])
        moved = jet.first[:, :4]
        tests = self._tests(x, tangent, matrix, moved)
        modes = jnp.where(jet.mixed, -1.0, jet.modes)
        point = BranchPoint(x, tangent, jet.extent, moved, matrix, tests, modes)
        good = solution.converged & (solution.residual <= closed)
        good &= jnp.all(jnp.isfinite(tangent))
        return point, good, solution.iterations, solution.left, solution.residual

    def _inside(self, x: Row) -> Float[Array, "4"]:
        """How far the parameters lie within their bounds."""
        first, second = (x[N - 2 : N] * self.scale[N - 2 :])[:, None]
        (low1, high1), (low2, high2) = self.bounds
        gaps = [second - low2, high2 - second, first - low1, high1 - first]
        # on a bound is within it, so that a walk from there sees where it leaves
        return jnp.concatenate(gaps) + ON_A_BOUND

    def _tests(
        self,
        x: Row,
        tangent: Row,
        matrix: Float[Array, "m n"],
        moved: Float[Array, "4 4"],
    ) -> Float[Array, " k"]:
        """Cusp; other multipliers at 1, at -1, on the circle; the bounds."""
        tests = self.kind.tests(x[N:], tangent, matrix, moved)
        return jnp.concatenate([tests, self._inside(x)])
