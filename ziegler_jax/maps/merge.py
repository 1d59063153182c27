"""The union of several sweeps of one point."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from typing import Literal

import numpy as np
import xarray as xr

from ..numerics.rules import choice, instance
from ..results import MEANING

# What a run has cost, and how it went: of several runs it is the sum, or nothing.
SUMS = ("points", "points_done", "compile_seconds", "run_seconds", "canary_checks")
SUMS += ("canary_mismatches",)
OF_A_RUN = {"points_per_second", "useful_step_fraction", "threads", "batch_size"}
OF_A_RUN |= {"blocks", "blocks_done"}
# Of these a digest depends, of the others (NumPy, Python) the digest sees what matters.
VERSIONS = ("ziegler_jax_version", "jax_version", "jaxlib_version", "diffrax_version")
DIGEST, NO_DIGEST = "scene_digest", "none"
# What people read of a scene, and no more: the first sweep's stays.
RECORD = {"scene", "scene_axes", "scene_function"}
RECORD |= {"numpy_version", "python_version"}
NEAR = 1e-9  # of the smaller gap beside two values of an axis that are taken for one


def merge(*sweeps: xr.Dataset, versions: Literal["same", "any"] = "same") -> xr.Dataset:
    """The union of sweeps of one point: longer axes, finer ones, missing points.

    ```python
    def point(q):
        return zj.critical_load(zj.uniform_rods(q=1.0, kappa=q))

    one = zj.sweep(point, q=[0.5, 1.0, 2.0])
    other = zj.sweep(point, q=[1.5, 2.0, 3.0])
    ds = zj.merge(one, other)  # q = 0.5, 1, 1.5, 2, 3
    ```

    Sweeps must have the same `scene_digest`, a hash of the traced equations with all
    numbers in them, and the same units and lists of codes, which are not part of it
    (`units`, `si_unit`, `flag_values`, `flag_meanings`).

    Numbers that several sweeps have must be equal to the last bit. Where one has NaN
    the number of the other counts; a point that none has is NaN, with the code
    `not_computed`.

    Two values $a$, $b$ of an axis, in two sweeps, are one if
    $|a - b| < 10^{-9} g$, where $g$ is the smallest gap beside them, to the next value
    of the one and of the other; $g$ is their magnitude where neither has a next. So
    `np.arange(1, 1.5, 0.1)` and `np.linspace(1, 1.4, 5)` are one axis. The first
    dataset's coordinate stays, and of each cell the numbers of the first dataset that
    has computed it; only what is computed at the same coordinates, to the last bit,
    must be the same.

    **Arguments:**

    - `sweeps`: of the same point and options, over axes of the same names, with any
        values. (Samples have no axis: join them by `xr.concat` along their dimension.
        What `follow_again` marked hangs on the cells beside: merge first, mark then, or
        leave out `again` and `outcome_again` by `drop_vars`.)
    - `versions`: `"any"` consents to sweeps of several versions of this package, JAX,
        jaxlib or diffrax. A digest changes with these: you vouch that the point is the
        same. Two sweeps of the same versions must still have the same digest, and
        common numbers must still be equal.

    **Returns:** a dataset over the unions of the axes, rising. Of the attributes,
    points and seconds are sums; several versions and their digests are listed one after
    the other; the source of the point is that of the first sweep; other attributes of a
    run (threads, batches) are left out.

    **Raises:** `ValueError` that names what differs: a variable, an attribute, a point;
    and for a point with host callbacks, which has no digest.
    """
    choice("versions", versions, ("same", "any"))
    if not sweeps:
        raise ValueError("Arguments of `merge` must be datasets, but there are none.")
    for number, ds in enumerate(sweeps):
        instance(f"sweeps[{number}]", ds, xr.Dataset)
    _check_axes(sweeps)
    _check_digests(sweeps, consent=versions == "any")
    _check_facts(sweeps)
    first, aligned = sweeps[0], _aligned(sweeps)
    numbers: dict[Hashable, xr.DataArray] = {}
    for dims, names in _by_cells(sweeps).items():
        numbers |= _union(aligned, dims, names)
    data = {
        n: (v.dims, numbers[n].transpose(*v.dims).values, v.attrs)
        for n, v in first.data_vars.items()
    }
    axes = {n: (v.dims, aligned[0][n].values, v.attrs) for n, v in first.coords.items()}
    return xr.Dataset(data, axes, _attributes(sweeps))


# Axes and cells -----------------------------------------------------------------------


def _aligned(sweeps: Sequence[xr.Dataset]) -> list[xr.Dataset]:
    """The sweeps over the unions of their axes, rising, with gaps.

    Of two near values the earlier dataset's is the axis's; `_own(axis)` has each
    dataset's own ones.
    """
    first, moved = sweeps[0], []
    known = {d: np.unique(first[d].values) for d in map(str, first.indexes)}
    for ds in sweeps:
        stand = {d: _stand_ins(known[d], ds[d].values) for d in known}
        known = {d: np.union1d(known[d], stand[d]) for d in known}
        own = {_own(d): (d, ds[d].values) for d in known}
        moved.append(ds.assign(own).assign_coords(stand))
    codes = {n: v for n, v in first.data_vars.items() if v.dtype.kind not in "fc"}
    gaps = {n: v.dtype.type(0) for n, v in codes.items()}
    return [ds.reindex(known, fill_value=gaps) for ds in moved]


def _own(axis: str) -> str:
    """The name of the variable with a dataset's own values of an axis."""
    return f"own values of {axis}"


