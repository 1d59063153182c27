"""Changes on the edges of cells, joined to lines through the cells.

In a cell two changes between the same two labels are joined; of four the two nearest,
and the other two; what is left alone, as where three labels meet, is joined to the
middle of all.
"""

from typing import NamedTuple

import numpy as np

from .cells import Cell, Cells, Pair
from .edges import Crossing, Edge

Key = tuple  # of a vertex: an edge and which of its changes, or a cell


class Vertex(NamedTuple):
    """A point of a line."""

    x: float  # in cells of the grid, as places are
    y: float
    width: float  # of the interval in which the change lies, in the same measure
    along: int  # 0: that interval lies along x; 1: along y


class Line(NamedTuple):
    """A boundary between two labels."""

    pair: Pair
    vertices: list[Vertex]


def lines(cells: Cells, changes: dict[Edge, list[Crossing]]) -> list[Line]:
    """The boundaries through the finest cells."""
    vertices: dict[Key, Vertex] = {}
    joined: dict[Pair, dict[Key, list[Key]]] = {}
    for cell in sorted(cells.leaves()):
        if cell[0] < cells.levels or not cells.unlike(cell):
            continue
        here = _around(cells, cell, changes)
        vertices |= {key: vertex for key, (vertex, _) in here.items()}
        middle = _middle(cells.size(cell), [vertex for vertex, _ in here.values()])
        for pair in sorted({pair for _, pair in here.values()}):
            keys = [key for key, (_, other) in here.items() if other == pair]
            for one, other in _couples(keys, vertices):
                end = ("middle", cell) if other is None else other
                vertices.setdefault(end, middle)
                graph = joined.setdefault(pair, {})
                graph.setdefault(one, []).append(end)
                graph.setdefault(end, []).append(one)
    return [
        Line(pair, [vertices[key] for key in path])
        for pair, graph in sorted(joined.items())
        for path in _paths(graph)
    ]


def _around(
    cells: Cells, cell: Cell, changes: dict[Edge, list[Crossing]]
) -> dict[Key, tuple[Vertex, Pair]]:
    """The changes on a cell's border, in their order around it."""
    here: dict[Key, tuple[Vertex, Pair]] = {}
    for one, other in cells.edges(cell):
        edge = min(one, other), max(one, other)
        on_edge = list(enumerate(changes.get(edge, ())))
        for number, change in on_edge if edge[0] == one else reversed(on_edge):
            (i, j), (k, m) = edge
            along, size = int(i == k), abs(k - i) + abs(m - j)
            x, y = i + change.at * (k - i), j + change.at * (m - j)
            vertex = Vertex(x, y, change.width * size, along)
            here[edge, number] = vertex, change.pair
    return here


def _middle(size: int, around: list[Vertex]) -> Vertex:
    """Where changes meet that nothing else joins; known to a cell."""
    x = float(np.mean([v.x for v in around])) if around else 0.0
    y = float(np.mean([v.y for v in around])) if around else 0.0
    return Vertex(x, y, float(size), 0)


def _couples(
    keys: list[Key], vertices: dict[Key, Vertex]
) -> list[tuple[Key, Key | None]]:
    """Keys two by two, nearest first; None beside the one that is left."""
    left, couples = list(keys), []
    while len(left) > 1:
        pairs = [(a, b) for n, a in enumerate(left) for b in left[n + 1 :]]
        one, other = min(pairs, key=lambda ab: _distance(*(vertices[k] for k in ab)))
        couples.append((one, other))
        left = [key for key in left if key not in (one, other)]
    return [*couples, *((key, None) for key in left)]


def _distance(one: Vertex, other: Vertex) -> float:
    return float(np.hypot(one.x - other.x, one.y - other.y))


def _paths(graph: dict[Key, list[Key]]) -> list[list[Key]]:
    """Every link of a graph once, in paths: from ends first, then around loops."""
    left = {key: list(others) for key, others in graph.items()}
    ends = [key for key, others in graph.items() if len(others) != 2]
    paths = []
    for start in [*ends, *graph]:
        while left[start]:
            path = [start]
            while left[path[-1]]:
                following = left[path[-1]].pop()
                left[following].remove(path[-1])
                path.append(following)
                if len(graph[following]) != 2:
                    break
            paths.append(path)
    return paths
