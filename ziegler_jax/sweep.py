"""A sweep: any function of named numbers, over named axes, as a labelled dataset."""

import inspect
import json
import platform
from collections.abc import Callable, Mapping
from importlib import metadata
from typing import Any, Literal

import numpy as np
import xarray as xr
from tqdm import tqdm

from ._audit import audit_attributes, checked_share, drawn
from ._choice import Undecided, stiff_points
from ._lanes import (
    Effort,
    Program,
    all_cores,
    compiled,
    run_lanes,
    together,
)
from ._override import Override, overriding
from ._surroundings import constants
from ._variables import AXES, Variable
from .outcome import SOLVER, flag_attributes


def sweep(
    point: Callable[..., Any],
    *,
    where: Callable[..., Any] | None = None,
    batch_size: int | None = None,
    threads: int | None = None,
    progress: bool | None = None,
    precision: Literal["float64", "float32"] = "float64",
    audit: float | None = None,
    axes: Mapping[str, Any] | None = None,
    **named_axes: Any,
) -> xr.Dataset:
    """Compute `point` at every combination of the axes' values.

    ```python
    def point(q, mu):
        friction = zj.SmoothCoulomb(mu, pin_radius=0.1, v_smooth=0.01)
        column = zj.uniform_rods(q=q, friction=friction)
        return zj.settle(column, zj.State(omega=(0.0, 0.2)))

    ds = zj.sweep(point, q=np.linspace(1, 4, 64), mu=np.linspace(0.02, 0.4, 32))
    ```

    **Arguments:**

    - `point`: a function of named scalars that JAX can trace. It returns a scalar, a
        dict of scalars, or a result of the library, which knows its dimensions and
        units. It is compiled once for a batch of lanes and kept for the next sweep of
        the same function, as long as the numbers that it takes from around it stay the
        same. Where it runs one `settle`, lanes run in legs and are refilled as they
        end; whatever else it computes is then computed anew in each leg.
    - `where`: a function of the same names that says which points to compute. It gets
        the axes as NumPy arrays that broadcast against each other.
    - `batch_size`: lanes a batch. None is 8192 for points that run no `settle`, and
        else 128, or 512 where `configure_cpu()` was needed and not called. A lane's
        result does not depend on its batch mates; another batch size is another
        program, equal to rounding. With `solver="auto"` lanes of a kind share programs
        and batches.
    - `threads`: None uses every core that the process may use.
    - `progress`: a bar with points per second; None shows it on a terminal only.
    - `precision`: of the computation, whatever JAX's own setting.
    - `audit`: a share of the points, e.g. 0.01 (at least one, drawn at random), that
        is computed a second time in float64 with `rtol` and `atol` of its `settle` and
        `trajectory` a hundred times finer. Each variable's attributes then hold
        `audit_differences`, the `audit_quantiles` of the differences of its values;
        the dataset's hold `audit_points` and `audit_changed_outcomes`, the share of
        these whose outcome changed. It tells the error of the steps, not that of
        `rtol_settle`.
    - `named_axes`, `axes`: each a one-dimensional array of finite numbers. An axis that
        is named like an option goes into `axes`.

    **Returns:** an `xarray.Dataset` over the axes, in their order. Points that failed
    or were left out are NaN; `outcome`, a CF flag variable, says why. The attributes
    hold versions, precision, the scene's source with the numbers that it takes from
    around it, and what the run cost (the share of useful steps where lanes run in
    legs, else NaN).

    **Raises:** `ValueError` that names the argument, its value and the rule.
    """
    if axes is not None and not isinstance(axes, Mapping):
        raise ValueError(f"Argument `axes` must map names to values, but is {axes!r}.")
    grid = _axes(point, dict(axes or {}), named_axes)
    names, values = tuple(grid), list(grid.values())
    shape = tuple(v.size for v in values)
    valid = _valid_points(where, grid, shape)
    threads = all_cores() if threads is None else _count("threads", threads)
    if batch_size is not None:
        batch_size = _count("batch_size", batch_size)
    if precision not in ("float64", "float32"):
        raise ValueError(
            f"Argument `precision` must be float64 or float32, but is {precision!r}."
        )
    share = None if audit is None else checked_share(audit)
    wide = precision == "float64"
    groups = _groups(point, grid, valid, batch_size, wide)
    program = groups[0][0]
    _check_names(names, program)
    arrays = {
        name: _empty(variable, shape) for name, variable in program.variables.items()
    }
    count = int(valid.sum())
    with tqdm(
        total=count,
        unit="point",
        unit_scale=True,
        smoothing=0.05,
        disable=None if progress is None else not progress,
    ) as bar:

        def on_batch(done: int, useful: float) -> None:
            if np.isfinite(useful):
                bar.set_postfix_str(f"{useful:.0%} useful steps", refresh=False)
            bar.update(done)

        efforts = [
            run_lanes(part, values, some, arrays, threads=threads, on_batch=on_batch)
            for part, some in groups
        ]
    compile_seconds = sum(part.compile_seconds for part, _ in groups)
    effort = together(efforts)
    attributes = _provenance(point, program, effort, threads, count, compile_seconds)
    found = _dataset(grid, program, arrays, attributes)
    if share is not None:
        sample = drawn(valid, round(share * count))
        with overriding(Override(factor=FINER)):
            finer = sweep(
                point,
                where=lambda **_: sample,
                batch_size=batch_size,
                threads=threads,
                progress=progress,
                axes=grid,
            )
        audit_attributes(found, finer, sample)
    return found


