"""The column moving."""

import os
from pathlib import Path
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from matplotlib import animation
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..model.chain_of_rods import AbstractChain, Chain, check_column
from ..model.column import Column
from ..model.forces import FollowerForces
from ..motion.trajectory import Trajectory
from ..numerics.numbers import each
from ..numerics.rules import number
from .style import BLUE, VERMILLION, one_motion, rod_colours

ARROW = 0.175  # the largest load's arrow, of the chain's length
MOST_LONG = 3  # so many arrows may be as long
TRACE = 400  # states of the tip's way


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


class MovingChain:
    """Rods, their joints and the load, drawn at one state after the other."""

    def __init__(self, ax: Axes, chain: Drawn):
        """Draw the chain upright."""
        self.lengths, self.forces = np.asarray(chain.lengths), chain.forces
        n, long = len(self.lengths), float(self.lengths.sum())
        self.arrow = ARROW * long
        reach = 1.15 * long + self.arrow
        ax.set(xlim=(-reach, reach), ylim=(-0.15 * long, reach), aspect="equal")
        ax.axhline(0, color="0.5", lw=1, zorder=0)
        self.rods = []
        for colour, wide in zip(rod_colours(n), np.linspace(5, 3, n), strict=True):
            look = {"color": colour, "lw": wide, "solid_capstyle": "round"}
            self.rods += ax.plot([], [], **look)
        size = min(7.0, 24.0 / n)
        (self.joints,) = ax.plot([], [], "o", color="black", mfc="white", ms=size)
        (self.trace,) = ax.plot([], [], color=BLUE, lw=0.8, alpha=0.6, zorder=0)
        wide = max(0.5, min(1.0, MOST_LONG / max(1, len(self.forces))))
        look = {"arrowstyle": "-|>", "color": VERMILLION, "lw": 2 * wide}
        look |= {"shrinkA": 0, "shrinkB": 0, "mutation_scale": 16 * wide}
        self.loads = [
            ax.annotate("", (0, 0), (0, 1), arrowprops=look) for _ in self.forces
        ]
        ax.set(xticks=[], yticks=[])
        ax.spines[:].set_visible(False)
        self.show(np.zeros((1, n)))

    def show(self, phi: np.ndarray) -> None:
        """The last of these states (n, rods), and the tip's way to it."""
        places = self.places(phi)
        now, tip = places[-1], places[:, -1]
        for rod, ends in zip(self.rods, zip(now, now[1:], strict=False), strict=True):
            rod.set_data(*np.transpose(ends))
        self.joints.set_data(*now[:-1].T)
        self.trace.set_data(tip[:, 0], tip[:, 1])
        for arrow, force in zip(self.loads, self.forces, strict=True):
            begin, end = now[force.rod : force.rod + 2]
            head = begin + force.at * (end - begin)
            angle = force.follower * phi[-1, force.rod]
            along = np.array([-np.sin(angle), np.cos(angle)])
            arrow.xy = tuple(head)
            arrow.set_position(tuple(head + force.share * self.arrow * along))

    def places(self, phi: np.ndarray) -> np.ndarray:
        """Where base, joints and tip are, (n, rods + 1, 2); upright at zero."""
        rods = np.stack([-np.sin(phi), np.cos(phi)], axis=-1)  # state, rod, x and y
        ends = np.cumsum(self.lengths[:, None] * rods, axis=1)
        return np.concatenate([np.zeros_like(ends[:, :1]), ends], axis=1)


def animate(
    motion: Trajectory,
    path: str | os.PathLike | None = None,
    *,
    speed: float = 2.0,
    fps: int = 25,
    column: AbstractChain | None = None,
    ax: Axes | None = None,
) -> animation.FuncAnimation:
    r"""Draw the column moving, and write it as a GIF or MP4.

    ```python
    motion = zj.trajectory(column, start, np.linspace(0, 5, 101))
    zj.plot.animate(motion, "column.gif", column=column)
    ```

    Arrows are the follower forces, the thin line is the tip's way. In a
    notebook `IPython.display.HTML(animation.to_jshtml())` shows what is returned.

    **Arguments:**

    - `motion`: a `Trajectory` of one column or chain.
    - `path`: a file that ends in `.gif`, or `.mp4` where `ffmpeg` is installed; None
        writes nothing.
    - `speed`: time units $\sqrt{m l^2/k}$ (seconds, of a restored motion) a second.
    - `fps`: pictures a second.
    - `column`: the motion's, for the rods' lengths and the forces that follow them;
        None draws equal rods and a load along the last.
    - `ax`: where to draw, None opens a figure.

    **Returns:** matplotlib's animation; keep it as long as it is to move.

    **Raises:** `ValueError` for a motion of many columns, one that has no state, a
    column of another number of rods, and for a file of another kind, or of one that
    cannot be written here.
    """
    ts, phi = one_motion(motion)
    rods = phi.shape[1]
    for name, value in (("speed", speed), ("fps", fps)):
        number(name, value, "positive")
    chain = Drawn([1.0] * rods, [Force(rods - 1, 1.0, 1.0, 1.0)])
    if column is not None:
        check_column(column)
        chain = drawn_of(column)
        if column.joints != rods:
            raise ValueError(
                f"Argument `column` must have the {rods} rods of `motion`, but has "
                f"{column.joints}."
            )
    writer = None if path is None else _writer(Path(path), fps)
    there = np.isfinite(phi).all(axis=1)
    ts, phi = ts[there], phi[there]
    if ts.size < 2:
        raise ValueError("Argument `motion` must have states, but has fewer than two.")
    frames = np.arange(ts[0], ts[-1], speed / fps)
    ends = np.searchsorted(ts, frames, side="right")
    states = np.stack([np.interp(frames, ts, phi[:, i]) for i in range(rods)], axis=-1)
    if ax is None:
        ax = plt.subplots(figsize=(5, 4), layout="constrained")[1]
    moved = MovingChain(ax, chain)
    clock = ax.text(0.02, 0.02, "", transform=ax.transAxes)

    def draw(i: int) -> list:
        moved.show(np.concatenate([phi[: ends[i]][-TRACE:], states[i : i + 1]]))
        clock.set_text(f"t = {frames[i]:.1f}")
        return []

    figure = ax.figure
    assert isinstance(figure, Figure)
    moving = animation.FuncAnimation(
        figure, draw, frames=len(frames), interval=1000 / fps
    )
    if writer is not None and path is not None:
        moving.save(os.fspath(path), writer=writer)
    return moving


def _writer(path: Path, fps: int) -> animation.AbstractMovieWriter:
    """What writes files of this kind."""
    kinds = {".gif": animation.PillowWriter, ".mp4": animation.FFMpegWriter}
    kind = kinds.get(path.suffix.lower())
    if kind is None:
        raise ValueError(
            f"Argument `path` must end in .gif or .mp4, but is {str(path)!r}."
        )
    if not kind.isAvailable():
        raise ValueError(
            "Argument `path` must end in .gif where `ffmpeg` is not installed, but is "
            f"{str(path)!r}."
        )
    return kind(fps=fps)
