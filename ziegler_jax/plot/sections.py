"""Pictures of Poincare sections and of frequencies."""

import re
from typing import cast

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from ..analysis.poincare import PoincareSection
from ..motion.section import COORDINATE
from ..motion.trajectory import Trajectory
from ..numerics.rules import instance
from .style import LINE_COLOURS, one_motion, rod_colours, unit_label

SYMBOLS = {"phi": r"\varphi", "omega": r"\dot\varphi"}


def section(
    points: PoincareSection, *, rod: int | None = None, ax: Axes | None = None
) -> Axes:
    r"""Draw a section: angle and rate of a rod at each passage of the plane.

    ```python
    zj.plot.section(zj.poincare(column, start, points=50))
    ```

    A cycle is a few points, a quasi-periodic motion a closed curve, chaos a cloud with
    a structure. The plane stands in the title.

    **Arguments:**

    - `points`: of `poincare`; lanes of a `vmap` have a colour each.
    - `rod`: which, from 1 on; None: the last.
    - `ax`: where to draw, None opens a figure.

    **Returns:** the axes.

    **Raises:** `ValueError` for what is no section, and for a rod that is none.
    """
    instance("points", points, PoincareSection)
    rods = np.shape(points.phi)[-1]
    rod = rods if rod is None else rod
    if rod not in range(1, rods + 1):
        raise ValueError(f"Argument `rod` must be one of 1 to {rods}, but is {rod!r}.")
    ax = plt.subplots(layout="constrained")[1] if ax is None else ax
    phi, omega = (np.asarray(x)[..., rod - 1] for x in (points.phi, points.omega))
    lanes = zip(*(np.reshape(x, (-1, x.shape[-1])) for x in (phi, omega)), strict=True)
    size = 5.0 if phi.shape[-1] <= 100 else 2.0
    for i, (angle, rate) in enumerate(lanes):
        colour = LINE_COLOURS[i % len(LINE_COLOURS)]
        ax.plot(angle, rate, ".", color=colour, markersize=size)
    rates = unit_label("sqrt(k/(m l^2))")
    ax.set(
        xlabel=rf"angle $\varphi_{{{rod}}}$ (rad)",
        ylabel=rf"rate $\dot\varphi_{{{rod}}}$ (rad {rates})",
    )
    ax.set_title(_plane(dict(points.settings)), loc="left")
    ax.set(xlim=_limits(phi), ylim=_limits(omega))
    return ax


LEAST = 0.02  # of its distance from zero: a cycle's points are no cloud of rounding


def _limits(values: np.ndarray) -> tuple[float, float] | None:
    """Limits of an axis that magnify no points which are one but for errors."""
    values = values[np.isfinite(values)]
    if not values.size:
        return None
    low, high = float(values.min()), float(values.max())
    half = 1.1 * max((high - low) / 2, LEAST * max(abs(low), abs(high)), 1e-9)
    return (low + high) / 2 - half, (low + high) / 2 + half


def _plane(settings: dict) -> str:
    """The plane of a section, e.g. `phi1 rising` at a level."""
    name, _, direction = str(settings.get("section", "")).partition(" ")
    if not direction:
        return ""
    kind, rod = cast(re.Match, COORDINATE.fullmatch(name)).groups()
    symbol = f"{SYMBOLS[kind]}_{rod}" if len(rod) == 1 else f"{SYMBOLS[kind]}_{{{rod}}}"
    level = settings["level"]
    value = f"{level:g}" if isinstance(level, float) else r"\mathrm{const}"
    return f"section ${symbol} = {value}$, {direction}"


def spectrum(motion: Trajectory, *, skip: float = 0.5, ax: Axes | None = None) -> Axes:
    r"""Draw which frequencies a motion has: the rods' amplitude spectra.

    ```python
    zj.plot.spectrum(zj.trajectory(column, start, np.linspace(0, 200, 4001)))
    ```

    $$A(\omega) = \frac{2}{\sum_j w_j}
    \Bigl| \sum_j w_j\, (\varphi(t_j) - \bar\varphi)\, e^{-i\omega t_j} \Bigr|$$

    with Hann's window w: a harmonic of amplitude A is a peak of height A (to 15 %, as
    its frequency lies between two of the n/2 lines). A cycle has sharp peaks at the
    multiples of one frequency, a quasi-periodic motion at sums of two, chaos a broad
    band. (Eigenvalues of the linear column are those of `zj.spectrum`.)

    **Arguments:**

    - `motion`: a `Trajectory` at evenly spaced times, of one column.
    - `skip`: the share of its time that is left out as transient, below 1.
    - `ax`: where to draw, None opens a figure.

    **Returns:** the axes, angular frequencies in $\sqrt{k/(m l^2)}$, or in rad/s of a
    motion in SI.

    **Raises:** `ValueError` for times that are not evenly spaced or too few, and for
    a motion that ended early or is at rest.
    """
    ts, phi = one_motion(motion)
    if not 0 <= skip < 1:
        raise ValueError(f"Argument `skip` must be from 0 to below 1, but is {skip!r}.")
    first = int(skip * ts.size)
    ts, phi = ts[first:], phi[first:]
    if ts.size < 8 or not np.allclose(np.diff(ts), ts[1] - ts[0]):
        raise ValueError(
            "Argument `motion` must have at least 8 evenly spaced times after the "
            f"skipped ones, but has {ts.size}, or not even ones."
        )
    if not np.isfinite(phi).all():
        raise ValueError("Argument `motion` must reach its last time, but ended early.")
    if not np.ptp(phi, axis=0).any():
        raise ValueError("Argument `motion` must move, but is at rest.")
    window = np.hanning(ts.size)
    lines = np.fft.rfft(window[:, None] * (phi - phi.mean(axis=0)), axis=0)
    heights = 2 * np.abs(lines) / window.sum()
    frequency = 2 * np.pi * np.fft.rfftfreq(ts.size, ts[1] - ts[0])
    ax = plt.subplots(layout="constrained")[1] if ax is None else ax
    for i, colour in enumerate(rod_colours(phi.shape[1])):
        name, dash = rf"$\varphi_{{{i + 1}}}$", "--" if i % 2 else "-"
        ax.semilogy(frequency[1:], heights[1:, i], dash, color=colour, lw=1, label=name)
    # as far as a line stands out by a ten thousandth of the highest
    shown = frequency[heights.max(axis=1) > 1e-4 * heights.max()]
    rate = "rad s$^{-1}$" if motion.in_si else unit_label("sqrt(k/(m l^2))")
    ax.set(
        xlabel=rf"angular frequency ({rate})",
        ylabel="amplitude (rad)",
        xlim=(0, 1.1 * shown[-1]),
    )
    ax.legend()
    return ax
