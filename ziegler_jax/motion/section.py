"""Where a step passes a plane of phase space: the one watch over sections."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple, TypeVar, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from ..model.state import PhasePoint
from ..numerics.elementary import larger, smaller
from ..numerics.hermite import (
    Quintic,
    QuinticRate,
    chord_root,
    place,
)
from ..numerics.materialise import if_any_lane, materialise
from ..numerics.numbers import Flag, Option, Scalar
from ..numerics.passages import first_fall
from ..numerics.polynomial import Polynomial, over_step
from ..numerics.rules import number
from ..results import RATE, Units
from ..solvers import Step

Course = TypeVar("Course", bound=Quintic | Polynomial)
Coordinate = str  # "phi1", "omega2", ...
COORDINATE = re.compile(r"(phi|omega)([1-9]\d?)")


class SectionPlane(eqx.Module):
    r"""A plane of phase space that a motion passes, e.g. $\phi_1 = 0$ rising.

    **Arguments:** `coordinate`: which is constant on it, `phi1`, `omega2`, ...;
    `level`: its value, in rad or $\sqrt{k/(m l^2)}$; `rising`: whether it grows as the
    motion passes, or falls.

    **Raises:** `ValueError` for arguments that break a rule.
    """

    coordinate: Coordinate = eqx.field(static=True)
    level: Scalar
    rising: bool = eqx.field(static=True)

    def __init__(
        self,
        coordinate: Coordinate = "phi1",
        level: Scalar = 0.0,
        rising: bool = True,
    ):
        """Check and keep them."""
        if not isinstance(coordinate, str) or not COORDINATE.fullmatch(coordinate):
            raise ValueError(
                "Argument `coordinate` must be an angle or a rate, `phi1`, `phi2`, "
                f"`omega1`, ..., but is {coordinate!r}."
            )
        self.coordinate = coordinate
        self.level = number("level", level)
        if not isinstance(rising, bool | np.bool_):
            raise ValueError(
                f"Argument `rising` must be True or False, but is {rising!r}."
            )
        self.rising = bool(rising)

    @property
    def units(self) -> Units:
        """Its level's: an angle's or a rate's."""
        return {"level": "rad" if self.coordinate.startswith("phi") else RATE}

    @property
    def index(self) -> int:
        """The coordinate's place in a state of two rods."""
        return self.place(2)

    @property
    def others(self) -> list[int]:
        """The other coordinates there."""
        return self.free(2)

    def free(self, rods: int) -> list[int]:
        """The places of a state's other coordinates."""
        place = self.place(rods)
        return [i for i in range(2 * rods) if i != place]

    def place(self, rods: int) -> int:
        """The coordinate's place in a state of so many rods.

        **Raises:** `ValueError` where there is no such rod.
        """
        kind, which = cast(re.Match, COORDINATE.fullmatch(self.coordinate)).groups()
        if int(which) > rods:
            raise ValueError(
                f"Argument `coordinate` must be of one of {rods} rods, but is "
                f"{self.coordinate!r}."
            )
        return int(which) - 1 + (rods if kind == "omega" else 0)

    @property
    def sign(self) -> float:
        """1 where it is passed rising, else -1."""
        return 1.0 if self.rising else -1.0

    def settings(self) -> dict[str, Option]:
        """For the record."""
        direction = "rising" if self.rising else "falling"
        return {"section": f"{self.coordinate} {direction}", "level": self.level}


class Swing(NamedTuple):
    """The range of phi1: its middle is the section of a displaced chain."""

    low: Scalar
    high: Scalar

    @property
    def level(self) -> Scalar:
        """The section's."""
        return (self.low + self.high) / 2


class Turns(NamedTuple):
    """The range of phi1 so far, and the direction of its last turn."""

    swing: Swing
    down: Scalar  # 1 where it has turned down
    up: Scalar

    @property
    def both(self) -> Flag:
        """Whether it has turned both ways: then the swing is known."""
        return self.down * self.up > 0

    def after(self, step: Step) -> Turns:
        """A step later."""
        least, most = rod_angles(step)[0].extent()
        low, high = self.swing
        before, now = step.y0.omega[0], step.y1.omega[0]
        return Turns(
            Swing(smaller(low, least), larger(high, most)),
            jnp.where((before > 0) & (now <= 0), 1.0, self.down),
            jnp.where((before < 0) & (now >= 0), 1.0, self.up),
        )


