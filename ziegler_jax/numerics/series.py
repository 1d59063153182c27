r"""Power series in time: the equations of motion, read as recurrences.

A `Series` stands for a number that changes with time, $x(t_0 + s) = \sum_k x_k s^k$.
Sums, products and sines of series are series, each coefficient of which needs no later
one of its operands. Where the equations of motion are given series in place of numbers,
they tell the next coefficient of the motion from those before (Taylor's method; A.
Jorba, M. Zou, Experimental Mathematics 14 (2005) 99-117).
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import cast

from .materialise import materialise
from .numbers import Numbers, Scalar


class Series:
    """A power series whose coefficients are asked for in order.

    Those of a factor in a product are needed again and again: they are kept as arrays.
    Those of a sum are worked out where they are used.

    **Arguments:**

    - `at`: a traced number of the lane (see `materialise`).
    - `rule`: gives the coefficient of an order from those of `parts`; None where
        coefficients are told by `append`.
    - `parts`: the series that the rule asks.
    - `known`: the first coefficients, where they are told.
    """

    __array_ufunc__ = None  # numpy's numbers leave arithmetic to this class
    factor: Scalar | None = None  # of a multiple of `parts[0]`

    def __init__(
        self,
        at: Scalar,
        rule: Callable[[int], Scalar | None] | None = None,
        parts: tuple["Series", ...] = (),
        known: tuple[Scalar, ...] = (),
    ):
        """A series whose coefficients are worked out on demand."""
        self.at, self.rule, self.parts = at, rule, parts
        self.known, self.cached = list(known), rule is None

    def __getitem__(self, order: int) -> Scalar:
        """The coefficient; `ready` must have been called for its order."""
        if self.cached:
            return self.known[order]
        assert self.rule is not None
        return cast(Scalar, self.rule(order))

    def append(self, coefficient: Scalar) -> None:
        """Tell the next coefficient."""
        self.known.append(coefficient)

    def ready(self, order: int) -> None:
        """Work out what is kept, up to this order.

        Apart from its use: what is traced within `materialise` must not be kept.
        """
        for part in self.parts:
            part.ready(order)
        while self.cached and self.rule is not None and len(self.known) <= order:
            k = len(self.known)
            self.known.append(cast(Scalar, materialise(self.at, partial(self.rule, k))))

    def as_factor(self) -> "Series":
        """The same, its coefficients kept."""
        self.cached = True
        return self

    def derivative(self) -> "Series":
        """Its rate of change."""
        return Series(self.at, lambda k: (k + 1) * self[k + 1], (self,))

    def integral(self, start: Scalar) -> "Series":
        """What changes at this rate, from `start` on."""
        return Series(self.at, lambda k: self[k - 1] / k if k > 0 else start, (self,))

    def __neg__(self) -> "Series":
        """-x."""
        return self * -1.0

    def __add__(self, other: "Series | Scalar") -> "Series":
        """X + y."""
        if isinstance(other, Series):
            return Series(self.at, lambda k: self[k] + other[k], (self, other))
        return Series(
            self.at, lambda k: self[k] + other if k == 0 else self[k], (self,)
        )

    __radd__ = __add__

    def __sub__(self, other: "Series | Scalar") -> "Series":
        """X - y."""
        if isinstance(other, Series):
            return Series(self.at, lambda k: self[k] - other[k], (self, other))
        return self + (-other)

    def __rsub__(self, other: "Series | Scalar") -> "Series":
        """Y - x."""
        return (-self) + other

    def __mul__(self, other: "Series | Scalar") -> "Series":
        """X y, of which each coefficient is a sum of products."""
        if not isinstance(other, Series):
            multiple = Series(self.at, lambda k: self[k] * other, (self,))
            multiple.factor = other
            return multiple
        for x, y in ((self, other), (other, self)):
            if x.factor is not None and not x.cached:
                return (x.parts[0] * y) * x.factor
        parts = self.as_factor(), other.as_factor()
        return Series(self.at, lambda k: cauchy(self, other, k), parts)

    __rmul__ = __mul__

    def __truediv__(self, other: Scalar) -> "Series":
        """Over a number."""
        return self * (1 / other)


def cauchy(x: Series, y: Series, order: int, first: int = 0) -> Scalar:
    r"""$\sum_j x_j y_{k-j}$ over j from `first` to k; at least one term."""
    if x.factor is not None and not x.cached:  # once, not in each of the terms
        return cauchy(x.parts[0], y, order, first) * x.factor
    pairs = [(x[j], y[order - j]) for j in range(first, order + 1)]
    if x is not y or first > 0:
        return sum_of([a * b for a, b in pairs])
    # each product but the middle one stands there twice
    twice = [a * b for a, b in pairs[: (order + 1) // 2]]
    middle = [pairs[order // 2][0] ** 2] if order % 2 == 0 else []
    return sum_of(([2 * sum_of(twice)] if twice else []) + middle)


class _Turned(Series):
    """Sine or cosine, which know each other."""

    def ready(self, order: int) -> None:
        """Both up to this order."""
        angle, rate = self.parts
        angle.ready(order)
        rate.ready(order - 1)
        while len(self.known) <= order:
            assert self.rule is not None
            self.rule(len(self.known))


def sincos_series(
    x: Series, sincos: Callable[[Scalar], tuple[Scalar, Scalar]]
) -> tuple[Series, Series]:
    r"""Sine and cosine of a series.

    $$(k + 1) s_{k+1} = \sum_j \dot x_j c_{k-j}, \qquad
    (k + 1) c_{k+1} = -\sum_j \dot x_j s_{k-j}$$

    **Arguments:** `sincos`: what gives those of a number.
    """
    rate = x.derivative().as_factor()

    def rule(k):
        def pair():
            if k == 0:
                return sincos(x[0])
            c, s = cauchy(rate, cosine, k - 1), cauchy(rate, sine, k - 1)
            return c / k, s / -k

        for series, new in zip((sine, cosine), materialise(x.at, pair), strict=True):
            series.append(new)

    sine, cosine = _Turned(x.at, rule, (x, rate)), _Turned(x.at, rule, (x, rate))
    return sine.as_factor(), cosine.as_factor()


def added(one: Numbers, other: Numbers) -> Numbers:
    """Two rows of numbers, number by number."""
    return tuple(a + b for a, b in zip(one, other, strict=True))


def sum_of(terms: Sequence[Scalar]) -> Scalar:
    """Their sum, without a zero to begin with."""
    return sum(terms[1:], terms[0])


def value(coefficients: Sequence[Scalar], x: Scalar) -> Scalar:
    """The polynomial at x, by Horner's rule."""
    result = coefficients[-1]
    for c in reversed(coefficients[:-1]):
        result = c + x * result
    return result


def value_and_slope(coefficients: Sequence[Scalar], x: Scalar) -> tuple[Scalar, Scalar]:
    """The polynomial at x and its slope."""
    result, slope = coefficients[-1], None
    for c in reversed(coefficients[:-1]):
        slope = result if slope is None else result + x * slope
        result = c + x * result
    return result, 0.0 if slope is None else slope
