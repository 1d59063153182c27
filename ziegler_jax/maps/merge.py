"""Sweeps of one scene, made one."""

from collections.abc import Hashable, Sequence
from typing import Literal, NamedTuple

import numpy as np
import xarray as xr

from ..numerics.numbers import choice, instance

# What a run has cost, and how it went: of several runs it is the sum, or nothing.
SUMS = ("points", "points_done", "compile_seconds", "run_seconds", "canary_checks")
SUMS += ("canary_mismatches",)
OF_A_RUN = {"points_per_second", "useful_step_fraction", "threads", "batch_size"}
OF_A_RUN |= {"blocks", "blocks_done"}
LABELS = ("long_name", "units", "symbol", "flag_values", "flag_meanings", "comment")
# Of these a digest depends, of the others (NumPy, Python) the digest sees what matters.
VERSIONS = ("ziegler_jax_version", "jax_version", "jaxlib_version", "diffrax_version")
DIGEST, NO_DIGEST = "scene_digest", "none"
# What people read of a scene, and no more: the first sweep's stays.
RECORD = {"scene", "scene_axes", "scene_function", "scene_constants"}
RECORD |= {"numpy_version", "python_version"}
NEAR = 1e-9  # of the smaller gap beside two values of an axis that are taken for one


def merge(*sweeps: xr.Dataset, versions: Literal["same", "any"] = "same") -> xr.Dataset:
    """The union of sweeps of one scene: longer axes, finer ones, missing points.

    ```python
    def point(q):
        return zj.critical_load(zj.uniform_rods(q=1.0, kappa=q))

    one = zj.sweep(point, q=[0.5, 1.0, 2.0])
    other = zj.sweep(point, q=[1.5, 2.0, 3.0])
    ds = zj.merge(one, other)  # q = 0.5, 1, 1.5, 2, 3
    ```

    Sweeps are of one scene if their `scene_digest` is one: that of what JAX traced,
    with all numbers in it.

    A number that several hold must be the same in all, to the last bit; where one holds
    NaN that of the other counts, and what none holds is NaN, its codes `not_computed`.

    Two values $a$, $b$ of an axis, in two sweeps, are one if
    $|a - b| < 10^{-9} g$, where $g$ is the smallest gap beside them, to the next value
    of the one and of the other; $g$ is their magnitude where neither has a next. So
    `np.arange(1, 1.5, 0.1)` and `np.linspace(1, 1.4, 5)` are one axis. The first
    dataset's coordinate stays, and so does a cell that it has computed.

    **Arguments:**

    - `sweeps`: of the same scene and options, over axes of the same names,
        whatever their values. (Samples have no axis: join them by `xr.concat` along
        their dimension.)
    - `versions`: `"any"` consents to sweeps of several versions of this package, JAX,
        jaxlib or diffrax. A digest changes with these, so that it is then upon you that
        the scene is one; numbers that meet must still be the same.

    **Returns:** a dataset over the unions of the axes, rising. Of the attributes,
    points and seconds are sums; several versions and their digests stand behind each
    other; what people read of a scene (its source, `scene_constants`) is the first
    one's; what else belongs to a run (threads, batches, an audit) is left out.

    **Raises:** `ValueError` that names what differs: a variable, an attribute, a point.
    """
    choice("versions", versions, ("same", "any"))
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
        _check_same_scene(first, ds, number, consent=versions == "any")
    # of a sweep its parameters; labels of results (joint, rod) are in all the same
    axes = {
        name: _union([ds[name].values for ds in sweeps])
        for name in map(str, first.indexes)
    }
    new = _new_cells(sweeps, axes)
    data: dict[Hashable, tuple] = {}
    for name, variable in first.data_vars.items():
        shape = [
            axes[str(d)].values.size if str(d) in axes else variable.sizes[d]
            for d in variable.dims
        ]
        fill = np.nan if variable.dtype.kind in "fc" else 0
        whole, there = np.full(shape, fill, variable.dtype), np.zeros(shape, bool)
        for number, ds in enumerate(sweeps):
            at = _places(ds[name].variable, axes, number)
            _put(whole, there, ds[name], at, new[number])
        data[name] = variable.dims, whole, _labels(variable)
    coords = {
        name: (first[name].dims, axis.values, first[name].attrs)
        for name, axis in axes.items()
    }
    still = {n: fixed for n, fixed in first.coords.items() if fixed.ndim == 0}
    return xr.Dataset(data, {**coords, **still}, _attributes(sweeps))


