r"""Cells of a map, halved both ways where labels differ.

Level 0 are the cells between neighbouring points of the grid, L halvings make the
finest. A place is a pair of whole numbers, multiples of $2^L$ at the grid's points, so
that neighbours share their points. A cell is halved where its corners differ, or where
a point on its border, that a finer neighbour has brought, differs from them; from level
to level, so that the area of cells with unlike corners tells the boundary's dimension:

$$A_l \sim 2^{-\alpha l}, \qquad \alpha = 2 - D,$$

the uncertainty exponent, 1 for a line and near 0 where two labels are mixed throughout.

Source: C. Grebogi, S. W. McDonald, E. Ott, J. A. Yorke, Physics Letters A 99 (1983)
415-418.
"""

from collections.abc import Callable, Iterable
from itertools import combinations

import numpy as np

Place = tuple[int, int]
Cell = tuple[int, int, int]  # level, and the place of its first corner
Pair = tuple[int, int]  # two labels, the smaller one first

NOWHERE = -1  # the label of a point that was left out: no cell has it for a corner
# Two labels of which so many cells lie at a level, and whose area falls from level to
# level by less than this, are mixed: halving them on would bring no line.
MIXED_FROM, MIXED_FALL = 64, 2**-0.4


class Cells:
    """The cells of a map.

    **Arguments:**

    - `labels`: of the grid's points, along x and y; `NOWHERE` where one was left out.
    - `levels`: how often a cell may be halved.
    """

    def __init__(self, labels: np.ndarray, levels: int):
        """Nothing is halved."""
        self.levels, self.unit = levels, 2**levels
        self.shape = labels.shape
        self.labels: dict[Place, int] = {
            (i * self.unit, j * self.unit): int(label)
            for (i, j), label in np.ndenumerate(labels)
        }
        self.halved: set[Cell] = set()
        self.mixed_pairs: set[Pair] = set()  # that are halved no more

    # Cells ----------------------------------------------------------------------------

    def size(self, cell: Cell) -> int:
        """Its side."""
        return self.unit >> cell[0]

    def corners(self, cell: Cell) -> list[Place]:
        """The four of them, around the cell."""
        (_, i, j), s = cell, self.size(cell)
        return [(i, j), (i + s, j), (i + s, j + s), (i, j + s)]

    def edges(self, cell: Cell) -> list[tuple[Place, Place]]:
        """Its four edges, each from corner to corner around the cell."""
        around = self.corners(cell)
        return list(zip(around, [*around[1:], around[0]], strict=True))

    def pairs(self, cell: Cell) -> set[Pair]:
        """The unlike labels of its corners, by twos."""
        labels = {self.labels[place] for place in self.corners(cell)}
        return set(combinations(sorted(labels), 2))

    def is_there(self, cell: Cell) -> bool:
        """Whether all its corners belong to the map."""
        return all(self.labels[place] != NOWHERE for place in self.corners(cell))

    def coarsest(self) -> Iterable[Cell]:
        """The cells between the grid's points."""
        for i in range(self.shape[0] - 1):
            for j in range(self.shape[1] - 1):
                yield 0, i * self.unit, j * self.unit

    def children(self, cell: Cell) -> list[Cell]:
        """Its four quarters."""
        (level, i, j), h = cell, self.size(cell) // 2
        return [(level + 1, i + a, j + b) for a in (0, h) for b in (0, h)]

    def leaves(self) -> list[Cell]:
        """The cells of the map that were not halved."""
        leaves, left = [], [c for c in self.coarsest() if self.is_there(c)]
        while left:
            cell = left.pop()
            if cell in self.halved:
                left += self.children(cell)
            elif self.is_there(cell):
                leaves.append(cell)
        return leaves

    def leaf_at(self, x: float, y: float) -> Cell | None:
        """The leaf around a point that lies on no border; None outside of the map."""
        i, j = int(x // self.unit), int(y // self.unit)
        if not (0 <= i < self.shape[0] - 1 and 0 <= j < self.shape[1] - 1):
            return None
        cell = (0, i * self.unit, j * self.unit)
        if not self.is_there(cell):
            return None
        while cell in self.halved:
            h = self.size(cell) // 2
            _, i, j = cell
            cell = (cell[0] + 1, i + h * (x >= i + h), j + h * (y >= j + h))
        return cell if self.is_there(cell) else None

    # Halving --------------------------------------------------------------------------

    def new_places(self, cells: Iterable[Cell]) -> list[Place]:
        """The points without label that these cells' quarters need."""
        needed: dict[Place, None] = {}
        for cell in cells:
            (_, i, j), h = cell, self.size(cell) // 2
            five = [(i + h, j), (i, j + h), (i + h, j + h)]
            five += [(i + 2 * h, j + h), (i + h, j + 2 * h)]
            needed |= {place: None for place in five if place not in self.labels}
        return list(needed)

    def halve(self, cells: Iterable[Cell], new: dict[Place, int]) -> set[Cell]:
        """Quarter these cells; which leaves the new points make unlike.

        **Arguments:** `new`: the labels of their `new_places`.
        """
        self.labels |= new
        cells = list(cells)
        self.halved |= set(cells)
        quarters = [quarter for cell in cells for quarter in self.children(cell)]
        unlike = {q for q in quarters if self.unlike(q) or self._touched(q)}
        for (i, j), label in new.items():
            for a, b in ((-0.5, -0.5), (0.5, -0.5), (-0.5, 0.5), (0.5, 0.5)):
                leaf = self.leaf_at(i + a, j + b)
                if leaf is None or label == NOWHERE:
                    continue
                if any(self.labels[place] != label for place in self.corners(leaf)):
                    unlike.add(leaf)
        return {cell for cell in unlike if self.may_be_halved(cell)}

    def unlike(self, cell: Cell) -> bool:
        """Whether it is in the map and its corners differ."""
        return self.is_there(cell) and bool(self.pairs(cell))

    def _touched(self, cell: Cell) -> bool:
        """Whether a known point on its border has another label than its corners."""
        if not self.is_there(cell):
            return False
        label, edges = self.labels[cell[1:]], self.edges(cell)
        while edges:
            (i, j), (k, m) = edges.pop()
            middle = (i + k) // 2, (j + m) // 2
            if middle in ((i, j), (k, m)) or middle not in self.labels:
                continue
            if self.labels[middle] not in (label, NOWHERE):
                return True
            edges += [((i, j), middle), (middle, (k, m))]
        return False

    def may_be_halved(self, cell: Cell) -> bool:
        """Whether it is none of the finest, nor between labels that are mixed."""
        open_ = self.pairs(cell) - self.mixed_pairs
        return cell[0] < self.levels and (bool(open_) or not self.pairs(cell))

    def grow(
        self,
        pending: set[Cell],
        label_of: Callable[[list[Place]], list[int]],
        most_points: int,
    ) -> bool:
        """Halve cells, and what becomes unlike by that, to the finest.

        **Arguments:** `label_of`: computes points; `most_points`: so many at most.

        **Returns:** whether it came to its end.
        """
        reached = -1
        while pending:
            level = min(cell[0] for cell in pending)
            if level > reached:
                self._see_what_is_mixed(level)
                reached = level
            now = sorted(c for c in pending if c[0] == level and c not in self.halved)
            pending = {cell for cell in pending if cell[0] > level}
            now = [cell for cell in now if self.may_be_halved(cell)]
            places = self.new_places(now)
            if len(places) > most_points:
                return False
            most_points -= len(places)
            labels = label_of(places)
            pending |= self.halve(now, dict(zip(places, labels, strict=True)))
        return True

    def _see_what_is_mixed(self, level: int) -> None:
        """Labels whose unlike cells have not become less from the level before."""
        if level < 2:
            return
        now, before = self.unlike_areas(level), self.unlike_areas(level - 1)
        for pair, area in now.items():
            many = area * 4.0**level >= MIXED_FROM
            if many and area > MIXED_FALL * before.get(pair, 0.0):
                self.mixed_pairs.add(pair)

    def unlike_areas(
        self, level: int, area_of: Callable[[Cell], float] | None = None
    ) -> dict[Pair, float]:
        """The area of cells with two unlike corners at a level.

        **Arguments:** `area_of`: a cell's; None counts in coarsest cells.
        """
        parents = {cell for cell in self.halved if cell[0] == level - 1}
        cells = [q for cell in parents for q in self.children(cell)]
        cells = cells if level else list(self.coarsest())
        areas: dict[Pair, float] = {}
        for cell in cells:
            for pair in self.pairs(cell) if self.is_there(cell) else ():
                area = 0.25**level if area_of is None else area_of(cell)
                areas[pair] = areas.get(pair, 0.0) + area
        return areas


def exponent(areas: list[float]) -> float:
    """The uncertainty exponent of areas from level to level; NaN of fewer than two."""
    areas = [area for area in areas if area > 0]
    if len(areas) < 2:
        return np.nan
    slope = np.polyfit(np.arange(len(areas)), np.log2(areas), 1)[0]
    return float(-slope)
