"""The column moving."""

import os
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib import animation
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..model.chain_of_rods import AbstractChain, check_column
from ..motion.trajectory import Trajectory
from ..numerics.rules import number
from ..results import TIME
from .rods import Drawn, DrawnChain, Force, drawn_of
from .style import BLUE, one_motion, unit_label

TRACE = 400  # states of the tip's way


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
    ax.axhline(0, color="0.5", lw=1, zorder=0)
    moved = DrawnChain(ax, chain)
    low = -0.15 * float(moved.lengths.sum())
    ax.set(xlim=(-moved.reach, moved.reach), ylim=(low, moved.reach))
    (trace,) = ax.plot([], [], color=BLUE, lw=0.8, alpha=0.6, zorder=0)
    clock = ax.text(0.02, 0.02, "", transform=ax.transAxes)
    unit = "s" if motion.in_si else unit_label(TIME)

    def draw(i: int) -> list:
        moved.show(states[i])
        way = np.concatenate([phi[: ends[i]][-TRACE:], states[i : i + 1]])
        trace.set_data(*moved.places(way)[:, -1].T)
        clock.set_text(f"$t$ = {frames[i]:.1f} {unit}")
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
