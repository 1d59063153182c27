"""What is known of a map whose boundaries are followed, and what that has cost."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import xarray as xr
from scipy import stats

from ..numerics.numbers import number, whole_number
from ..sweep.once import Program
from .cells import NOWHERE, Cell, Cells
from .edges import Halvings, halved_edges, unlike_edges
from .lines import Line, lines

FINEST, MOST_LEVELS = 1e-13, 20
CERTAINTY = 0.95  # of the bound of the area that is missed
COMPARED, UNLIKE = 32, 0.1  # points of the map that are computed again; may be unlike
MISSING, LARGEST = -(2**62), 2**53  # no label; and the largest that there may be
# Labels that say that nothing is known: between two others they are a band.
UNKNOWN = {"unsettled", "undecided", "failed", "not_finite", "step_vanished"}
UNKNOWN |= {"budget_spent", "chattering"}


@dataclass(frozen=True)
class Fineness:
    r"""How finely `refine` follows boundaries.

    **Arguments:**

    - `width`: of the interval on a cell's edge in which the label changes, as a share
        of the axis's range; a band of undecided points between two labels may be wider.
    - `unknown_width`: the same where one of both labels is that nothing is known
        (`unsettled`, `undecided`, a failure): these borders move with the horizon.
    - `levels`: how often a cell is halved, both ways, on the way to a boundary.
    - `audit`: so many random points of cells that were not halved. If none of k has
        another label than its cell, less than 3/k of their area has, at 95 %.
    - `max_points`: points that are computed at most.

    **Raises:** `ValueError` for what breaks a rule.
    """

    width: float = 1e-4
    unknown_width: float = 1e-3
    levels: int = 3
    audit: int = 300
    max_points: int = 20_000

    def __post_init__(self):
        """Check them."""
        for name in ("levels", "audit", "max_points"):
            whole_number(name, getattr(self, name))
        for name in ("width", "unknown_width"):
            value = getattr(self, name)
            number(name, value, "positive")
            if value < FINEST:
                raise ValueError(
                    f"Argument `{name}` must be at least {FINEST:g}, near which places "
                    f"are no longer told apart, but is {value:g}."
                )
        if self.levels > MOST_LEVELS:
            raise ValueError(
                f"Argument `levels` must be at most {MOST_LEVELS}, but is "
                f"{self.levels}."
            )


class Audit(NamedTuple):
    """Random points of cells that were not halved."""

    points: int
    strangers: list[tuple[float, float]]  # those with another label than their cell
    share: float  # of the map, in such cells

    @property
    def missed(self) -> float:
        """The share of the map with another label in them is less, at 95 %."""
        return self.share * share_below(len(self.strangers), self.points)


def share_below(hits: int, points: int) -> float:
    """Clopper and Pearson's upper bound of a share, of which so many were hit."""
    if hits >= points:
        return 1.0
    return float(stats.beta.ppf(CERTAINTY, hits + 1, points - hits))