def _stand_ins(known: np.ndarray, part: np.ndarray) -> np.ndarray:
    """For each value the known one that it is taken for, else itself."""
    values = np.unique(part)
    behind = np.searchsorted(known, values).clip(0, known.size - 1)
    before = (behind - 1).clip(0)
    nearer = np.abs(values - known[before]) < np.abs(values - known[behind])
    place = np.where(nearer, before, behind)
    nearest = known[place]
    gap = np.minimum(_gaps(known)[place], _gaps(values))
    size = np.maximum(np.abs(nearest), np.abs(values))
    gap = np.where(np.isfinite(gap), gap, size)
    stand = np.where(np.abs(values - nearest) < NEAR * gap, nearest, values)
    return stand[np.searchsorted(values, part)]


def _gaps(values: np.ndarray) -> np.ndarray:
    """The smaller distance of each value to its neighbours; infinite for one alone."""
    between = np.concatenate([[np.inf], np.diff(values), [np.inf]])
    return np.minimum(between[:-1], between[1:])


def _by_cells(sweeps: Sequence[xr.Dataset]) -> dict[tuple[str, ...], list[Hashable]]:
    """The variables, by those of the sweeps' axes that they have.

    A place along these is a cell, whose numbers were all computed at one point. Along
    other dimensions (joint, rod), in all sweeps the same, lie the numbers of a point.
    """
    first = sweeps[0]
    named = str(first.attrs.get("scene_axes")).split(", ")
    own = [
        d
        for d in map(str, first.indexes)
        if d in named or any(not np.array_equal(first[d], ds[d]) for ds in sweeps)
    ]
    groups: dict[tuple[str, ...], list[Hashable]] = {}
    for name, variable in first.data_vars.items():
        groups.setdefault(tuple(d for d in own if d in variable.dims), []).append(name)
    return groups


def _union(
    aligned: Sequence[xr.Dataset], dims: tuple[str, ...], names: Sequence[Hashable]
) -> dict[Hashable, xr.DataArray]:
    """Variables with the numbers of all sweeps, cell by cell.

    A cell is of the first sweep that has computed it: of others, those at the same
    coordinates to the last bit have their say, and those near it have not.
    """
    whole = {name: aligned[0][name] for name in names}
    origin = {d: xr.DataArray(np.nan) for d in dims}  # each cell's own coordinates
    for ds in aligned:
        own = {d: ds[_own(d)] for d in dims}
        says, filled = xr.DataArray(True), xr.DataArray(False)
        for d in dims:
            says = says & (origin[d].isnull() | (origin[d] == own[d]))
        for name, before in whole.items():
            known = _known(ds[name]) & says
            _check_meeting(before, ds[name], known)
            whole[name] = ds[name].where(known, before)
            filled = filled | known.any([d for d in known.dims if d not in dims])
        origin = {d: x.fillna(own[d].where(filled)) for d, x in origin.items()}
    return whole


def _known(variable: xr.DataArray) -> xr.DataArray:
    """Which numbers have been computed."""
    return variable.notnull() if variable.dtype.kind in "fc" else variable != 0


def _check_meeting(one: xr.DataArray, two: xr.DataArray, known: xr.DataArray) -> None:
    """Refuse numbers that are `known` where another one is.

    **Raises:** `ValueError` with the first of them.
    """
    unlike = (one != two) & _known(one) & known
    if not unlike.any():
        return
    where = dict(zip(unlike.dims, np.argwhere(unlike.values)[0], strict=True))
    one, two = one[where], two[where]
    point = ", ".join(
        f"{d} = {two[d].item():.17g}"
        for d in where
        if d in two.coords and two[d].dtype.kind in "iuf"
    )
    raise ValueError(
        f"Arguments of `merge` must agree where they meet, but `{one.name}` is "
        f"{one.item()} and {two.item()}{' at ' if point else ''}{point}."
    )


# Refusals -----------------------------------------------------------------------------


def _check_axes(sweeps: Sequence[xr.Dataset]) -> None:
    """Refuse samples, whose parameters have values along another dimension."""
    for number, ds in enumerate(sweeps):
        along = [n for n, c in ds.coords.items() if c.ndim and n not in ds.indexes]
        if along:
            raise ValueError(
                f"Argument `sweeps[{number}]` must be over axes, but its `{along[0]}` "
                f"has values along `{ds[along[0]].dims[0]}`: join samples by "
                "`xr.concat` along their dimension."
            )


