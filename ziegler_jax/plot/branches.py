"""Pictures of branches of cycles."""

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from ..analysis.continuation import Branch
from ..numerics.rules import choice
from ..results import CODE
from .style import in_lines, label_of

SPECIAL_MARKERS = {
    CODE.fold: "s",
    CODE.torus: "D",
    CODE.flip: "^",
    CODE.pitchfork: "P",
}


def branch(
    cycles: Branch | xr.Dataset,
    variable: str = "joint_amplitude",
    *,
    parameter: str = "parameter",
    ax: Axes | None = None,
) -> Axes:
    """Draw a branch of cycles: solid where they attract, dashed where they do not.

    ```python
    zj.plot.branch(cycles, parameter="follower load $q$")
    ```

    Folds are squares, torus bifurcations diamonds, period doublings triangles,
    pitchforks crosses.

    **Arguments:**

    - `cycles`: of `continue_cycle`, or a dataset of it: of a sweep, reduced to one
        place by `sel`.
    - `variable`: what is drawn, e.g. `period`; of the last joint or rod where it has
        one a joint or rod and none was chosen.
    - `parameter`: what the parameter is called.
    - `ax`: where to draw, None opens a figure.

    **Returns:** the axes.

    **Raises:** `ValueError` for what is no branch, and for a variable that it does not
    have.
    """
    dataset = select_last_joint(branch_dataset(cycles))
    values = of_dims(dataset, variable, {"cycles": "point"})
    ax = plt.subplots(layout="constrained")[1] if ax is None else ax
    draw_branch(ax, dataset, variable)
    _specials(ax, dataset, variable)
    ax.legend()
    ax.set(xlabel=parameter, ylabel=in_lines(label_of(values)))
    return ax


def branch_dataset(cycles: Branch | xr.Dataset) -> xr.Dataset:
    """A branch as a dataset."""
    return cycles.to_dataset() if isinstance(cycles, Branch) else cycles


def select_last_joint(dataset: xr.Dataset) -> xr.Dataset:
    """The dataset for the last joint and rod, where neither was chosen."""
    if not isinstance(dataset, xr.Dataset):
        return dataset
    return dataset.isel({d: -1 for d in ("joint", "rod") if d in dataset.dims})


def _specials(ax: Axes, dataset: xr.Dataset, variable: str) -> None:
    """Where the branch changes."""
    names = ("special_kind", "special_parameter", f"special_{variable}")
    if not all(name in dataset for name in names):
        return
    kinds, places, values = (np.asarray(dataset[name]) for name in names)
    for kind, marker in SPECIAL_MARKERS.items():
        here = (kinds == kind) & np.isfinite(places) & np.isfinite(values)
        if here.any():
            label = kind.name
            look = {"color": "black", "mfc": "white", "ms": 7, "zorder": 3}
            ax.plot(places[here], values[here], marker, label=label, **look)


def draw_branch(ax: Axes, branch: xr.Dataset, variable: str) -> None:
    """A branch of cycles, solid where they attract."""
    for name in ("parameter", "stable"):
        if not isinstance(branch, xr.Dataset) or name not in branch:
            raise ValueError(
                "Argument `branch` must be the dataset of a branch of cycles, with "
                f"`{name}`, but is {type(branch).__name__}."
            )
    values = np.asarray(of_dims(branch, variable, {"branch": "point"}), float)
    parameter = np.asarray(branch["parameter"], float)
    stable = np.asarray(branch["stable"], float) == 1
    there = np.flatnonzero(np.isfinite(values[:-1]) & np.isfinite(values[1:]))
    for attracts, line, text in ((True, "-", "attracts"), (False, "--", "does not")):
        # a stretch has the look of the point at its beginning, and reaches the next
        begins = there[stable[there] == attracts]
        if not begins.size:
            continue
        gap, xy = np.full((1, 2), np.nan), []
        for part in np.split(begins, np.flatnonzero(np.diff(begins) > 1) + 1):
            run = slice(part[0], part[-1] + 2)
            xy += [np.stack([parameter[run], values[run]], -1), gap]
        label = f"branch: {text}"
        shown = np.concatenate(xy[:-1]).T
        ax.plot(*shown, line, color="0.35", linewidth=1.2, label=label)


def of_dims(
    dataset: xr.Dataset, variable: str, dims: dict[str, str] | None = None
) -> xr.DataArray:
    """The variable, if it spans these dimensions and no others; None: whatever."""
    if not isinstance(dataset, xr.Dataset):
        raise ValueError(
            "Argument `dataset` must be an `xarray.Dataset`, but is "
            f"{type(dataset).__name__}."
        )
    if not dataset.data_vars or not all(dataset.sizes.values()):
        raise ValueError(
            "Argument `dataset` must hold points of a sweep, but is empty."
        )
    if variable not in dataset.data_vars:
        choice("variable", variable, [str(name) for name in dataset.data_vars])
    values = dataset[variable]
    if dims is None:
        return values
    for argument, dim in dims.items():
        if dim not in values.dims:
            raise ValueError(
                f"Argument `{argument}` must be a dimension of `{variable}`, which has "
                f"{', '.join(str(d) for d in values.dims) or 'none'}, but is {dim!r}."
            )
    names = list(dims.values())
    if len(set(names)) < len(names):
        raise ValueError(
            f"Arguments `x` and `y` must differ, but both are {names[0]!r}."
        )
    spare = [str(dim) for dim in values.dims if dim not in names]
    if spare:
        raise ValueError(
            f"Argument `dataset` must have no dimension but {', '.join(names)} in "
            f"`{variable}`, but has {', '.join(spare)}; choose with "
            f"`dataset.sel({spare[0]}=...)`."
        )
    return values