class Study:
    """A map, its cells, and all that was computed."""

    def __init__(
        self,
        coarse: xr.Dataset,
        axes: dict[str, np.ndarray],
        names: tuple[str, ...],
        program: Program,
        fineness: Fineness,
    ):
        """Nothing is halved."""
        self.coarse, self.axes, self.names = coarse, axes, names
        self.program, self.fineness = program, fineness
        self.codes: dict[tuple[int, ...], int] = {}  # what labels go by, in order
        self.tell: Callable[[int, float], object] = lambda *_: None
        self.computed: list[dict[str, np.ndarray]] = []
        self.enough = True  # points, for all halvings
        given = {n: whole(n, coarse[n].transpose(*axes).values) for n in names}
        absent = self._absent(given)
        here = self._coded(np.stack([v.ravel() for v in given.values()], -1))
        coded = np.where(absent, NOWHERE, here.reshape(absent.shape))
        self.cells = Cells(coded, fineness.levels)

    # Points ---------------------------------------------------------------------------

    def compute(self, places: Sequence[tuple[float, float]]) -> list[int]:
        """The labels at places."""
        table = np.array(places, float).reshape(-1, 2) / self.cells.unit
        values = {
            name: np.interp(table[:, i], np.arange(axis.size), axis)
            for i, (name, axis) in enumerate(self.axes.items())
        }
        results = self.program.at(values, self.tell)
        self.computed.append({**values, **results})
        columns = [whole(n, results[n]) for n in self.names]
        return self._coded(np.stack(columns, -1)).tolist()

    def _coded(self, rows: np.ndarray) -> np.ndarray:
        """A number a label, in the order in which they came; `NOWHERE` without one."""
        codes = [
            NOWHERE if MISSING in row else self.codes.setdefault(row, len(self.codes))
            for row in map(tuple, rows.tolist())
        ]
        return np.array(codes, int)

    def _absent(self, values: Mapping[str, np.ndarray]) -> np.ndarray:
        """Which points were left out."""
        absent = np.zeros(tuple(a.size for a in self.axes.values()), bool)
        for name, array in values.items():
            absent |= array == self._meanings(name).get("not_computed", MISSING)
        return absent

    def _meanings(self, name: str) -> dict[str, int]:
        attrs = self.coarse[name].attrs
        meanings = str(attrs.get("flag_meanings", "")).split()
        return dict(zip(meanings, np.ravel(attrs.get("flag_values", [])), strict=False))

    def is_unknown(self, code: int) -> bool:
        """Whether a label says that nothing is known."""
        row = next(row for row, other in self.codes.items() if other == code)
        meanings = [self._meanings(name) for name in self.names]
        return any(
            value in {v for n, v in known.items() if n in UNKNOWN}
            for value, known in zip(row, meanings, strict=True)
        )

    def check(self) -> None:
        """Compute some of the coarse points again.

        **Raises:** `ValueError` where a label is another.
        """
        there = [p for p, label in self.cells.labels.items() if label != NOWHERE]
        if not there:
            raise ValueError("Argument `coarse` must hold points, but holds none.")
        random = np.random.default_rng(0)
        some = random.permutation(len(there))[: min(COMPARED, self.left())]
        places = [there[n] for n in some]
        again = self.compute(places)
        others = [
            place
            for place, label in zip(places, again, strict=True)
            if label != self.cells.labels[place]
        ]
        # another processor may lead a chaotic lane elsewhere
        if len(others) > UNLIKE * len(places):
            at = ", ".join(
                f"{name} = {axis[i // self.cells.unit]:.17g}"
                for (name, axis), i in zip(self.axes.items(), others[0], strict=True)
            )
            raise ValueError(
                "Argument `point` must be the scene of `coarse`, but gives another "
                f"{' or '.join(f'`{n}`' for n in self.names)} at {len(others)} of "
                f"{len(places)} points, e.g. {at}."
            )

    # Cells ----------------------------------------------------------------------------

    def unlike(self) -> set[Cell]:
        """The coarse cells with unlike corners."""
        return {cell for cell in self.cells.coarsest() if self.cells.unlike(cell)}

    def left(self) -> int:
        """How many points may still be computed."""
        return max(self.fineness.max_points - self.points, 0)

    @property
    def points(self) -> int:
        """How many were computed."""
        one = next(iter(self.axes))
        return sum(len(part[one]) for part in self.computed)

    def grow(self, pending: set[Cell]) -> bool:
        """Halve cells to the finest; whether it came to its end."""
        return self.cells.grow(pending, self.compute, self.left())

    def audited(self, seed: int = 1) -> Audit:
        """Random points of the cells that stayed whole."""
        clean = [c for c in self.cells.leaves() if not self.cells.pairs(c)]
        areas = np.array([self.area(cell) for cell in clean])
        map_area = self.map_area()
        count = min(self.fineness.audit, self.left())
        if not clean or not count:
            share = float(areas.sum() / map_area) if map_area else 0.0
            return Audit(0, [], share)
        random = np.random.default_rng(seed)
        chosen = random.choice(len(clean), count, p=areas / areas.sum())
        places, expected = [], []
        for n in chosen.tolist():
            (_, i, j), size = clean[n], self.cells.size(clean[n])
            x, y = random.uniform(0, size, 2)
            places.append((i + x, j + y))
            expected.append(self.cells.labels[i, j])
        labels = self.compute(places)
        strangers = [
            place
            for place, label, usual in zip(places, labels, expected, strict=True)
            if label != usual
        ]
        return Audit(count, strangers, float(areas.sum() / map_area))

    def map_area(self) -> float:
        """Of all cells, in the axes' own measure."""
        return sum(
            self.area(c) for c in self.cells.coarsest() if self.cells.is_there(c)
        )

    def area(self, cell: Cell) -> float:
        """In the axes' own measure."""
        corners = np.array(self.cells.corners(cell), float) / self.cells.unit
        spans = [
            np.ptp(np.interp(corners[:, i], np.arange(axis.size), axis))
            for i, axis in enumerate(self.axes.values())
        ]
        return float(spans[0] * spans[1])

    def forced(self, strangers: Iterable[tuple[float, float]]) -> set[Cell]:
        """Halve the cells around strangers until corners differ; these cells."""
        pending: set[Cell] = set()
        for x, y in strangers:
            leaf = self.cells.leaf_at(x, y)
            while leaf is not None and self.cells.may_be_halved(leaf):
                if self.cells.pairs(leaf):
                    break
                if self.left() < 5:
                    self.enough = False
                    break
                places = self.cells.new_places([leaf])
                labels = dict(zip(places, self.compute(places), strict=True))
                pending |= self.cells.halve([leaf], labels)
                leaf = self.cells.leaf_at(x, y)
        return {cell for cell in pending if cell not in self.cells.halved}

    def is_complete(self) -> bool:
        """Whether all was followed to its end."""
        return self.enough and not self.cells.mixed_pairs

    def lines(self) -> list[Line]:
        """The edges' changes, joined."""
        spans = [
            np.abs(np.diff(axis)).max() / np.ptp(axis) for axis in self.axes.values()
        ]
        edge = max(spans) / self.cells.unit
        usual, unknown = (
            max(0, math.ceil(math.log2(edge / width)))
            for width in (self.fineness.width, self.fineness.unknown_width)
        )
        edges = unlike_edges(self.cells)
        halvings = Halvings(usual, unknown, self.left(), self.is_unknown)
        changes, enough = halved_edges(self.cells, edges, self.compute, halvings)
        self.enough &= enough
        return lines(self.cells, changes)


def whole(name: str, values: np.ndarray) -> np.ndarray:
    """Labels as whole numbers; `MISSING` for NaN, of a point that has none."""
    numbers = np.asarray(values, float)
    there = ~np.isnan(numbers)
    if (np.abs(numbers[there]) > LARGEST).any() or (numbers % 1)[there].any():
        raise ValueError(
            f"Argument `label` must hold codes or whole numbers, but `{name}` does not."
        )
    return np.where(there, numbers, MISSING).astype(int)
