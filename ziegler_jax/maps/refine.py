"""From a coarse map to its boundaries."""

from collections.abc import Callable, Sequence

import numpy as np
import xarray as xr
from tqdm import tqdm

from ..numerics.numbers import instance
from ..results import labels as attributes_of
from ..sweep.axes import Returned
from ..sweep.lanes import Lanes
from ..sweep.once import Program
from ..sweep.progress import shown, stream
from .cells import exponent
from .lines import Line
from .study import Audit, Fineness, Study


def refine(
    point: Callable[..., Returned],
    coarse: xr.Dataset,
    label: str | Sequence[str] = "outcome",
    *,
    fineness: Fineness = Fineness(),  # noqa: B008, a value
    lanes: Lanes = Lanes(),  # noqa: B008, a value
    progress: bool | None = None,
) -> xr.Dataset:
    r"""The boundaries of a map, from a coarse sweep of the same scene.

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
    the changes are joined to lines. At last random points of the cells that stayed
    whole are computed: where one has another label its cell is halved as well, and how
    many have bounds the area that is missed (Clopper and Pearson's, at 95 %, before
    that mending). Where two labels are mixed throughout, halving brings no line: the
    cells between these two are left, wherever they lie, the uncertainty exponent says
    why, and `refine_complete` is 0.

    **Arguments:**

    - `point`: the scene of `coarse`, a function of its two axes.
    - `coarse`: a sweep over two axes, in memory or opened from a store; points that
        `where` left out stay out.
    - `label`: the variable whose changes are followed, one of codes or whole numbers;
        or several, e.g. `("outcome", "returns")`.
    - `fineness`: how finely, see `Fineness`.
    - `lanes`: how lanes run, see `Lanes`.
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
    many had another label, the share of the map in cells that stayed whole, and
    `refine_missed_area`, the bound of the share of the map with another label in these.

    **Raises:** `ValueError` for a dataset that is no sweep over two axes, or not of
    this `point`; for labels that are no whole numbers.
    """
    instance("fineness", fineness, Fineness)
    instance("lanes", lanes, Lanes)
    names = _labels(coarse, label)
    axes = _axes(coarse, names)
    program = Program(point, names=[*axes], lanes=lanes)
    study = Study(coarse, axes, names, program, fineness)
    with tqdm(file=stream(), unit="point", disable=not shown(progress)) as bar:
        study.tell = lambda count, _: bar.update(count)
        study.check()
        complete = study.grow(study.unlike())
        audit = study.audited()
        complete &= study.grow(study.forced(audit.strangers))
        boundaries = study.lines()
    return _dataset(study, boundaries, audit, complete and study.is_complete())


def _dataset(
    study: Study, boundaries: list[Line], audit: Audit, complete: bool
) -> xr.Dataset:
    """The coarse map with all that was found."""
    ds = study.coarse.assign(
        {**_refined(study), **_boundary(study, boundaries), **_pairs(study)}
    )
    fineness = study.fineness
    return ds.assign_attrs(
        refine_width=fineness.width,
        refine_unknown_width=fineness.unknown_width,
        refine_levels=fineness.levels,
        refine_max_points=fineness.max_points,
        refine_points=study.points,
        refine_complete=int(complete),
        refine_audit_points=audit.points,
        refine_audit_strangers=len(audit.strangers),
        refine_whole_share=audit.share,
        refine_missed_area=audit.missed,
    )


def _refined(study: Study) -> dict[str, tuple]:
    """All points that were computed."""
    whole = {
        name: np.concatenate([part[name] for part in study.computed])
        for name in [*study.axes, *study.program.variables]
    }
    data = {}
    for name, values in whole.items():
        if name in study.axes:
            data[f"refined_{name}"] = "refined", values, study.coarse[name].attrs
        else:
            variable = study.program.variables[name]
            dims = ("refined", *variable.dims)
            data[f"refined_{name}"] = dims, values, attributes_of(variable)
    return data


def _boundary(study: Study, boundaries: list[Line]) -> dict[str, tuple]:
    """The lines' vertices, in order."""
    rows = {code: row for row, code in study.codes.items()}
    vertices = [(n, v) for n, line in enumerate(boundaries) for v in line.vertices]
    sides = [line.pair for line in boundaries for _ in line.vertices]
    data: dict[str, tuple] = {}
    widths = np.zeros(len(vertices))
    for i, (name, axis) in enumerate(study.axes.items()):
        places = np.array([v[i] for _, v in vertices]) / study.cells.unit
        at = np.interp(places, np.arange(axis.size), axis)
        data[f"boundary_{name}"] = "vertex", at, study.coarse[name].attrs
        half = np.array([v.width / 2 for _, v in vertices]) / study.cells.unit
        ends = [
            np.interp(places + s * half, np.arange(axis.size), axis) for s in (-1, 1)
        ]
        mine = np.array([v.along == i for _, v in vertices], bool)
        widths = np.where(mine, (ends[1] - ends[0]) / np.ptp(axis), widths)
    about = {"long_name": "width of the interval, of the axis's range", "units": "1"}
    data["boundary_width"] = "vertex", widths, about
    numbers = np.array([n for n, _ in vertices], int)
    data["boundary_line"] = "vertex", numbers, {"long_name": "number of the line"}
    for part, name in enumerate(study.names):
        both = [[rows[one][part], rows[other][part]] for one, other in sides]
        values = np.array(both, int).reshape(-1, 2)
        attrs = study.coarse[name].attrs
        data[f"boundary_{name}"] = ("vertex", "side"), values, attrs
    return data


def _pairs(study: Study) -> dict[str, tuple]:
    """How the area between labels falls from level to level."""
    rows = {code: row for row, code in study.codes.items()}
    by_level = [
        study.cells.unlike_areas(n, study.area) for n in range(study.cells.levels + 1)
    ]
    pairs = sorted({pair for areas in by_level for pair in areas})
    table = np.array([[a.get(p, 0.0) for a in by_level] for p in pairs])
    table = table.reshape(len(pairs), len(by_level))
    total = study.map_area()
    data: dict[str, tuple] = {}
    for part, name in enumerate(study.names):
        both = [[rows[one][part], rows[other][part]] for one, other in pairs]
        values = np.array(both, int).reshape(-1, 2)
        data[f"pair_{name}"] = ("pair", "side"), values, study.coarse[name].attrs
    about = {"long_name": "share of the map in cells between both", "units": "1"}
    data["pair_area"] = ("pair", "level"), table / total, about
    slopes = np.array([exponent(list(row)) for row in table])
    about = {"long_name": "uncertainty exponent, 1 of a line", "units": "1"}
    data["pair_exponent"] = "pair", slopes, about
    return data


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
