"""How many points run: compiled batches on threads, lanes refilled as they end."""

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from contextlib import nullcontext
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from ._cpu import compiles_whole_loops
from ._interrupt import held_interrupts
from ._legs import Legs, in_legs
from ._override import Override, current_override, overriding
from ._packing import Packing
from ._surroundings import surroundings
from ._variables import DIMENSIONS, Variable, named_variables

# A loop's working set stays in the first caches; where XLA makes many kernels of it,
# each must have enough to do.
BATCH_OF_ONE_KERNEL, BATCH_OF_MANY = 128, 384
BATCH_WITHOUT = 8192
# A leg costs its dispatch, and half a leg of idling per lane at its end: measured best
# at about a sixth of a lane's steps.
LEGS_A_LANE = 6
SHORTEST_LEG, FIRST_LEG, LONGEST_LEG = 64, 128, 1024
# Where neighbours cost alike, a leg is a lane's whole run: none idles for long, and
# calls are few. A few stragglers go on beside the next lanes.
ALIKE, STRAGGLERS, OVERDUE, LONGEST_RUN = 0.8, 0.05, 1.5, 16384
# 256 bits is XLA's default; nothing changes where the processor has no AVX-512
_CPU_OPTIONS = {"xla_cpu_prefer_vector_width": 512}


class Program(NamedTuple):
    """One batch of a scene, compiled."""

    run: Callable[..., Any]
    results: Packing
    carry: Packing | None  # None: the lanes do not run in legs
    variables: dict[str, Variable]  # values are shapes and dtypes
    attributes: dict[str, Any]
    coordinates: dict[str, Any]  # of the dimensions of results
    batch_size: int
    wide: bool  # float64
    compile_seconds: float
    override: Override  # that it was traced in


@held_interrupts()
def compiled(
    point: Callable,
    names: tuple[str, ...],
    batch_size: int | None,
    wide: bool,
    digest: str = "",
) -> Program:
    """`point` for one batch of lanes; kept for the next call where it can be.

    **Arguments:** `digest`: that of the scene's program where it is known: it sees
    what `surroundings` cannot.
    """
    around = digest, surroundings(point), current_override()
    try:
        return _kept(point, names, batch_size, wide, around)
    except TypeError as error:
        if "unhashable" not in str(error):
            raise
        return compile_point(point, names, batch_size, wide)


@lru_cache(maxsize=32)
def _kept(point, names, batch_size, wide, around) -> Program:
    del around  # a part of the key: a changed global or option is another scene
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
        described["solves"] = legs.refused or legs.calls > 0
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
        whole = compiles_whole_loops()
        small = BATCH_OF_ONE_KERNEL if whole else BATCH_OF_MANY
        if carried is None:
            carry = None
            size = batch_size or (small if described["solves"] else BATCH_WITHOUT)
            lanes = [jax.ShapeDtypeStruct((size,), dtype)] * len(names)
            run = batched(whole_run, (0,)).lower(lanes).compile()
        else:
            carry = Packing(carried)
            size = batch_size or small

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
    own_steps: int  # of the lanes
    all_steps: int  # that their batches ran

    @property
    def useful_steps(self) -> float:
        """The share of the lanes' own steps; NaN where they do not run in legs."""
        return self.own_steps / self.all_steps if self.all_steps else float("nan")


def run_lanes(
    program: Program,
    axes: Mapping[str, np.ndarray],
    points: Iterator[np.ndarray],
    put: Callable[[np.ndarray, list[Any], np.ndarray], None],
    *,
    threads: int,
    on_batch: Callable[[int, float], None],
) -> Effort:
    """Compute points of the grid of `axes`.

    **Arguments:**

    - `points`: their places in the grid, in C order, some at a time.
    - `put`: told by any thread of places, their results (lanes behind) and steps.
    - `on_batch`: told the number of finished points and the useful share.
    """
    queue = _Queue(points)
    work = _Work(program, axes, put)
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
    return Effort(time.perf_counter() - started, work.own_steps, work.all_steps)


