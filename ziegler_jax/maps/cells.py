r"""Cells of a map, halved both ways where labels differ.

Cells of level 0 lie between neighbouring points of the grid; `levels` halvings make the
finest, whose side is 1. A place is a pair of whole numbers, multiples of $2^L$ at the
grid's points, so that neighbours share their points; a cell is a row of its level and
the place of its first corner. A leaf is halved where two points on its border have
unlike labels, be they corners or brought by a finer neighbour; from level to level, so
that the area of cells with unlike corners tells the boundary's dimension:

$$A_l \sim 2^{-\alpha l}, \qquad \alpha = 2 - D,$$

the uncertainty exponent, 1 for a line and near 0 where two labels are mixed throughout.

Source: C. Grebogi, S. W. McDonald, E. Ott, J. A. Yorke, Physics Letters A 99 (1983)
415-418.
"""

from collections.abc import Callable
from itertools import combinations

import numpy as np

# The labels of places, or None where the points do not suffice.
LabelOf = Callable[[np.ndarray], np.ndarray | None]

NOWHERE = -1  # the label of a point that was left out: no cell has it for a corner
UNSEEN = -2  # the label of a place that was not computed
MANY = 2**31  # above any label: two are one number
MOST_LEVELS = 16  # a place is one number of 63 bits on maps of 2^31 points
# Two labels of which so many cells lie at a level, and whose area falls from level to
# level by less than this, are mixed: halving them on would bring no line.
MIXED_FROM, MIXED_FALL = 64, 2**-0.4

CORNERS = np.array([(0, 0), (1, 0), (1, 1), (0, 1)])  # around a cell
COUPLES = np.array(list(combinations(range(4), 2)))  # of corners
QUARTERS = np.array([(0, 0), (0, 1), (1, 0), (1, 1)])
NEW = np.array([(1, 0), (0, 1), (1, 1), (2, 1), (1, 2)])  # that quarters bring


