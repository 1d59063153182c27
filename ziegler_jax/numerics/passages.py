"""When a number passes a level within a step: the first time, and for how long.

The first looks for what leaves a level and comes back to it; for how long is a matter
of a step's halves, in which an excursion that returns does not count.
"""

import jax.numpy as jnp

from .elementary import larger
from .hermite import (
    HermiteQuartic,
    Quintic,
    QuinticRate,
    differentiated,
    falling_root,
)
from .materialise import if_any_lane, materialise
from .numbers import Flag, Numbers, Pair, Scalar
from .polynomial import Polynomial
from .series import value, value_and_slope

TURNING = 5  # steps of Newton's method, from a chord on


def first_fall(
    course: Quintic | QuinticRate | Polynomial,
) -> tuple[Flag, Scalar, Scalar]:
    """Whether the course falls through zero, and the bracket of the first time.

    It changes its sign no more often than its control polygon does. Where that is more
    than once the places are looked at where it turns, in each half of the step up to
    two.
    """
    zero, one = jnp.zeros_like(course.g0), jnp.ones_like(course.g0)
    signs = [x > 0 for x in course.polygon()]
    changes = [a != b for a, b in zip(signs, signs[1:], strict=False)]
    winds = sum(jnp.asarray(x, jnp.int32) for x in changes) > 1
    plain = signs[0] & jnp.logical_not(signs[-1]), zero, one

    def turning():
        slopes, middle = course.slopes(), 0.5 * one
        return *_turns(slopes, zero, middle), middle, *_turns(slopes, middle, one)

    def search(bracket):
        there, left, right = bracket
        # once for all numbers: computed twice, roundings may lead to two places
        inner = materialise(course.g0, turning)
        places = zero, *inner, one
        above = [x > 0 for x in (course.g0, *map(course, inner), course.g1)]
        for i in reversed(range(len(places) - 1)):
            falls = winds & above[i] & ~above[i + 1]
            left = jnp.where(falls, places[i], left)
            right = jnp.where(falls, places[i + 1], right)
            there = there | falls
        return there, left, right

    return if_any_lane(winds, search, plain)


def _turns(slopes: Numbers, left: Scalar, right: Scalar) -> Pair:
    """Where a course of this slope turns in the bracket, in order; else its end.

    Between slopes of unlike sign it turns once; else twice where the slope's own
    extremum has the other sign, once on either side of it.
    """
    begin, end = value(slopes, left), value(slopes, right)
    once, way = begin * end < 0, jnp.where(begin > 0, 1.0, -1.0)
    falling = tuple(way * c for c in slopes)
    rising = tuple(-c for c in falling)
    # how a slope that changes its sign twice falls first and then rises
    lowest = _falls(differentiated(rising), left, right)
    dips = ~once & (value(falling, lowest) < 0)
    first = _falls(falling, left, jnp.where(once, right, lowest))
    second = _falls(rising, lowest, right)
    return jnp.where(once | dips, first, right), jnp.where(dips, second, right)


def _falls(number: Numbers, left: Scalar, right: Scalar) -> Scalar:
    """Where a polynomial falls through zero in the bracket."""

    def both(x: Scalar) -> Pair:
        return value_and_slope(number, x)

    above, below = value(number, left), value(number, right)
    drop = jnp.where(above > below, above - below, jnp.inf)
    chord = left + jnp.clip(above / drop, 0.0, 1.0) * (right - left)
    return falling_root(both, chord, left, right, TURNING)


def share_within(course: HermiteQuartic, most: Scalar) -> Scalar:
    """The share of [0, 1] in which a cubic lies within +-most.

    By halves, in each of which it counts as monotone: its inverse's cubic, by the
    slopes of both ends, says where it passes a level, and a step of Newton's method,
    which carries the derivative, says it better.
    """
    middle, slope = course(0.5), course.slope(0.5) / 2
    first = course._replace(g1=middle, v0=course.v0 / 2, v1=slope)
    second = course._replace(g0=middle, v0=slope, v1=course.v1 / 2)
    return (_monotone_share(first, most) + _monotone_share(second, most)) / 2


def _monotone_share(course: HermiteQuartic, most: Scalar) -> Scalar:
    """The same of a cubic that does not turn."""
    rise = course.g1 - course.g0
    flat = rise == 0
    inverse = 1 / jnp.where(flat, 1.0, rise)
    # the inverse's slopes by the chord's, at most 3: so it is monotone
    at_start, at_end = (
        1 / larger(slope * inverse, 1 / 3) for slope in (course.v0, course.v1)
    )

    def passes(level):
        """Where it passes the level; an end where it does not."""
        t = (level - course.g0) * inverse
        s = 1 - t
        x = t * (t * (3 - 2 * t) + s * (at_start * s - at_end * t))
        slope = course.slope(x) * inverse
        by = (course(x) - level) * inverse / jnp.where(slope > 0, slope, jnp.inf)
        inner = jnp.clip(x - by, 0.0, 1.0)
        return jnp.where(t <= 0, 0.0, jnp.where(t >= 1, 1.0, inner))

    share = jnp.abs(passes(most) - passes(-most))
    return jnp.where(flat, jnp.where(jnp.abs(course.g0) < most, 1.0, 0.0), share)
