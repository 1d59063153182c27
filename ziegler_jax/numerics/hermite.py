r"""Numbers over a step, from what is known at its ends: extrema, passages, guards.

A guard is positive while the modes of a step hold. Its course over the step is known
with its extrema, and so a guard that falls below zero and rises again within the step
is seen.
"""

from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple, Protocol

import jax
import jax.numpy as jnp

from .elementary import larger, smaller
from .numbers import Flag, Flags, Numbers, Pair, Scalar
from .series import value, value_and_slope

ITERATIONS = 4  # of a Newton method that is kept in a bracket
FINE = 1e-6  # a step that short goes to and fro no more
INNER = 1e-3  # how near to a step's ends a third point may lie


class Quintic(NamedTuple):
    r"""A number over a step, at x from 0 to 1, $O(h^6)$ from its course.

    It has the values, slopes and second derivatives of both ends, a step the unit.
    """

    g0: Scalar
    v0: Scalar
    a0: Scalar
    g1: Scalar
    v1: Scalar
    a1: Scalar

    def __call__(self, x: Scalar) -> Scalar:
        """The number at x: the cubic of values and slopes, and what bends it."""
        (c2, c3), rest = _cubic(self), 1 - x
        bent = rest * (self.a0 / 2 - c2) + x * (self.a1 / 2 - c2 - 3 * c3)
        return self.g0 + x * (self.v0 + x * (c2 + c3 * x) + x * rest * rest * bent)

    def slope(self, x: Scalar) -> Scalar:
        """The slope at x."""
        return value(self.slopes(), x)

    def slopes(self) -> Numbers:
        """The slope as a polynomial: its coefficients from the constant one on."""
        rise = self.g1 - self.g0 - self.v0 - self.a0 / 2
        faster, more = self.v1 - self.v0 - self.a0, self.a1 - self.a0
        c3 = 10 * rise - 4 * faster + more / 2
        c4 = 7 * faster - 15 * rise - more
        c5 = 6 * rise - 3 * faster + more / 2
        return self.v0, self.a0, 3 * c3, 4 * c4, 5 * c5

    def polygon(self) -> Numbers:
        """The control points of its Bezier curve."""
        first, last = self.g0 + self.v0 / 5, self.g1 - self.v1 / 5
        second = first + self.v0 / 5 + self.a0 / 20
        return self.g0, first, second, last - self.v1 / 5 + self.a1 / 20, last, self.g1

    def turning(self) -> tuple[Flag, Scalar]:
        """Whether the slope changes its sign between the ends, and where about."""
        return turning(self)

    def largest(self) -> Scalar:
        """The largest size at the end and about where it turns."""
        turns, x = self.turning()
        end = jnp.abs(self.g1)  # of numbers below the normal ones, too: not by `extent`
        return jnp.where(turns, larger(jnp.abs(self(x)), end), end)

    def extent(self) -> Pair:
        """The smallest and the largest number at the end and about where it turns."""
        turns, x = self.turning()
        inner = jnp.where(turns, self(x), self.g1)
        return smaller(inner, self.g1), larger(inner, self.g1)

    def extremum(self) -> Scalar:
        """The number where it turns, else at the end.

        Where it turns it does not move to first order: the place, which is exact to
        rounding, carries no derivative.
        """
        still = jax.lax.stop_gradient(self)
        turns, x = still.turning()
        slopes = still.slopes()
        for _ in range(2):  # from within h^3
            slope, bend = value_and_slope(slopes, x)
            moved = x - slope / jnp.where(bend == 0, jnp.inf, bend)
            x = jnp.where(turns, jnp.clip(moved, 0.0, 1.0), 1.0)
        return self(x)

    def mean(self) -> Scalar:
        """Its mean over the step."""
        bent = (self.v0 - self.v1) / 10 + (self.a0 + self.a1) / 120
        return (self.g0 + self.g1) / 2 + bent


class QuinticRate(NamedTuple):
    r"""How fast a quintic runs over a step, at x from 0 to 1, $O(h^5)$ from its course.

    A quartic with the rates and their slopes at both ends, whose integral is the
    quintic's rise: its own extremum is seen where a cubic's would be off by $O(h^4)$.
    """

    path: Quintic
    scale: Scalar  # of its slope: one by the step's length
    level: Scalar = 0.0  # what is taken off

    def __call__(self, x: Scalar) -> Scalar:
        """The rate at x."""
        return self.scale * self.path.slope(x) - self.level

    def slope(self, x: Scalar) -> Scalar:
        """Its slope at x, per step."""
        return value(self.slopes(), x)

    def slopes(self) -> Numbers:
        """The slope as a polynomial."""
        return tuple(self.scale * c for c in differentiated(self.path.slopes()))

    def polygon(self) -> Numbers:
        """The control points of its Bezier curve."""
        points = self.path.polygon()
        return tuple(
            5 * self.scale * (b - a) - self.level
            for a, b in zip(points, points[1:], strict=False)
        )

    @property
    def g0(self) -> Scalar:
        """The rate at the step's start."""
        return self.scale * self.path.v0 - self.level

    @property
    def g1(self) -> Scalar:
        """At its end."""
        return self.scale * self.path.v1 - self.level

    @property
    def v0(self) -> Scalar:
        """Its slope at the start, per step."""
        return self.scale * self.path.a0

    @property
    def v1(self) -> Scalar:
        """At the end."""
        return self.scale * self.path.a1


