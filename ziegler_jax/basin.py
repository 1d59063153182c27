"""Basins: which long-run motion each start of a plane reaches, and how many do."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import xarray as xr

from .column import Column, State
from .outcome import OUTCOME
from .simulate import Settled, settle
from .sweep import sweep

STARTS = ("phi1", "phi2", "omega1", "omega2")


def basin(
    column: Column | Callable[..., Column],
    axes: Mapping[str, Any],
    *,
    start: State | None = None,
    threads: int | None = None,
    progress: bool | None = None,
    **options: Any,
) -> xr.Dataset:
    """Settle from every start of a plane, or of any grid.

    ```python
    ds = zj.basin(column, {"phi2": np.linspace(-1, 1, 65), "omega2": rates})
    zj.plot.map(ds, "outcome", x="phi2", y="omega2")
    ds.fraction.sel(reached="stuck")
    ```

    **Arguments:**

    - `column`: a column, or a function of the further axes' names that makes one.
    - `axes`: values of `phi1`, `phi2`, `omega1`, `omega2`, at least one of them, and of
        what `column` takes if it is a function.
    - `start`: the rest of the start; None is the upright column.
    - `threads`, `progress`: as in `sweep`.
    - `options`: of `settle`.

    **Returns:** an `xarray.Dataset` over the axes as `sweep` makes it, and
    `fraction(reached, ...)`: of the computed starts, the share with each outcome that
    occurs, over the axes that are not starts. On an even grid that is a share of area.
    Cycles that coexist differ in `joint_amplitude`, not in the outcome.

    **Raises:** `ValueError` for arguments that break a rule.
    """
    start = State() if start is None else start
    if not isinstance(axes, Mapping) or not set(STARTS) & set(axes):
        raise ValueError(
            f"Argument `axes` must have one of {', '.join(STARTS)} at least, but is "
            f"{axes!r}."
        )
    if not isinstance(start, State):
        raise ValueError(f"Argument `start` must be a `State`, but is {start!r}.")
    over = [name for name in axes if name in STARTS]
    if callable(column) == (len(over) == len(axes)) or not (
        callable(column) or isinstance(column, Column)
    ):
        raise ValueError(
            "Argument `column` must be a `Column` where all axes are starts, else a "
            f"function of the others, but is {column!r} with the axes "
            f"{', '.join(axes)}."
        )

    def point(**values: Any) -> Settled:
        given = dict(zip(STARTS, start.y, strict=True))
        y = [values.pop(name, given[name]) for name in STARTS]
        scene = column(**values) if callable(column) else column
        return settle(scene, State(y[:2], y[2:]), **options)

    found = sweep(point, axes=axes, threads=threads, progress=progress)
    codes = [code for code in OUTCOME if (found.outcome == code).any()]
    shares = [(found.outcome == code).mean(over) for code in codes]
    reached = xr.DataArray(
        np.array([code.name for code in codes]), dims="reached", name="reached"
    )
    fraction = xr.concat(shares, dim=reached)
    fraction.attrs = {"long_name": "share of the starts", "units": "1"}
    return found.assign(fraction=fraction)
