"""From a cell of a map to its motion.

A dataset holds the numbers of a cell, its attributes the function that computed them.
Called with these numbers, the function asks its question again, of a column and a
start: this time they are handed over, and nothing is computed.
"""

import importlib
import json
from collections.abc import Callable, Mapping
from types import FunctionType
from typing import NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr

from ..context import questions_go_to
from ..model.column import Column, State
from ..motion.options import Method
from ..motion.scene import Times
from ..motion.trajectory import Trajectory, trajectory
from ..numerics.numbers import instance
from ..sweep.provenance import origin, recent_point

Point = Callable[..., object]
LONGEST, SAMPLES = 200.0, 4001  # of a motion whose times are not given


def scene(
    dataset: xr.Dataset,
    at: Mapping[str, float] | None = None,
    *,
    point: Point | None = None,
    **named: float,
) -> tuple[Column, State]:
    r"""The column and the start of one cell of a map.

    ```python
    def point(q, mu):
        friction = zj.SmoothCoulomb(mu, pin_radius=0.1, v_smooth=0.05)
        column = zj.uniform_rods(q=q, friction=friction)
        return zj.settle(column, zj.State(omega=(0.0, 0.3)))

    ds = zj.sweep(point, q=[2.0, 2.6], mu=[0.1, 0.2])
    column, start = zj.scene(ds, q=2.6, mu=0.1)
    section = zj.poincare(column, start, points=3)
    ```

    **Arguments:**

    - `dataset`: of `sweep`, `open_sweep`, `merge` or `refine`, or a part of it; one
        that `SI.restore` made as well.
    - `at`, `named`: the cell, by values of the axes, to the nearest; none of those that
        `sel` has chosen before. An axis named like an option goes into `at`.
    - `point`: the function of the sweep, where it cannot be looked up: of a sweep of
        another process it is imported from the module in which it was, and one that was
        typed at a prompt, or stands in the script itself or in a function, is not
        there. In the process of the sweep it is never needed.

    **Returns:** the column and the start of the first motion that the point follows.

    **Raises:** `ValueError` for a cell that is not on the map, for a function that is
    not there or not the dataset's any more (its source or the numbers that it reads
    have changed), and for a point that follows no motion of one column.
    """
    return _asked(dataset, {**(at or {}), **named}, point).scene


def motion(
    dataset: xr.Dataset,
    at: Mapping[str, float] | None = None,
    *,
    ts: Times | None = None,
    method: Method | None = None,
    point: Point | None = None,
    **named: float,
) -> Trajectory:
    r"""The motion of one cell of a map.

    ```python
    def point(q, mu):
        friction = zj.SmoothCoulomb(mu, pin_radius=0.1, v_smooth=0.05)
        column = zj.uniform_rods(q=q, friction=friction)
        return zj.settle(column, zj.State(omega=(0.0, 0.3)))

    ds = zj.sweep(point, q=[2.0, 2.6], mu=[0.1, 0.2])
    zj.plot.time_history(zj.motion(ds, q=2.6, mu=0.1))
    ```

    **Arguments:**

    - `dataset`, `at`, `named`, `point`: as `scene`.
    - `ts`: the times, as in `trajectory` (in $\sqrt{m l^2/k}$, also of a dataset that
        `SI.restore` gave: write `seconds / units.time`); None is 4001 times from the
        start to the time at which the cell's own motion ended, at most to 200 (100
        where the dataset does not know it).
    - `method`: as in `trajectory`; None has the solver and tolerances that the point
        names, and of what it does not name those of `trajectory`, which are finer than
        those of `settle`.

    **Returns:** `Trajectory`, in 64 bits, in the column's own units.

    **Raises:** `ValueError` as `scene` and `trajectory`.
    """
    asked = _asked(dataset, {**(at or {}), **named}, point)
    if ts is None:
        end = in_own_unit(asked.cell.get("time", xr.DataArray(np.nan)))
        end = min(end, LONGEST) if end > 0 else LONGEST / 2
        ts = np.linspace(0.0, end, SAMPLES)
    with jax.enable_x64(True):
        return trajectory(*asked.scene, ts, method=method or asked.method)


class Asked(NamedTuple):
    """A question that a point asks."""

    scene: tuple[Column, State]
    method: Method
    cell: xr.Dataset  # one place of the map


class _Interruption(BaseException):
    """Ends a point where it asks; no `except Exception` of the user's keeps it."""


def _asked(dataset: xr.Dataset, at: Mapping[str, float], point: Point | None) -> Asked:
    """The first question that the point asks of one column at this cell."""
    instance("dataset", dataset, xr.Dataset)
    function = checked_point(dataset, point)
    cell, values = _cell(dataset, at)
    asked: list[Asked] = []

    def tell(question: Callable, arguments: tuple, options: dict[str, object]) -> None:
        names = question.__code__.co_varnames  # a function of the library
        given = {**dict(zip(names, arguments, strict=False)), **options}
        column, start = given.get("column"), given.get("start", given.get("guess"))
        if isinstance(column, Column) and isinstance(start, State):
            method = cast(Method, given.get("method", Method()))
            asked.append(Asked((column, start), method, cell))
        if asked or {"make_column", "bracket"} & {*names}:  # a search would be long
            raise _Interruption

    with jax.enable_x64(True), questions_go_to(tell):
        try:
            function(**{n: jnp.asarray(v, jnp.float64) for n, v in values.items()})
        except _Interruption:
            pass
    if not asked:
        raise ValueError(
            "Argument `dataset` must be of a `point` that follows the motion of one "
            "column (`settle`, `verdict`, `trajectory`, ...), but that of this one "
            "asks for none."
        )
    return asked[0]


