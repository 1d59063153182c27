"""From a coarse map to its boundaries."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import xarray as xr
from tqdm import tqdm

from ..numerics.rules import number, whole_number
from ..results import labels as attributes_of
from ..sweep.once import Program
from ..sweep.pool import Lanes
from ..sweep.progress import shown, stream
from ..sweep.returned import Returned
from .boundaries import Audit, BoundarySearch, numbers_of
from .cells import MOST_LEVELS, exponent, labels_of_pair
from .lines import Lines

FINEST, UNKNOWN_WIDTH = 1e-13, 1e-3


def refine(
    point: Callable[..., Returned] | Program,
    coarse: xr.Dataset,
    label: str | Sequence[str] = "outcome",
    *,
    width: float | tuple[float, float] = 1e-4,
    levels: int = 3,
    audit: int = 300,
    max_points: int = 20_000,
    progress: bool | None = None,
) -> xr.Dataset:
    r"""The boundaries of a map, from a coarse sweep of the same point.

    ```python
    def point(q, c):
        column = zj.point_masses(2, 1, q=q, damping=zj.Viscous(c, 0.2))
        return {"regime": zj.regime(column)}

    coarse = zj.sweep(point, q=np.linspace(0.5, 4, 17), c=np.linspace(0.05, 0.5, 9))
    ds = zj.refine(point, coarse, "regime")
    zj.plot.map(ds, "regime", x="q", y="c")
    ```

    Cells of the coarse map whose corners have unlike labels are halved both ways,
    `levels` times; so is a cell at whose border a finer neighbour finds another label.
    Then every edge with unlike ends is halved to the `width`, all edges at once, and
    the changes are joined to lines. Last, random points of the cells that were not
    halved are computed. A cell in which one has another label is halved as well, and
    the number of these bounds the missed area (by Clopper and Pearson, at 95 %, before
    that correction). Where two labels are mixed throughout, halving gives no line: the
    cells between these two are left out, the uncertainty exponent says why, and
    `refine_complete` is 0.

    **Arguments:**

    - `point`: the point of `coarse`, a function of its two axes; or a `Program` of it,
        which is not traced again and has its own threads and batches.
    - `coarse`: a sweep over two axes, in memory or opened from a store; points that
        `where` left out stay out.
    - `label`: the variable whose changes are followed, of codes or integers;
        or several, e.g. `("outcome", "returns")`.
    - `width`: of the interval on a cell's edge in which the label changes, as a share
        of the axis's range; a band of undecided points between two labels may be wider.
        Where one of the two labels is undecided (`unsettled`, `undecided`, `slow` and
        the like, a failure) it is 1e-3, or `width` if larger: such borders move with
        the horizon. A pair states both widths.
    - `levels`: how often a cell is halved, both ways, on the way to a boundary.
    - `audit`: the number of random points in cells that were not halved. If none of k
        has another label than its cell, less than 3/k of their area has, at 95 %.
    - `max_points`: points that are computed at most.
    - `progress`: a bar of points; None shows it on a terminal only.

    **Returns:** `coarse`, and besides (q, mu and outcome stand for the names of axes
    and labels)

    - along `refined`, all points that were computed: `refined_q`, `refined_mu`, and
        each variable as `refined_...`;
    - along `vertex`, the lines' points in order: `boundary_q`, `boundary_mu`,
        `boundary_line` (the line's number), `boundary_width` (of the interval or the
        band, as a share of the axis's range) and, along `side`, both labels as
        `boundary_outcome`;
    - along `pair`, the labels that meet (`pair_outcome`), along `level` the share of
        the map in cells between them (`pair_area`), and `pair_exponent`: 1 where that
        halves from level to level, near 0 where it does not fall.

    Attributes `refine_...` hold the options, how many points were computed, whether all
    was followed to its end within them (`refine_complete`), the audit's points and how
    many had another label, the share of the map in cells that were not halved, and
    `refine_missed_area`, the bound of the share of the map with another label in these.

    **Raises:** `ValueError` for a dataset that is no sweep over two axes, or not of
    this `point`; for labels that are not integers; for widths and counts that break
    a rule.
    """
    widths = _widths(width)
    for name, count in (("levels", levels), ("audit", audit)):
        whole_number(name, count)
    whole_number("max_points", max_points)
    if levels > MOST_LEVELS:
        raise ValueError(
            f"Argument `levels` must be at most {MOST_LEVELS}, but is {levels}."
        )
    names = _labels(coarse, label)
    axes = _axes(coarse, names)
    parameters = [*axes, *numbers_of(coarse)]
    program = point if isinstance(point, Program) else Program(point, names=parameters)
    program.check(parameters, Lanes())
    search = BoundarySearch(
        coarse, axes, names, program, levels=levels, max_points=max_points
    )
    with tqdm(file=stream(), unit="point", disable=not shown(progress)) as bar:
        search.on_batch = lambda count, _: bar.update(count)
        search.check()
        search.follow()
        audited = search.audited(audit)
        search.mend(audited)
        lines = search.lines(*widths)
    return _dataset(search, lines, audited, widths)


def _widths(width: float | tuple[float, float]) -> tuple[float, float]:
    """The width, and that where nothing is known.

    **Raises:** `ValueError` for what breaks a rule.
    """
    one = width if isinstance(width, tuple) else (width,)
    if len(one) > 2:
        raise ValueError(f"Argument `width` must be one or two, but is {width!r}.")
    for value in one:
        number("width", value, "positive")
        if value < FINEST:
            raise ValueError(
                f"Argument `width` must be at least {FINEST:g}, near which places "
                f"are no longer told apart, but is {value:g}."
            )
    return one[0], one[1] if len(one) == 2 else max(one[0], UNKNOWN_WIDTH)


def _dataset(
    search: BoundarySearch, lines: Lines, audit: Audit, widths: tuple[float, float]
) -> xr.Dataset:
    """The coarse map with all that was computed."""
    ds = search.coarse.assign(
        {**_refined(search), **_boundary(search, lines), **_pairs(search)}
    )
    return ds.assign_attrs(
        refine_width=widths[0],
        refine_unknown_width=widths[1],
        refine_levels=search.cells.levels,
        refine_max_points=search.max_points,
        refine_points=search.points,
        refine_complete=int(search.complete),
        refine_audit_points=audit.points,
        refine_audit_mislabelled=len(audit.mislabelled),
        refine_whole_share=audit.share,
        refine_missed_area=audit.missed,
    )


def _refined(search: BoundarySearch) -> dict[str, tuple]:
    """All points that were computed."""
    values = {
        name: np.concatenate([part[name] for part in search.computed])
        for name in [*search.axes, *search.program.variables]
    }
    data: dict[str, tuple] = {
        f"refined_{name}": ("refined", values[name], search.coarse[name].attrs)
        for name in search.axes
    }
    for name, variable in search.program.variables.items():
        dims = ("refined", *variable.dims)
        data[f"refined_{name}"] = dims, values[name], attributes_of(variable)
    return data


def _boundary(search: BoundarySearch, lines: Lines) -> dict[str, tuple]:
    """The lines' vertices, in order."""
    half = lines.width[:, None] / 2
    at, low, high = (
        search.values(lines.places + shift) for shift in (0.0, -half, half)
    )
    widths = [(high[n] - low[n]) / np.ptp(axis) for n, axis in search.axes.items()]
    about = {"long_name": "width of the interval, of the axis's range", "units": "1"}
    return {
        **{f"boundary_{n}": ("vertex", at[n], search.coarse[n].attrs) for n in at},
        "boundary_width": ("vertex", np.choose(lines.along, widths), about),
        "boundary_line": ("vertex", lines.line, {"long_name": "number of the line"}),
        **_sides(search, "boundary", "vertex", lines.pair),
    }


def _sides(
    search: BoundarySearch, kind: str, dim: str, pairs: np.ndarray
) -> dict[str, tuple]:
    """Both labels of each pair."""
    values = search.label_values(labels_of_pair(pairs))
    return {
        f"{kind}_{name}": ((dim, "side"), values[name], search.coarse[name].attrs)
        for name in search.names
    }


def _pairs(search: BoundarySearch) -> dict[str, tuple]:
    """How the area between labels falls from level to level."""
    levels = range(search.cells.levels + 1)
    by_level = [search.cells.unlike_areas(level, search.areas) for level in levels]
    pairs = sorted({pair for areas in by_level for pair in areas})
    table = np.array([[areas.get(p, 0.0) for areas in by_level] for p in pairs])
    table = table.reshape(len(pairs), len(by_level))
    share = {"long_name": "share of the map in cells between both", "units": "1"}
    slope = {"long_name": "uncertainty exponent, 1 of a line", "units": "1"}
    return {
        **_sides(search, "pair", "pair", np.array(pairs, int)),
        "pair_area": (("pair", "level"), table / search.map_area(), share),
        "pair_exponent": ("pair", np.array([exponent(row) for row in table]), slope),
    }


# Names in the result beside those of axes and labels.
TAKEN = ("line", "width", "area", "exponent")


def _labels(coarse: xr.Dataset, label: str | Sequence[str]) -> tuple[str, ...]:
    """The names of the labels.

    **Raises:** `ValueError` for what is no variable of the dataset.
    """
    if not isinstance(coarse, xr.Dataset):
        raise ValueError(
            "Argument `coarse` must be a dataset from `sweep`, but is a "
            f"{type(coarse).__name__}."
        )
    names = tuple(label) if isinstance(label, tuple | list) else (str(label),)
    known = [str(name) for name in coarse.data_vars]
    if not names or len(set(names)) < len(names) or not set(names) <= set(known):
        raise ValueError(
            "Argument `label` must be a variable of the dataset, or several unlike "
            f"ones, of {', '.join(known)}, but is {label!r}."
        )
    refined = [name for name in known if name.startswith(("refined_", "boundary_"))]
    if refined:
        raise ValueError(
            "Argument `coarse` must not be refined already, but holds "
            f"`{refined[0]}`: refine the sweep itself, by all its labels at once."
        )
    for name in (*names, *map(str, coarse[names[0]].dims)):
        if name in TAKEN:
            raise ValueError(
                f"Axes and labels of `coarse` must not be named `{name}`, as a number "
                "of the result is: rename it."
            )
    return names


def _axes(coarse: xr.Dataset, names: tuple[str, ...]) -> dict[str, np.ndarray]:
    """The two axes of a sweep, rising."""
    dims = coarse[names[0]].dims
    if len(dims) != 2 or any(set(coarse[n].dims) != set(dims) for n in names):
        raise ValueError(
            "Argument `coarse` must be a sweep over two axes with one label a point, "
            f"but `{names[0]}` has the dimensions {', '.join(map(str, dims))}."
        )
    axes = {}
    for dim in map(str, dims):
        if dim not in coarse.coords or coarse[dim].size < 2:
            raise ValueError(
                f"Axis `{dim}` of `coarse` must be an axis of its own with two values "
                f"at least, and a cell between them, but has {coarse[dim].size}."
            )
        values = np.asarray(coarse[dim].values, float)
        if not (np.diff(values) > 0).all():
            raise ValueError(
                f"Axis `{dim}` of `coarse` must rise: write `coarse.sortby({dim!r})`."
            )
        axes[dim] = values
    return axes