def _check_facts(sweeps: Sequence[xr.Dataset]) -> None:
    """Refuse a sweep of other variables, in other units, or with other options."""
    # xarray forgets attributes where a coordinate is assigned anew: others know them
    about: dict[Hashable, dict[str, object]] = {}
    for ds in sweeps:
        for name, axis in ds.coords.items():
            about[name] = {**axis.attrs, **about.get(name, {})}
    ours = _facts(sweeps[0], about)
    for number, ds in enumerate(sweeps):
        theirs = _facts(ds, about)
        for what in {**ours, **theirs}:
            one, two = ours.get(what), theirs.get(what)
            if not np.array_equal(np.asarray(one), np.asarray(two)):
                raise ValueError(
                    f"Argument `sweeps[{number}]` must be of the scene of the first, "
                    f"but {what} {two!r}, not {one!r}."
                )


def _facts(
    ds: xr.Dataset, about: Mapping[Hashable, Mapping[str, object]]
) -> dict[str, object]:
    """All that must be the same in sweeps of one scene, by the words of a refusal."""
    facts: dict[str, object] = {
        "has the axes and labels": sorted(map(str, ds.coords)),
        "holds": sorted(map(str, ds.data_vars)),
    }
    for name, v in ds.variables.items():
        attrs = {**about.get(name, {}), **v.attrs}
        facts[f"its `{name}` has the dimensions"] = sorted(map(str, v.dims))
        for key in MEANING:
            facts[f"the attribute `{key}` of its `{name}` is"] = attrs.get(key)
        if name in ds.data_vars:
            facts[f"its `{name}` has the type"] = v.dtype
            sizes = {d: n for d, n in v.sizes.items() if d not in ds.indexes}
            facts[f"its `{name}` has the sizes"] = sizes
        elif not v.ndim:
            facts[f"its `{name}` is"] = str(v.values)  # of NaN as well
    scene = _of_the_scene(ds).items()
    return facts | {f"its attribute `{key}` is": value for key, value in scene}


def _identities(ds: xr.Dataset) -> list[tuple[str, ...]]:
    """The versions and the digest of a sweep, or of each that a merged one is of."""
    known = [str(ds.attrs.get(key)).split(", ") for key in (*VERSIONS, DIGEST)]
    length = max(map(len, known))
    return [*zip(*(x if len(x) == length else x * length for x in known), strict=False)]


def _check_digests(sweeps: Sequence[xr.Dataset], consent: bool) -> None:
    """Refuse sweeps whose point is another program, as far as that can be told."""
    known: dict[tuple[str, ...], tuple[int, str]] = {}
    for number, ds in enumerate(sweeps):
        digest = ds.attrs.get(DIGEST)
        if digest in (None, NO_DIGEST):
            why = (
                "has no attribute `scene_digest`, by which a scene is known"
                if digest is None
                else "is of a point with host callbacks, by which no scene is known"
            )
            raise ValueError(
                f"Argument `sweeps[{number}]` must be of a scene that is known, but it "
                f"{why}: join such datasets by xarray's own tools."
            )
        for *here, digest in _identities(ds):
            if number and tuple(here) not in known and not consent:
                there = zip(VERSIONS, here, next(iter(known)), strict=True)
                key, two, one = next(pair for pair in there if pair[1] != pair[2])
                raise ValueError(
                    f"Argument `sweeps[{number}]` must be of the versions of the first,"
                    f" but its `{key}` is {two!r}, not {one!r}: whether two versions "
                    "computed one scene no digest tells. Where you know that they did, "
                    '`versions="any"` merges them.'
                )
            place, other = known.setdefault(tuple(here), (number, digest))
            if digest != other:
                raise ValueError(
                    f"Argument `sweeps[{number}]` must be of the scene of "
                    f"`sweeps[{place}]`, but its `{DIGEST}` is {digest!r}, not "
                    f"{other!r}: its `point` is another program, or has other numbers "
                    "in it."
                )


def _of_the_scene(ds: xr.Dataset) -> dict[str, object]:
    """The attributes that say what was computed, beside the digest and versions."""
    apart = OF_A_RUN | set(SUMS) | RECORD | {DIGEST, *VERSIONS}
    named = {str(key): value for key, value in ds.attrs.items()}
    return {k: v for k, v in named.items() if k not in apart}


def _attributes(sweeps: Sequence[xr.Dataset]) -> dict[str, object]:
    """The scene's, and what the runs cost together."""
    sums = {
        key: sum(ds.attrs[key] for ds in sweeps)
        for key in SUMS
        if all(key in ds.attrs for ds in sweeps)
    }
    record = {k: v for k, v in sweeps[0].attrs.items() if k in RECORD}
    unlike = dict.fromkeys(known for ds in sweeps for known in _identities(ds))
    columns = zip(*unlike, strict=True)
    several = {
        key: ", ".join(values if len({*values}) > 1 else values[:1])
        for key, values in zip((*VERSIONS, DIGEST), columns, strict=True)
        if all(key in ds.attrs for ds in sweeps)
    }
    return {**several, **record, **_of_the_scene(sweeps[0]), **sums}