def checked_point(dataset: xr.Dataset, point: Point | None) -> Point:
    """The function of a dataset: the one that is given, known or importable.

    **Raises:** `ValueError` where there is none, or it is not the dataset's any more.
    """
    if "scene" not in dataset.attrs:
        raise ValueError(
            "Argument `dataset` must be from `sweep`, whose attributes name the scene, "
            "but has no `scene` among them."
        )
    if point is not None and not callable(point):
        raise ValueError(f"Argument `point` must be a function, but is {point!r}.")
    known = point or recent_point(dataset.attrs) or _imported(dataset)
    if known is None:
        where = str(dataset.attrs.get("scene_function", "")) or "nowhere by name"
        raise ValueError(
            "Argument `point` must be given: the dataset's function is "
            f"{where.replace(':', '.')}, which this process cannot import (what stands "
            "in a script, a notebook or another function is not importable)."
        )
    here = origin(known)
    for key, what in (("scene", "source"), ("scene_constants", "numbers around it")):
        ours, theirs = here[key], str(dataset.attrs.get(key, here[key]))
        same = ours == theirs or theirs.startswith("<")  # a source that had no text
        if not same and key == "scene_constants":
            same = json.loads(ours) == json.loads(theirs)
        if not same:
            raise ValueError(
                f"Argument `point` must be the dataset's function, but its {what} is "
                f"not what it was: {_first_unlike(theirs, ours)}."
            )
    return known


def _imported(dataset: xr.Dataset) -> Point | None:
    """The dataset's function, by its name."""
    module, _, name = str(dataset.attrs.get("scene_function", "")).partition(":")
    if not name or "<" in name:
        return None
    try:
        thing: object = importlib.import_module(module)
        for part in name.split("."):
            thing = getattr(thing, part)
    except (ImportError, AttributeError):
        return None
    return thing if isinstance(thing, FunctionType) else None


def _first_unlike(before: str, now: str) -> str:
    """The first line that differs of two texts."""
    old, new = before.splitlines(), now.splitlines()
    for one, other in zip(old, new, strict=False):
        if one != other:
            return f"`{other.strip()}`, which was `{one.strip()}`"
    return f"{len(new)} lines, which were {len(old)}"


def _cell(
    dataset: xr.Dataset, at: Mapping[str, float]
) -> tuple[xr.Dataset, dict[str, float]]:
    """The cell, and the values of the scene's parameters there.

    **Raises:** `ValueError` for a place that is none of the map's.
    """
    axes = str(dataset.attrs.get("scene_axes", "")).split(", ")
    gone = [name for name in axes if name not in dataset.coords]
    if gone:
        raise ValueError(
            f"Argument `dataset` must hold the axis `{gone[0]}` of its scene, but does "
            "not."
        )
    dims = {str(d) for name in axes for d in dataset[name].dims}
    for name in at:
        if name not in dims:
            raise ValueError(
                f"Argument `{name}` must be an axis of the dataset, which has "
                f"{', '.join(sorted(dims)) or 'none left'}."
            )
    missing = sorted(dims - set(at))
    if missing:
        raise ValueError(
            f"Argument `{missing[0]}` must be given: a cell has one value on each axis."
        )
    places = {dim: nearest(dataset, dim, value) for dim, value in at.items()}
    cell = dataset.isel(places)
    return cell, {name: in_own_unit(cell[name]) for name in axes}


def in_own_unit(number: xr.DataArray) -> float:
    """A number in the column's unit, which `SI.restore` may have changed."""
    return float(number) / number.attrs.get("si_unit", 1.0)


def nearest(dataset: xr.Dataset, dim: str, value: float) -> int:
    """The place of the nearest value of an axis, or of a sample by its number."""
    if not isinstance(value, int | float | np.number):
        raise ValueError(f"Argument `{dim}` must be a number, but is {value!r}.")
    if dim not in dataset.indexes:
        size = dataset.sizes[dim]
        if not (isinstance(value, int | np.integer) and 0 <= value < size):
            raise ValueError(
                f"Argument `{dim}` must be a number of 0 to {size - 1}, but is "
                f"{value!r}."
            )
        return int(value)
    values = np.asarray(dataset[dim], float)
    apart = np.abs(values - value)
    place = int(apart.argmin())
    # a cell reaches halfway to its neighbours, and as far beyond the ends
    gaps = np.abs(np.diff(np.sort(values)))
    reach = gaps.max() / 2 if gaps.size else np.inf
    if not apart[place] <= reach * (1 + 1e-9):
        raise ValueError(
            f"Argument `{dim}` must be on the map, which reaches from {values.min():g} "
            f"to {values.max():g}, but is {value:g}."
        )
    return place