class Axis(NamedTuple):
    """The values of several sweeps along one dimension, rising.

    `places`: of each sweep's values in it; `same`: whether they are there to the last
    bit, or another sweep's that is near stands for them.
    """

    values: np.ndarray
    places: list[np.ndarray]
    same: list[np.ndarray]


def _union(parts: Sequence[np.ndarray]) -> Axis:
    """All values, of two that are near the first dataset's."""
    whole = np.unique(parts[0])
    if whole.dtype.kind == "f":
        for part in parts[1:]:
            values = np.unique(part)
            stands = _near(whole, values)
            whole = np.unique(np.concatenate([whole, values[np.isnan(stands)]]))
    else:
        whole = np.unique(np.concatenate(parts))
    places, same = [], []
    for part in parts:
        behind = np.searchsorted(whole, part).clip(0, whole.size - 1)
        if whole.dtype.kind == "f":  # the nearest one
            before = (behind - 1).clip(0)
            nearer = np.abs(part - whole[before]) < np.abs(part - whole[behind])
            behind = np.where(nearer, before, behind)
        places.append(behind)
        same.append(whole[behind] == part)
    return Axis(whole, places, same)


def _near(known: np.ndarray, values: np.ndarray) -> np.ndarray:
    """For each value the known one that it is taken for, or NaN; both rise."""
    behind = np.searchsorted(known, values).clip(0, known.size - 1)
    before = (behind - 1).clip(0)
    nearer = np.abs(values - known[before]) < np.abs(values - known[behind])
    place = np.where(nearer, before, behind)
    nearest = known[place]
    gap = np.minimum(_gaps(known)[place], _gaps(values))
    size = np.maximum(np.abs(nearest), np.abs(values))
    gap = np.where(np.isfinite(gap), gap, size)
    one = (np.abs(values - nearest) < NEAR * gap) | (values == nearest)
    return np.where(one, nearest, np.nan)


def _gaps(values: np.ndarray) -> np.ndarray:
    """The smaller distance of each value to its neighbours; infinite for one alone."""
    between = np.concatenate([[np.inf], np.diff(values), [np.inf]])
    return np.minimum(between[:-1], between[1:])


def _places(
    part: xr.Variable, axes: dict[str, Axis], number: int
) -> tuple[np.ndarray, ...]:
    """Where the values of a sweep stand in the union."""
    sizes = zip(map(str, part.dims), part.shape, strict=True)
    return np.ix_(
        *(axes[d].places[number] if d in axes else np.arange(n) for d, n in sizes)
    )


def _known(values: np.ndarray) -> np.ndarray:
    """Which numbers have been computed."""
    return ~np.isnan(values) if values.dtype.kind in "fc" else values != 0


def _new_cells(
    sweeps: Sequence[xr.Dataset], axes: dict[str, Axis]
) -> list[xr.Variable]:
    """The cells that each sweep may fill: not those that another near it has filled.

    A cell is a place along the dimensions that all variables have.
    """
    variables = sweeps[0].data_vars.values()
    dims = [d for d in axes if all(d in v.dims for v in variables)]
    filled = np.zeros([axes[d].values.size for d in dims], bool)
    new = []
    for number, ds in enumerate(sweeps):
        here, same = np.zeros([ds.sizes[d] for d in dims], bool), np.ones((), bool)
        for d in dims:
            same = np.logical_and.outer(same, axes[d].same[number])
        cells = xr.Variable(dims, here)
        at = _places(cells, axes, number)
        new.append(xr.Variable(dims, same | ~filled[at]))
        for variable in ds.data_vars.values():
            inside = [d for d in variable.dims if d not in dims]
            known = xr.Variable(variable.dims, _known(variable.values))
            here |= known.any(inside).transpose(*dims).values
        filled[at] |= here
    return new


