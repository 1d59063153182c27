"""When a number passes a level within a step: the first time, and for how long.

Both look into the step: what leaves a level and comes back to it is seen.
"""

from typing import cast

import jax.numpy as jnp

from .elementary import larger
from .hermite import (
    HermiteQuartic,
    Quintic,
    QuinticRate,
    differentiated,
    falling_root,
    polynomial,
)
from .materialise import if_any_lane, materialise
from .numbers import Flag, Numbers, Pair, Scalar

TURNING = 5  # steps of Newton's method, from a chord on


def first_fall(course: Quintic | QuinticRate) -> tuple[Flag, Scalar, Scalar]:
    """Whether the course falls through zero, and the bracket of the first time.

    It changes its sign no more often than its control polygon does. Where that is more
    than once the places are looked at where it turns, in each half of the step up to
    two.
    """
    zero, one = jnp.zeros_like(course.g0), jnp.ones_like(course.g0)
    signs = [x > 0 for x in course.polygon()]
    changes = [a != b for a, b in zip(signs, signs[1:], strict=False)]
    winds = sum(jnp.asarray(x, jnp.int32) for x in changes) > 1
    plain = cast(Flag, signs[0] & ~signs[-1]), zero, one

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
            there = cast(Flag, there | falls)
        return there, left, right

    return if_any_lane(winds, search, plain)


def _turns(slopes: Numbers, left: Scalar, right: Scalar) -> Pair:
    """Where a course of this slope turns in the bracket, in order; else its end.

    Between slopes of unlike sign it turns once; else twice where the slope's own
    extremum has the other sign, once on either side of it.
    """
    begin, end = polynomial(slopes, left), polynomial(slopes, right)
    once, way = begin * end < 0, jnp.where(begin > 0, 1.0, -1.0)
    falling = tuple(way * c for c in slopes)
    rising = tuple(-c for c in falling)
    # how a slope that changes its sign twice falls first and then rises
    lowest = _falls(differentiated(rising), left, right)
    dips = ~once & (polynomial(falling, lowest) < 0)
    first = _falls(falling, left, jnp.where(once, right, lowest))
    second = _falls(rising, lowest, right)
    return jnp.where(once | dips, first, right), jnp.where(dips, second, right)


def _falls(number: Numbers, left: Scalar, right: Scalar) -> Scalar:
    """Where a polynomial falls through zero in the bracket."""
    slope = differentiated(number)

    def both(x: Scalar) -> Pair:
        return polynomial(number, x), polynomial(slope, x)

    above, below = polynomial(number, left), polynomial(number, right)
    drop = jnp.where(above > below, above - below, jnp.inf)
    chord = left + jnp.clip(above / drop, 0.0, 1.0) * (right - left)
    return falling_root(both, chord, left, right, TURNING)


def share_within(course: HermiteQuartic, most: Scalar) -> Scalar:
    """The share of [0, 1] in which the cubic lies within +-most.

    By halves, in each of which it counts as monotone: its inverse's cubic, by the
    slopes of both ends, says where it passes a level, and a step of Newton's method,
    which carries the derivative, says it better.
    """
    zero, one = 0.0 * course.g0, 0.0 * course.g0 + 1.0
    middle, slope = course(0.5 * one), course.slope(0.5 * one)
    first = _share_of_a_half(course, zero, course.g0, middle, course.v0, slope, most)
    second = _share_of_a_half(
        course, 0.5 * one, middle, course.g1, slope, course.v1, most
    )
    return 0.5 * (first + second)


def _share_of_a_half(
    course: HermiteQuartic,
    left: Scalar,
    a: Scalar,
    b: Scalar,
    slope_a: Scalar,
    slope_b: Scalar,
    most: Scalar,
) -> Scalar:
    """The share in which a course from a to b over half a step lies within +-most."""
    rise = b - a
    flat = rise == 0
    inverse = 1 / jnp.where(flat, 1.0, rise)

    def inverses(slope):
        """The inverse's slope by the chord's, at most 3: so it is monotone."""
        by_chord = 0.5 * slope * inverse
        return 1 / larger(by_chord, 1 / 3)

    at_a, at_b = inverses(slope_a), inverses(slope_b)

    def passes(level):
        """Where it passes, as a share of the half; an end where it does not."""
        t = (level - a) * inverse
        s = 1 - t
        guess = t * (t * (3 - 2 * t) + s * (at_a * s - at_b * t))
        x = left + 0.5 * guess
        slope = 0.5 * course.slope(x) * inverse
        better = guess - (course(x) - level) * inverse / jnp.where(
            slope > 0, slope, jnp.inf
        )
        return jnp.where(
            t <= 0, 0.0, jnp.where(t >= 1, 1.0, jnp.clip(better, 0.0, 1.0))
        )

    share = jnp.abs(passes(most) - passes(-most))
    return jnp.where(flat, jnp.where(jnp.abs(a) < most, 1.0, 0.0), share)
