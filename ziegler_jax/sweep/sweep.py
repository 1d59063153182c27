"""A sweep: any function of named numbers, over named axes, as a labelled dataset."""

from __future__ import annotations

import inspect
import math
import os
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, NamedTuple

import jax
import jax.numpy as jnp
import xarray as xr
from numpy.typing import ArrayLike

from ..numerics.rules import instance
from ..runtime import all_cores, refuse_forked
from .assembly import BlockAssembler, Memory, Tally, check_room
from .cluster import Arrays, check_client, run_blocks
from .grid import Block, Grid, axes_of, check_signature
from .once import Program
from .pool import Effort, Lanes, run_lanes
from .program import Scene, compiled, refuse_tracers, traced
from .progress import Progress, tracing
from .provenance import check_names, identity, template, warn_of_hosts
from .returned import Returned
from .store import Store, SweepStore, prepared

if TYPE_CHECKING:  # installed by an extra
    from distributed import Client


def sweep(
    point: Callable[..., Returned] | Program,
    *,
    where: Callable[..., ArrayLike] | None = None,
    lanes: Lanes = Lanes(),
    store: str | os.PathLike | Store | None = None,
    client: Client | None = None,
    progress: bool | None = None,
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

    Samples, in which two parameters vary together:

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
        dimensions) and results. Each sweep traces it anew, so that it reads its
        globals and attributes again, and compiles it only if its program changed. (JAX
        itself remembers a function that you give to `jax.jit` and call on plain
        numbers.) The motions of a point (`settle`, `periodic_orbit`, ...) run in chunks
        of steps, each in batches of its own: a motion that has ended makes room for the
        next point. Motions inside your own `vmap`, `jvp`, `lax.scan` or `lax.cond` run
        from start to end in one batch; inside `jit` or `checkpoint` they run in chunks
        as well, unless these have random keys or call the host.
    - `where`: a function of the same names that says which points to compute. It gets
        the axes as NumPy arrays that broadcast against each other, a number as an array
        as well, with `store` of a block at a time: so it must judge each point by its
        own values.
    - `lanes`: batches and threads, see `Lanes`.
    - `store`: a folder, e.g. `"map.zarr"`, to which every block is written as soon as
        it is finished; only unfinished blocks are in memory. A block is a sixteenth
        of the sweep, but about 256 points at least and 16 000 at most. The same sweep
        with the same store computes only missing or damaged blocks, also after it was
        killed, and ends in the same numbers to the last bit (on the same kind of
        processor). A store of another point, other axes, tolerances, units, codes or
        versions is refused. (Other names and sentences are not: the store's stay.) A
        point is identified by a digest of its traced equations, which does not see into
        a host callback (`jax.pure_callback`, `io_callback`): a sweep with one warns
        that it cannot be resumed, and a later sweep refuses its store. `open_sweep`
        reads the store at any time; `Store(path, overwrite=True)` replaces the sweep in
        it.
    - `client`: a `dask.distributed.Client`: blocks become tasks of its cluster, one a
        worker's thread at a time. Its workers must be able to import the package and
        what `point` needs, and to write to `store` where there is one.
    - `progress`: a bar with points per second; None shows it on a terminal and in a
        notebook. While the point is traced and compiled the bar says so, with the
        seconds. The logger `ziegler_jax.sweep` has a message of level INFO for every
        finished block, an object of JSON: its place, points, seconds, steps and
        outcomes.
    - `named_axes`, `axes`: each a one-dimensional array of finite numbers, no two of
        them alike; or one number, which all points have: it becomes a coordinate
        without a dimension. An axis that is named like an option goes into `axes`.
        Names are of letters, digits and underscores, as those of results are.
        Parameters that are `xarray.DataArray`s of one dimension vary together along it,
        as in xarray: samples, or a path through the parameters (see the second
        example). A dimension without a name (xarray's `dim_0`) that no other shares
        gets the axis' name. Their attributes `long_name`, `units` and `symbol` go into
        the dataset and pictures: `xr.DataArray(F, attrs={"units": "N"})`.

    **Returns:** an `xarray.Dataset` over the axes, in their order. Points that failed
    or were left out are NaN; `outcome`, a CF flag variable, says why. One warning at
    the end says how many failed in which way, and what to do (a column that turned
    over, `escaped`, is no failure). The attributes are versions, the digest of the
    traced point (`scene_digest`, equal for sweeps of the same point; `none` with host
    callbacks), its source for people to read, and the cost of this run: seconds, the
    share of useful steps (NaN where no motion runs in chunks). One batch of 256 is
    computed a second time: `canary_mismatches` of `canary_checks` gave other bits, and
    any mismatch warns. With `store`, arrays stay on the disk until they are used.

    **Raises:** `ValueError` that names the argument, its value and the rule; a
    sweep in memory that would take more than half of what is free; what `point` raises
    while it runs, with a note of the batch's values; `OSError` where
    the store cannot be written; `KeyboardInterrupt` after Ctrl-C, as soon as JAX has
    compiled (after a second one at once). Finished blocks stay in the store.
    """
    refuse_forked()
    # where JAX writes down equations a zero is a tracer, too
    refuse_tracers(jnp.zeros(()), *jax.tree.leaves((named_axes, axes)))
    program = point if isinstance(point, Program) else None
    function = program.scene.point if program else point
    places = axes_of(function, axes, named_axes, inspect.signature(sweep).parameters)
    if where is not None and not callable(where):
        raise ValueError(f"Argument `where` must be a function, but is {where!r}.")
    instance("lanes", lanes, Lanes)
    if store is not None and not isinstance(store, Store):
        store = Store(store)
    if client is not None:
        check_client(client)
    grid = _grid(places, where, in_memory=store is None)
    if program:
        program.check(grid.names, lanes)
        scene = program.scene._replace(seconds=0.0)
    else:
        with tracing(progress):
            scene = traced(function, grid.names, lanes.batch_size, grid.points)
    check_names(scene, grid)
    if store is None:
        room = scene.bytes_a_point * math.prod(grid.shape)
        check_room(f"the results of {math.prod(grid.shape)} points", room)
        backend: Memory | SweepStore = Memory(template(grid, scene))
    else:
        nothing, known = template(grid, scene), identity(scene, grid)
        backend = prepared(store.path, nothing, grid, known, store.overwrite)
        warn_of_hosts(scene)
    # a cluster's worker runs as many blocks as it has threads
    threads = lanes.threads or (all_cores() if client is None else 1)
    return _filled(_Run(scene, program, grid, threads, client), backend, progress)


def _grid(
    axes: xr.Dataset, where: Callable[..., ArrayLike] | None, in_memory: bool
) -> Grid:
    """The points; what would not fit into memory is refused before it is made."""
    size = math.prod(axes.sizes.values())
    if where is not None:
        check_signature(where, [*map(str, axes.coords)], "where")
        if in_memory:
            check_room(f"which of {size} points `where` chooses", size)
            return Grid(axes, Grid(axes).box.chosen(where))
    elif in_memory:
        check_room(f"one number at each of {size} points", 8 * size)
    return Grid(axes, where)


class _Run(NamedTuple):
    """The points to compute, and the workers for them."""

    scene: Scene
    program: Program | None  # that has been compiled, or is once
    grid: Grid
    threads: int
    client: Client | None


def _filled(run: _Run, backend: Memory | SweepStore, show: bool | None) -> xr.Dataset:
    """The dataset, after what is missing of it has been computed."""
    scene, grid, seconds = run.scene, run.grid, run.scene.seconds
    with backend:
        missing = backend.missing(grid)
        if not missing:
            return backend.dataset({})
        left = sum(missing.values())
        with Progress(grid.points - left, grid.points, show) as progress:

            def write_block(block: Block, arrays: Arrays | None, tally: Tally) -> None:
                if arrays is not None:  # else a worker has written them
                    backend.write_block(block, arrays, tally)
                progress.finished(block, tally)

            if run.client is None:
                with progress.compiling():
                    program = run.program.compiled() if run.program else compiled(scene)
                seconds += program.compile_seconds
                assembler = BlockAssembler(grid, scene.variables, write_block)
                effort = run_lanes(
                    program,
                    grid.box.values,
                    assembler.points_of(missing),
                    assembler.put,
                    threads=run.threads,
                    on_batch=progress.advance,
                )
            else:
                effort = run_blocks(
                    run.client,
                    scene,
                    grid,
                    missing,
                    backend.path if isinstance(backend, SweepStore) else None,
                    run.threads,
                    write_block,
                    progress.advance,
                )
        progress.warn_of_failures(left, scene.variables)
        return backend.dataset({**_cost(effort, left, seconds), "threads": run.threads})


def _cost(effort: Effort, points: int, seconds: float) -> dict[str, float]:
    """The cost of this run, and the number of points that it computed."""
    return {
        "compile_seconds": round(seconds, 3),
        "run_seconds": round(effort.seconds, 5),
        "points_per_second": round(points / max(effort.seconds, 1e-9), 1),
        "useful_step_fraction": round(effort.useful_steps, 4),
        "canary_checks": effort.canary_checks,
        "canary_mismatches": effort.canary_mismatches,
    }
