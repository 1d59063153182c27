"""Blocks as tasks of a Dask cluster: each worker with its own compiled program.

A task is a block. Where there is a store, the worker writes the block itself and sends
back what it cost; else it sends the numbers. Dask gives the task of a worker that died
to another; a block that was finished before is not computed again.

What 10^9 points ask for, at r points a second and core (the main job's kind: about
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
from typing import Any, NamedTuple, Protocol, TypedDict, Unpack
from uuid import uuid4

import numpy as np

from ..runtime import compiles_whole_loops, configure_cpu
from .partition import Block, BlockAssembler, Blocks, Tally
from .pool import Effort, run_lanes, warn_of
from .program import Compiled, Scene, compiled, traced
from .store import SweepStore

SENT_WITH_A_TASK = 1_000_000  # bytes of a point; a larger one is sent by itself
_TASKS_A_THREAD = 3  # on their way, so that no worker waits for the next


Arrays = dict[str, np.ndarray]  # of a block, by the variables' names
# what a task gave: its block, the arrays if it did not store them, and what it cost
Ran = tuple[int, Arrays | None, Tally, Effort]


class Client(Protocol):
    """What is asked of a `dask.distributed.Client`."""

    @property
    def status(self) -> str:
        """`running` until it is closed."""
        ...

    def submit(self, *task, **options):
        """Have a function run by a worker."""
        ...

    def scatter(self, data: list, broadcast: bool, hash: bool) -> list:
        """Send data to the workers."""
        ...

    def nthreads(self) -> Mapping[str, int]:
        """Each worker's threads."""
        ...

    def cancel(self, futures: list) -> None:
        """Give tasks up."""
        ...


class Task(Protocol):
    """A `dask.distributed.Future` of a task."""

    def result(self) -> Ran:
        """What it gave."""
        ...


class Means(TypedDict):
    """How a sweep's blocks are computed and kept."""

    threads: int
    store: str | None


class Recipe(NamedTuple):
    """What a worker must know of a sweep beside the block."""

    point: bytes  # pickled: the same bytes are the same program to a worker
    names: tuple[str, ...]
    batch_size: int
    digest: str  # of the scene
    whole_loops: bool
    threads: int
    store: str | None
    token: str  # this sweep's: a store may have been replaced since the last

    @staticmethod
    def of(scene: Scene, **parts: Unpack[Means]) -> "Recipe":
        """What there is to know.

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
        return Recipe(
            point,
            scene.names,
            scene.batch_size,
            scene.digest,
            whole_loops=compiles_whole_loops(),
            token=uuid4().hex,
            **parts,
        )


def check_client(client: Client) -> None:
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
    client: Client,
    recipe: Recipe,
    blocks: Blocks,
    missing: Mapping[int, int],
    write_block: Callable[[Block, Arrays | None, Tally], None],
    on_batch: Callable[[int, float], None],
) -> Effort:
    """Compute the missing blocks on the cluster of `client`.

    **Arguments:** `write_block`: given each block, its arrays (None if the worker has
    written them) and its tally.
    """
    from distributed import as_completed

    started = time.perf_counter()
    recipes = [recipe]
    if len(recipe.point) > SENT_WITH_A_TASK:
        recipes = client.scatter(recipes, broadcast=True, hash=False)
    waiting = iter(missing)
    flying = as_completed()
    done = own = ran = checks = mismatches = 0

    def submit() -> None:
        if client.status != "running":
            raise RuntimeError("The client was closed before the sweep's end.")
        room = _TASKS_A_THREAD * max(1, sum(client.nthreads().values()))
        for number in islice(waiting, max(0, room - flying.count())):
            flying.add(
                client.submit(_compute, recipes[0], blocks.block(number), pure=False)
            )

    try:
        submit()
        for future in flying:
            number, arrays, tally, effort = _result(future)
            write_block(blocks.block(number), arrays, tally)
            done += 1
            own, ran = own + effort.own_steps, ran + effort.all_steps
            checks += effort.canary_checks
            mismatches += effort.canary_mismatches
            on_batch(missing[number], own / ran if ran else float("nan"))
            submit()
    except Exception as error:
        where = "nothing is stored" if recipe.store is None else (
            f"they are in {recipe.store}, and the same sweep goes on from there"
        )  # fmt: skip
        error.add_note(f"Of {len(missing)} blocks {done} were finished: {where}.")
        raise
    finally:
        if client.status == "running":
            client.cancel(list(flying.futures))
    if mismatches:
        warn_of(mismatches, checks)
    seconds = time.perf_counter() - started
    return Effort(seconds, own, ran, checks, mismatches)


def _result(future: Task) -> Ran:
    """What a task gave.

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


def _compute(recipe: Recipe, block: Block) -> Ran:
    """A task."""
    with _PREPARING:
        scene, program = _program(*recipe[:5])
        store = None if recipe.store is None else _store(recipe.store, recipe.token)
    if store is not None and store.holds(block):
        # its writer died before it could say so
        return block.number, None, Tally(0, 0.0, 0, {}, {}), Effort(0.0, 0, 0, 0, 0)
    whole: list[Any] = []
    part = Blocks(block.axes, block.chosen, points_a_block=block.chosen.size)
    assembler = BlockAssembler(
        part, scene.variables, lambda *fields: whole.extend(fields)
    )
    effort = run_lanes(
        program,
        part.values,
        assembler.points_of([part.block(0)]),
        assembler.put,
        threads=recipe.threads,
        on_batch=lambda *_: None,
    )
    _, arrays, tally = whole
    if store is None:
        return block.number, arrays, tally, effort
    store.write_block(block, arrays, tally)
    return block.number, None, tally, effort


_PREPARING = threading.Lock()  # a worker's threads compile once


@lru_cache(maxsize=8)
def _program(
    pickled: bytes,
    names: tuple[str, ...],
    batch_size: int,
    digest: str,
    whole_loops: bool,
) -> tuple[Scene, Compiled]:
    import cloudpickle

    if whole_loops and not compiles_whole_loops():
        configure_cpu()  # before the point's arrays, if it has any, start JAX
    point = cloudpickle.loads(pickled)
    if whole_loops != compiles_whole_loops():
        raise ValueError(
            "Argument `client` must have workers that compile loops as this process "
            "does, but one of them cannot: see `configure_cpu`."
        )
    scene = traced(point, names, batch_size)
    if scene.digest != digest:
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