class _Queue:
    """The points that wait, handed out in order to any thread."""

    def __init__(self, source: Iterator[np.ndarray]):
        self.source, self.closed = source, False
        self.waiting = np.zeros(0, np.int64)
        self.lock = threading.Lock()

    def take(self, count: int) -> np.ndarray:
        """So many points, fewer only at the end."""
        taken = [np.zeros(0, np.int64)]
        with self.lock:
            while count and not self.closed:
                if not self.waiting.size:
                    self.waiting = next(self.source, taken[0])
                part, self.waiting = self.waiting[:count], self.waiting[count:]
                if not part.size:  # the end
                    break
                taken.append(part)
                count -= part.size
        return np.concatenate(taken)

    def close(self) -> None:
        with self.lock:
            self.closed = True


class _Work:
    """Where the points' numbers come from and where their results go."""

    def __init__(self, program, axes, put):
        self.program, self.put = program, put
        self.names, self.axes = list(axes), list(axes.values())
        self.shape = tuple(axis.size for axis in self.axes)
        self.dtype = np.float64 if program.wide else np.float32
        self.lock = threading.Lock()
        self.finished = self.reported = 0
        self.own_steps = self.all_steps = 0

    def values(self, points: np.ndarray) -> list[np.ndarray]:
        places = np.unravel_index(points, self.shape)
        pairs = zip(self.axes, places, strict=True)
        return [axis[place].astype(self.dtype) for axis, place in pairs]

    def call(self, points: np.ndarray, *arguments: Any) -> Any:
        """Run the program and wait for it; what it raises says at which points."""
        override = self.program.override
        # a context that is entered slows every call, so none without need
        usual = override == Override()
        context = nullcontext() if usual else overriding(override)
        try:
            # both settings are local to a thread
            with jax.enable_x64(self.program.wide), context:
                return jax.block_until_ready(self.program.run(*arguments))
        except Exception as error:
            pairs = list(zip(self.names, self.values(points), strict=True))
            spans = [f"{v.min():.17g} <= {n} <= {v.max():.17g}" for n, v in pairs]
            error.add_note(f"In a batch of points with {', '.join(spans)}.")
            raise

    def store(
        self, points: np.ndarray, lanes: Any, packed: Any, steps: np.ndarray, ran: int
    ) -> None:
        """Hand over the results of `lanes` and count: their own steps, all that ran."""
        if points.size:
            found = self.program.results.unpack([np.asarray(p) for p in packed])
            self.put(points, [result[..., lanes] for result in found], steps)
        with self.lock:
            self.finished += points.size
            self.own_steps += int(steps.sum())
            self.all_steps += ran

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
        packed = work.call(points, work.values(np.resize(points, size)))
        work.store(points, slice(0, points.size), packed, np.zeros_like(points), 0)


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
    recent = np.zeros(0, np.int64)  # the steps of the last lanes that ended
    quota = FIRST_LEG
    while busy.any():
        packed, carried, running, steps = work.call(
            points[busy], np.int32(quota), fresh, values, carried
        )
        steps, running = np.asarray(steps), np.asarray(running)
        ran = int((steps - before).max(where=busy, initial=0)) * size
        before, fresh = steps.copy(), np.zeros(size, bool)
        lanes = np.flatnonzero(busy & ~running)
        work.store(points[lanes], lanes, packed, steps[lanes], ran)
        if queue.closed:
            return
        busy &= running
        recent = np.concatenate([recent, steps[lanes]])[-size:]
        typical, slow = _cost(recent)
        alike = 2 * recent.size >= size and typical > ALIKE * slow
        mates = busy & (steps < OVERDUE * slow)
        if alike and np.count_nonzero(mates) > STRAGGLERS * size:
            quota = int(np.clip(slow // 16, SHORTEST_LEG, LONGEST_LEG))
            continue
        idle = np.flatnonzero(~busy)
        new = queue.take(idle.size)
        if new.size:
            place = idle[: new.size]
            points[place], busy[place], fresh[place], before[place] = new, True, True, 0
            values = work.values(points)
            fair = np.clip(typical // LEGS_A_LANE, SHORTEST_LEG, LONGEST_LEG)
            quota = min(slow, LONGEST_RUN) if alike else fair


def _cost(steps: np.ndarray) -> tuple[int, int]:
    """The steps of a usual lane, and of the slowest, both but for stragglers."""
    if not steps.size:
        return 0, 0
    few = int(STRAGGLERS * steps.size)
    slow = int(np.partition(steps, -1 - few)[-1 - few])
    return int(np.minimum(steps, slow).mean()), slow
