"""How many points run: compiled batches on threads, lanes refilled as they end."""

import os
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from ._choice import lanes_of
from ._cpu import compiles_whole_loops
from ._legs import Legs, in_legs
from ._override import Override, current_override, overriding
from ._surroundings import surroundings
from ._variables import DIMENSIONS, Variable, named_variables
from .outcome import SOLVER

# A loop's working set stays in the first caches; where XLA makes many kernels of it,
# each must have enough to do.
BATCH_OF_ONE_KERNEL, BATCH_OF_MANY = 128, 512
BATCH_WITHOUT = 8192
# A leg costs its dispatch, and half a leg of idling per lane at its end: measured best
# at about a sixth of a lane's steps.
LEGS_A_LANE = 6
SHORTEST_LEG, FIRST_LEG, LONGEST_LEG = 64, 128, 1024
# 256 bits is XLA's default; nothing changes where the processor has no AVX-512
_CPU_OPTIONS = {"xla_cpu_prefer_vector_width": 512}


class Program(NamedTuple):
    """One batch of a scene, compiled."""

    run: Callable[..., Any]
    results: "Packing"
    carry: "Packing | None"  # None: the lanes do not run in legs
    variables: dict[str, Variable]  # values are shapes and dtypes
    attributes: dict[str, Any]
    coordinates: dict[str, Any]  # of the dimensions of results
    batch_size: int
    wide: bool  # float64
    compile_seconds: float
    override: Override  # that it was traced in


class Packing:
    """Many small arrays a lane as one array a dtype: a call then has few arguments."""

    def __init__(self, shapes: Sequence[Any]):
        """Lay out leaves of these shapes and dtypes."""
        self.shapes = [(tuple(s.shape), np.dtype(s.dtype)) for s in shapes]
        self.dtypes = sorted({dtype for _, dtype in self.shapes}, key=str)

    def pack(self, leaves: Sequence[Any]) -> tuple[jax.Array, ...]:
        """One vector a dtype."""
        return tuple(
            jnp.concatenate(
                [jnp.ravel(leaf) for leaf, (_, d) in self._pairs(leaves) if d == dtype]
            )
            for dtype in self.dtypes
        )

    def unpack(self, packed: Sequence[Any]) -> list[Any]:
        """The leaves again; lanes, if any, stand behind, and stay there."""
        used = dict.fromkeys(self.dtypes, 0)
        leaves = []
        for shape, dtype in self.shapes:
            source = packed[self.dtypes.index(dtype)]
            size = int(np.prod(shape))
            part = source[used[dtype] : used[dtype] + size]
            leaves.append(part.reshape(shape + source.shape[1:]))
            used[dtype] += size
        return leaves

    def empty(self, lanes: int) -> tuple[np.ndarray, ...]:
        """Zeros for a batch that has not started."""
        return tuple(
            np.zeros(
                (sum(int(np.prod(s)) for s, d in self.shapes if d == dt), lanes), dt
            )
            for dt in self.dtypes
        )

    def _pairs(self, leaves):
        return zip(leaves, self.shapes, strict=True)


def compiled(
    point: Callable,
    names: tuple[str, ...],
    batch_size: int | None,
    wide: bool,
    kind: SOLVER | None = None,
) -> Program:
    """`point` for one batch of lanes; kept for the next call where it can be.

    **Arguments:** `kind`: that of all lanes, where `solver="auto"` has asked for it.
    """
    around = surroundings(point), current_override()
    try:
        return _kept(point, names, batch_size, wide, kind, around)
    except TypeError as error:
        if "unhashable" not in str(error):
            raise
        with lanes_of(kind):
            return compile_point(point, names, batch_size, wide)


@lru_cache(maxsize=32)
def _kept(point, names, batch_size, wide, kind, around) -> Program:
    del around  # a part of the key: a changed global or option is another scene
    with lanes_of(kind):
        return compile_point(point, names, batch_size, wide)


