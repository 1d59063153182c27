"""Pictures of motions."""

from collections.abc import Sequence

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from ..motion.trajectory import Trajectory
from ..results import CODE
from ..units.si import SI
from .style import one_motion, rod_colours, unit_label

COLUMNS, ROOM = 6, 0.13  # of a legend, and what a row of it takes of the axis


def time_history(
    motion: Trajectory,
    *,
    ax: Sequence[Axes] | np.ndarray | None = None,
    units: SI | None = None,
) -> np.ndarray:
    r"""Draw a motion: the rods' angles over time, and beside it their phase planes.

    More than two rods are coloured from dark at the base to light at the tip.

    **Arguments:**

    - `motion`: a `Trajectory` of one column or chain; seconds on the axes of one in SI.
    - `ax`: two axes to draw in; None opens a figure.
    - `units`: the column's `SI` units, for seconds on the axes; None leaves
        $\sqrt{m l^2/k}$.

    **Returns:** the two axes, as an array. A motion that ended before its last time
    says so in the first one's title.

    **Raises:** `ValueError` for a `motion` of many columns and for an `ax` that is not
    two axes.
    """
    time, rate = unit_label("sqrt(m l^2/k)"), unit_label("sqrt(k/(m l^2))")
    one_motion(motion)
    if units is not None:
        motion = units.restore(motion)
    if motion.in_si:
        time, rate = "s", "s$^{-1}$"
    (ts, phi), omega = one_motion(motion), np.asarray(motion.omega)
    if ax is None:
        ax = plt.subplots(
            1, 2, figsize=(9, 3.6), width_ratios=(1.7, 1), layout="constrained"
        )[1]
    axes = np.ravel(np.asarray(ax, dtype=object))
    if axes.size != 2:
        raise ValueError(f"Argument `ax` must be two axes, but is {axes.size}.")
    for i, colour in enumerate(rod_colours(phi.shape[1])):
        name = rf"$\varphi_{{{i + 1}}}$"
        axes[0].plot(ts, phi[:, i], color=colour, lw=1.2, label=name)
        axes[1].plot(phi[:, i], omega[:, i], color=colour, lw=1.0, label=name)
    axes[0].set(xlabel=f"time $t$ ({time})", ylabel=r"angle $\varphi_i$ (rad)")
    axes[1].set(
        xlabel=r"angle $\varphi_i$ (rad)",
        ylabel=rf"rate $\dot\varphi_i$ (rad {rate})",
    )
    low, high = axes[0].get_ylim()
    rows = -(-phi.shape[1] // COLUMNS)
    axes[0].set_ylim(low, high + ROOM * rows * (high - low))
    close = {"columnspacing": 1.2, "handlelength": 1.4}
    axes[0].legend(loc="upper right", ncols=min(phi.shape[1], COLUMNS), **close)
    outcome = CODE(int(motion.outcome))
    if outcome is not CODE.complete:
        axes[0].set_title(f"ended early: {outcome.name}")
    return axes
