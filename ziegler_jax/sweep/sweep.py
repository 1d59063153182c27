"""A sweep: any function of named numbers, over named axes, as a labelled dataset."""

import inspect
import math
import os
from collections.abc import Callable, Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
import xarray as xr
from numpy.typing import ArrayLike

from ..numerics.numbers import instance
from ..runtime import all_cores, refuse_forked
from .axes import Returned, check_signature, checked_axes, own_labels, parameters
from .cluster import Arrays, Client, Recipe, check_client, run_blocks
from .lanes import Lanes
from .once import Program
from .partition import (
    Block,
    BlockAssembler,
    Blocks,
    Memory,
    Tally,
    check_room,
    evaluate_where,
)
from .pool import Effort, run_lanes
from .program import Scene, compiled, refuse_tracers, traced
from .progress import Progress, tracing
from .provenance import check_names, identity, provenance, template, warn_of_hosts
from .store import Store, SweepStore, prepared


def sweep(
    point: Callable[..., Returned] | Program,
    *,
    where: Callable[..., ArrayLike] | None = None,
    lanes: Lanes = Lanes(),  # noqa: B008, a value
    store: str | os.PathLike | Store | None = None,
    client: Client | None = None,
    progress: bool | None = None,
    log: str | os.PathLike | None = None,
    axes: Mapping[str, ArrayLike] | None = None,
    **named_axes: ArrayLike,
) -> xr.Dataset:
    """Compute `point` at every combination of the axes' values.

    ```python
    def point(q, mu):
        friction = zj.SmoothCoulomb(mu, pin_radius=0.1, v_smooth=0.05)
        column = zj.uniform_rods(q=q, friction=friction)
        return zj.settle(column, zj.State(omega=(0.0, 0.2)))

    ds = zj.sweep(point, q=np.linspace(1, 4, 31), mu=np.linspace(0.02, 0.4, 11))
    ```

    Samples, both parameters drawn anew for each:

    ```python
    def load(kappa, c):
        column = zj.uniform_rods(q=1.0, kappa=kappa, damping=zj.Viscous(c, c))
        return zj.critical_load(column)

    random = np.random.default_rng(0)
    kappa = xr.DataArray(random.normal(1, 0.05, 1000), dims="sample")
    c = xr.DataArray(random.uniform(0.01, 0.1, 1000), dims="sample")
    ds = zj.sweep(load, kappa=kappa, c=c)  # q_cr(sample), kappa(sample), c(sample)
    ```

    **Arguments:**

    - `point`: a function of named scalars that JAX can trace, or a `Program`, which was
        traced before. It returns a scalar, a result of the library, which knows its
        dimensions and units, or a dict of scalars, `Variable`s (arrays with named
        dimensions) and results. It is traced anew at each sweep, so that whatever it
        reads is read again, but compiled only if that changed its program. (A function
        that you give to `jax.jit` yourself and call on plain numbers is JAX's to
        remember.) The motions that it follows one after the other (`settle`,
        `periodic_orbit`, `verdict`, ...) run in chunks of steps, each in batches of its
        own, in which a lane makes room for the next one as soon as its motion has
        ended. Motions inside a transformation of your own (`vmap`, `jvp`) or a loop or
        conditional (`lax.scan`, `lax.cond`) run whole; inside a call (`jit`,
        `checkpoint`) they do as elsewhere, unless it holds keys or has the host do
        something.
    - `where`: a function of the same names that says which points to compute. It gets
        the axes as NumPy arrays that broadcast against each other; with `store`, those
        of a block at a time, so that it must judge each point by its own values.
    - `lanes`: how they run, see `Lanes`.
    - `store`: a folder, e.g. `"map.zarr"`, into which every block goes as soon as it
        is finished; in memory are the blocks that are not. A block is a sixteenth of
        the sweep, but about 256 points at least and 16 000 at most.
        The same sweep with the same store computes only what is missing or damaged,
        also after it was killed, and ends in the same numbers to the last bit (on the
        same kind of processor). A store of another scene, other axes, tolerances,
        units, codes or versions is refused. (Other names and sentences are not: the
        store's stay.) The scene is known by a digest of what JAX traced, which does not
        show what a host callback computes: a sweep of a point with one
        (`jax.pure_callback`, `io_callback`) warns that it cannot be resumed, and its
        store is refused to the next. `open_sweep` reads the store at any time;
        `Store(path, overwrite=True)` replaces the sweep that is in it.
    - `client`: a `dask.distributed.Client`: blocks become tasks of its cluster, one a
        worker's thread at a time. Its workers must be able to import the package and
        what `point` needs, and to write to `store` where there is one.
    - `progress`: a bar with points per second; None shows it on a terminal and in a
        notebook. While the scene is traced and compiled it says so, with the seconds.
    - `log`: a file to which a line of JSON is added for every finished block: where
        it lies, its points, seconds, steps and outcomes.
    - `named_axes`, `axes`: each a one-dimensional array of finite numbers, no two of
        them alike. An axis that is named like an option goes into `axes`. Names are of
        letters, digits and underscores, as those of results are. Parameters that are
        `xarray.DataArray`s of one dimension vary together along it, as in xarray:
        samples, or a path through the parameters (see the second example). A dimension
        that was given no name (xarray's `dim_0`) and is no other's has the axis' name.
        What their attributes `long_name`, `units` and `symbol` say stands in the
        dataset and in pictures: `xr.DataArray(F, attrs={"units": "N"})`.

    **Returns:** an `xarray.Dataset` over the axes, in their order. Points that failed
    or were left out are NaN; `outcome`, a CF flag variable, says why. One warning at
    the end says how many failed in which way, and what to do (a column that turned
    over, `escaped`, is no failure). The attributes
    hold versions, the scene's digest (`scene_digest`: two sweeps of one are
    of one scene; `none` for a point with host callbacks), its source for
    people to read, and what this run cost: seconds,
    the share of useful steps (NaN where no motion runs in chunks), and how many of the
    batches that were computed a second time, one of 256, gave other bits
    (`canary_mismatches`, of `canary_checks`; it warns where there are any). With
    `store`, its arrays stay on the disk until they are looked at.

    **Raises:** `ValueError` that names the argument, its value and the rule; a
    sweep in memory that would take more than half of what is free; what `point` raises
    while it runs, with a note of the batch's values; `OSError` where
    the store cannot be written; `KeyboardInterrupt` after Ctrl-C, as soon as JAX has
    compiled (after a second one at once). What was finished before stays in the store.
    """
    refuse_forked()
    # where JAX writes down equations a zero is a tracer, too
    refuse_tracers(jnp.zeros(()), *jax.tree.leaves((named_axes, axes)))
    program = point if isinstance(point, Program) else None
    function = program.scene.point if program else point
    grid = checked_axes(function, axes, named_axes, inspect.signature(sweep).parameters)
    if where is not None:
        if not callable(where):
            raise ValueError(f"Argument `where` must be a function, but is {where!r}.")
        check_signature(where, list(parameters(grid)), "where")
    instance("lanes", lanes, Lanes)
    if store is not None and not isinstance(store, Store):
        store = Store(store)
    if client is not None:
        check_client(client)
    size = math.prod(values.size for values in grid.values())
    if where is not None and store is None:
        check_room(f"which of {size} points `where` chooses", size)
        blocks = Blocks(grid, evaluate_where(where, grid))
    else:
        if store is None:
            check_room(f"one number at each of {size} points", 8 * size)
        blocks = Blocks(grid, where)
    if program:
        program.check(parameters(grid), lanes)
        scene = program.scene._replace(seconds=0.0)
    else:
        names = tuple(parameters(grid))
        with tracing(progress):
            scene = traced(function, names, lanes.batch_size, blocks.points)
    check_names(scene, grid)
    if store is None:
        check_room(f"the results of {size} points", scene.bytes_a_point * size)
    # a cluster's worker runs as many blocks as it has threads
    threads = lanes.threads or (all_cores() if client is None else 1)
    run = _Run(scene, program, blocks, threads, client, store)
    origin = provenance(scene, blocks.points)
    own = own_labels({**named_axes, **(axes or {})})
    nothing = template(grid, scene, blocks.shape, origin, own)
    if store is None:
        backend: Memory | SweepStore = Memory(nothing)
    else:
        backend = prepared(
            store.path, nothing, blocks, identity(scene, blocks), store.overwrite
        )
        warn_of_hosts(scene)
    return _filled(run, backend, progress, log)