def compile_point(
    point: Callable, names: tuple[str, ...], batch_size: int | None, wide: bool
) -> Program:
    """Trace and compile `point` for one batch of lanes."""
    dtype = np.dtype(np.float64 if wide else np.float32)
    scalar = jax.ShapeDtypeStruct((), dtype)
    flag = jax.ShapeDtypeStruct((), bool)
    count = jax.ShapeDtypeStruct((), np.int32)

    described: dict[str, Any] = {}  # what crosses no trace: names, meanings, settings

    def leaves(values):
        result = point(**dict(zip(names, values, strict=True)))
        variables = named_variables(result)
        described["variables"] = variables
        attributes = getattr(result, "attributes", dict)
        described["attributes"] = attributes()
        own = getattr(result, "coordinates", dict)()
        described["coordinates"] = {**DIMENSIONS, **own}
        return [jnp.asarray(v.value) for v in variables.values()]

    def find_legs(quota, fresh, values):
        with in_legs(Legs(quota, fresh, None)) as legs:
            leaves(values)
        return legs.left if legs.calls == 1 else None

    def whole_run(values):
        return results.pack(leaves(values))

    def batched(function, in_axes):
        options = _CPU_OPTIONS if jax.default_backend() == "cpu" else None
        function = jax.vmap(function, in_axes=in_axes, out_axes=-1)
        return jax.jit(function, compiler_options=options)

    with jax.enable_x64(wide):
        values = [scalar] * len(names)
        started = time.perf_counter()
        shapes = jax.eval_shape(leaves, values)
        variables = {
            name: variable._replace(value=shape)
            for (name, variable), shape in zip(
                described["variables"].items(), shapes, strict=True
            )
        }
        results = Packing(shapes)
        carried = jax.eval_shape(find_legs, count, flag, values)
        if carried is None:
            carry = None
            size = batch_size or BATCH_WITHOUT
            lanes = [jax.ShapeDtypeStruct((size,), dtype)] * len(names)
            run = batched(whole_run, (0,)).lower(lanes).compile()
        else:
            carry = Packing(carried)
            whole = compiles_whole_loops()
            size = batch_size or (BATCH_OF_ONE_KERNEL if whole else BATCH_OF_MANY)

            def leg(quota, fresh, values, carried):
                with in_legs(Legs(quota, fresh, carry.unpack(carried))) as legs:
                    found = leaves(values)
                left = carry.pack(legs.left)
                return results.pack(found), left, legs.running, legs.steps

            def one_kernel(quota, *arguments):
                """A loop of one turn: XLA makes all that is in it a single kernel."""
                shapes = jax.eval_shape(leg, quota, *arguments)
                nothing = jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), shapes)
                return lax.while_loop(
                    lambda state: state[0] > 0,  # the compiler cannot count this
                    lambda state: (0 * state[0], leg(quota, *arguments)),
                    (quota, nothing),
                )[1]

            run = batched(one_kernel if whole else leg, (None, 0, 0, -1))
            # one step of no lane in particular: a call of a jitted function costs half
            # of what calling its compiled form does
            begun = [np.ones(size, dtype)] * len(names)
            run(np.int32(1), np.ones(size, bool), begun, carry.empty(size))
        seconds = time.perf_counter() - started
    return Program(
        run,
        results,
        carry,
        variables,
        described["attributes"],
        described["coordinates"],
        size,
        wide,
        seconds,
        current_override(),
    )


class Effort(NamedTuple):
    """What the lanes cost."""

    seconds: float
    useful_steps: float  # the lanes' own steps over all steps that their batches ran


