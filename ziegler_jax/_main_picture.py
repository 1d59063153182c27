"""The main job's pictures: three sections of its map, with the flutter onset in each.

Of both friction laws: where their outcomes differ, and how often. Matplotlib's own
backend for files is taken: no window opens.
"""

from collections.abc import Sequence
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from ._main_both import Shares
from .plot.maps import map as draw_map
from .plot.style import (
    BLUE,
    GREEN,
    ORANGE,
    PALE_BLUE,
    PURPLE,
    REST_COLOUR,
    SKY,
    VERMILLION,
    VIOLET,
)
from .results import CODE

matplotlib.use("Agg")  # a file, not a window
Q_CRITICAL = (18 - 2 * 7**0.5) / 5  # undamped and without friction
# of pairs of outcomes, smoothed and dry: pale where both are alike
PAIR_COLOURS = (PALE_BLUE, REST_COLOUR, "#C8C8C8")
PAIR_COLOURS += (VIOLET, BLUE, VERMILLION, ORANGE, SKY, PURPLE, GREEN)
SIZE, SIZE_OF_BOTH = (8.5, 4.5), (8.5, 6.6)
Onset = tuple[np.ndarray, np.ndarray]  # from the last stuck q to the first cycle's


def draw_sections(
    planes: Sequence[xr.Dataset],
    titles: Sequence[str],
    onsets: Sequence[Onset],
    heading: str,
    path: Path,
) -> None:
    """Draw sections of the map over (q, mu_s), and their flutter onsets, to a file.

    Of which kind an unsettled motion is stands in the map's store, not here.
    """
    with _fonts():
        figure, axes = plt.subplots(
            1, 3, figsize=SIZE, sharex=True, sharey=True, layout="constrained"
        )
        _draw_maps(figure, axes, planes, titles, onsets)
        _name_axes(axes[None])
        _save(figure, heading, path)


def draw_differences(
    planes: Sequence[xr.Dataset],
    titles: Sequence[str],
    shares: Shares,
    heading: str,
    path: Path,
) -> None:
    """Draw which outcome each law has in sections, and how often these differ."""
    with _fonts():
        figure, axes = plt.subplots(2, 2, figsize=SIZE_OF_BOTH, layout="constrained")
        colours = dict(enumerate(PAIR_COLOURS, 1))
        legend: dict[str, Artist | None] = {}
        for ax, plane, title in zip(axes.flat, planes, titles, strict=False):
            draw_map(plane, "ends", "q", "mu_s", ax=ax, colours=colours)
            _move_legend(ax, legend)
            ax.set_title(title)
            _mark_critical(ax, legend)
        _legend_below(figure, legend, 3)
        _name_axes(axes)
        _draw_shares(axes[1, 1], shares)
        _save(figure, heading, path)


def _fonts():
    """The size of letters, and the width of hatches."""
    return plt.rc_context({"font.size": 10.5, "hatch.linewidth": 0.6})


def _name_axes(axes: np.ndarray) -> None:
    """Load and static friction, on the outer axes."""
    for ax in axes.flat:
        ax.set(xlabel="", ylabel="")
    for ax in axes[-1]:
        ax.set_xlabel(r"follower load $q = F\,l/k$ (–)")
    for ax in axes[:, 0]:
        ax.set_ylabel(r"static friction coefficient $\mu_s$ (–)")


def _save(figure: Figure, heading: str, path: Path) -> None:
    """Write the file."""
    figure.suptitle(heading, fontsize="medium")
    figure.savefig(path, dpi=200)
    plt.close(figure)


def _move_legend(ax: Axes, legend: dict[str, Artist | None]) -> None:
    """Take the legend of a map to those of the others."""
    own = ax.get_legend()
    if own is not None:
        names = [text.get_text() for text in own.get_texts()]
        legend |= dict(zip(names, own.legend_handles, strict=True))
        own.remove()


def _legend_below(
    figure: Figure, legend: dict[str, Artist | None], columns: int
) -> None:
    """What the maps' colours mean."""
    blank = Patch(facecolor="white", edgecolor="grey")
    named = legend | {r"no such $\mu_k$ on grid": blank}
    figure.legend(
        [artist for artist in named.values() if artist],
        [name for name, artist in named.items() if artist],
        loc="outside lower center",
        ncols=columns,
        frameon=False,
    )


def _draw_shares(ax: Axes, shares: Shares) -> None:
    """How many cells differ over the ratio of both coefficients."""
    ax.plot(shares.ratio, shares.differ, "o-", color=VERMILLION, label="all")
    ax.plot(
        shares.ratio, shares.settled, "s--", color=BLUE, label="both motions settled"
    )
    ax.set_title("share of cells whose outcome differs")
    ax.set(xlim=(0, 1.02), ylim=(0, None))
    ax.set_xlabel(r"kinetic over static coefficient $\mu_k/\mu_s$ (–)")
    ax.set_ylabel("share (–)")
    ax.legend(frameon=False)


def _draw_maps(
    figure: Figure,
    axes: Sequence[Axes],
    planes: Sequence[xr.Dataset],
    titles: Sequence[str],
    onsets: Sequence[Onset],
) -> None:
    settled = [
        plane["joint_amplitude"].where(plane["outcome"] == CODE.cycle)
        for plane in planes
    ]
    style, legend = {"vmin": 0, "vmax": max(float(a.max()) for a in settled)}, {}
    for ax, plane, title, (_, first) in zip(axes, planes, titles, onsets, strict=True):
        draw_map(plane, "joint_amplitude", "q", "mu_s", ax=ax, colorbar=False, **style)
        ax.set_title(title)
        _move_legend(ax, legend)
        _mark_onset(ax, plane, first, legend)
        _mark_critical(ax, legend)
    figure.colorbar(
        axes[0].collections[0],
        ax=figure.axes,
        label=r"amplitude of joint 2, largest $|\varphi_2 - \varphi_1|$ (rad)",
        location="top",
        aspect=50,
        extend="max",
    )
    _legend_below(figure, legend, 3)


def _mark_onset(
    ax: Axes, plane: xr.Dataset, first: np.ndarray, legend: dict[str, Artist | None]
) -> None:
    """The lower edge of the first cells with a cycle, upright within a row."""
    mu, q = plane["mu_s"].values, plane["q"].values
    edges = np.concatenate([mu[:1], (mu[:-1] + mu[1:]) / 2, mu[-1:]])
    up = np.stack([edges[:-1], edges[1:]], axis=1).ravel()
    at = np.repeat(first - (q[1] - q[0]) / 2, 2)
    ax.plot(at, up, color="white", lw=3.5)
    (line,) = ax.plot(at, up, color="black", lw=1.8)
    legend["flutter onset: first load with a cycle"] = line


def _mark_critical(ax: Axes, legend: dict[str, Artist | None]) -> None:
    """The load at which the column without friction loses its stability."""
    line = ax.axvline(Q_CRITICAL, color="black", linestyle="--", linewidth=1)
    legend[rf"linear $q_{{cr}} = {Q_CRITICAL:.4f}$"] = line
