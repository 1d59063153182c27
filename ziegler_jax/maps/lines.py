"""Edges of cells whose ends differ, halved and joined to lines.

Two labels differ at an edge's ends. Its middle has one of them, and the change lies in
the other half; or a third one, and there are two changes. Where a label says that
nothing is known, both of its changes are sought, but coarsely, as they move with the
time for which motions are followed: between two known labels they are one change, a
band, whose width is stated.

In a cell two changes between the same two labels are joined; of four the two nearest,
and the other two; one that is left alone, as where three labels meet, is joined to the
middle of all.
"""

from collections.abc import Callable
from itertools import combinations
from typing import NamedTuple

import numpy as np

from .cells import Cells, LabelOf, pair_of

MOST_CHANGES = 8  # along one edge: of more nothing is told but where they lie
BAND = 4  # halvings beside the unknown within an edge: to a sixteenth
# The sides of a cell, in order around it, as edges: their first place is so far from
# the cell's, and they lie along x (0) or y (1); the way around runs back on two.
SIDES = np.array([(0, 0, 0), (1, 0, 1), (0, 1, 0), (0, 0, 1)])
BACK = np.array([False, False, True, True])

# A part of an edge at whose ends labels differ; `left`: halvings.
INTERVAL = [("edge", int), ("low", float), ("high", float)]
INTERVAL += [("before", int), ("after", int), ("left", int)]


class Lines(NamedTuple):
    """Vertices of boundaries, in order along one line after the other."""

    places: np.ndarray  # (n, 2), in sides of finest cells
    width: np.ndarray  # of the interval in which the change lies, in the same measure
    along: np.ndarray  # 0: that interval lies along x; 1: along y
    pair: np.ndarray  # of labels
    line: np.ndarray  # the line's number


def unlike_edges(cells: Cells) -> np.ndarray:
    """The edges of finest cells at whose ends labels differ: places, and along."""
    leaves = cells.leaves()
    finest = leaves[leaves[:, 0] == cells.levels]
    edges = np.insert(finest[:, 1:], 2, 0, axis=1)[:, None] + SIDES
    edges = np.unique(edges.reshape(-1, 3), axis=0)
    before, after = _ends(cells, edges)
    return edges[before != after]