def together(efforts: Sequence[Effort]) -> Effort:
    """What several runs cost, one after the other."""
    seconds = sum(e.seconds for e in efforts)
    useful = sum(e.useful_steps * e.seconds for e in efforts) / max(seconds, 1e-9)
    return Effort(seconds, useful)


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
    - `on_batch`: told the number of finished points and the useful share.
    """
    queue = _Queue(np.flatnonzero(valid))
    work = _Work(program, axes, valid.shape, into)
    runner = _run_whole if program.carry is None else _run_in_legs
    started = time.perf_counter()
    pool = ThreadPoolExecutor(threads)
    try:
        running = {pool.submit(runner, work, queue) for _ in range(threads)}
        while running:
            ended, running = wait(running, 0.1, return_when=FIRST_COMPLETED)
            on_batch(work.finished_since(), work.useful())
            for future in ended:
                future.result()
    finally:
        # Ctrl-C and errors: a batch in flight ends its leg, nothing more is begun
        queue.close()
        pool.shutdown(wait=True)
    return Effort(time.perf_counter() - started, work.useful())


class _Queue:
    """The points that wait, handed out in order to any thread."""

    def __init__(self, points: np.ndarray):
        self.points, self.next, self.closed = points, 0, False
        self.lock = threading.Lock()

    def take(self, count: int) -> np.ndarray:
        with self.lock:
            first = self.next
            self.next = min(first + count, self.points.size)
            return self.points[first : self.next]

    def close(self) -> None:
        with self.lock:
            self.next, self.closed = self.points.size, True


class _Work:
    """Where the points' numbers come from and where their results go."""

    def __init__(self, program, axes, shape, into):
        self.program, self.axes, self.shape = program, axes, shape
        self.flat = [
            np.moveaxis(a.reshape(-1, *a.shape[len(shape) :]), 0, -1)
            for a in into.values()
        ]
        self.dtype = np.float64 if program.wide else np.float32
        self.lock = threading.Lock()
        self.finished = self.reported = 0
        self.own_steps = self.all_steps = 0

    def values(self, points: np.ndarray) -> list[np.ndarray]:
        places = np.unravel_index(points, self.shape)
        pairs = zip(self.axes, places, strict=True)
        return [axis[place].astype(self.dtype) for axis, place in pairs]

    def call(self, *arguments: Any) -> Any:
        # both settings are local to a thread
        with jax.enable_x64(self.program.wide), overriding(self.program.override):
            return self.program.run(*arguments)

    def store(
        self, points: np.ndarray, lanes: Any, packed: Any, own: int, ran: int
    ) -> None:
        """Keep the results of `lanes` and count: their own steps, all that ran."""
        if points.size:
            found = self.program.results.unpack([np.asarray(p) for p in packed])
            for target, result in zip(self.flat, found, strict=True):
                target[..., points] = result[..., lanes]
        with self.lock:
            self.finished += points.size
            self.own_steps += own
            self.all_steps += ran

    def mean_steps(self) -> float:
        return self.own_steps / self.finished if self.finished else 0.0

    def useful(self) -> float:
        return self.own_steps / self.all_steps if self.all_steps else float("nan")

    def finished_since(self) -> int:
        with self.lock:
            since = self.finished - self.reported
            self.reported = self.finished
            return since


def _run_whole(work: _Work, queue: _Queue) -> None:
    """Batches of lanes that each run to their end."""
    size = work.program.batch_size
    while (points := queue.take(size)).size:
        # the last batch is padded with real lanes: another size would be compiled again
        packed = work.call(work.values(np.resize(points, size)))
        work.store(points, slice(0, points.size), packed, 0, 0)


def _run_in_legs(work: _Work, queue: _Queue) -> None:
    """One batch whose lanes are refilled from the queue after each leg."""
    size = work.program.batch_size
    points = queue.take(size)
    if not points.size:
        return
    busy = np.arange(size) < points.size
    points = np.resize(points, size)  # idle places repeat real lanes
    values = work.values(points)
    fresh = np.ones(size, bool)
    carried: Any = work.program.carry.empty(size)
    before = np.zeros(size, np.int64)
    quota = FIRST_LEG
    while busy.any():
        packed, carried, running, steps = work.call(
            np.int32(quota), fresh, values, carried
        )
        steps, running = np.asarray(steps), np.asarray(running)
        ran = int((steps - before).max(where=busy, initial=0)) * size
        before, fresh = steps.copy(), np.zeros(size, bool)
        lanes = np.flatnonzero(busy & ~running)
        work.store(points[lanes], lanes, packed, int(steps[lanes].sum()), ran)
        if queue.closed:
            return
        busy &= running
        new = queue.take(lanes.size)
        if new.size:
            place = lanes[: new.size]
            points[place], busy[place], fresh[place], before[place] = new, True, True, 0
            values = work.values(points)
            fair = work.mean_steps() / LEGS_A_LANE
            quota = int(np.clip(fair, SHORTEST_LEG, LONGEST_LEG))


def all_cores() -> int:
    """The cores that this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:
        return os.cpu_count() or 1