FINER = 0.01  # the audit's tolerances, against the point's own


def _groups(
    point: Callable,
    grid: dict[str, np.ndarray],
    valid: np.ndarray,
    batch_size: int | None,
    wide: bool,
) -> list[tuple[Program, np.ndarray]]:
    """Programs, each with the points it is for: two where "auto" finds two kinds."""
    scene = point, tuple(grid), batch_size, wide
    try:
        return [(compiled(*scene), valid)]
    except Undecided:
        stiff = stiff_points(point, grid, valid, wide)
        kinds = (SOLVER.explicit, valid & ~stiff), (SOLVER.stiff, valid & stiff)
        return [(compiled(*scene, kind), some) for kind, some in kinds if some.any()]


def _axes(point: Callable, extra: dict, named: dict) -> dict[str, np.ndarray]:
    """The axes by name, checked against the function and the rules."""
    if not callable(point):
        raise ValueError(f"Argument `point` must be a function, but is {point!r}.")
    twice = set(extra) & set(named)
    if twice:
        raise ValueError(
            f"Axis `{twice.pop()}` must be given once, but is given twice."
        )
    grid = {}
    for name, values in {**named, **extra}.items():
        if not isinstance(name, str):
            raise ValueError(
                f"Argument `axes` must have strings as names, not {name!r}."
            )
        try:
            kind = np.asarray(values).dtype.kind
            if kind not in "iuf" or np.ma.isMaskedArray(values):
                raise TypeError
            values = np.asarray(values, dtype=np.float64)
        except (TypeError, ValueError):
            raise ValueError(
                f"Axis `{name}` must be real numbers, but is {values!r}."
            ) from None
        if values.ndim != 1:
            raise ValueError(
                f"Axis `{name}` must have one dimension, but has shape {values.shape}."
            )
        if values.size == 0:
            raise ValueError(f"Axis `{name}` must have values, but is empty.")
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            raise ValueError(
                f"Axis `{name}` must be finite, but is {values[bad[0]]} at index "
                f"{bad[0]}."
            )
        grid[name] = values
    if not grid:
        raise ValueError("A sweep must have at least one axis, but has none.")
    _check_signature(point, list(grid), "point")
    return grid


def _check_signature(function: Callable, names: list[str], what: str) -> None:
    try:
        parameters = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):
        return  # a callable that hides its parameters: the call itself will tell
    takes_any = any(p.kind is p.VAR_KEYWORD for p in parameters)
    by_name = [
        p for p in parameters if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)
    ]
    known = {p.name for p in by_name}
    for name in names:
        if name not in known and not takes_any:
            raise ValueError(
                f"Axis `{name}` must be a parameter of `{what}`, which takes "
                f"{', '.join(sorted(known)) or 'no parameters by name'}."
            )
    for p in by_name:
        if p.default is p.empty and p.name not in names:
            raise ValueError(
                f"Parameter `{p.name}` of `{what}` must be an axis of the sweep, whose "
                f"axes are {', '.join(names)}."
            )


