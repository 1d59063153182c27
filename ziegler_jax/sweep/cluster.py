"""Blocks as tasks of a Dask cluster: each worker with its own compiled program.

A task is a block. With a store, the worker writes the block itself and sends back its
cost; else it sends the numbers. Dask gives the task of a worker that died to another
one; a finished block is not computed again.

The cost of 10^9 points, at r points a second and core (the main job's kind: about
1600; its results: 8 variables, 81 bytes a point):

- 61 000 blocks of 16 384 points, each a task of 16 384 / r = 10 s: a scheduler, which
  needs a millisecond a task, feeds thousands of cores.
- 10^9 / r = 170 core hours: 40 minutes on 256 cores, and some ten seconds of tracing
  and compilation a worker.
- To a worker go 20 to 30 kB a task (the point, the block's axes, which points): 1.5 GB
  in all. A point of more than a megabyte, which closes over a table, goes to each
  worker once. To the store go 81 GB, 1.3 MB a block: 33 MB/s from 256 cores, in half a
  million files of 16 to 260 kB. Gathered instead, they would go through one process
  and its memory; with `store` less than a kilobyte a task comes back.

Beside the lanes, a worker's event loop takes some 3 % of a core, half of which is
`distributed.worker.profile.enabled` (false in Dask's configuration turns it off), and
the scheduler with a client some 4 % of one.
"""

import threading
import time
from collections.abc import Callable, Mapping
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from uuid import uuid4

import numpy as np

from ..runtime import compiles_whole_loops, configure_cpu
from .assembly import OpenBlock, Tally
from .grid import Block, Grid
from .pool import NO_EFFORT, Effort, run_lanes, warn_of
from .program import Compiled, Scene, compiled, traced
from .store import SweepStore

if TYPE_CHECKING:  # installed by an extra
    from distributed import Client, Future

SENT_WITH_A_TASK = 1_000_000  # bytes of a point; a larger one is sent by itself
_TASKS_A_THREAD = 3  # on their way, so that no worker waits for the next

Arrays = dict[str, np.ndarray]  # of a block, by the variables' names
# What a task gave: its block, the arrays if it did not store them, and what it cost.
Ran = tuple[int, Arrays | None, Tally, Effort]


class Recipe(NamedTuple):
    """The part of a sweep that a worker needs beside the block."""

    point: bytes  # pickled: the same bytes are the same program to a worker
    names: tuple[str, ...]
    batch_size: int
    digest: str  # of the scene
    whole_loops: bool

    @staticmethod
    def of(scene: Scene) -> "Recipe":
        """The recipe of a sweep.

        **Raises:** `ValueError` if `point` cannot be sent.
        """
        import cloudpickle

        try:
            point = cloudpickle.dumps(scene.point)
        except Exception as error:  # pickle's, of many kinds
            raise ValueError(
                "Argument `point` must be a function that can be sent to the workers "
                f"of `client`, but {type(error).__name__}: {error}. What it refers to "
                "(an open file, a lock, a client) must be made inside it."
            ) from error
        size, loops = scene.batch_size, compiles_whole_loops()
        return Recipe(point, scene.names, size, scene.digest, loops)


def check_client(client: "Client") -> None:
    """Refuse what is no client, or one that is closed.

    **Raises:** `ValueError`.
    """
    if not hasattr(client, "submit"):
        raise ValueError(
            f"Argument `client` must be a `dask.distributed.Client`, not {client!r}."
        )
    status = getattr(client, "status", "running")
    if status != "running":
        raise ValueError(
            f"Argument `client` must be a client that runs, but its status is "
            f"{status!r}: connect a new one."
        )


