r"""Power series in time: the equations of motion, read as recurrences.

A `Series` stands for a number that changes with time, $x(t_0 + s) = \sum_k x_k s^k$.
Sums, products and sines of series are series, each coefficient of which needs no later
one of its operands. Where the equations of motion are given series in place of numbers,
they tell the next coefficient of the motion from those before (Taylor's method; A.
Jorba, M. Zou, Experimental Mathematics 14 (2005) 99-117).
"""

from collections.abc import Callable
from typing import Any

from ._materialise import materialise
from ._types import Scalar


class Series:
    """A power series whose coefficients are asked for in order, and kept.

    **Arguments:**

    - `at`: a traced number of the lane (see `materialise`).
    - `rule`: the coefficient of a given order; None where they are told by `append`.
    - `known`: the first coefficients.
    """

    __array_ufunc__ = None  # numpy's numbers leave arithmetic to this class

    def __init__(
        self, at: Scalar, rule: Callable[[int], Any] | None = None, known: tuple = ()
    ):
        self.at, self.rule, self.known = at, rule, list(known)

    def __getitem__(self, order: int) -> Any:
        """The coefficient of this order."""
        while len(self.known) <= order:
            assert self.rule is not None
            self.known.append(self.rule(len(self.known)))
        return self.known[order]

    def append(self, coefficient: Any) -> None:
        """Tell the next coefficient."""
        self.known.append(coefficient)

    def __neg__(self) -> "Series":
        return Series(self.at, lambda k: -self[k])

    def __add__(self, other: Any) -> "Series":
        if isinstance(other, Series):
            return Series(self.at, lambda k: self[k] + other[k])
        return Series(self.at, lambda k: self[k] + other if k == 0 else self[k])

    __radd__ = __add__

    def __sub__(self, other: Any) -> "Series":
        if isinstance(other, Series):
            return Series(self.at, lambda k: self[k] - other[k])
        return self + (-other)

    def __rsub__(self, other: Any) -> "Series":
        return (-self) + other

    def __mul__(self, other: Any) -> "Series":
        if isinstance(other, Series):
            return Series(self.at, lambda k: cauchy(self, other, k))
        return Series(self.at, lambda k: self[k] * other)

    __rmul__ = __mul__


def cauchy(x: Series, y: Series, order: int, first: int = 0) -> Any:
    r"""$\sum_j x_j y_{k-j}$ over j from `first` to k, kept as an array."""
    places = range(first, order + 1)
    if not places:
        return 0.0
    # asked for before: what is traced within `materialise` must not be kept
    pairs = [(x[j], y[order - j]) for j in places]

    def total():
        if x is not y or first > 0:
            return sum_of([a * b for a, b in pairs])
        # each product but the middle one stands there twice
        twice = [a * b for a, b in pairs[: (order + 1) // 2]]
        middle = [pairs[order // 2][0] ** 2] if order % 2 == 0 else []
        return sum_of(([2 * sum_of(twice)] if twice else []) + middle)

    return materialise(x.at, total)


def sincos_series(x: Series, sincos: Callable) -> tuple[Series, Series]:
    r"""Sine and cosine: $k s_k = \sum_j j x_j c_{k-j}$, $k c_k = -\sum_j j x_j s_{k-j}$.

    **Arguments:** `sincos`: what gives those of a number.
    """

    def pair(k):
        if k == 0:
            return materialise(x.at, sincos, x[0])
        rows = [(j / k, x[j], sine[k - j], cosine[k - j]) for j in range(1, k + 1)]

        def both():
            slopes = [share * v for share, v, _, _ in rows]
            pairs = zip(slopes, rows, strict=True)
            up, down = zip(*((v * c, v * s) for v, (_, _, s, c) in pairs), strict=True)
            return sum_of(list(up)), -sum_of(list(down))

        return materialise(x.at, both)

    pairs: list[Any] = []

    def part(i):
        def rule(k):
            if len(pairs) == k:
                pairs.append(pair(k))
            return pairs[k][i]

        return rule

    sine, cosine = Series(x.at, part(0)), Series(x.at, part(1))
    return sine, cosine


def sum_of(terms: list) -> Any:
    """Their sum, without a zero to begin with."""
    return sum(terms[1:], terms[0])


def value(coefficients: list, x: Any) -> Any:
    """The polynomial at x, by Horner's rule."""
    result = coefficients[-1]
    for c in reversed(coefficients[:-1]):
        result = c + x * result
    return result