def _put(
    whole: np.ndarray,
    there: np.ndarray,
    part: xr.DataArray,
    at: tuple[np.ndarray, ...],
    new: xr.Variable,
) -> None:
    """Put the numbers of a sweep in their places.

    **Raises:** `ValueError` where another number is there.
    """
    values, before, already = part.values, whole[at], there[at]
    known = _known(values) & new.set_dims(dict(part.sizes)).values
    unlike = known & already & (before != values)
    if unlike.any():
        where = np.argwhere(unlike)[0]
        point = ", ".join(
            f"{d} = {part[d].values[i]:.17g}"
            for d, i in zip(part.dims, where, strict=True)
            if d in part.indexes and part[d].dtype.kind in "iuf"
        )
        raise ValueError(
            f"Arguments of `merge` must agree where they meet, but `{part.name}` is "
            f"{before[tuple(where)]} and {values[tuple(where)]} at {point}."
        )
    whole[at] = np.where(known, values, before)
    there[at] |= known


def _check_same_scene(
    first: xr.Dataset, other: xr.Dataset, number: int, consent: bool
) -> None:
    """Refuse sweeps of different scenes, and without consent of different versions."""

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
    _check_digests(first, other, number, consent)
    ours, theirs = _of_the_scene(first), _of_the_scene(other)
    for key in sorted({*ours, *theirs}):
        if not _same(ours.get(key), theirs.get(key)):
            refuse(f"its attribute `{key}` is", ours.get(key), theirs.get(key))


def _check_digests(
    first: xr.Dataset, other: xr.Dataset, number: int, consent: bool
) -> None:
    """Refuse sweeps whose point is another program, as far as that can be told."""
    for key in VERSIONS:
        here, there = (ds.attrs.get(key) for ds in (first, other))
        if here != there:
            if consent:
                return
            raise ValueError(
                f"Argument `sweeps[{number}]` must be of the versions of the first, but"
                f" its `{key}` is {there!r}, not {here!r}: whether two versions "
                "computed one scene no digest tells. Where you know that they did, "
                '`versions="any"` merges them.'
            )
    here, there = (ds.attrs.get(DIGEST) for ds in (first, other))
    for place, digest in ((0, here), (number, there)):
        if digest in (None, NO_DIGEST):
            why = (
                "has no attribute `scene_digest`, by which a scene is known"
                if digest is None
                else "is of a point with host callbacks, by which no scene is known"
            )
            raise ValueError(
                f"Argument `sweeps[{place}]` must be of a scene that is known, but it "
                f"{why}: join such datasets by xarray's own tools."
            )
    if here != there:
        raise ValueError(
            f"Argument `sweeps[{number}]` must be of the scene of the first, but its"
            f" `{DIGEST}` is {there!r}, not {here!r}: its `point` is another program, "
            "or has other numbers in it."
        )


def _of_the_scene(ds: xr.Dataset) -> dict[str, object]:
    """The attributes that say what was computed, beside the digest and versions."""
    apart = OF_A_RUN | set(SUMS) | RECORD | {DIGEST, *VERSIONS}
    named = {str(key): value for key, value in ds.attrs.items()}
    return {k: v for k, v in named.items() if k not in apart and k[:6] != "audit_"}


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
    record = {k: v for k, v in sweeps[0].attrs.items() if k in RECORD}
    several = {
        key: ", ".join(dict.fromkeys(str(ds.attrs[key]) for ds in sweeps))
        for key in (*VERSIONS, DIGEST)
        if all(key in ds.attrs for ds in sweeps)
    }
    return {**several, **record, **_of_the_scene(sweeps[0]), **sums}
