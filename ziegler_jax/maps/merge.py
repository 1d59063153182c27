"""Sweeps of one scene, made one."""

from collections.abc import Hashable, Mapping, Sequence
from typing import Literal, NamedTuple, NoReturn

import numpy as np
import xarray as xr

from ..numerics.numbers import choice, instance
from ..results import unlike_meaning

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
    """The union of sweeps of one scene: longer axes, finer ones, missing points.

    ```python
    def point(q):
        return zj.critical_load(zj.uniform_rods(q=1.0, kappa=q))

    one = zj.sweep(point, q=[0.5, 1.0, 2.0])
    other = zj.sweep(point, q=[1.5, 2.0, 3.0])
    ds = zj.merge(one, other)  # q = 0.5, 1, 1.5, 2, 3
    ```

    Sweeps are of one scene if their `scene_digest` is one: that of what JAX traced,
    with all numbers in it. Units and lists of codes are in no digest: they must be the
    same as well (`units`, `si_unit`, `flag_values`, `flag_meanings`).

    A number that several hold must be the same in all, to the last bit; where one holds
    NaN that of the other counts, and what none holds is NaN, its codes `not_computed`.

    Two values $a$, $b$ of an axis, in two sweeps, are one if
    $|a - b| < 10^{-9} g$, where $g$ is the smallest gap beside them, to the next value
    of the one and of the other; $g$ is their magnitude where neither has a next. So
    `np.arange(1, 1.5, 0.1)` and `np.linspace(1, 1.4, 5)` are one axis. The first
    dataset's coordinate stays, and of each cell the numbers of the first dataset that
    has computed it; only what is computed at the same coordinates, to the last bit,
    must be the same.

    **Arguments:**

    - `sweeps`: of the same scene and options, over axes of the same names,
        whatever their values. (Samples have no axis: join them by `xr.concat` along
        their dimension.)
    - `versions`: `"any"` consents to sweeps of several versions of this package, JAX,
        jaxlib or diffrax. A digest changes with these, so that it is then upon you that
        the scene is one; any two of the same versions must still have one digest, and
        numbers that meet must still be the same.

    **Returns:** a dataset over the unions of the axes, rising. Of the attributes,
    points and seconds are sums; several versions and their digests stand behind each
    other; what people read of a scene (its source) is the first
    one's; what else belongs to a run (threads, batches, an audit) is left out.

    **Raises:** `ValueError` that names what differs: a variable, an attribute, a point;
    and for a scene that no digest knows, that of a point with host callbacks.
    """
    choice("versions", versions, ("same", "any"))
    if not sweeps:
        raise ValueError("Arguments of `merge` must be datasets, but there are none.")
    for number, ds in enumerate(sweeps):
        instance(f"sweeps[{number}]", ds, xr.Dataset)
    sweeps = (sweeps[0], *(_in_order(sweeps[0], ds) for ds in sweeps[1:]))
    for number, ds in enumerate(sweeps):
        along = [n for n, c in ds.coords.items() if c.ndim and n not in ds.indexes]
        if along:
            raise ValueError(
                f"Argument `sweeps[{number}]` must be over axes, but its `{along[0]}` "
                f"has values along `{ds[along[0]].dims[0]}`: join samples by "
                "`xr.concat` along their dimension."
            )
        _check_like(sweeps[0], ds, number)
    _check_digests(sweeps, consent=versions == "any")
    _check_attributes(sweeps)
    first = sweeps[0]
    # of a sweep its parameters; labels of results (joint, rod) are in all the same
    axes = {
        name: _union([ds[name].values for ds in sweeps])
        for name in map(str, first.indexes)
    }
    whole = {name: _nothing(v, axes) for name, v in first.data_vars.items()}
    for dims, names in _by_cells(first, axes).items():
        _fill({name: whole[name] for name in names}, sweeps, axes, dims)
    data = {n: (first[n].dims, x, _labels(first[n])) for n, x in whole.items()}
    coords = {n: (first[n].dims, a.values, first[n].attrs) for n, a in axes.items()}
    still = {n: fixed for n, fixed in first.coords.items() if fixed.ndim == 0}
    return xr.Dataset(data, {**coords, **still}, _attributes(sweeps))


