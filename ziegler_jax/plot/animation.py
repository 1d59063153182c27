"""The column moving."""

import os
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib import animation
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..model.column import Column
from ..motion.trajectory import Trajectory
from ..numerics.rules import instance, number
from .style import BLUE, PHI1, PHI2, VERMILLION

ARROW = 0.35  # the load's arrow, in l
TRACE = 400  # states of the tip's way


class MovingColumn:
    """Two rods, their joints and the load, drawn at one state after the other."""

    def __init__(self, ax: Axes, l2: float = 1.0, follower: float = 1.0):
        """Draw the column upright; the load turns by `follower` times rod 2's angle."""
        self.l2, self.follower = l2, follower
        reach = 1.15 * (1 + l2) + ARROW
        ax.set(xlim=(-reach, reach), ylim=(-0.3, reach), aspect="equal")
        ax.axhline(0, color="0.5", lw=1, zorder=0)
        (self.one,) = ax.plot([], [], color=PHI1, lw=5, solid_capstyle="round")
        (self.two,) = ax.plot([], [], color=PHI2, lw=3, solid_capstyle="round")
        (self.joints,) = ax.plot([], [], "o", color="black", mfc="white", ms=7)
        (self.trace,) = ax.plot([], [], color=BLUE, lw=0.8, alpha=0.6, zorder=0)
        look = {"arrowstyle": "-|>", "color": VERMILLION, "lw": 2}
        look |= {"shrinkA": 0, "shrinkB": 0, "mutation_scale": 16}
        self.load = ax.annotate("", (0, 0), (0, 1), arrowprops=look)
        ax.set(xticks=[], yticks=[])
        ax.spines[:].set_visible(False)
        self.show(np.zeros((1, 2)))

    def show(self, phi: np.ndarray) -> None:
        """The last of these states (n, 2), and the tip's way to it."""
        knee, tip = self.places(phi)
        (x1, y1), (x2, y2) = knee[-1], tip[-1]
        self.one.set_data([0, x1], [0, y1])
        self.two.set_data([x1, x2], [y1, y2])
        self.joints.set_data([0, x1], [0, y1])
        self.trace.set_data(tip[:, 0], tip[:, 1])
        angle = self.follower * phi[-1, 1]
        along = np.array([-np.sin(angle), np.cos(angle)])
        self.load.xy = (x2, y2)
        self.load.set_position(tuple(tip[-1] + ARROW * along))

    def places(self, phi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where knee and tip are, (n, 2) each; the column stands upright at rest."""
        rods = np.stack([-np.sin(phi), np.cos(phi)], axis=-1)  # state, rod, x and y
        knee = rods[:, 0]
        return knee, knee + self.l2 * rods[:, 1]


def load_of(column: Column) -> tuple[float, float]:
    """Where the load attacks, the length of rod 2, and its follower fraction."""
    follower = 1.0 if column.follower is None else float(column.follower)
    return float(column.l2), follower


def animate(
    motion: Trajectory,
    path: str | os.PathLike | None = None,
    *,
    speed: float = 2.0,
    fps: int = 25,
    l2: float = 1.0,
    follower: float = 1.0,
    ax: Axes | None = None,
) -> animation.FuncAnimation:
    r"""Draw the column moving, and write it as a GIF or MP4.

    ```python
    zj.plot.animate(zj.trajectory(column, start, np.linspace(0, 5, 101)), "column.gif")
    ```

    The arrow is the load, the thin line the tip's way. In a
    notebook `IPython.display.HTML(animation.to_jshtml())` shows what is returned.

    **Arguments:**

    - `motion`: a `Trajectory` of one column.
    - `path`: a file that ends in `.gif`, or `.mp4` where `ffmpeg` is installed; None
        writes nothing.
    - `speed`: time units $\sqrt{m l^2/k}$ (seconds, of a restored motion) a second.
    - `fps`: pictures a second.
    - `l2`, `follower`: of the motion's column, the length of rod 2 in l and the
        load's follower fraction $\eta$.
    - `ax`: where to draw, None opens a figure.

    **Returns:** matplotlib's animation; keep it as long as it is to move.

    **Raises:** `ValueError` for a motion of many columns, one that has no state, and
    for a file of another kind, or of one that cannot be written here.
    """
    instance("motion", motion, Trajectory)
    ts, phi = np.asarray(motion.ts), np.asarray(motion.phi)
    if ts.ndim != 1 or phi.shape != (ts.size, 2):
        raise ValueError(
            "Argument `motion` must be one motion, but its `phi` has shape "
            f"{phi.shape} at times of shape {ts.shape}."
        )
    for name, value in (("speed", speed), ("fps", fps), ("l2", l2)):
        number(name, value, "positive")
    number("follower", follower, "finite")
    writer = None if path is None else _writer(Path(path), fps)
    there = np.isfinite(phi).all(axis=1)
    ts, phi = ts[there], phi[there]
    if ts.size < 2:
        raise ValueError("Argument `motion` must have states, but has fewer than two.")
    frames = np.arange(ts[0], ts[-1], speed / fps)
    ends = np.searchsorted(ts, frames, side="right")
    states = np.stack([np.interp(frames, ts, phi[:, i]) for i in (0, 1)], axis=-1)
    if ax is None:
        ax = plt.subplots(figsize=(5, 4), layout="constrained")[1]
    column = MovingColumn(ax, l2, follower)
    clock = ax.text(0.02, 0.02, "", transform=ax.transAxes)

    def draw(i: int) -> list:
        column.show(np.concatenate([phi[: ends[i]][-TRACE:], states[i : i + 1]]))
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