class HermiteQuartic(NamedTuple):
    r"""A number over a step, at x from 0 to 1: a cubic Hermite and what bends it.

    $$g(x) = g_0 + x\,(v_0 + x\,(c_2 + c_3 x)) + \beta x^2 (1 - x)^2$$

    With $\beta = h \sum_i d_i k_i$ of a Runge-Kutta method it is that method's own
    interpolant, e.g. of order 4 for Tsit5; with $\beta = 0$ it is of order 3.
    """

    g0: Scalar
    g1: Scalar
    v0: Scalar  # slopes per step
    v1: Scalar
    bend: Scalar

    def __call__(self, x: Scalar) -> Scalar:
        """The number at x; exact at both ends."""
        rest, rise = 1 - x, self.g1 - self.g0
        inner = rest * (self.v0 - rise) - x * (self.v1 - rise)
        inner = inner + self.bend * x * rest
        return rest * self.g0 + x * self.g1 + x * rest * inner

    def slope(self, x: Scalar) -> Scalar:
        """The slope at x, per step."""
        c2, c3 = _cubic(self)
        bends = 2 * self.bend * x * (1 - x) * (1 - 2 * x)
        return self.v0 + x * (2 * c2 + 3 * x * c3) + bends


def cubic(g0: Scalar, g1: Scalar, v0: Scalar, v1: Scalar) -> HermiteQuartic:
    """What has these values and slopes at both ends."""
    return HermiteQuartic(g0, g1, v0, v1, jnp.zeros_like(g0))


def through(
    g0: Scalar, v0: Scalar, x: Scalar, gx: Scalar, g1: Scalar
) -> HermiteQuartic:
    """The cubic with this start and slope that passes gx at x and g1 at 1."""
    chord = g1 - g0 - v0
    c3 = (chord - (gx - g0 - v0 * x) / (x * x)) / (1 - x)
    return cubic(g0, g1, v0, v0 + 2 * chord + c3)


class Course(Protocol):
    """A number over a step, and how fast it runs."""

    def __call__(self, x: Scalar) -> Scalar:
        """The number at x, from 0 to 1."""
        ...

    def slope(self, x: Scalar) -> Scalar:
        """Its slope there, per step."""
        ...


def turning(course: "HermiteQuartic | Quintic") -> tuple[Flag, Scalar]:
    r"""Whether a number's slope changes its sign between the ends, and where about.

    Between slopes of unlike sign the cubic has exactly one extremum, at the root
    of $\kappa x^2 - (1 + \kappa)\,x + r = 0$ with $r = v_0 / (v_0 - v_1)$ and
    $\kappa = 3 c_3 / (v_0 - v_1)$, written here so that nothing cancels. It lies
    within h^3 of the quintic's, whose value there is within h^6. In 32 bits it is
    cheap: seven digits of the place are fourteen of the number there. A number
    whose slopes underflow hardly moves, and counts as one that does not turn. Then
    the place is the end.
    """
    v0, v1, (_, c3) = course.v0, course.v1, _cubic(course)
    turns = v0 * v1 < 0
    inverse = 1 / jnp.where(turns, v0 - v1, 1.0)
    r, kappa = v0 * inverse, 3 * c3 * inverse
    b = 1 + kappa
    root = _root(_short(b * b - 4 * kappa * r))
    far, first = _short(jnp.abs(b)) + root, b >= 0
    x = jnp.where(first, _short(2 * r), far) / jnp.where(first, far, _short(-2 * kappa))
    x = smaller(larger(x, 0.0), 1.0).astype(r.dtype)
    return turns, jnp.where(turns, x, 1.0)


def probe_point(g0: Scalar, v0: Scalar, g1: Scalar) -> Pair:
    """Where to look into a step: where the parabola is zero or least, and that."""
    c2 = g1 - g0 - v0
    turns = (v0 < 0) & (2 * c2 > -v0)
    x = jnp.where(turns, -0.5 * v0 / jnp.where(turns, c2, 1.0), 0.5)
    least = jnp.where(turns, g0 + 0.5 * x * v0, g1)
    root = _root(v0 * v0 - 4 * c2 * g0)
    zero = 2 * g0 / jnp.where(root > v0, root - v0, 1.0)
    return jnp.clip(jnp.where(least < 0, zero, x), INNER, 1 - INNER), least


