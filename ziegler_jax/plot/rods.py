"""Rods, joints and follower forces, as moving pictures and sketches draw them."""

from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes

from ..model.chain_of_rods import AbstractChain, Chain
from ..model.column import Column
from ..model.forces import FollowerForces
from ..numerics.numbers import each
from .style import VERMILLION, rod_colours

ARROW = 0.175  # the largest load's arrow, of the chain's length
MOST_LONG = 3  # so many arrows may be as long


class Force(NamedTuple):
    """A follower force as it is drawn."""

    rod: int  # which, from 0
    follower: float  # by which share of the rod's angle it turns
    at: float  # where on the rod, of its length
    share: float  # of the longest arrow, negative where it pulls


class Drawn(NamedTuple):
    """What a picture shows of a chain beside its angles."""

    lengths: list[float]
    forces: list[Force]


def drawn_of(column: AbstractChain) -> Drawn:
    """The rods' lengths and the follower forces of a column or chain."""
    if isinstance(column, Chain):
        lengths, pattern = column.lengths, column.pattern
    else:
        assert isinstance(column, Column)
        lengths = column.l1 or 1.0, column.l2
        pattern = FollowerForces((0.0, 1.0), column.follower)
    n, weights = len(lengths), [float(w) for w in pattern.weights]
    sizes = [abs(weight) for weight in weights if weight]
    # many are drawn shorter: each lies along its rod
    largest = max(sizes, default=1.0) * max(1.0, len(sizes) / MOST_LONG)
    parts = zip(weights, each(pattern.follower, n), each(pattern.at, n), strict=True)
    forces = [
        Force(rod, float(follower), float(at), weight / largest)
        for rod, (weight, follower, at) in enumerate(parts)
        if weight
    ]
    return Drawn([float(length) for length in lengths], forces)


class DrawnChain:
    """Rods, their joints and the follower forces, drawn at one state or more."""

    def __init__(self, ax: Axes, chain: Drawn):
        """Draw the chain upright."""
        self.lengths, self.forces = np.asarray(chain.lengths), chain.forces
        n, long = len(self.lengths), float(self.lengths.sum())
        self.arrow = ARROW * long
        self.reach = 1.15 * long + self.arrow
        ax.set(aspect="equal", xticks=[], yticks=[])
        ax.spines[:].set_visible(False)
        self.rods = []
        for colour, wide in zip(rod_colours(n), np.linspace(5, 3, n), strict=True):
            look = {"color": colour, "lw": wide, "solid_capstyle": "round"}
            self.rods += ax.plot([], [], **look)
        size = min(7.0, 24.0 / n)
        (self.joints,) = ax.plot([], [], "o", color="black", mfc="white", ms=size)
        wide = max(0.5, min(1.0, MOST_LONG / max(1, len(self.forces))))
        look = {"arrowstyle": "-|>", "color": VERMILLION, "lw": 2 * wide}
        look |= {"shrinkA": 0, "shrinkB": 0, "mutation_scale": 16 * wide}
        self.loads = [
            ax.annotate("", (0, 0), (0, 1), arrowprops=look) for _ in self.forces
        ]
        self.show(np.zeros(n))

    def show(self, phi: np.ndarray) -> None:
        """The state of these angles (rods,)."""
        now = self.places(phi)
        for rod, ends in zip(self.rods, zip(now, now[1:], strict=False), strict=True):
            rod.set_data(*np.transpose(ends))
        self.joints.set_data(*now[:-1].T)
        for arrow, force in zip(self.loads, self.forces, strict=True):
            begin, end = now[force.rod : force.rod + 2]
            head = begin + force.at * (end - begin)
            angle = force.follower * phi[force.rod]
            along = np.array([-np.sin(angle), np.cos(angle)])
            arrow.xy = tuple(head)
            arrow.set_position(tuple(head + force.share * self.arrow * along))

    def places(self, phi: np.ndarray) -> np.ndarray:
        """Where base, joints and tip are, (..., rods + 1, 2); upright at zero."""
        rods = np.stack([-np.sin(phi), np.cos(phi)], axis=-1)  # state, rod, x and y
        ends = np.cumsum(self.lengths[:, None] * rods, axis=-2)
        return np.concatenate([np.zeros_like(ends[..., :1, :]), ends], axis=-2)