class Axis(NamedTuple):
    """The values of several sweeps along one dimension, rising.

    `places`: of each sweep's values in it; `exact`: a number for each of these values,
    the same for those that are the same to the last bit.
    """

    values: np.ndarray
    places: list[np.ndarray]
    exact: list[np.ndarray]

    @property
    def differs(self) -> bool:
        """Whether a sweep has other values than the first."""
        return any(not np.array_equal(self.exact[0], e) for e in self.exact)


def _union(parts: Sequence[np.ndarray]) -> Axis:
    """All values, of two that are near the earlier dataset's."""
    whole, stand = np.unique(parts[0]), [parts[0]]
    for part in parts[1:]:
        near = whole.dtype.kind == "f"
        stand.append(_stand_ins(whole, part) if near else part)
        whole = np.unique(np.concatenate([whole, stand[-1]]))
    unlike = np.unique(np.concatenate(parts))
    return Axis(
        whole,
        [np.searchsorted(whole, values) for values in stand],
        [np.searchsorted(unlike, part) for part in parts],
    )


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


def _nothing(variable: xr.DataArray, axes: Mapping[str, Axis]) -> np.ndarray:
    """A variable over the unions, with nothing computed."""
    shape = [
        axes[str(d)].values.size if str(d) in axes else n
        for d, n in variable.sizes.items()
    ]
    fill = np.nan if variable.dtype.kind in "fc" else 0
    return np.full(shape, fill, variable.dtype)


def _known(values: np.ndarray) -> np.ndarray:
    """Which numbers have been computed."""
    return ~np.isnan(values) if values.dtype.kind in "fc" else values != 0


def _by_cells(
    first: xr.Dataset, axes: Mapping[str, Axis]
) -> dict[tuple[str, ...], list[Hashable]]:
    """The variables, by those of the sweep's axes that they have.

    A place along these is a cell, whose numbers were all computed at one point. Along
    other dimensions lie the numbers of a point.
    """
    named = str(first.attrs.get("scene_axes")).split(", ")
    own = [d for d, axis in axes.items() if d in named or axis.differs]
    groups: dict[tuple[str, ...], list[Hashable]] = {}
    for name, variable in first.data_vars.items():
        groups.setdefault(tuple(d for d in own if d in variable.dims), []).append(name)
    return groups


def _fill(
    whole: Mapping[Hashable, np.ndarray],
    sweeps: Sequence[xr.Dataset],
    axes: Mapping[str, Axis],
    dims: tuple[str, ...],
) -> None:
    """Put the numbers of all sweeps in their places, cell by cell.

    A cell is of the first sweep that has computed it: of others, those at the same
    coordinates to the last bit have their say, and those near it have not.
    """
    # at which coordinates each cell was computed, as one number
    origin = np.full([axes[d].values.size for d in dims], -1)
    for number, ds in enumerate(sweeps):
        point = np.zeros((), int)
        for d in dims:
            size = 1 + max(e.max() for e in axes[d].exact)
            point = np.add.outer(point * size, axes[d].exact[number])
        at = np.ix_(*(axes[d].places[number] for d in dims))
        free = (origin[at] == -1) | (origin[at] == point)
        filled = np.zeros_like(free)
        for name, values in whole.items():
            known = xr.Variable(ds[name].dims, _known(ds[name].values))
            known = known & xr.Variable(dims, free)
            places = (
                axes[str(d)].places[number] if str(d) in axes else np.arange(n)
                for d, n in known.sizes.items()
            )
            _put(values, np.ix_(*places), ds[name], known.values)
            inner = [d for d in known.dims if d not in dims]
            filled |= known.any(inner).transpose(*dims).values
        origin[at] = np.where(filled, point, origin[at])


