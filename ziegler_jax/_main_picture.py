"""The main job's picture: three sections of its map, and where flutter begins.

Matplotlib's own backend for files is taken: no window opens.
"""

from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from .plot.maps import map as draw_map
from .plot.style import BLUE, GREEN, VERMILLION
from .results import CODE

Q_CRITICAL = (18 - 2 * 7**0.5) / 5  # undamped and without friction
TOP = 0.4
Onset = tuple[np.ndarray, np.ndarray]  # from the last stuck q to the first cycle's


def draw_sections(
    planes: Sequence[xr.Dataset],
    titles: Sequence[str],
    onsets: Sequence[Onset],
    heading: str,
    path: Path,
) -> None:
    """Draw sections of the map over (q, mu_s), and their flutter onsets, to a file."""
    with plt.rc_context({"font.size": 9.5, "hatch.linewidth": 0.6}):
        figure, axes = plt.subplots(
            2, 2, figsize=(8.5, 6.6), sharex=True, sharey=True, layout="constrained"
        )
        _draw_maps(figure, axes.flat[:3], planes, titles)
        _draw_onset(axes[1, 1], planes, titles, onsets)
        for ax in axes.flat:
            ax.set_ylim(0.01, TOP)
            ax.set(xlabel="", ylabel="")
        for ax in axes[1]:
            ax.set_xlabel(r"follower load $q = F\,l/k$ (–)")
        for ax in axes[:, 0]:
            ax.set_ylabel(r"static friction coefficient $\mu_s$ (–)")
        figure.suptitle(heading, fontsize="medium")
        figure.savefig(path, dpi=200)
        plt.close(figure)


def _draw_maps(
    figure: Figure,
    axes: Sequence[Axes],
    planes: Sequence[xr.Dataset],
    titles: Sequence[str],
) -> None:
    settled = [
        plane["joint_amplitude"].where(plane["outcome"] == CODE.cycle)
        for plane in planes
    ]
    style, legend = {"vmin": 0, "vmax": max(float(a.max()) for a in settled)}, {}
    for ax, plane, title in zip(axes, planes, titles, strict=True):
        draw_map(plane, "joint_amplitude", "q", "mu_s", ax=ax, colorbar=False, **style)
        ax.set_title(title)
        axes_legend = ax.get_legend()
        if axes_legend is not None:
            names = [text.get_text() for text in axes_legend.get_texts()]
            legend |= dict(zip(names, axes_legend.legend_handles, strict=True))
            axes_legend.remove()
        _mark_critical(ax, "white")
    figure.colorbar(
        axes[0].collections[0],
        ax=figure.axes,
        label=r"amplitude of joint 2, largest $|\varphi_2 - \varphi_1|$ (rad)",
        location="top",
        aspect=50,
        extend="max",
    )
    blank = Patch(facecolor="white", edgecolor="grey", label=r"no such $\mu_k$ on grid")
    figure.legend(
        handles=[*legend.values(), blank],
        loc="outside lower center",
        ncols=4,
        frameon=False,
    )


def _draw_onset(
    ax: Axes,
    planes: Sequence[xr.Dataset],
    titles: Sequence[str],
    onsets: Sequence[Onset],
) -> None:
    colours, dashes = (BLUE, VERMILLION, GREEN), ("-", (0, (4, 1.5)), (0, (1, 1)))
    rows = zip(planes, titles, onsets, colours, dashes, strict=True)
    for plane, title, (low, high), colour, dash in rows:
        mu = plane["mu_s"].values
        # upright within a row of the grid, and level between two of them
        edges = np.concatenate([mu[:1], (mu[:-1] + mu[1:]) / 2, mu[-1:]])
        up = np.stack([edges[:-1], edges[1:]], axis=1).ravel()
        last, first = (np.repeat(x, 2) for x in (low, high))
        ax.fill_betweenx(up, last, first, color=colour, alpha=0.15, lw=0)
        ax.plot(first, up, color=colour, linestyle=dash, lw=2, label=title)
    _mark_critical(ax, "black")
    ax.set_title("flutter onset: the first load with a cycle")
    handles, _ = ax.get_legend_handles_labels()
    handles.append(Patch(facecolor="0.85", label="above the last stuck load"))
    ax.legend(handles=handles, loc="center right", framealpha=1, edgecolor="white")


def _mark_critical(ax: Axes, colour: str) -> None:
    ax.axvline(Q_CRITICAL, color=colour, linestyle="--", linewidth=1)
    ax.annotate(
        rf"linear $q_{{cr}} = {Q_CRITICAL:.4f}$",
        (Q_CRITICAL, 0.97),
        (4, 0),
        xycoords=("data", "axes fraction"),
        textcoords="offset points",
        va="top",
        color=colour,
    )
