"""The search for the boundaries of a map: the points it computes, and its audit."""

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
import xarray as xr
from scipy import stats

from ..sweep.once import Program
from .cells import NOWHERE, Cells
from .lines import Lines, changes, lines, unlike_edges

CERTAINTY = 0.95  # of the bound of the area that is missed
COMPARED, UNLIKE = 32, 0.1  # points of the map that are computed again; may be unlike
MISSING, LARGEST = -(2**62), 2**53  # no label; and the largest that there may be
# Labels that say that nothing is known: between two others they are a band.
UNKNOWN = {"unsettled", "undecided", "not_finite", "step_vanished", "budget_spent"}
UNKNOWN |= {"chattering", "no_passages", "unstable_near", "slow", "aperiodic"}
UNKNOWN |= {"growing", "lasting"}


class Audit(NamedTuple):
    """Random points of cells that were not halved."""

    points: int
    mislabelled: np.ndarray  # the places of those with another label than their cell
    share: float  # of the map, in such cells

    @property
    def missed(self) -> float:
        """The share of the map with another label in them is less, at 95 %."""
        return self.share * share_below(len(self.mislabelled), self.points)


def share_below(hits: int, points: int) -> float:
    """Clopper and Pearson's upper bound of a share, of which so many were hit."""
    if hits >= points:
        return 1.0
    return float(stats.beta.ppf(CERTAINTY, hits + 1, points - hits))


def numbers_of(dataset: xr.Dataset) -> dict[str, float]:
    """The parameters of a sweep that are numbers, which all points have."""
    names = str(dataset.attrs.get("scene_axes", "")).split(", ")
    there = [name for name in names if name in dataset.coords]
    return {name: float(dataset[name]) for name in there if not dataset[name].ndim}