class _Run(NamedTuple):
    """What is to be computed, and by whom."""

    scene: Scene
    program: Program | None  # that has been compiled, or is once
    blocks: Blocks
    threads: int
    client: Client | None
    store: Store | None


def _filled(
    run: _Run,
    backend: Memory | SweepStore,
    show: bool | None,
    log: str | os.PathLike | None,
) -> xr.Dataset:
    """The dataset, after what is missing of it has been computed."""
    scene, blocks = run.scene, run.blocks
    try:
        missing = backend.missing(blocks)
        if not missing and not backend.damaged():
            return backend.dataset({})
    except BaseException:
        backend.release()  # one that was just made holds its lock
        raise
    left = sum(missing.values())
    seconds = scene.seconds
    with backend, Progress(blocks.points - left, blocks.points, show, log) as progress:

        def write_block(block: Block, arrays: Arrays | None, tally: Tally) -> None:
            if arrays is not None:  # else a worker has written them
                backend.write_block(block, arrays, tally)
            progress.finished(block, tally)

        backend.mend(parameters(blocks.grid))
        if not missing:
            return backend.dataset({})
        if run.client is None:
            with progress.compiling():
                program = run.program.compiled() if run.program else compiled(scene)
            seconds += program.compile_seconds
            assembler = BlockAssembler(blocks, scene.variables, write_block)
            effort = run_lanes(
                program,
                blocks.values,
                assembler.points_of(map(blocks.block, missing)),
                assembler.put,
                threads=run.threads,
                on_batch=progress.advance,
            )
        else:
            place = None if run.store is None else os.path.realpath(run.store.path)
            recipe = Recipe.of(scene, threads=run.threads, store=place)
            effort = run_blocks(
                run.client, recipe, blocks, missing, write_block, progress.advance
            )
        progress.warn_of_failures(left, scene.variables)
        return backend.dataset({**_cost(effort, left, seconds), "threads": run.threads})


def _cost(effort: Effort, points: int, seconds: float) -> dict[str, float]:
    """What this run cost, and how many points it computed."""
    return {
        "compile_seconds": round(seconds, 3),
        "run_seconds": round(effort.seconds, 5),
        "points_per_second": round(points / max(effort.seconds, 1e-9), 1),
        "useful_step_fraction": round(effort.useful_steps, 4),
        "canary_checks": effort.canary_checks,
        "canary_mismatches": effort.canary_mismatches,
    }
