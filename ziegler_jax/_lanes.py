"""How many points run: one compiled batch, a queue in order of cost, and threads.

A vmapped loop runs until its slowest lane ends, so lanes of like cost belong together.
The queue is worked off in three levels, every 4th point of each axis first, then every
2nd, then all: what the finished points cost predicts their neighbours, and each level
is sorted by that. Every point is computed once, in the same compiled program.
"""

import itertools
import os
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import numpy as np

from ._variables import DIMENSIONS, Variable, named_variables

STRIDES = (4, 2, 1)
BATCH_WITH_LOOP = 128  # the loop's working set stays in the first caches
BATCH_WITHOUT = 8192
# 256 bits is XLA's default; nothing changes where the processor has no AVX-512
_CPU_OPTIONS = {"xla_cpu_prefer_vector_width": 512}


class Program(NamedTuple):
    """One batch of a scene, compiled."""

    run: Callable[..., tuple]
    variables: dict[str, Variable]  # values are shapes and dtypes
    attributes: dict[str, Any]
    batch_size: int
    wide: bool  # float64
    compile_seconds: float


@lru_cache(maxsize=32)
def compile_point(
    point: Callable, names: tuple[str, ...], batch_size: int | None, wide: bool
) -> Program:
    """Trace and compile `point` for one batch of lanes."""
    dtype = np.dtype(np.float64 if wide else np.float32)

    def result(*values):
        return point(**dict(zip(names, values, strict=True)))

    def lane(*values):
        return tuple(v.value for v in named_variables(result(*values)).values())

    with jax.enable_x64(wide):
        scalar = jax.ShapeDtypeStruct((), dtype)
        shape: Any = jax.eval_shape(result, *[scalar] * len(names))
        variables = named_variables(shape)
        if batch_size is None:
            batch_size = BATCH_WITH_LOOP if "steps" in variables else BATCH_WITHOUT
        started = time.perf_counter()
        options = _CPU_OPTIONS if jax.default_backend() == "cpu" else None
        lanes = jax.ShapeDtypeStruct((batch_size,), dtype)
        lowered = jax.jit(jax.vmap(lane), compiler_options=options).lower(
            *[lanes] * len(names)
        )
        compiled = lowered.compile()
        seconds = time.perf_counter() - started
    attributes = shape.attributes() if hasattr(shape, "attributes") else {}
    return Program(compiled, variables, attributes, batch_size, wide, seconds)


class Effort(NamedTuple):
    """What the lanes cost."""

    seconds: float
    useful_steps: float  # the lanes' own steps over all steps that their batches ran


def run_lanes(
    program: Program,
    axes: Sequence[np.ndarray],
    valid: np.ndarray,
    into: dict[str, np.ndarray],
    *,
    threads: int,
    on_batch: Callable[[int, float], None],
) -> Effort:
    """Compute every valid point of the grid of `axes`.

    **Arguments:**

    - `valid`: shape of the grid, which points to compute.
    - `into`: arrays of the grid's shape (and the variable's own behind it), filled in.
    - `on_batch`: told the number of points and the useful share after each batch.
    """
    shape = valid.shape
    flat = {
        name: array.reshape(-1, *array.shape[len(shape) :])
        for name, array in into.items()
    }
    cost = np.full(shape, np.nan) if "steps" in into else None
    lock = threading.Lock()
    taken = [0, 0]  # useful steps, all steps

    def compute(lanes: np.ndarray) -> int:
        size = program.batch_size
        padded = np.resize(lanes, size)  # repeats real lanes: a remainder costs no more
        places = np.unravel_index(padded, shape)
        values = [
            axis[place].astype(np.float64 if program.wide else np.float32)
            for axis, place in zip(axes, places, strict=True)
        ]
        with jax.enable_x64(program.wide):  # this setting is local to a thread
            results = [np.asarray(x) for x in program.run(*values)]
        for name, result in zip(program.variables, results, strict=True):
            flat[name][lanes] = result[: lanes.size]
        if cost is not None:
            steps = flat["steps"][lanes]
            cost.reshape(-1)[lanes] = steps
            with lock:
                taken[0] += int(steps.sum())
                taken[1] += int(steps.max()) * size
        return lanes.size

    def useful() -> float:
        return taken[0] / taken[1] if taken[1] else 1.0

    started = time.perf_counter()
    pool = ThreadPoolExecutor(threads)
    try:
        for level in _levels(valid, cost):
            batches = [
                level[i : i + program.batch_size]
                for i in range(0, level.size, program.batch_size)
            ]
            for done in _in_flight(pool, compute, batches, 4 * threads):
                on_batch(done, useful())
    finally:
        # Ctrl-C and errors: what waits is dropped, what runs ends with its batch
        pool.shutdown(wait=True, cancel_futures=True)
    return Effort(time.perf_counter() - started, useful())


def _in_flight(
    pool: ThreadPoolExecutor, compute: Callable, batches: list, most: int
) -> Iterator[int]:
    """Results as they come, with at most `most` batches submitted at a time."""
    waiting = set()
    queue = iter(batches)
    while True:
        for batch in itertools.islice(queue, most - len(waiting)):
            waiting.add(pool.submit(compute, batch))
        if not waiting:
            return
        done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
        for future in done:
            yield future.result()


def _levels(valid: np.ndarray, cost: np.ndarray | None) -> Iterator[np.ndarray]:
    """The points of each level, costly ones first; `cost` is read as it fills."""
    if cost is None or valid.size < 64:
        yield np.flatnonzero(valid)
        return
    left = valid.copy()
    for stride in STRIDES:
        level = np.zeros_like(valid)
        grid = tuple(slice(None, None, stride) for _ in valid.shape)
        level[grid] = left[grid]
        left &= ~level
        points = np.flatnonzero(level)
        if points.size:
            expected = _expected_cost(cost, points, 2 * stride)
            yield points[np.argsort(-expected, kind="stable")]


def _expected_cost(cost: np.ndarray, points: np.ndarray, reach: int) -> np.ndarray:
    """The mean cost of the finished neighbours on the coarser grid, by nearness."""
    places = np.stack(np.unravel_index(points, cost.shape), axis=1)
    total, weight = np.zeros(points.size), np.zeros(points.size)
    last = np.array(cost.shape) - 1
    floor = places - places % reach
    for corner in itertools.product((0, reach), repeat=cost.ndim):
        near = np.minimum(floor + corner, last - last % reach)
        found = cost[tuple(near.T)]
        distance = np.sum((near - places) ** 2, axis=1)
        w = np.where(np.isnan(found), 0.0, 1.0 / (distance + 0.25))
        total += np.where(np.isnan(found), 0.0, found) * w
        weight += w
    known = weight > 0
    overall = float(np.nanmean(cost)) if np.any(~np.isnan(cost)) else 0.0
    return np.where(known, total / np.where(known, weight, 1.0), overall)


def all_cores() -> int:
    """The cores that this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:
        return os.cpu_count() or 1


def grid_shape(variable: Variable) -> tuple[int, ...]:
    """The shape of a variable at one point."""
    return tuple(len(DIMENSIONS[dim]) for dim in variable.dims)
