"""How far and how finely a curve is followed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from ..analysis.branch_point import Arc, increasing
from ..numerics.numbers import Pair, Scalar, is_concrete
from ..numerics.rules import number, whole_number
from .problem import Bounds

Values = Float[Array, " n"] | np.ndarray | Sequence[float]


class Course(eqx.Module):
    r"""How far and how finely a curve of bifurcations is followed.

    It is walked by a few points, as its bends ask for, from the start both ways, until
    a parameter leaves its bounds. Then it is filled: every point wanted is predicted
    from the walk's and corrected, all in one batch.

    **Arguments:**

    - `points`: so many in the end, at equal distances along the curve; 200 unless said.
    - `values`: of the second parameter instead, an array (n,): then the curve's points
        are there, on the piece nearest to the start where it has several; NaN where the
        curve does not come.
    - `second`, `first`: the bounds of both parameters, at which the curve ends.
    - `step`: the longest of the walk: rad for the state, the first cycle's period for
        T, the first values for the parameters; `error`: how far a point of the walk may
        lie from the tangent at the one before.
    - `room`: for so many points of the walk in each direction.

    **Raises:** `ValueError` for numbers that break a rule.
    """

    # those of the parameters are in units of their own, which `SI.scaled` leaves alone
    units: ClassVar = dict.fromkeys(("values", "second", "first", "step", "error"), "1")

    points: int = eqx.field(static=True)
    values: Values | None
    second: Pair
    first: Pair
    step: Scalar
    error: Scalar
    room: int = eqx.field(static=True)

    def __init__(
        self,
        points: int | None = None,
        values: Values | None = None,
        second: Pair = (-np.inf, np.inf),
        first: Pair = (-np.inf, np.inf),
        step: Scalar = 0.1,
        error: Scalar = 3e-3,
        room: int = 100,
    ):
        """Check and keep them."""
        if points is not None and values is not None:
            raise ValueError(
                "Arguments `points` and `values` both say where the curve's points "
                f"are, but {points!r} and {np.size(values)} values were given: "
                "leave one out."
            )
        self.points = whole_number("points", 200 if points is None else points)
        if values is not None and (np.ndim(values) != 1 or np.size(values) == 0):
            raise ValueError(
                "Argument `values` must be numbers in one dimension, but has shape "
                f"{np.shape(values)}."
            )
        self.first = increasing("first", first)
        self.second = increasing("second", second)
        if values is not None and is_concrete(values):
            values = _known(values, self.second)
        self.values = values
        self.step = number("step", step, "positive")
        self.error = number("error", error, "positive")
        self.room = whole_number("room", room)

    @property
    def bounds(self) -> Bounds:
        """Of both parameters."""
        return Bounds(self.first, self.second)

    @property
    def arc(self) -> Arc:
        """As a walk takes it."""
        return Arc(1, self.step, self.room, error=self.error)

    @property
    def count(self) -> int:
        """How many points there will be."""
        return self.points if self.values is None else int(np.shape(self.values)[0])


def _known(values: Values, bounds: Pair) -> np.ndarray:
    """Values that are numbers, within their bounds where these are known too."""
    try:
        numbers = np.asarray(values, float)
    except (TypeError, ValueError):
        raise ValueError(
            f"Argument `values` must be numbers, but is {values!r}."
        ) from None
    if not np.all(np.isfinite(numbers)):
        raise ValueError("Argument `values` must be finite, but is not.")
    low, high = bounds
    if is_concrete(low) and is_concrete(high):
        out = numbers[(numbers < low) | (numbers > high)]
        if out.size:
            raise ValueError(
                f"Argument `values` must lie in `second`, ({low:g}, {high:g}), but "
                f"holds {out[0]:g}."
            )
    return numbers