def _check_names(names: tuple[str, ...], program: Program) -> None:
    taken = set(program.variables)
    for variable in program.variables.values():
        taken |= set(variable.dims)
    for name in names:
        if name in taken:
            raise ValueError(
                f"Axis `{name}` must be named unlike a result or its dimensions, which "
                f"are {', '.join(sorted(taken))}."
            )


def _valid_points(where: Callable | None, grid: dict, shape: tuple) -> np.ndarray:
    if where is None:
        return np.ones(shape, dtype=bool)
    if not callable(where):
        raise ValueError(f"Argument `where` must be a function, but is {where!r}.")
    _check_signature(where, list(grid), "where")
    mesh = np.meshgrid(*grid.values(), indexing="ij", sparse=True)
    try:
        chosen = np.asarray(where(**dict(zip(grid, mesh, strict=True))))
        valid = np.broadcast_to(chosen, shape)
    except Exception as error:
        raise ValueError(
            "Argument `where` must work on arrays that broadcast (use `&`, not `and`), "
            f"but raised {type(error).__name__}: {error}"
        ) from error
    if valid.dtype != bool:
        raise ValueError(
            f"Argument `where` must return booleans, but returned {valid.dtype}."
        )
    if not valid.any():
        raise ValueError("Argument `where` must leave a point, but leaves none.")
    return valid.copy()


def _count(name: str, x: Any) -> int:
    if isinstance(x, bool) or not isinstance(x, (int, np.integer)) or x < 1:
        raise ValueError(
            f"Argument `{name}` must be a whole number of at least 1, but is {x!r}."
        )
    return int(x)


def _empty(variable: Variable, shape: tuple[int, ...]) -> np.ndarray:
    """NaN for numbers, 0 (`not_computed`) for codes."""
    dtype = np.dtype(variable.value.dtype)
    if dtype.kind in "biu" and variable.codes is None:
        dtype = np.dtype(np.float64)  # so that a missing point can be told from 0
    fill = np.nan if dtype.kind in "fc" else 0
    return np.full(shape + tuple(variable.value.shape), fill, dtype)


def _dataset(
    grid: dict, program: Program, arrays: dict, attributes: dict
) -> xr.Dataset:
    dims = tuple(grid)
    data, used = {}, {}
    for name, variable in program.variables.items():
        attrs: dict[str, Any] = {
            "long_name": variable.long_name,
            "units": variable.units,
        }
        if variable.codes is not None:
            attrs = {"long_name": variable.long_name, **flag_attributes(variable.codes)}
        data[name] = (dims + variable.dims, arrays[name], attrs)
        used |= {dim: program.coordinates[dim] for dim in variable.dims}
    coords = {}
    for name, values in {**used, **grid}.items():
        if name in used and name not in AXES:  # rods, joints, branches
            coords[name] = list(values)
            continue
        meaning, units, symbol = AXES.get(name, (name, "1", name))
        attrs = {"long_name": meaning, "units": units, "symbol": symbol}
        coords[name] = (name, np.asarray(values), attrs)
    return xr.Dataset(data, coords, attributes)


def _provenance(
    point: Callable,
    program: Program,
    effort: Effort,
    threads: int,
    count: int,
    compile_seconds: float,
) -> dict[str, Any]:
    try:
        scene = inspect.getsource(point)
    except (OSError, TypeError):
        scene = repr(point)
    versions = {
        f"{package}_version": metadata.version(package)
        for package in ("ziegler_jax", "jax", "jaxlib", "diffrax", "numpy")
    }
    return {
        **versions,
        "python_version": platform.python_version(),
        "scene": scene,
        "scene_constants": json.dumps(constants(point)),
        **program.attributes,
        "precision": "float64" if program.wide else "float32",
        "batch_size": program.batch_size,
        "threads": threads,
        "points": count,
        "compile_seconds": round(compile_seconds, 3),
        "run_seconds": round(effort.seconds, 3),
        "points_per_second": round(count / max(effort.seconds, 1e-9), 1),
        "useful_step_fraction": round(effort.useful_steps, 4),
    }
