"""Numbers over a step by their power series, where a method leaves it behind.

Such a step may be so long that what the numbers of its ends say of its middle is off
by more than the step itself.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp

from .elementary import larger, smaller
from .hermite import cubic, differentiated, turning
from .numbers import Flag, Numbers, Pair, Scalar
from .series import sum_of, value, value_and_slope

# Steps of Newton's method to where a number turns, from the cubic's place: there its
# error is the square of the place's.
POLISHED, EXACT = 2, 5


class Polynomial(NamedTuple):
    """A number over a step, at x from 0 to 1, by its power series.

    `terms`: the series' coefficients, a step the unit; `g1`: the number at the end, to
    which the terms add up but for rounding.
    """

    terms: Numbers
    g1: Scalar

    @property
    def g0(self) -> Scalar:
        """The number at the start."""
        return self.terms[0]

    @property
    def v0(self) -> Scalar:
        """Its slope there, per step."""
        return self.terms[1]

    @property
    def a0(self) -> Scalar:
        """And how that changes, per step."""
        return 2 * self.terms[2]

    @property
    def v1(self) -> Scalar:
        """The slope at the end."""
        return sum_of(self.slopes())

    @property
    def a1(self) -> Scalar:
        """And how that changes there."""
        return sum_of(differentiated(self.slopes()))

    def __call__(self, x: Scalar) -> Scalar:
        """The number at x."""
        return value(self.terms, x)

    def slope(self, x: Scalar) -> Scalar:
        """Its slope at x, per step."""
        return value(self.slopes(), x)

    def slopes(self) -> Numbers:
        """The slope as a polynomial."""
        return differentiated(self.terms)

    def polygon(self) -> Numbers:
        """The control points of its Bezier curve."""
        n = len(self.terms) - 1
        parts = [c / math.comb(n, j) for j, c in enumerate(self.terms)]
        inner = (
            sum_of([math.comb(i, j) * parts[j] for j in range(i + 1)])
            for i in range(1, n)
        )
        return self.g0, *inner, self.g1

    def turning(self, polished: int = POLISHED) -> tuple[Flag, Scalar]:
        """Whether the slope changes its sign between the ends, and where.

        Else the place is the end. A number that turns twice within a step counts as
        one that does not turn: steps are shorter than that.
        """
        slopes = self.slopes()
        turns, x = turning(cubic(self.g0, self.g1, self.v0, self.v1))
        for _ in range(polished):
            slope, bend = value_and_slope(slopes, x)
            moved = x - slope / jnp.where(bend == 0, jnp.inf, bend)
            x = jnp.where(turns, jnp.clip(moved, 0.0, 1.0), 1.0)
        return turns, x

    def largest(self) -> Scalar:
        """The largest size at the end and where it turns."""
        low, high = self.extent()
        return larger(-low, high)

    def extent(self) -> Pair:
        """The smallest and the largest number at the end and where it turns."""
        turns, x = self.turning()
        inner = jnp.where(turns, self(x), self.g1)
        return smaller(inner, self.g1), larger(inner, self.g1)

    def extremum(self) -> Scalar:
        """The number where it turns, else at the end.

        Where it turns it does not move to first order: the place carries no derivative.
        """
        _, x = jax.lax.stop_gradient(self).turning(EXACT)
        return self(x)

    def mean(self) -> Scalar:
        """Its mean over the step."""
        return sum_of([c / (k + 1) for k, c in enumerate(self.terms)])


def over_step(coefficients: Sequence[Scalar], h: Scalar, end: Scalar) -> Polynomial:
    """A power series in time over a step of length h, at whose end it is `end`."""
    terms, power = [coefficients[0]], h
    for c in coefficients[1:]:
        terms.append(c * power)
        power = power * h
    return Polynomial(tuple(terms), end)
