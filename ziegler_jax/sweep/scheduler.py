"""How many points run: compiled batches on threads, lanes refilled as they end."""

import itertools
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from typing import Any, NamedTuple

import jax
import numpy as np

from ..runtime import own_flags
from .program import Program

# A leg costs its dispatch, and half a leg of idling per lane at its end: measured best
# at about a sixth of a lane's steps.
LEGS_A_LANE = 6
SHORTEST_LEG, FIRST_LEG, LONGEST_LEG = 64, 128, 1024
# Where neighbours cost alike, a leg is a lane's whole run: none idles for long, and
# calls are few. A few stragglers go on beside the next lanes.
ALIKE, STRAGGLERS, OVERDUE, LONGEST_RUN = 0.8, 0.05, 1.5, 16384
# A lane makes no step in a leg where a motion of its sequence ends as it begins.
STALLED = 8
# Every so many calls one is made twice: it costs 0.4 % and must give the same bits.
CANARY = 256
_CALLS = itertools.count(1)  # of this process: a cluster's blocks make a few each


class Effort(NamedTuple):
    """What the lanes cost."""

    seconds: float
    own_steps: int  # of the lanes
    all_steps: int  # that their batches ran
    canary_checks: int  # calls that were made twice
    canary_mismatches: int  # and gave other numbers the second time

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
    seconds = time.perf_counter() - started
    if work.mismatches:
        warn_of(work.mismatches, work.checks)
    return Effort(seconds, work.own_steps, work.all_steps, work.checks, work.mismatches)


def warn_of(mismatches: int, checks: int) -> None:
    """Say that the same program has given different numbers."""
    warnings.warn(
        f"{mismatches} of {checks} batches that were computed twice gave other numbers "
        "the second time: this processor, or JAX on it, is not to be trusted with "
        "threads. Sweep with `threads=1` and compare.",
        stacklevel=2,
    )


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
        self.checks = self.mismatches = 0

    def values(self, points: np.ndarray) -> list[np.ndarray]:
        places = np.unravel_index(points, self.shape)
        pairs = zip(self.axes, places, strict=True)
        return [axis[place].astype(self.dtype) for axis, place in pairs]

    def call(self, points: np.ndarray, *arguments: Any) -> Any:
        """Run the program and wait for it; now and then a second time, to compare."""
        found = self._run(points, *arguments)
        with self.lock:
            check = next(_CALLS) % CANARY == 0
        if check:
            same = _same_bits(found, self._run(points, *arguments))
            with self.lock:
                self.checks += 1
                self.mismatches += not same
        return found

    def _run(self, points: np.ndarray, *arguments: Any) -> Any:
        """One call; what it raises says at which points."""
        try:
            with own_flags(), jax.enable_x64(self.program.wide):  # a thread's own
                return jax.block_until_ready(self.program.run(*arguments))
        except Exception as error:
            error.add_note(f"In a batch of points with {self.spans(points)}.")
            raise

    def spans(self, points: np.ndarray) -> str:
        """Where these points lie."""
        pairs = zip(self.names, self.values(points), strict=True)
        return ", ".join(f"{v.min():.17g} <= {n} <= {v.max():.17g}" for n, v in pairs)

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
    before, stalled = np.zeros(size, np.int64), np.zeros(size, np.int64)
    recent = np.zeros(0, np.int64)  # the steps of the last lanes that ended
    quota = FIRST_LEG
    while busy.any():
        packed, carried, running, steps = work.call(
            points[busy], np.int32(quota), fresh, values, carried
        )
        steps, running = np.asarray(steps), np.asarray(running)
        ran = int((steps - before).max(where=busy, initial=0)) * size
        stalled = np.where(busy & running & (steps == before), stalled + 1, 0)
        if stalled.max() >= STALLED:
            lane = stalled.argmax()
            raise RuntimeError(
                "A lane takes no step and comes to no end, after "
                f"{steps[lane]} steps at {work.spans(points[[lane]])}."
            )
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


def _same_bits(one: Any, other: Any) -> bool:
    pairs = zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True)
    return all(np.asarray(a).tobytes() == np.asarray(b).tobytes() for a, b in pairs)


def _cost(steps: np.ndarray) -> tuple[int, int]:
    """The steps of a usual lane, and of the slowest, both but for stragglers."""
    if not steps.size:
        return 0, 0
    few = int(STRAGGLERS * steps.size)
    slow = int(np.partition(steps, -1 - few)[-1 - few])
    return int(np.minimum(steps, slow).mean()), slow
