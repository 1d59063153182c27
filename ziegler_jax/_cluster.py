"""Blocks as tasks of a Dask cluster: each worker with its own compiled program.

A task is a block. Where there is a store, the worker writes the block itself and sends
back what it cost; else it sends the numbers. Dask gives the task of a worker that died
to another; a block that was finished before is not computed again.
"""

import threading
import time
from collections.abc import Callable, Mapping
from functools import lru_cache
from itertools import islice
from typing import Any, NamedTuple

from ._blocks import Block, Blocks, Desk, Tally
from ._cpu import compiles_whole_loops, configure_cpu
from ._fingerprint import scene_hash
from ._lanes import Effort, Program, compiled, run_lanes
from ._store import Store

_TASKS_A_THREAD = 3  # on their way, so that no worker waits for the next


class Recipe(NamedTuple):
    """What a worker must know of a sweep beside the block."""

    point: Callable[..., Any]
    names: tuple[str, ...]
    batch_size: int
    wide: bool
    digest: str  # of the scene
    whole_loops: bool
    threads: int
    store: str | None


def run_blocks(
    client: Any,
    recipe: Recipe,
    blocks: Blocks,
    missing: Mapping[int, int],
    keep: Callable[[Block, Any, Tally], None],
    on_batch: Callable[[int, float], None],
) -> Effort:
    """Compute the missing blocks on the cluster of `client`.

    **Arguments:** `keep`: told each block, its arrays (None if the worker has written
    them) and its tally.
    """
    import cloudpickle
    from distributed import as_completed

    text = cloudpickle.dumps(recipe)
    started = time.perf_counter()
    waiting = iter(missing)
    flying = as_completed()
    own = ran = 0

    def submit() -> None:
        room = _TASKS_A_THREAD * max(1, sum(client.nthreads().values()))
        for number in islice(waiting, max(0, room - flying.count())):
            flying.add(client.submit(_compute, text, blocks.block(number), pure=False))

    try:
        submit()
        for future in flying:
            block, arrays, tally, effort = future.result()
            keep(block, arrays, tally)
            own, ran = own + effort.own_steps, ran + effort.all_steps
            on_batch(missing[block.number], own / ran if ran else float("nan"))
            submit()
    finally:
        client.cancel(list(flying.futures))
    return Effort(time.perf_counter() - started, own, ran)


def _compute(text: bytes, block: Block) -> tuple[Block, Any, Tally, Effort]:
    """A task."""
    recipe, program, store = _prepared(text)
    if store is not None and store.holds(block):  # its writer died before it said so
        return block, None, Tally(0, 0.0, 0, {}), Effort(0.0, 0, 0)
    part = Blocks(block.axes, points_a_block=block.chosen.size)
    found: list[Any] = []
    desk = Desk(part, program.variables, lambda *whole: found.extend(whole))
    _, chosen, known = (
        (block, block.chosen, None) if store is None else store.work(block)
    )
    points = desk.hand_out([(part.block(0), chosen, known)])
    effort = run_lanes(
        program, block.axes, points, desk.put,
        threads=recipe.threads, on_batch=lambda *_: None,
    )  # fmt: skip
    _, arrays, tally = found
    if store is None:
        return block, arrays, tally, effort
    store.keep(block, arrays, tally)
    return block, None, tally, effort


_PREPARING = threading.Lock()  # a worker's threads compile once


def _prepared(text: bytes) -> tuple[Recipe, Program, Store | None]:
    with _PREPARING:
        return _unpacked(text)


@lru_cache(maxsize=8)
def _unpacked(text: bytes) -> tuple[Recipe, Program, Store | None]:
    import cloudpickle

    recipe: Recipe = cloudpickle.loads(text)
    if recipe.whole_loops and not compiles_whole_loops():
        configure_cpu()
    here = scene_hash(recipe.point, recipe.names, recipe.wide)
    if here != recipe.digest:
        raise ValueError(
            "Argument `client` must have workers with the same scene, but to one of "
            "them `point` is another program: its modules or versions differ."
        )
    program = compiled(
        recipe.point, recipe.names, recipe.batch_size, recipe.wide, recipe.digest
    )
    store = None if recipe.store is None else Store(recipe.store, "r+")
    return recipe, program, store