class Passage(NamedTuple):
    """Whether a step passes the plane, when and where."""

    there: Bool[Array, ""]
    time: Scalar
    y: PhasePoint


def passage(plane: SectionPlane, step: Step) -> Passage:
    """The step's first passage through the plane, on `rod_angles` and `rod_rates`.

    A step that begins and ends on one side may pass the plane and come back: it is
    looked for between the extrema of the coordinate's course.
    """
    n, h, sign = len(step.y0.phi), step.t1 - step.t0, -plane.sign
    i = plane.place(n)
    g0, g1 = (sign * (y[i] - plane.level) for y in (step.y0, step.y1))
    passes = (g0 > 0) & (g1 <= 0)
    # as far as a course of these slopes reaches beyond its ends, at most
    slopes = jnp.abs(step.f0[i]) + jnp.abs(step.f1[i])
    near = smaller(jnp.abs(g0), jnp.abs(g1)) <= h * slopes
    may = passes | (near & ((g0 > 0) == (g1 > 0)))

    def locate(blank):
        del blank
        turned, rates = rod_angles(step), rod_rates(step)
        guard = _guard(step, i, sign, plane.level)

        def where():
            there, left, right = first_fall(guard)
            about = chord_root(guard, left, right)
            return there, place(guard, 0.0, about, left, right)

        there, x = materialise(step.t0, where)  # once for all numbers
        y = PhasePoint(path(x) for path in (*turned, *rates))
        return Passage(jnp.asarray(may & there), step.t0 + x * h, y)

    return if_any_lane(may, locate, Passage(jnp.zeros_like(may), step.t1, step.y1))


def _guard(
    step: Step, i: int, sign: float, level: Scalar
) -> Quintic | QuinticRate | Polynomial:
    """How far coordinate i lies above its level, by its sign; exact at both ends."""
    n = len(step.y0.phi)
    g0, g1 = (sign * (y[i] - level) for y in (step.y0, step.y1))
    if step.series:
        _, *rest = _of_series(step)[i].terms
        return Polynomial((g0, *(sign * c for c in rest)), g1)
    course = Quintic(*(sign * x for x in _quintics(step)[i % n]))
    if i < n:
        return course._replace(g0=g0, g1=g1)
    return QuinticRate(course, 1 / (step.t1 - step.t0), sign * level)


def rod_angles(step: Step) -> tuple[Quintic | Polynomial, ...]:
    """The rods' angles over the step: its own series, where it has none quintics."""
    if step.series:
        return _of_series(step)[: len(step.y0.phi)]
    return _quintics(step)


def rod_rates(step: Step) -> tuple[QuinticRate | Polynomial, ...]:
    """How fast they turn."""
    if step.series:
        return _of_series(step)[len(step.y0.phi) :]
    return tuple(QuinticRate(path, 1 / (step.t1 - step.t0)) for path in _quintics(step))


def _of_series(step: Step) -> tuple[Polynomial, ...]:
    h = step.t1 - step.t0
    pairs = zip(step.series, step.y1, strict=True)
    return tuple(over_step(c, h, end) for c, end in pairs)


def _quintics(step: Step) -> tuple[Quintic, ...]:
    h = step.t1 - step.t0

    def end(i: int, y: PhasePoint, f: PhasePoint) -> tuple[Scalar, Scalar, Scalar]:
        return y.phi[i], h * y.omega[i], h * h * f.omega[i]

    return tuple(
        Quintic(*end(i, step.y0, step.f0), *end(i, step.y1, step.f1))
        for i in range(len(step.y0.phi))
    )


def angles(step: Step) -> tuple[Quintic | Polynomial, ...]:
    """The rods' angles over the step, then those of the joints between them."""
    rods = rod_angles(step)
    return *rods, *_between(rods)


def joint_rates(step: Step) -> tuple[Polynomial, ...]:
    """How fast the joints turn, by the step's series."""
    rates = _of_series(step)[len(step.y0.phi) :]
    return rates[0], *_between(rates)


def _between(rods: Sequence[Course]) -> Iterator[Course]:
    """Each rod's number less that of the one before: a course is linear in its own."""
    for one, two in pairwise(rods):
        yield jax.tree.map(lambda a, b: b - a, one, two)