def run_blocks(
    client: Any,  # a `Client`, whose methods are typed as if they might be awaited
    scene: Scene,
    grid: Grid,
    missing: Mapping[int, int],
    store: Path | None,
    threads: int,
    write_block: Callable[[Block, Arrays | None, Tally], None],
    on_batch: Callable[[int, float], None],
) -> Effort:
    """Compute the missing blocks on the cluster of `client`.

    **Arguments:** `threads`: of a task; `write_block`: given each block, its arrays
    (None if the worker has written them) and its tally.
    """
    from distributed import as_completed

    started = time.perf_counter()
    recipe = Recipe.of(scene)
    sent = [recipe]
    if len(recipe.point) > SENT_WITH_A_TASK:
        sent = client.scatter(sent, broadcast=True, hash=False)
    # a store may have been replaced since the last sweep: workers open it once a sweep
    place = None if store is None else (str(store), uuid4().hex)
    waiting, flying = iter(missing), as_completed()
    done, total = 0, NO_EFFORT

    def submit() -> None:
        if client.status != "running":
            raise RuntimeError("The client was closed before the sweep's end.")
        room = _TASKS_A_THREAD * max(1, sum(client.nthreads().values()))
        for number in islice(waiting, max(0, room - flying.count())):
            task = sent[0], grid.block(number), place, threads
            flying.add(client.submit(_compute, *task, pure=False))

    try:
        submit()
        for future in flying:
            number, arrays, tally, effort = _result(future)
            write_block(grid.block(number), arrays, tally)
            done, total = done + 1, total.plus(effort)
            on_batch(missing[number], total.useful_steps)
            submit()
    except Exception as error:
        where = "nothing is stored" if store is None else (
            f"they are in {store}, and the same sweep goes on from there"
        )  # fmt: skip
        error.add_note(f"Of {len(missing)} blocks {done} were finished: {where}.")
        raise
    finally:
        if client.status == "running":
            client.cancel(list(flying.futures))
    if total.canary_mismatches:
        warn_of(total.canary_mismatches, total.canary_checks)
    return total._replace(seconds=time.perf_counter() - started)


def _result(future: "Future") -> Ran:
    """The result of a task.

    **Raises:** `RuntimeError` if it was cancelled or the cluster is gone.
    """
    from concurrent.futures import CancelledError as Cancelled

    from distributed import CancelledError

    try:
        return future.result()
    except (CancelledError, Cancelled) as error:
        raise RuntimeError(
            "A block was cancelled before it was finished: the client was closed, or "
            "someone cancelled its task."
        ) from error


def _compute(
    recipe: Recipe, block: Block, place: tuple[str, str] | None, threads: int
) -> Ran:
    """A task."""
    with _PREPARING:
        scene, program = _program(recipe)
        store = None if place is None else _store(*place)
    if store is not None and store.holds(block):
        # its writer died before it could say so
        return block.number, None, Tally(0, 0.0, 0, {}, {}), NO_EFFORT
    opened = OpenBlock(block, scene.variables)
    effort = run_lanes(
        program,
        block.box.values,
        iter([opened.points]),
        opened.put,
        threads=threads,
        on_batch=lambda *_: None,
    )
    tally = opened.tally()
    if store is None:
        return block.number, opened.arrays, tally, effort
    store.write_block(block, opened.arrays, tally)
    return block.number, None, tally, effort


_PREPARING = threading.Lock()  # a worker's threads compile once


@lru_cache(maxsize=8)
def _program(recipe: Recipe) -> tuple[Scene, Compiled]:
    import cloudpickle

    if recipe.whole_loops and not compiles_whole_loops():
        configure_cpu()  # before the point's arrays, if it has any, start JAX
    point = cloudpickle.loads(recipe.point)
    if recipe.whole_loops != compiles_whole_loops():
        raise ValueError(
            "Argument `client` must have workers that compile loops as this process "
            "does, but one of them cannot: see `configure_cpu`."
        )
    scene = traced(point, recipe.names, recipe.batch_size)
    if scene.digest != recipe.digest:
        raise ValueError(
            "Argument `client` must have workers with the same scene, but to one of "
            "them `point` is another program: its modules, versions or the numbers "
            "that it computes there differ."
        )
    return scene, compiled(scene)


@lru_cache(maxsize=8)
def _store(path: str, token: str) -> SweepStore:
    del token
    return SweepStore(Path(path))
