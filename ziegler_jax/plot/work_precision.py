"""The picture of error against run time."""

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from .style import LINE_COLOURS, LINE_MARKERS


def work_precision(
    dataset: xr.Dataset,
    variable: str,
    *,
    ax: Axes | None = None,
) -> Axes:
    """Draw error against run time, one line a solver, one marker a tolerance.

    The markers are medians over the points; the pale band reaches up to the 95th
    percentile.

    **Arguments:**

    - `dataset`: from `zj.work_precision`.
    - `variable`: whose error, e.g. `joint_amplitude`.
    - `ax`: where to draw; None opens a figure.

    **Returns:** the axes.

    **Raises:** `ValueError` for a variable whose error the dataset does not have.
    """
    name = f"{variable}_error"
    if name not in dataset:
        names = ", ".join(str(n) for n in dataset.data_vars)
        raise ValueError(
            f"Argument `variable` must name one of {names}, but `{name}` is not there."
        )
    ax = plt.subplots(layout="constrained")[1] if ax is None else ax
    error, price = dataset[name], dataset["seconds_a_point"]
    for i, solver in enumerate(dataset.solver.values):
        look = i % len(LINE_COLOURS)
        colour, marker = LINE_COLOURS[look], LINE_MARKERS[look]
        x = price.sel(solver=solver).values
        low, high = (error.sel(solver=solver, quantile=p).values for p in (0.5, 0.95))
        order = np.argsort(x)
        ax.plot(x[order], low[order], marker + "-", color=colour, label=str(solver))
        ax.fill_between(
            x[order], low[order], high[order], color=colour, alpha=0.15, linewidth=0
        )
    ax.set(xscale="log", yscale="log", xlabel=_label(price), ylabel=_label(error))
    ax.grid(which="major", alpha=0.3)
    ax.legend()
    return ax


def _label(values: xr.DataArray) -> str:
    units = values.attrs["units"]
    text = values.attrs["long_name"]
    return text if units == "1" else f"{text} ({units})"
