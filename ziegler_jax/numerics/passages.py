"""When a number passes a level within a step: the first time, and for how long.

The first looks for what leaves a level and comes back to it; for how long is a matter
of a step's halves, in which an excursion that returns does not count.
"""

import jax.numpy as jnp

from .elementary import larger
from .hermite import (
    Quintic,
    QuinticRate,
    differentiated,
    falling_root,
)
from .materialise import if_any_lane, materialise
from .numbers import Flag, Numbers, Pair, Scalar
from .polynomial import Polynomial
from .series import value, value_and_slope

STILL = 1e-150  # a rate that changes by less does not, and its square is no zero
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


def share_within(path: Quintic | Polynomial, most: Scalar) -> Scalar:
    """The share of [0, 1] in which the slope of a course lies within +-most.

    By halves, in each of which it counts as monotone: its inverse's cubic, by the
    bends of both ends, says where it passes a level. One step of Newton's method on the
    slope itself, a polynomial, says it better: the error is that of the cubic squared,
    and so is its derivative's.
    """
    slopes = path.slopes()
    middle, bend = value_and_slope(slopes, 0.5)
    first = _monotone_share(slopes, (path.v0, middle), (path.a0, bend), 0.0, most)
    return first + _monotone_share(
        slopes, (middle, path.v1), (bend, path.a1), 0.5, most
    )


def _monotone_share(
    slopes: Numbers, ends: Pair, bends: Pair, left: float, most: Scalar
) -> Scalar:
    """The same of the half from `left` on, where a polynomial counts as monotone."""
    begin, end = ends
    rise = end - begin
    flat = jnp.abs(rise) < STILL
    inverse = 1 / jnp.where(flat, 1.0, rise)
    # the inverse's slopes by the chord's, at most 3: so it is monotone
    at_start, at_end = (1 / larger(0.5 * bend * inverse, 1 / 3) for bend in bends)

    def passes(level):
        """Where it passes the level; an end where it does not."""
        t = (level - begin) * inverse
        s = 1 - t
        about = t * (t * (3 - 2 * t) + s * (at_start * s - at_end * t))
        x = left + 0.5 * about
        height, slope = value_and_slope(slopes, x)
        onwards = slope * inverse > 0
        by = (height - level) / jnp.where(onwards, slope, jnp.inf)
        inner = jnp.clip(x - by, left, left + 0.5)
        return jnp.where(t <= 0, left, jnp.where(t >= 1, left + 0.5, inner))

    share = jnp.abs(passes(most) - passes(-most))
    return jnp.where(flat, jnp.where(jnp.abs(begin) < most, 0.5, 0.0), share)