def extrema(course: HermiteQuartic) -> Pair:
    """Where in (0, 1) the cubic has its extrema, in order; 1 for one that is absent."""
    v0 = course.v0
    c2, c3 = _cubic(course)
    square = c2 * c2 - 3 * c3 * v0
    root = _root(square)
    sum_ = -(c2 + jnp.where(c2 < 0, -root, root))  # nothing cancels

    def inside(top, bottom):
        x = top / jnp.where(bottom == 0, 1.0, bottom)
        there = (square > 0) & (bottom != 0) & (x > 0) & (x < 1)
        return jnp.where(there, x, 1.0)

    x1, x2 = inside(sum_, 3 * c3), inside(v0, sum_)
    return jnp.minimum(x1, x2), jnp.maximum(x1, x2)


def falls_below(
    course: HermiteQuartic, tol: Scalar, turns: Pair
) -> tuple[Flag, Scalar, Scalar]:
    """Whether the guard falls below -tol, and the bracket of that.

    **Returns:** the verdict, and the two places in [0, 1] between which it falls.
    """
    a, b = turns
    below_a, below_b = course(a) < -tol, course(b) < -tol
    left = jnp.where(below_a, 0.0, jnp.where(below_b, a, b))
    right = jnp.where(below_a, a, jnp.where(below_b, b, 1.0))
    return below_a | below_b | (course.g1 < -tol), left, right


def bezier_verdict(course: HermiteQuartic, tol: Scalar) -> Flags:
    """Whether the guard's Bezier polygon alone decides, and then whether it falls.

    A polynomial changes its sign no more often than its control polygon does: with at
    most one change, to below -tol, there is at most one crossing and no dip.
    """
    b1, b3 = course.g0 + course.v0 / 4, course.g1 - course.v1 / 4
    b2 = (course.g0 + course.g1) / 2 + (course.v0 - course.v1 + course.bend) / 6
    low = [b < -tol for b in (b1, b2, b3, course.g1)]
    rises = [jnp.logical_not(a) | b for a, b in pairwise(low)]
    return rises[0] & rises[1] & rises[2], low[3]


def chord_root(course: Course, left: Scalar, right: Scalar) -> Scalar:
    """About where the course crosses zero in the bracket: on the chord."""
    at_left, at_right = course(left), course(right)
    drop = at_left - at_right
    share = jnp.where(drop > 0, at_left / jnp.where(drop > 0, drop, 1.0), 0.5)
    return left + jnp.clip(share, 0.0, 1.0) * (right - left)


def place(
    course: Course,
    level: Scalar,
    x: Scalar,
    left: Scalar,
    right: Scalar,
) -> Scalar:
    """Where the course passes `level` in the bracket, from about x."""

    def above(x):
        return course(x) - level, course.slope(x)

    return falling_root(above, x, left, right, ITERATIONS)


def falling_root(
    function: Callable[[Scalar], Pair],
    x: Scalar,
    left: Scalar,
    right: Scalar,
    times: int,
) -> Scalar:
    """Where a number falls through zero, from about x: Newton's method in a bracket.

    Where a step is not shorter than half of the last the bracket is halved: about a
    root at an inflection Newton's steps may go to and fro.

    **Arguments:** `function`: the number and its slope at x; `times`: how many steps.
    """
    most = right - left
    for _ in range(times):
        value, slope = function(x)
        left = jnp.where(value > 0, x, left)
        right = jnp.where(value > 0, right, x)
        newton = x - value / jnp.where(slope < 0, slope, -1.0)
        good = (slope < 0) & (newton >= left) & (newton <= right)
        good &= jnp.abs(newton - x) <= larger(most, FINE)
        after = jnp.where(good, newton, 0.5 * (left + right))
        x, most = after, 0.5 * jnp.abs(after - x)
    return x


def differentiated(coefficients: Numbers) -> Numbers:
    """The polynomial of its slope."""
    return tuple(i * c for i, c in enumerate(coefficients))[1:]


def _cubic(course: HermiteQuartic | Quintic) -> Pair:
    """c2, c3 of the cubic through the values and slopes of both ends."""
    rise, v0, v1 = course.g1 - course.g0, course.v0, course.v1
    return 3 * rise - 2 * v0 - v1, v0 + v1 - 2 * rise


def _short(x: jax.Array) -> jax.Array:
    return x.astype(jnp.float32)


def _root(square: Scalar) -> Scalar:
    """The square root; where there is none zero, with a slope of zero."""
    there = square > 0
    return jnp.where(there, jnp.sqrt(jnp.where(there, square, 1.0)), 0.0)
