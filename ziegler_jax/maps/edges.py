"""Edges of cells whose ends differ, halved until the change between is known.

Two labels differ at an edge's ends. Its middle has one of them, and the change lies in
the other half; or a third one, and there are two changes. Where that says that nothing
is known, both of its changes are found, coarsely, for they move with the time for which
motions are followed: between two known labels lies then a band whose width is stated.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from .cells import Cells, Pair, Place

Edge = tuple[Place, Place]
MOST_CHANGES = 8  # along one edge: of more nothing is told but where they lie
BAND = 4  # halvings of what borders on the unknown within an edge: to a sixteenth


class Crossing(NamedTuple):
    """Where the label changes along an edge."""

    at: float  # the share of the edge before it
    width: float  # of the interval in which it lies, as a share of the edge
    before: int
    after: int

    @property
    def pair(self) -> Pair:
        """Its labels, the smaller one first."""
        return min(self.before, self.after), max(self.before, self.after)


class _Interval(NamedTuple):
    """A part of an edge at whose ends labels differ."""

    edge: int
    low: float
    high: float
    before: int
    after: int
    left: int  # halvings


class Halvings(NamedTuple):
    """How often edges are halved, and what labels say that nothing is known."""

    usual: int
    unknown: int  # of an edge with such an end
    most_points: int
    is_unknown: Callable[[int], bool]


def unlike_edges(cells: Cells) -> list[Edge]:
    """The edges of the finest cells at whose ends labels differ."""
    edges: dict[Edge, None] = {}
    for cell in sorted(cells.leaves()):
        if cell[0] < cells.levels:
            continue
        for one, other in cells.edges(cell):
            edge = min(one, other), max(one, other)
            if cells.labels[one] != cells.labels[other]:
                edges[edge] = None
    return list(edges)


def halved_edges(
    cells: Cells,
    edges: list[Edge],
    label_of: Callable[[list[tuple[float, float]]], list[int]],
    halvings: Halvings,
) -> tuple[dict[Edge, list[Crossing]], bool]:
    """Halve edges, all at once: where labels change along each.

    **Arguments:** `label_of`: computes points; it must know the labels of the unknown.

    **Returns:** the changes, and whether the points were enough for all halvings.
    """
    is_unknown = halvings.is_unknown
    open_, done, points, enough = [], [], 0, True
    for n, edge in enumerate(edges):
        ends = [cells.labels[place] for place in edge]
        count = halvings.unknown if any(map(is_unknown, ends)) else halvings.usual
        open_.append(_Interval(n, 0.0, 1.0, ends[0], ends[1], count))
    while open_:
        counts = np.bincount([i.edge for i in open_], minlength=len(edges))
        now = [i for i in open_ if i.left and counts[i.edge] <= MOST_CHANGES]
        done += [i for i in open_ if not i.left or counts[i.edge] > MOST_CHANGES]
        points += len(now)
        if points > halvings.most_points:
            done, enough = done + now, False
            break
        middles = [_along(edges[i.edge], (i.low + i.high) / 2) for i in now]
        labels = label_of(middles) if now else []
        open_ = [
            part
            for interval, label in zip(now, labels, strict=True)
            for part in _halves(interval, label, is_unknown(label))
        ]
    along: list[list[_Interval]] = [[] for _ in edges]
    for interval in sorted(done):
        along[interval.edge].append(interval)
    parts = zip(edges, along, strict=True)
    changes = {edge: crossings(intervals, is_unknown) for edge, intervals in parts}
    return changes, enough


def _halves(whole: _Interval, label: int, unknown: bool) -> list[_Interval]:
    """The halves of an interval at whose ends labels differ."""
    middle, left = (whole.low + whole.high) / 2, whole.left - 1
    if unknown and label not in (whole.before, whole.after):
        left = min(left, BAND)
    halves = (
        whole._replace(high=middle, after=label, left=left),
        whole._replace(low=middle, before=label, left=left),
    )
    return [half for half in halves if half.before != half.after]


def crossings(
    intervals: list[_Interval], is_unknown: Callable[[int], bool]
) -> list[Crossing]:
    """The changes along an edge; a band between two known labels is one of them."""
    changes: list[Crossing] = []
    left = list(intervals)
    while left:
        first = last = left.pop(0)
        if left and _is_band(first, left[0], is_unknown):
            last = left.pop(0)
        middle, width = (first.low + last.high) / 2, last.high - first.low
        changes.append(Crossing(middle, width, first.before, last.after))
    return changes


def _is_band(
    first: _Interval, second: _Interval, is_unknown: Callable[[int], bool]
) -> bool:
    """Whether two changes are the borders of the unknown between known labels."""
    ends = first.before, second.after
    across = first.after == second.before and ends[0] != ends[1]
    return across and is_unknown(first.after) and not any(map(is_unknown, ends))


def _along(edge: Edge, share: float) -> tuple[float, float]:
    """The place so far along an edge."""
    (i, j), (k, m) = edge
    return i + share * (k - i), j + share * (m - j)