def _ends(cells: Cells, edges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The labels at both ends."""
    first, step = edges[:, :2], np.eye(2, dtype=int)[edges[:, 2]]
    return cells.label_at(first), cells.label_at(first + step)


def changes(
    cells: Cells,
    edges: np.ndarray,
    label_of: LabelOf,
    is_unknown: Callable[[np.ndarray], np.ndarray],
    halvings: tuple[int, int],
) -> np.ndarray:
    """Halve edges, all at once: the intervals in which labels change along them.

    **Arguments:**

    - `is_unknown`: which labels say that nothing is known.
    - `halvings`: how often an edge is halved, and one with such an end.
    """
    parts = np.zeros(len(edges), INTERVAL)
    parts["edge"], parts["high"] = np.arange(len(edges)), 1
    parts["before"], parts["after"] = _ends(cells, edges)
    unknown = is_unknown(parts["before"]) | is_unknown(parts["after"])
    parts["left"] = np.where(unknown, halvings[1], halvings[0])
    done = []
    while parts.size:
        counts = np.bincount(parts["edge"])[parts["edge"]]
        last = (parts["left"] == 0) | (counts > MOST_CHANGES)
        done, parts = [*done, parts[last]], parts[~last]
        middles = _along(edges[parts["edge"]], (parts["low"] + parts["high"]) / 2)
        labels = label_of(middles)
        if labels is None:
            done.append(parts)
            break
        parts = _halves(parts, labels, is_unknown(labels))
    whole = np.concatenate([parts[:0], *done])
    return _with_bands(np.sort(whole, order=["edge", "low"]), is_unknown)


def _along(edges: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Places so far along edges."""
    return edges[:, :2] + np.eye(2)[edges[:, 2]] * share[:, None]


def _halves(parts: np.ndarray, labels: np.ndarray, unknown: np.ndarray) -> np.ndarray:
    """The halves of intervals at whose ends labels differ, by their middles' labels."""
    enters = unknown & (labels != parts["before"]) & (labels != parts["after"])
    parts["left"] -= 1
    parts["left"] = np.where(enters, np.minimum(parts["left"], BAND), parts["left"])
    lower, upper = parts, parts.copy()
    lower["high"] = upper["low"] = (parts["low"] + parts["high"]) / 2
    lower["after"] = upper["before"] = labels
    halves = np.concatenate([lower, upper])
    return halves[halves["before"] != halves["after"]]


def _with_bands(
    parts: np.ndarray, is_unknown: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray:
    """The changes along edges, of which a band between two known labels is one."""
    first, second = parts[:-1], parts[1:]
    band = (first["edge"] == second["edge"]) & (first["before"] != second["after"])
    band &= (first["after"] == second["before"]) & is_unknown(first["after"])
    band &= ~is_unknown(first["before"]) & ~is_unknown(second["after"])
    for name in ("high", "after"):
        first[name] = np.where(band, second[name], first[name])
    # a point without a label is on no side of a boundary
    parts = parts[np.concatenate([[True], ~band])[: parts.size]]
    return parts[(parts["before"] >= 0) & (parts["after"] >= 0)]


def lines(cells: Cells, edges: np.ndarray, parts: np.ndarray) -> Lines:
    """The boundaries through the finest cells, from the changes along their edges."""
    edges = edges[parts["edge"]]
    at = (parts["low"] + parts["high"]) / 2
    vertices = Lines(
        _along(edges, at),
        parts["high"] - parts["low"],
        edges[:, 2],
        pair_of(parts["before"], parts["after"]),
        np.zeros(at.size, int),
    )
    links, vertices = _links(*_around_cells(cells, edges, at), vertices)
    paths = sorted(_paths(links, vertices.pair.size), key=lambda p: vertices.pair[p[0]])
    order = np.concatenate([np.empty(0, int), *paths])
    number = np.repeat(np.arange(len(paths)), [len(path) for path in paths])
    return Lines._make(column[order] for column in vertices)._replace(line=number)


def _around_cells(
    cells: Cells, edges: np.ndarray, at: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The finest cells on whose borders changes lie, and these, in order around each.

    A change lies on a side of two cells, unless one of them is none of the finest.
    """
    leaves = cells.leaves()
    finest = cells.key(leaves[leaves[:, 0] == cells.levels, 1:])
    rows = []
    for number, side in enumerate(SIDES):
        cell = cells.key(edges[:, :2] - side[:2])
        here = np.flatnonzero((edges[:, 2] == side[2]) & np.isin(cell, finest))
        way = 1 - at[here] if BACK[number] else at[here]
        rows.append((cell[here], number + way, here))
    cell, way, change = (np.concatenate(column) for column in zip(*rows, strict=True))
    order = np.lexsort((way, cell))
    return cell[order], change[order]


def _links(
    cell: np.ndarray, change: np.ndarray, vertices: Lines
) -> tuple[list[tuple[int, int]], Lines]:
    """The couples of vertices that are joined, and all vertices, middles as well."""
    links, middles = [], []
    for here in _groups(cell, change):
        place = vertices.places[here].mean(axis=0)
        for like in _groups(vertices.pair[here], here):
            left = like.tolist()
            while len(left) > 1:
                couple = _nearest(left, vertices.places)
                links.append(couple)
                left = [vertex for vertex in left if vertex not in couple]
            for vertex in left:
                links.append((vertex, vertices.pair.size + len(middles)))
                middles.append((place, 1.0, 0, vertices.pair[vertex], 0))
    if not middles:
        return links, vertices
    more = Lines._make(np.array(column) for column in zip(*middles, strict=True))
    both = zip(vertices, more, strict=True)
    return links, Lines._make(np.concatenate(columns) for columns in both)


def _groups(keys: np.ndarray, values: np.ndarray) -> list[np.ndarray]:
    """The values of each key, in their order."""
    order = np.argsort(keys, kind="stable")
    starts = np.flatnonzero(np.diff(keys[order])) + 1
    return np.split(values[order], starts) if keys.size else []


def _nearest(left: list[int], places: np.ndarray) -> tuple[int, int]:
    """The two nearest of some vertices, of equal couples the first."""
    if len(left) == 2:
        return left[0], left[1]
    couples = list(combinations(left, 2))
    apart = [np.hypot(*(places[one] - places[other])) for one, other in couples]
    return couples[int(np.argmin(apart))]


def _paths(links: list[tuple[int, int]], count: int) -> list[list[int]]:
    """Links joined to paths: those with ends first, then those around loops.

    No vertex has more than two links, one in each cell beside it.
    """
    left: list[list[int]] = [[] for _ in range(count)]
    for one, other in links:
        left[one].append(other)
        left[other].append(one)
    ends = [vertex for vertex, others in enumerate(left) if len(others) == 1]
    paths = []
    for start in [*ends, *range(count)]:
        path = [start]
        while left[path[-1]]:
            following = left[path[-1]].pop()
            left[following].remove(path[-1])
            path.append(following)
        if len(path) > 1:
            paths.append(path)
    return paths
