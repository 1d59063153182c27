r"""Curves of bifurcations of cycles in the plane of two parameters.

A fold, a flip, a torus or a pitchfork of cycles at one value of a second parameter lies
on a curve. With the cycle $z$, both parameters and the null vectors v as unknowns it is
one more curve F(x) = 0 (`degeneracy` has the equations), walked by pseudo-arclength as
branches of cycles are (`continuation`), in both directions from where it is met, and
then filled in one batch (`fill`).

On the way test functions change sign, and the zero is found along the arc: a cusp of
folds, one more multiplier at 1 or -1, a pair on the unit circle. Where a cycle comes to
graze, a joint's rate touching zero or a sticking joint its most, its multipliers jump:
curves of folds, flips and tori end there, as `modes_change`, on a curve of grazing.

Source: Y. A. Kuznetsov, Elements of Applied Bifurcation Theory (2004), section 10.3; M.
di Bernardo et al., Piecewise-smooth Dynamical Systems (2008), chapter 8.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import cast

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..analysis.branch_point import Arc, BranchPoint, codes_of
from ..analysis.continuation import Branch, CyclePoints
from ..analysis.march import ContinuationState, Walk
from ..analysis.periodic_orbit import PeriodicOrbit, check_orbit, cycle_method
from ..analysis.shooting import start_of
from ..model.column import Column
from ..motion.checks import check_maker, check_two_rods, made
from ..motion.implicit import fixed, lost
from ..motion.options import Method, recorded
from ..numerics.numbers import Scalar, is_concrete
from ..numerics.rules import choice, instance, number
from ..results import CODE, Settings
from ..runtime import requires_x64
from .bifurcation import Bifurcation
from .bifurcations import BifurcationCurve, BifurcationPoints
from .course import Course
from .degeneracy import Torus
from .derivative import moving_point
from .fill import Filled, Knots, at_values, corrected, evenly, joined
from .problem import TESTS, WITHIN, CurveProblem, N
from .start import (
    DEGENERACIES,
    KINDS,
    Beginning,
    Kind,
    cycle_of,
    degeneracy_of,
    met_on_branch,
    of_orbit,
    of_points,
)

SPECIALS = 6  # in each direction there is room for so many
MEETS = 0.02  # the sine of the angle at which a torus' pair is all but one

Start = PeriodicOrbit | CyclePoints | Bifurcation | Branch


@requires_x64
def bifurcation_curve(
    make_column: Callable[[Scalar, Scalar], Column],
    kind: Kind,
    start: Start,
    *,
    second: Scalar,
    first: Scalar | None = None,
    course: Course = Course(),
    arc: Arc = Arc(),
    method: Method = Method(),
) -> BifurcationCurve:
    r"""The curve of a bifurcation of cycles in the plane of two parameters.

    ```python
    # fold = zj.bifurcation(lambda q: make(q, 0.26), "fold", orbit, 1.95)
    course = zj.Course(values=[0.1, 0.2, 0.26], second=(0.1, 0.26))
    curve = zj.bifurcation_curve(make, "fold", fold, second=0.26, course=course)
    curve.points.first  # 1.61206, ..., 1.86140
    ```

    **Arguments:**

    - `make_column`: a function of both parameters, e.g. `lambda q, tau: ...`.
    - `kind`: "fold"; "flip": the period doubles; "torus": a complex pair of multipliers
        leaves the unit circle; "pitchfork": a symmetric cycle loses its symmetry. With
        set-valued friction also "sticking_1", "sticking_2": the joint comes to rest in
        the cycle and the torque that would hold it is just the most: beyond it sticks
        (crossing becomes sliding); and "grazing_1", "grazing_2": the joint's slip comes
        down to the rate zero and turns: beyond it is at rest for a moment. There the
        multipliers have two values: those of one side are given.
    - `start`: a cycle, `PeriodicOrbit`, at the values `first` and `second`: then its
        branch is followed in the first parameter, as `arc` says, to the first
        bifurcation of this kind; but for sticking and grazing Newton's method starts at
        the cycle itself, which must be near. Or what knows a bifurcation and its
        first parameter already: `Bifurcation`, `Branch`, or `CyclePoints` such as
        `branch.special`, whose first one of this kind is taken; then `first` is left
        out.
    - `course`: how far and how finely the curve is followed, see `Course`.
    - `arc`: of the branch of a `PeriodicOrbit`; else it has no meaning.
    - `method`: an explicit one; its step budget is that of the walk in each direction,
        and of each point in the end.

    **Returns:** `BifurcationCurve`; of symmetric cycles, half a period is shot.

    **Derivatives:** of the numbers of `points` at the `values` of a `course`, forward
    and reverse, first order, in these and in every number that `make_column` was made
    from, by the implicit function theorem. The second derivatives in it are central
    differences, good to some five digits; in `first` at folds none is left. NaN are
    those of points that are spread evenly, whose places depend on the ends, of
    `special` and of `residual`.

    Where the sequence of stick and slip changes smoothly, a joint beginning to stick
    where its rate passes zero, the curve goes on. Where the cycle grazes, curves of
    folds, flips, tori and pitchforks end. A branch may turn there, too, at a corner: a
    multiplier passes 1 by a jump, "fold" ends as `no_start`, and the curve of such
    points is that of "grazing_1" or "grazing_2", from a cycle near.

    **Raises:** `ValueError` for arguments that break a rule.
    """
    check_maker(make_column, 2)
    choice("kind", kind, KINDS)
    instance("course", course, Course)
    instance("arc", arc, Arc)
    dtype = jnp.result_type(float)
    second = number("second", second)
    _check_start(course, second, first)
    second = jnp.asarray(second, dtype)
    at = fixed(second)
    begin, about = _begun(make_column, kind, start, at, first, arc, method)
    check_two_rods("bifurcation_curve", about)
    method = cycle_method("bifurcation_curve", method, about)
    live = eqx.filter_closure_convert(make_column, begin.first, at)
    still = fixed(live)
    cycle, closing, shot_steps = cycle_of(kind, still, begin, at, method)
    degeneracy = degeneracy_of(kind)
    problem = CurveProblem(still, degeneracy, cycle, course.arc, course.bounds, method)
    problem = problem.beginning(closing)

    def walk(direction: Float[Array, ""]) -> ContinuationState:
        heading = problem.heading(direction)
        return Walk(heading, SPECIALS, (True,) * len(TESTS), False).follow()

    ways = fixed(jax.vmap(walk)(jnp.array([-1.0, 1.0], dtype)))
    down, up = (_knots(jax.tree.map(lambda a, i=i: a[i], ways)) for i in (0, 1))
    knots = joined(down, up)
    if course.values is None:
        x, rows = evenly(knots, course.points)
    else:
        values = fixed(jnp.asarray(course.values, dtype)) / problem.scale[N - 1]
        x, rows = at_values(knots, values)
        rows = jnp.zeros_like(rows).at[:, N - 1].set(1.0)
    filled = fixed(corrected(problem, x, rows))
    if course.values is not None:
        moved = partial(moving_point, problem, make_column)
        values = jnp.asarray(course.values, dtype)
        filled = filled._replace(point=jax.vmap(moved)(filled.point, values))
    settings = _settings(kind, course, method, begin)
    ordinary = jnp.full(course.count, CODE.ordinary, jnp.int8)
    points = _points(problem, filled, ordinary, settings)
    scene = live, start, second, first, course, arc
    if course.values is None:
        points = lost(points, scene)
    points = eqx.tree_at(lambda p: p.residual, points, lost(points.residual, scene))
    ends = jax.vmap(lambda way: _end(problem, way))(ways)
    special, codes = _specials(ways, jnp.stack([down.filled, up.filled]), ends)
    there = codes != CODE.ordinary
    none = jnp.zeros(there.shape, jnp.int32)
    residual = jnp.full(there.shape, jnp.nan, dtype)  # they are not corrected again
    notable = Filled(special, there, residual, none)
    started = jnp.any(ways.filled > 0)
    failed = jnp.where(cycle.failure > 0, cycle.failure, CODE.not_converged)
    spent = 2 * jnp.asarray(method.max_steps, jnp.int32) - jnp.sum(
        ways.left, dtype=jnp.int32
    )
    return BifurcationCurve(
        points=points,
        special=lost(_points(problem, notable, codes, settings), scene),
        ends=ends.astype(jnp.int8),
        knots=ways.filled,
        outcome=jnp.where(started, CODE.found, failed).astype(jnp.int8),
        steps=begin.steps + shot_steps + spent + jnp.sum(filled.steps, dtype=jnp.int32),
        settings=settings,
    )


def _begun(
    make_column: Callable[[Scalar, Scalar], Column],
    kind: Kind,
    start: Start,
    second: Float[Array, ""],
    first: Scalar | None,
    arc: Arc,
    method: Method,
) -> tuple[Beginning, Column]:
    """Where the curve is met, and a column of the kind that is asked about."""
    if isinstance(start, PeriodicOrbit):
        check_orbit("start", start, 2)
        if first is None:
            raise ValueError(
                "Argument `first` must be given with a `PeriodicOrbit`: the value of "
                "the first parameter at which it is one."
            )

        def make(x: Scalar) -> Column:
            return make_column(x, second)

        about = made(make, number("first", first))
        if kind not in DEGENERACIES:
            if not about.sticks:
                raise ValueError(
                    "Argument `kind` must not be a change of modes without set-valued "
                    f"friction, where no joint sticks, but is {kind!r}."
                )
            at = fixed(jnp.asarray(first, second.dtype))
            return of_orbit(start, at), about
        return met_on_branch(kind, make, start, first, arc, method), about
    if kind not in DEGENERACIES:
        raise ValueError(
            f"Argument `start` must be a `PeriodicOrbit` for {kind!r}, a cycle nearby, "
            f"but is a `{type(start).__name__}`."
        )
    if first is not None:
        raise ValueError(
            "Argument `first` must be left out where `start` is no `PeriodicOrbit`: "
            f"its points have theirs, but is {first!r}."
        )
    if isinstance(start, Bifurcation):
        start = start.cycle
    if isinstance(start, Branch):
        start = start.special
    if not isinstance(start, CyclePoints):
        raise ValueError(
            "Argument `start` must be a `PeriodicOrbit`, `CyclePoints`, a `Branch` or "
            f"a `Bifurcation`, but is {start!r}."
        )
    begin = of_points(kind, start)
    return begin, made(lambda x: make_column(x, second), begin.first)


def _check_start(course: Course, second: Scalar, first: Scalar | None) -> None:
    """Refuse a start out of bounds, as far as all is known."""
    for name, value in (("second", second), ("first", first)):
        low, high = getattr(course, name)
        known = value is not None and all(is_concrete(x) for x in (low, high, value))
        if known and not low <= value <= high:
            raise ValueError(
                f"Argument `{name}` must lie in the bounds of `course`, ({low:g}, "
                f"{high:g}), but is {value:g}."
            )


def _knots(way: ContinuationState) -> Knots:
    """The points of a walk; where it left its bounds, its last one is on the bound.

    Without the last ones where it ends at a grazing cycle, which crowd there.
    """
    x, tangent = way.points.x, way.points.tangent
    places = jnp.arange(x.shape[0], dtype=jnp.int32)
    grazes = (way.points.modes < 0) & (places < way.filled)
    first = jnp.argmax(grazes).astype(jnp.int32)
    count = jnp.where(jnp.any(grazes), first, way.filled)
    edges = way.kind > len(WITHIN)
    which = jnp.argmax(edges)
    last = jnp.where(jnp.any(edges), jnp.maximum(way.filled - 1, 0), x.shape[0])
    return Knots(
        x.at[last].set(way.special.x[which], mode="drop"),
        tangent.at[last].set(way.special.tangent[which], mode="drop"),
        count,
        jnp.zeros((), jnp.int32),
    )


def _specials(
    ways: ContinuationState, counts: Int[Array, "2"], ends: Int[Array, "2"]
) -> tuple[BranchPoint, Int[Array, " n"]]:
    """Where something happens in either direction, and what; last points at a graze."""
    way, last = jnp.arange(2, dtype=jnp.int32), jnp.maximum(counts - 1, 0)
    special = jax.tree.map(
        lambda a, points: jnp.concatenate(
            [a.reshape(-1, *a.shape[2:]), points[way, last]]
        ),
        ways.special,
        ways.points,
    )
    codes = codes_of(ways.kind.reshape(-1), TESTS)
    changes = jnp.where(ends == CODE.modes_change, ends, int(CODE.ordinary))
    return special, jnp.concatenate([codes, changes.astype(codes.dtype)])


def _end(problem: CurveProblem, way: ContinuationState) -> Int[Array, ""]:
    """Why a walk ended."""
    end = jnp.where(way.outcome == CODE.found, CODE.unfinished, way.outcome)
    changes = way.modes_change | (way.here.modes < 0)
    lost = end == CODE.not_converged
    end = jnp.where(lost & changes, CODE.modes_change, end)
    if isinstance(problem.kind, Torus):
        met = jnp.sin(way.here.x[-1]) < 0
        # close to it the two vectors nearly agree, and Newton's method loses them
        met |= lost & (jnp.sin(way.here.x[-1]) < MEETS)
        end = jnp.where(met, CODE.resonance, end)
    return jnp.where(way.filled > 0, end, CODE.no_start)


def _points(
    problem: CurveProblem,
    filled: Filled,
    meeting: Int[Array, " n"],
    settings: Settings,
) -> BifurcationPoints:
    """The points in their own units; NaN where there is none."""
    point, good = filled.point, filled.good

    def shown(a: Float[Array, "n ..."]) -> Float[Array, "n ..."]:
        mask = good.reshape(-1, *(1,) * (a.ndim - 1))
        return jnp.where(mask, a, jnp.nan)

    x = point.x[:, :N] * problem.scale[None]
    y = start_of(problem.section, x[:, :4])
    half = problem.cycle.sign < 0
    moved = point.moved
    outcome = jnp.where(good, CODE.found, CODE.not_converged)
    return BifurcationPoints(
        first=shown(x[:, 4]),
        second=shown(x[:, 5]),
        phi=shown(y[:, :2]),
        omega=shown(y[:, 2:]),
        period=shown(jnp.where(half, 2.0, 1.0) * x[:, 3]),
        rod_amplitude=shown(point.extent[:, :2]),
        joint_amplitude=shown(point.extent[:, jnp.array([0, 2])]),
        monodromy=shown(jnp.where(half, moved @ moved, moved)),
        residual=shown(filled.residual),
        modes=shown(point.modes),
        meeting=meeting,
        outcome=outcome.astype(jnp.int8),
        settings=settings,
    )


def _settings(kind: Kind, course: Course, method: Method, begin: Beginning) -> Settings:
    """How a curve was followed, for the record."""
    return recorded(
        kind=kind,
        **cast(dict, method.settings()),
        step=course.step,
        error=course.error,
        room=course.room,
        points=course.count,
        second_least=course.second[0],
        second_largest=course.second[1],
        first_least=course.first[0],
        first_largest=course.first[1],
        **begin.section.settings(),
    )
