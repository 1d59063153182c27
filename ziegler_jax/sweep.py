"""A sweep: any function of named numbers, over named axes, as a labelled dataset."""

import functools
import inspect
import json
import os
import platform
from collections.abc import Callable, Mapping
from importlib import metadata
from typing import Any, Literal, get_args

import numpy as np
import xarray as xr

from ._audit import audit_attributes, checked_share, drawn
from ._blocks import Block, Blocks, Desk, Tally, asked
from ._cluster import Recipe, run_blocks
from ._cpu import all_cores
from ._fingerprint import fingerprint, scene_hash
from ._lanes import Effort, Program, compiled, run_lanes
from ._override import Override, overriding
from ._progress import Progress
from ._store import Memory, Resume, prepared
from ._surroundings import constants
from ._variables import AXES, empty
from .outcome import flag_attributes


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
    store: str | os.PathLike | None = None,
    resume: Resume = "same",
    client: Any = None,
    log: str | os.PathLike | None = None,
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
        the axes as NumPy arrays that broadcast against each other; with `store`, those
        of a block at a time, so that it must judge each point by its own values.
    - `batch_size`: lanes a batch. None is 8192 for points that follow no motion, and
        else 128, or 384 where `configure_cpu()` was needed and not called. A lane's
        result does not depend on its batch mates; another batch size is another
        program, equal to rounding.
    - `threads`: None uses every core that the process may use.
    - `progress`: a bar with points per second; None shows it on a terminal only.
    - `precision`: of the computation, whatever JAX's own setting.
    - `audit`: a share of the points, e.g. 0.01 (at least one, drawn at random), that
        is computed a second time in float64 with `rtol` and `atol` of its `settle` and
        `trajectory` a hundred times finer. Each variable's attributes then hold
        `audit_differences`, the `audit_quantiles` of the differences of its values;
        the dataset's hold `audit_points` and `audit_changed_outcomes`, the share of
        these whose outcome changed. It tells the error of the steps, not that of
        `rtol_settle`. Not with `store` or `client`.
    - `store`: a folder, e.g. `"map.zarr"`, into which every block of about 16 000
        points goes as soon as it is finished; in memory are the blocks that are not.
        The same sweep with the same store computes only what is missing, also after it
        was killed, and ends in the same numbers to the last bit (on the same kind of
        processor). A store of another scene, other axes, tolerances, precision or
        versions is refused. The scene is known by its lowered program, which does not
        show what a host callback does. `open_sweep` reads the store at any time.
    - `resume`: `"overwrite"` replaces the store's sweep; `"unsettled"` goes on with one
        whose `max_windows` and `max_steps` were smaller, and computes its points that
        are `unsettled` or `budget_spent` anew; else it must be `"same"`.
    - `client`: a `dask.distributed.Client`: blocks become tasks of its cluster, one a
        worker's thread at a time. Its workers must be able to import the package and
        what `point` needs, and to write to `store` where there is one.
    - `log`: a file to which a line of JSON is added for every finished block: where
        it lies, its points, seconds, steps and outcomes.
    - `named_axes`, `axes`: each a one-dimensional array of finite numbers. An axis that
        is named like an option goes into `axes`.

    **Returns:** an `xarray.Dataset` over the axes, in their order. Points that failed
    or were left out are NaN; `outcome`, a CF flag variable, says why. The attributes
    hold versions, precision, the scene's source with the numbers that it takes from
    around it, and what the run cost (the share of useful steps where lanes run in
    legs, else NaN). With `store`, its arrays stay on the disk until they are looked at.

    **Raises:** `ValueError` that names the argument, its value and the rule; what
    `point` raises while it runs, with a note of the batch's values; `OSError` where
    the store cannot be written; `KeyboardInterrupt` after Ctrl-C, as soon as JAX has
    compiled (after a second one at once). What was finished before stays in the store.
    """
    if axes is not None and not isinstance(axes, Mapping):
        raise ValueError(f"Argument `axes` must map names to values, but is {axes!r}.")
    grid = _axes(point, dict(axes or {}), named_axes)
    names = tuple(grid)
    if where is not None:
        if not callable(where):
            raise ValueError(f"Argument `where` must be a function, but is {where!r}.")
        _check_signature(where, list(grid), "where")
    whole = where is not None and store is None
    blocks = Blocks(grid, asked(where, grid) if whole else where)
    if threads is not None:
        threads = _count("threads", threads)
    if batch_size is not None:
        batch_size = _count("batch_size", batch_size)
    if precision not in ("float64", "float32"):
        raise ValueError(
            f"Argument `precision` must be float64 or float32, but is {precision!r}."
        )
    share = None if audit is None else checked_share(audit)
    if resume not in get_args(Resume):
        raise ValueError(
            "Argument `resume` must be same, unsettled or overwrite, but is "
            f"{resume!r}."
        )
    if store is None and resume != "same":
        raise ValueError("Argument `resume` must come with `store`, but that is None.")
    if client is not None and not hasattr(client, "submit"):
        raise ValueError(
            f"Argument `client` must be a `dask.distributed.Client`, not {client!r}."
        )
    wide = precision == "float64"
    digest = ""
    if store is not None or client is not None:
        if audit is not None:
            raise ValueError(
                "Argument `audit` must be left out with `store` or `client`, but is "
                f"{audit!r}: audit a smaller sweep of the same scene in memory."
            )
        digest = scene_hash(point, names, wide)
    program = compiled(point, names, batch_size, wide, digest=digest)
    _check_names(names, program)
    if threads is None:  # a cluster's worker runs as many blocks as it has threads
        threads = all_cores() if client is None else 1
    total = int(blocks.sizes.sum())
    attributes = _provenance(point, program, threads, total)
    template = _template(grid, program, blocks.shape, attributes)
    if store is None:
        shelf = Memory(template)
    else:
        here = fingerprint(
            point, blocks, scene=digest, settings=program.attributes,
            batch_size=program.batch_size, wide=wide,
        )  # fmt: skip
        shelf = prepared(store, template, blocks, here, resume)
    missing = shelf.missing(blocks)
    left = sum(missing.values())
    if not missing:
        return shelf.dataset({})
    with shelf, Progress(total - left, total, progress, log) as told:

        def keep(block: Block, arrays: Any, tally: Tally) -> None:
            if arrays is not None:  # else a worker has written them
                shelf.keep(block, arrays, tally)
            told.finished(block, tally)

        if client is not None:
            recipe = Recipe.of(
                point, program, names, digest=digest, threads=threads,
                store=None if store is None else os.path.abspath(store),
            )  # fmt: skip
            effort = run_blocks(client, recipe, blocks, missing, keep, told.advance)
        else:
            desk = Desk(blocks, program.variables, keep)
            points = desk.hand_out(shelf.work(blocks.block(n)) for n in missing)
            effort = run_lanes(
                program, grid, points, desk.put,
                threads=threads, on_batch=told.advance,
            )  # fmt: skip
        found = shelf.dataset({**attributes, **_cost(effort, left)})
    if share is not None:
        sample = drawn(blocks.chosen(), round(share * total))
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


def _count(name: str, x: Any) -> int:
    if isinstance(x, bool) or not isinstance(x, (int, np.integer)) or x < 1:
        raise ValueError(
            f"Argument `{name}` must be a whole number of at least 1, but is {x!r}."
        )
    return int(x)


def _template(
    grid: dict, program: Program, shape: tuple, attributes: dict
) -> xr.Dataset:
    """The dataset with nothing computed."""
    data, used, coords = {}, {}, {}
    for name, variable in program.variables.items():
        attrs: dict[str, Any] = {
            "long_name": variable.long_name,
            "units": variable.units,
        }
        if variable.codes is not None:
            attrs = {"long_name": variable.long_name, **flag_attributes(variable.codes)}
        data[name] = (tuple(grid) + variable.dims, empty(variable, shape), attrs)
        used |= {dim: program.coordinates[dim] for dim in variable.dims}
    for name, values in {**used, **grid}.items():
        if name in used and name not in AXES:  # rods, joints, branches
            coords[name] = list(values)
            continue
        meaning, units, symbol = AXES.get(name, (name, "1", name))
        attrs = {"long_name": meaning, "units": units, "symbol": symbol}
        coords[name] = (name, np.asarray(values), attrs)
    return xr.Dataset(data, coords, attributes)


def _provenance(
    point: Callable, program: Program, threads: int, points: int
) -> dict[str, Any]:
    try:
        scene = inspect.getsource(point)
    except (OSError, TypeError):
        scene = repr(point)
    return {
        **_versions(),
        "scene": scene,
        "scene_constants": json.dumps(constants(point)),
        **program.attributes,
        "precision": "float64" if program.wide else "float32",
        "batch_size": program.batch_size,
        "threads": threads,
        "points": points,
        "compile_seconds": round(program.compile_seconds, 3),
    }


@functools.cache  # reading them takes 25 ms
def _versions() -> dict[str, str]:
    packages = ("ziegler_jax", "jax", "jaxlib", "diffrax", "numpy")
    versions = {f"{package}_version": metadata.version(package) for package in packages}
    return {**versions, "python_version": platform.python_version()}


def _cost(effort: Effort, points: int) -> dict[str, float]:
    """What the last run cost, and how many points it computed."""
    return {
        "run_seconds": round(effort.seconds, 3),
        "points_per_second": round(points / max(effort.seconds, 1e-9), 1),
        "useful_step_fraction": round(effort.useful_steps, 4),
    }