class BoundarySearch:
    """A map, its cells, and all points that were computed.

    **Arguments:** `names`: of the labels; `axes`, rising; of the others see `refine`.
    """

    def __init__(
        self,
        coarse: xr.Dataset,
        axes: dict[str, np.ndarray],
        names: tuple[str, ...],
        program: Program,
        *,
        levels: int = 3,
        max_points: int = 20_000,
    ):
        """Take the labels of the coarse map."""
        self.coarse, self.axes, self.names = coarse, axes, names
        self.program, self.max_points = program, max_points
        self.numbers = numbers_of(coarse)
        self.codes: dict[tuple[int, ...], int] = {}  # of labels, as they came
        self.on_batch: Callable[[int, float], object] = lambda *_: None
        self.computed: list[dict[str, np.ndarray]] = []
        self.points_suffice = True
        given = {n: whole(n, coarse[n].transpose(*axes).values) for n in names}
        absent = [v == self._meaning(n, "not_computed") for n, v in given.items()]
        codes = self._coded(given)
        self.cells = Cells(np.where(np.any(absent, axis=0), NOWHERE, codes), levels)

    # Points ---------------------------------------------------------------------------

    @property
    def points(self) -> int:
        """How many were computed."""
        one = next(iter(self.axes))
        return sum(len(part[one]) for part in self.computed)

    @property
    def left(self) -> int:
        """How many may still be computed."""
        return self.max_points - self.points

    @property
    def complete(self) -> bool:
        """Whether all was followed to its end."""
        return self.points_suffice and not self.cells.mixed.size

    def values(self, places: np.ndarray) -> dict[str, np.ndarray]:
        """Where places are along the axes."""
        steps = places.T / self.cells.unit
        return {
            name: np.interp(step, np.arange(axis.size), axis)
            for step, (name, axis) in zip(steps, self.axes.items(), strict=True)
        }

    def label_of(self, places: np.ndarray) -> np.ndarray | None:
        """The labels at places, or None where the points do not suffice."""
        if len(places) > self.left:
            self.points_suffice = False
            return None
        return self._compute(places)

    def _compute(self, places: np.ndarray) -> np.ndarray:
        """The labels at places."""
        values = self.values(places)
        given = {n: np.full(len(places), x) for n, x in self.numbers.items()}
        results = self.program.at({**values, **given}, self.on_batch)
        self.computed.append({**values, **results})
        return self._coded({n: whole(n, results[n]) for n in self.names})

    def _coded(self, labels: Mapping[str, np.ndarray]) -> np.ndarray:
        """A number a label, in the order in which they came; `NOWHERE` without one."""
        table = np.stack(list(labels.values()), -1)
        rows = map(tuple, table.reshape(-1, len(labels)).tolist())
        codes = [
            NOWHERE if MISSING in row else self.codes.setdefault(row, len(self.codes))
            for row in rows
        ]
        return np.array(codes, int).reshape(table.shape[:-1])

    def label_values(self, codes: np.ndarray) -> dict[str, np.ndarray]:
        """The labels behind their numbers."""
        rows = np.array(list(self.codes), int).reshape(-1, len(self.names))
        return dict(zip(self.names, np.moveaxis(rows[codes], -1, 0), strict=True))

    def is_unknown(self, codes: np.ndarray) -> np.ndarray:
        """Which labels say that nothing is known, or are none."""
        rows = self.label_values(np.arange(len(self.codes)))
        unknown = [
            np.isin(values, [self._meaning(name, word) for word in UNKNOWN])
            for name, values in rows.items()
        ]
        return np.append(np.any(unknown, axis=0), True)[codes]  # the last of `NOWHERE`

    def _meaning(self, name: str, word: str) -> int:
        """The label of that meaning, or `MISSING`."""
        attrs = self.coarse[name].attrs
        words = str(attrs.get("flag_meanings", "")).split()
        numbers = np.ravel(attrs.get("flag_values", [])).tolist()
        return dict(zip(words, numbers, strict=False)).get(word, MISSING)

    def check(self) -> None:
        """Compute some of the coarse points again.

        **Raises:** `ValueError` where a label is another.
        """
        there = np.flatnonzero(self.cells.labels != NOWHERE)
        if not there.size:
            raise ValueError("Argument `coarse` must hold points, but holds none.")
        some = np.random.default_rng(0).permutation(there)[: min(COMPARED, self.left)]
        places = self.cells.places[some]
        others = places[self._compute(places) != self.cells.labels[some]]
        # another processor may lead a chaotic lane elsewhere
        if len(others) > UNLIKE * len(places):
            at = ", ".join(f"{n} = {x[0]:.17g}" for n, x in self.values(others).items())
            raise ValueError(
                "Argument `point` must be the scene of `coarse`, but gives another "
                f"{' or '.join(f'`{n}`' for n in self.names)} at {len(others)} of "
                f"{len(places)} points, e.g. {at}."
            )

    # Cells ----------------------------------------------------------------------------

    def follow(self) -> None:
        """Halve cells on boundaries to the finest."""
        self.cells.grow(self.label_of)

    def audited(self, points: int, seed: int = 1) -> Audit:
        """Random points of the cells that stayed whole."""
        leaves = self.cells.leaves()
        clean = leaves[(self.cells.pairs(leaves) < 0).all(axis=1)]
        areas = self.areas(clean)
        count = min(points, self.left)
        if not areas.size:
            return Audit(0, np.empty((0, 2)), 0.0)
        random = np.random.default_rng(seed)
        chosen = clean[random.choice(areas.size, count, p=areas / areas.sum())]
        side = self.cells.side(chosen)[:, None]
        places = chosen[:, 1:] + random.uniform(0, side, (count, 2))
        usual = self.cells.label_at(chosen[:, 1:])
        mislabelled = places[self._compute(places) != usual]
        return Audit(count, mislabelled, float(areas.sum() / self.map_area()))

    def mend(self, audit: Audit) -> None:
        """Follow what an audit met: halve around it, until corners differ."""
        while True:
            cells, in_map = self.cells.leaf_at(audit.mislabelled)
            cells = np.unique(cells[in_map], axis=0)
            like = (self.cells.pairs(cells) < 0).all(axis=1)
            cells = cells[like & (cells[:, 0] < self.cells.levels)]
            if not cells.size or not self.cells.halve(cells, self.label_of):
                break
        self.follow()

    def areas(self, cells: np.ndarray) -> np.ndarray:
        """In the axes' own measure."""
        first, side = cells[:, 1:], self.cells.side(cells)[:, None]
        low, high = self.values(first).values(), self.values(first + side).values()
        return np.prod([b - a for a, b in zip(low, high, strict=True)], axis=0)

    def map_area(self) -> float:
        """Of all cells, in the axes' own measure."""
        return float(self.areas(self.cells.at_level(0)).sum())

    def lines(self, width: float, unknown_width: float) -> Lines:
        """The boundaries, each change within a width, a share of the axis's range."""
        steps = [np.diff(axis).max() / np.ptp(axis) for axis in self.axes.values()]
        edge = max(steps) / self.cells.unit
        usual, unknown = (
            max(0, math.ceil(math.log2(edge / w))) for w in (width, unknown_width)
        )
        edges = unlike_edges(self.cells)
        halvings = usual, unknown
        parts = changes(self.cells, edges, self.label_of, self.is_unknown, halvings)
        return lines(self.cells, edges, parts)


def whole(name: str, values: np.ndarray) -> np.ndarray:
    """Labels as whole numbers; `MISSING` for NaN, of a point that has none."""
    numbers = np.asarray(values, float)
    there = ~np.isnan(numbers)
    if (np.abs(numbers[there]) > LARGEST).any() or (numbers % 1)[there].any():
        raise ValueError(
            f"Argument `label` must hold codes or whole numbers, but `{name}` does not."
        )
    return np.where(there, numbers, MISSING).astype(int)
