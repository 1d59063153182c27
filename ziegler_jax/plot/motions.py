"""Pictures of motions."""

from collections.abc import Sequence
from typing import cast

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from ..motion.trajectory import Trajectory
from ..numerics.rules import instance
from ..results import CODE
from ..units.si import SI
from .style import PHI1, PHI2, unit_label


def time_history(
    motion: Trajectory,
    *,
    ax: Sequence[Axes] | np.ndarray | None = None,
    units: SI | None = None,
) -> np.ndarray:
    r"""Draw a motion: $\phi_1, \phi_2$ over time, and beside it the phase plane.

    **Arguments:**

    - `motion`: a `Trajectory` of one column; seconds on the axes of one in SI.
    - `ax`: two axes to draw in; None opens a figure.
    - `units`: the column's `SI` units, for seconds on the axes; None leaves
        $\sqrt{m l^2/k}$.

    **Returns:** the two axes, as an array. A motion that ended before its last time
    says so in the first one's title.

    **Raises:** `ValueError` for a `motion` of many columns and for an `ax` that is not
    two axes.
    """
    time, rate = unit_label("sqrt(m l^2/k)"), unit_label("sqrt(k/(m l^2))")
    instance("motion", motion, Trajectory)
    if units is not None:
        motion = cast(Trajectory, units.restore(motion))
    if motion.in_si:
        time, rate = "s", "s$^{-1}$"
    ts, phi, omega = (np.asarray(a) for a in (motion.ts, motion.phi, motion.omega))
    if ts.ndim != 1 or phi.shape != (ts.size, 2):
        raise ValueError(
            "Argument `motion` must be one motion, but its `phi` has shape "
            f"{phi.shape} at times of shape {ts.shape}."
        )
    if ax is None:
        ax = plt.subplots(
            1, 2, figsize=(9, 3.6), width_ratios=(1.7, 1), layout="constrained"
        )[1]
    axes = np.ravel(np.asarray(ax, dtype=object))
    if axes.size != 2:
        raise ValueError(f"Argument `ax` must be two axes, but is {axes.size}.")
    for i, colour in enumerate((PHI1, PHI2)):
        name = rf"$\varphi_{i + 1}$"
        axes[0].plot(ts, phi[:, i], color=colour, lw=1.2, label=name)
        axes[1].plot(phi[:, i], omega[:, i], color=colour, lw=1.0, label=name)
    axes[0].set(xlabel=f"time $t$ ({time})", ylabel=r"angle $\varphi_i$ (rad)")
    axes[1].set(
        xlabel=r"angle $\varphi_i$ (rad)",
        ylabel=rf"rate $\dot\varphi_i$ (rad {rate})",
    )
    axes[0].legend(loc="upper right", ncols=2)
    outcome = CODE(int(motion.outcome))
    if outcome is not CODE.complete:
        axes[0].set_title(f"ended early: {outcome.name}")
    return axes