def pair_of(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Two labels as one number, the smaller first; -1 where they are alike."""
    pair = np.minimum(one, other) * MANY + np.maximum(one, other)
    return np.where(one == other, -1, pair)


def labels_of_pair(pairs: np.ndarray) -> np.ndarray:
    """The two labels of each pair, the smaller first."""
    return np.stack(np.divmod(pairs, MANY), axis=-1)


class Cells:
    """The cells of a map.

    **Arguments:**

    - `labels`: of the grid's points, along x and y; `NOWHERE` where one was left out.
    - `levels`: how often a cell may be halved.
    """

    def __init__(self, labels: np.ndarray, levels: int):
        """Take the grid's cells."""
        self.levels, self.unit = levels, 2**levels
        self.shape = np.array(labels.shape)
        self.stride = labels.shape[1] * self.unit
        self.places = self.unit * np.argwhere(np.ones(labels.shape))
        self.labels = labels.ravel()
        self.halved = [np.empty(0, int) for _ in range(levels + 1)]  # keys, by level
        self.mixed = np.empty(0, int)  # pairs that are halved no more

    # Places and cells -----------------------------------------------------------------

    def key(self, places: np.ndarray) -> np.ndarray:
        """A number a place, rising from row to row."""
        return places[..., 0] * self.stride + places[..., 1]

    def label_at(self, places: np.ndarray) -> np.ndarray:
        """The labels there; `UNSEEN` where none is known."""
        known, keys = self.key(self.places), self.key(places)
        at = np.searchsorted(known, keys).clip(max=known.size - 1)
        return np.where(known[at] == keys, self.labels[at], UNSEEN)

    def side(self, cells: np.ndarray) -> np.ndarray:
        """Their sides."""
        return self.unit >> cells[:, 0]

    def corners(self, cells: np.ndarray) -> np.ndarray:
        """The labels of the four corners around each cell."""
        return self.label_at(self._around(cells, CORNERS, 1))

    def _around(self, cells: np.ndarray, steps: np.ndarray, parts: int) -> np.ndarray:
        """Places so many parts of a side from the first corner, shape (n, steps, 2)."""
        step = self.side(cells)[:, None, None] // parts
        return cells[:, None, 1:] + steps * step

    def pairs(self, cells: np.ndarray) -> np.ndarray:
        """The unlike labels of each cell's corners by twos, each once, else -1."""
        labels = self.corners(cells)
        pairs = np.sort(pair_of(*labels[:, COUPLES].transpose(2, 0, 1)), axis=1)
        return np.where(np.diff(pairs, axis=1, prepend=-1) > 0, pairs, -1)

    def at_level(self, level: int) -> np.ndarray:
        """The cells of a level, halved or not, all of whose corners are in the map."""
        if level == 0:
            places = self.unit * np.argwhere(np.ones(self.shape - 1))
        else:
            first = np.stack(np.divmod(self.halved[level - 1], self.stride), -1)
            side = self.unit >> level
            places = (first[:, None] + side * QUARTERS).reshape(-1, 2)
        cells = np.insert(places, 0, level, axis=1)
        return cells[(self.corners(cells) != NOWHERE).all(axis=1)]

    def leaves(self) -> np.ndarray:
        """The cells of the map that were not halved, from the coarsest on."""
        parts = [
            cells[~np.isin(self.key(cells[:, 1:]), self.halved[level])]
            for level in range(self.levels + 1)
            for cells in [self.at_level(level)]
        ]
        return np.concatenate(parts)

    def leaf_at(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The leaves around points on no border, and whether they are in the map."""
        inside = ((points > 0) & (points < (self.shape - 1) * self.unit)).all(axis=1)
        level = np.zeros(len(points), int)
        first = (points // self.unit * self.unit).astype(int)
        for n in range(self.levels):
            deeper = (level == n) & np.isin(self.key(first), self.halved[n])
            side = self.unit >> (n + 1)
            level[deeper] = n + 1
            first[deeper] = points[deeper] // side * side
        cells = np.insert(first, 0, level, axis=1)
        return cells, inside & (self.corners(cells) >= 0).all(axis=1)

    # Halving --------------------------------------------------------------------------

    def may_be_halved(self, cells: np.ndarray) -> np.ndarray:
        """Which are none of the finest, nor only between labels that are mixed."""
        pairs = self.pairs(cells)
        open_ = (pairs >= 0) & ~np.isin(pairs, self.mixed)
        like = (pairs < 0).all(axis=1)
        return (cells[:, 0] < self.levels) & (open_.any(axis=1) | like)

    def unlike(self) -> np.ndarray:
        """The leaves with unlike labels on their borders, that may be halved."""
        around = (self.places[:, None] + (CORNERS - 0.5)).reshape(-1, 2)
        labels = np.repeat(self.labels, len(CORNERS))
        cells, in_map = self.leaf_at(around)
        unlike = (labels != NOWHERE) & (labels != self.label_at(cells[:, 1:]))
        cells = np.unique(cells[in_map & unlike], axis=0)
        return cells[self.may_be_halved(cells)]

    def halve(self, cells: np.ndarray, label_of: LabelOf) -> bool:
        """Quarter these cells; whether the points that this needs sufficed."""
        new = self._around(cells, NEW, 2).reshape(-1, 2)
        new = np.unique(new[self.label_at(new) == UNSEEN], axis=0)
        labels = label_of(new)
        if labels is None:
            return False
        places = np.concatenate([self.places, new])
        order = np.argsort(self.key(places))
        self.places = places[order]
        self.labels = np.concatenate([self.labels, labels])[order]
        for level in np.unique(cells[:, 0]):
            keys = self.key(cells[cells[:, 0] == level, 1:])
            self.halved[level] = np.union1d(self.halved[level], keys)
        return True

    def grow(self, label_of: LabelOf) -> bool:
        """Halve the leaves with unlike labels, the coarsest first, to the finest.

        **Returns:** whether the points sufficed.
        """
        reached = -1
        while (cells := self.unlike()).size:
            level = cells[0, 0]
            if level > reached:
                self._see_mixed(level)
                reached = level
            cells = cells[cells[:, 0] == level]
            if not self.halve(cells[self.may_be_halved(cells)], label_of):
                return False
        return True

    def _see_mixed(self, level: int) -> None:
        """Give up labels whose unlike cells are no fewer than at the level before."""
        if level < 2:
            return
        now, before = self.unlike_areas(level), self.unlike_areas(level - 1)
        slow = [
            pair
            for pair, area in now.items()
            if area * 4.0**level >= MIXED_FROM
            and area > MIXED_FALL * before.get(pair, 0.0)
        ]
        self.mixed = np.union1d(self.mixed, np.array(slow, int))

    def unlike_areas(
        self, level: int, area_of: Callable[[np.ndarray], np.ndarray] | None = None
    ) -> dict[int, float]:
        """The area of cells of a level with two unlike corners, by pairs of labels.

        **Arguments:** `area_of`: the areas of cells; None counts in coarsest cells.
        """
        cells = self.at_level(level)
        areas = np.full(len(cells), 0.25**level) if area_of is None else area_of(cells)
        rows = self.pairs(cells)
        cell, column = np.nonzero(rows >= 0)
        pairs, place = np.unique(rows[cell, column], return_inverse=True)
        sums = np.bincount(place, areas[cell], pairs.size)
        return dict(zip(pairs.tolist(), sums.tolist(), strict=True))


def exponent(areas: np.ndarray) -> float:
    """The uncertainty exponent of areas from level to level; NaN of fewer than two."""
    areas = areas[areas > 0]
    if areas.size < 2:
        return np.nan
    slope = np.polyfit(np.arange(areas.size), np.log2(areas), 1)[0]
    return float(-slope)
