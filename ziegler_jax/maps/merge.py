"""Sweeps of one scene, made one."""

from collections.abc import Hashable

import numpy as np
import xarray as xr

from ..numerics.numbers import instance

# What a run has cost, and how it went: of several runs it is the sum, or nothing.
SUMS = ("points", "points_done", "compile_seconds", "run_seconds", "canary_checks")
SUMS += ("canary_mismatches",)
OF_A_RUN = {"points_per_second", "useful_step_fraction", "threads", "batch_size"}
OF_A_RUN |= {"blocks", "blocks_done", "scene_function"}  # where its code was
LABELS = ("long_name", "units", "symbol", "flag_values", "flag_meanings", "comment")


def merge(*sweeps: xr.Dataset) -> xr.Dataset:
    """The union of sweeps of one scene: longer axes, finer ones, missing points.

    ```python
    def point(q):
        return zj.critical_load(zj.uniform_rods(q=1.0, kappa=q))

    one = zj.sweep(point, q=[0.5, 1.0, 2.0])
    other = zj.sweep(point, q=[1.5, 2.0, 3.0])
    ds = zj.merge(one, other)  # q = 0.5, 1, 1.5, 2, 3
    ```

    A number that several hold must be the same in all, to the last bit; where one holds
    NaN that of the other counts, and what none holds is NaN, its codes `not_computed`.
    Values of axes are the same if all their bits are.

    **Arguments:** `sweeps`: of the same scene, options, versions and precision, over
    axes of the same names, whatever their values. (Samples have no axis: join them by
    `xr.concat` along their dimension.)

    **Returns:** a dataset over the unions of the axes, rising. Of the attributes,
    points and seconds are sums; what else belongs to a run (threads, batches, an audit)
    is left out.

    **Raises:** `ValueError` that names what differs: a variable, an attribute, a point.
    """
    if not sweeps:
        raise ValueError("Arguments of `merge` must be datasets, but there are none.")
    for number, ds in enumerate(sweeps):
        instance(f"sweeps[{number}]", ds, xr.Dataset)
        along = [n for n, c in ds.coords.items() if c.ndim and n not in ds.indexes]
        if along:
            raise ValueError(
                f"Argument `sweeps[{number}]` must be over axes, but its `{along[0]}` "
                f"has values along `{ds[along[0]].dims[0]}`: join samples by "
                "`xr.concat` along their dimension."
            )
    first = sweeps[0]
    for number, ds in enumerate(sweeps[1:], start=1):
        _check_same_scene(first, ds, number)
    # of a sweep its parameters; labels of results (joint, rod) are in all the same
    axes = {
        name: np.unique(np.concatenate([ds[name].values for ds in sweeps]))
        for name in map(str, first.indexes)
    }
    data: dict[Hashable, tuple] = {}
    for name, variable in first.data_vars.items():
        shape = [
            axes[str(d)].size if str(d) in axes else variable.sizes[d]
            for d in variable.dims
        ]
        fill = np.nan if variable.dtype.kind in "fc" else 0
        whole, there = np.full(shape, fill, variable.dtype), np.zeros(shape, bool)
        for ds in sweeps:
            _put(str(name), whole, there, ds[name], axes)
        data[name] = variable.dims, whole, _labels(variable)
    coords = {name: (first[name].dims, axes[name], first[name].attrs) for name in axes}
    still = {n: fixed for n, fixed in first.coords.items() if fixed.ndim == 0}
    return xr.Dataset(data, {**coords, **still}, _attributes(sweeps))


def _put(
    name: str,
    whole: np.ndarray,
    there: np.ndarray,
    part: xr.DataArray,
    axes: dict[str, np.ndarray],
) -> None:
    """Put a sweep's numbers in their places.

    **Raises:** `ValueError` where another number is there.
    """
    places = [
        np.searchsorted(axes[str(d)], part[d].values)
        if str(d) in axes
        else np.arange(n)
        for d, n in part.sizes.items()
    ]
    at, values = np.ix_(*places), part.values
    known = ~np.isnan(values) if values.dtype.kind in "fc" else values != 0
    before, twice = whole[at], known & there[at]
    unlike = twice & (before != values)
    if unlike.any():
        where = np.argwhere(unlike)[0]
        point = ", ".join(
            f"{d} = {part[d].values[i]:.17g}"
            for d, i in zip(part.dims, where, strict=True)
            if str(d) in axes and part[d].dtype.kind in "iuf"
        )
        raise ValueError(
            f"Arguments of `merge` must agree where they meet, but `{name}` is "
            f"{before[tuple(where)]} and {values[tuple(where)]} at {point}."
        )
    whole[at] = np.where(known, values, before)
    there[at] |= known


def _check_same_scene(first: xr.Dataset, other: xr.Dataset, number: int) -> None:
    """Refuse sweeps of different scenes."""

    def refuse(what: str, one: object, two: object) -> None:
        raise ValueError(
            f"Argument `sweeps[{number}]` must be of the scene of the first, but "
            f"{what} {two!r}, not {one!r}."
        )

    for what, names in (
        ("has the axes and labels", [ds.indexes for ds in (first, other)]),
        ("holds", [ds.data_vars for ds in (first, other)]),
    ):
        one, two = (sorted(map(str, some)) for some in names)
        if one != two:
            refuse(what, one, two)
    for name, variable in first.data_vars.items():
        if other[name].dims != variable.dims:
            refuse(f"its `{name}` has the dimensions", variable.dims, other[name].dims)
        if other[name].dtype != variable.dtype:
            refuse(f"its `{name}` has the type", variable.dtype, other[name].dtype)
        loose = [d for d in variable.dims if d not in first.indexes]
        if any(other[name].sizes[d] != variable.sizes[d] for d in loose):
            refuse(f"its `{name}` has the sizes", variable.sizes, other[name].sizes)
    for name, fixed in first.coords.items():
        if fixed.ndim == 0 and not fixed.equals(other.coords.get(name, xr.DataArray())):
            refuse(f"its `{name}` is", fixed.item(), other.coords.get(name))
    ours, theirs = _of_the_scene(first), _of_the_scene(other)
    for key in sorted({*ours, *theirs}):
        if not _same(ours.get(key), theirs.get(key)):
            refuse(f"its attribute `{key}` is", ours.get(key), theirs.get(key))


def _of_the_scene(ds: xr.Dataset) -> dict[str, object]:
    """The attributes that say what was computed."""
    run = OF_A_RUN | set(SUMS)
    named = {str(key): value for key, value in ds.attrs.items()}
    return {k: v for k, v in named.items() if k not in run and k[:6] != "audit_"}


def _same(one: object, other: object) -> bool:
    return (
        one is not None
        and other is not None
        and np.array_equal(np.asarray(one), np.asarray(other))
    )


def _labels(variable: xr.DataArray) -> dict[Hashable, object]:
    """What a variable is, without an audit of it."""
    return {k: v for k, v in variable.attrs.items() if k in LABELS}


def _attributes(sweeps: tuple[xr.Dataset, ...]) -> dict[str, object]:
    """The scene's, and what the runs cost together."""
    sums = {
        key: sum(ds.attrs[key] for ds in sweeps)
        for key in SUMS
        if all(key in ds.attrs for ds in sweeps)
    }
    code = {k: v for k, v in sweeps[0].attrs.items() if k == "scene_function"}
    return _of_the_scene(sweeps[0]) | code | sums