def _put(
    whole: np.ndarray, at: tuple[np.ndarray, ...], part: xr.DataArray, known: np.ndarray
) -> None:
    """Put the numbers of a sweep that are `known` in their places.

    **Raises:** `ValueError` where another number is there.
    """
    values, before = part.values, whole[at]
    unlike = known & _known(before) & (before != values)
    if unlike.any():
        where = np.argwhere(unlike)[0]
        point = [
            f"{d} = {part[d].values[i]:.17g}"
            for d, i in zip(part.dims, where, strict=True)
            if d in part.indexes and part[d].dtype.kind in "iuf"
        ]
        raise ValueError(
            f"Arguments of `merge` must agree where they meet, but `{part.name}` is "
            f"{before[tuple(where)]} and {values[tuple(where)]}"
            f"{' at ' if point else ''}{', '.join(point)}."
        )
    whole[at] = np.where(known, values, before)


def _refuse(number: int, what: str, two: object, one: object) -> NoReturn:
    raise ValueError(
        f"Argument `sweeps[{number}]` must be of the scene of the first, but {what} "
        f"{two!r}, not {one!r}."
    )


def _in_order(first: xr.Dataset, other: xr.Dataset) -> xr.Dataset:
    """Its variables over the dimensions in the first's order."""
    turned = {}
    for name, one in first.data_vars.items():
        dims = other[name].dims if name in other else ()
        if dims != one.dims and {*dims} == {*one.dims}:
            turned[name] = other[name].transpose(*one.dims)
    return other.assign(turned) if turned else other


def _check_like(first: xr.Dataset, other: xr.Dataset, number: int) -> None:
    """Refuse a sweep of other variables, or of the same in other units."""
    for what, one, two in (
        ("has the axes and labels", first.coords, other.coords),
        ("holds", first.data_vars, other.data_vars),
    ):
        if {*one} != {*two}:
            _refuse(number, what, sorted(map(str, two)), sorted(map(str, one)))
    for name, one in first.variables.items():
        two = other.variables[name]
        if two.dims != one.dims:
            _refuse(number, f"its `{name}` has the dimensions", two.dims, one.dims)
        key = unlike_meaning(one.attrs, two.attrs)
        if name in first.coords and not (key in one.attrs and key in two.attrs):
            key = None  # xarray forgets them where a coordinate is assigned anew
        if key is not None:
            what = f"the attribute `{key}` of its `{name}` is"
            _refuse(number, what, two.attrs.get(key), one.attrs.get(key))
        if name in first.coords:
            if not one.ndim and not one.equals(two):
                _refuse(number, f"its `{name}` is", two.values, one.values)
            continue
        if two.dtype != one.dtype:
            _refuse(number, f"its `{name}` has the type", two.dtype, one.dtype)
        loose = [d for d in one.dims if d not in first.indexes]
        if any(two.sizes[d] != one.sizes[d] for d in loose):
            _refuse(number, f"its `{name}` has the sizes", two.sizes, one.sizes)


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


def _check_attributes(sweeps: Sequence[xr.Dataset]) -> None:
    """Refuse sweeps that were computed with other options."""
    ours = _of_the_scene(sweeps[0])
    for number, ds in enumerate(sweeps):
        theirs = _of_the_scene(ds)
        for key in sorted({*ours, *theirs}):
            one, two = ours.get(key), theirs.get(key)
            if not np.array_equal(np.asarray(one), np.asarray(two)):
                _refuse(number, f"its attribute `{key}` is", two, one)


def _of_the_scene(ds: xr.Dataset) -> dict[str, object]:
    """The attributes that say what was computed, beside the digest and versions."""
    apart = OF_A_RUN | set(SUMS) | RECORD | {DIGEST, *VERSIONS}
    named = {str(key): value for key, value in ds.attrs.items()}
    return {k: v for k, v in named.items() if k not in apart and k[:6] != "audit_"}


def _labels(variable: xr.DataArray) -> dict[Hashable, object]:
    """What a variable is, without an audit of it."""
    return {k: v for k, v in variable.attrs.items() if str(k)[:6] != "audit_"}


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
