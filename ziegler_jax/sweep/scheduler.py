"""How many points run: stages in compiled batches on threads.

A lane goes through the stages of its point in order, to and fro between the phases of a
loop, and waits before each until a batch takes it. At a loop a batch runs a chunk of
steps at a time; lanes that have ended or go on elsewhere make room for others. What
waits further on is taken first, so that few lanes are open.
"""

import math
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from typing import NamedTuple

import numpy as np

from .lanes import OpenLanes, Queue, Work, joined, split
from .program import Compiled

# Chunk length trades the cost of a call, with what Python does between two, about that
# of so many steps of 128 lanes, against lanes that idle once they have ended, for half
# a chunk each: the sum is least at sqrt(2 CALL steps). With 50, 70, 100 and 150 a main
# job of 60 000 points took 6.33, 6.17, 6.15 and 6.30 s, one by windows 6.95, 6.95, 6.79
# and 6.89 (medians of five, two threads of an EPYC; each spreads by 3 %). On a Xeon
# one of 40 000 took 9.0, 8.5 and 8.4 s with 50, 100 and 150 and 8.7 with 250; by
# windows it took 8.1, 8.0, 7.9 and 7.7. So 70 to 150 cannot be told apart.
CALL, LANES = 100, 128
SHORTEST_CHUNK, FIRST_CHUNK, LONGEST_CHUNK = 64, 128, 1024
LAST_CHUNK = 4096  # where no lane waits for a place; but Ctrl-C has to wait for it
# Where neighbours cost alike, a chunk is a lane's whole run: none idles for long, and
# calls are few. A few stragglers go on beside the next lanes.
ALIKE, STRAGGLERS, OVERDUE, LONGEST_RUN = 0.8, 0.05, 1.5, 16384
# A lane makes no step in a chunk where a motion of its sequence ends as it begins.
STALLED = 8
# A batch leaves its loop for a later one where so many batches of lanes wait, and one
# with fewer lanes than this share for one where more wait.
AHEAD, SPARSE = 4, 0.5


class Effort(NamedTuple):
    """What the lanes cost."""

    seconds: float
    own_steps: int  # of the lanes
    all_steps: int  # that their batches ran
    canary_checks: int  # calls that were made twice
    canary_mismatches: int  # and gave other numbers the second time

    @property
    def useful_steps(self) -> float:
        """The share of the lanes' own steps; NaN where no loop was cut."""
        return self.own_steps / self.all_steps if self.all_steps else float("nan")


def run_lanes(
    program: Compiled,
    axes: Mapping[str, np.ndarray],
    points: Iterator[np.ndarray],
    put: Callable[[np.ndarray, list[np.ndarray], np.ndarray], None],
    *,
    threads: int,
    on_batch: Callable[[int, float], object],
) -> Effort:
    """Compute points of the grid of `axes`.

    **Arguments:**

    - `points`: their places in the grid, in C order, some at a time.
    - `put`: told by any thread of places, their results (lanes behind) and steps.
    - `on_batch`: told the number of finished points and the useful share.
    """
    work = Work(program, axes, Queue(points), put)
    started = time.perf_counter()
    pool = ThreadPoolExecutor(threads)
    try:
        running = {pool.submit(_run, work) for _ in range(threads)}
        while running:
            ended, running = wait(running, 0.1, return_when=FIRST_COMPLETED)
            on_batch(work.finished_since(), work.useful())
            for future in ended:
                future.result()
    finally:
        # Ctrl-C and errors: a batch in flight ends its chunk, nothing more is begun
        work.queue.close()
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


def _run(work: Work) -> None:
    """A thread: batches at one loop after the other, until no lane is left."""
    loops = [i for i, stage in enumerate(work.stages) if stage.is_loop]
    batch, last = None, work.stages[loops[-1]].ways if loops else ()
    # the steps of the last lanes that ended at each loop
    recent = {loop: np.zeros(0, np.int64) for loop in loops}
    while not work.queue.closed:
        work.finish()
        here = _chosen(work, loops, batch)
        if here is None:
            if work.leave(batch):
                break
            continue
        if batch is None or batch.loop != here:
            old, batch = batch, _Batch(work, here, recent)
            if old is not None:
                work.give(old.loop, old.lanes(old.busy))
            work.change(old, batch)
        elif here in last and not any(map(work.ready, loops)) and work.join(batch):
            break
        batch.refill()
        if batch.busy.any():
            if work.is_last():
                batch.max_steps = LAST_CHUNK
            batch.chunk()
    if not work.queue.closed:
        work.finish(all_of_them=True)


def _chosen(work: Work, loops: list[int], batch: "_Batch | None") -> int | None:
    """At which loop a thread goes on."""
    ready = {loop: work.ready(loop) for loop in loops}
    if batch is None:
        full = [loop for loop in loops if ready[loop] >= work.width(loop)]
        most = max(loops, key=lambda loop: ready[loop], default=None)
        return max(full) if full else most if most and ready[most] else None
    later = [loop for loop in loops if loop > batch.loop]
    ahead = [loop for loop in later if ready[loop] >= AHEAD * work.width(loop)]
    if ahead:
        return max(ahead)
    busy = np.count_nonzero(batch.busy)
    if busy + ready[batch.loop] < SPARSE * work.width(batch.loop):
        others = [loop for loop in loops if loop != batch.loop]
        most = max(others, key=lambda loop: ready[loop], default=batch.loop)
        if most != batch.loop and ready[most] > busy + ready[batch.loop]:
            return most
    return batch.loop if busy + ready[batch.loop] else None


class _Batch:
    """Lanes at a loop, each in its place until it has ended."""

    def __init__(self, work: Work, loop: int, recent: dict[int, np.ndarray]):
        """No lane yet; `recent`: the steps of the thread's last lanes at each loop."""
        self.recent = recent
        self.work, self.loop, self.stage = work, loop, work.stages[loop]
        self.ways = np.array(self.stage.ways)
        size = self.stage.lanes
        self.busy, self.wants = np.zeros(size, bool), True
        self.entered, self.stalled, none = np.zeros((3, size), np.int64)
        rows = *self.stage.fixed.empty(size), *self.stage.state.empty(size)
        self.open = OpenLanes(none, none, none, rows)
        self.dear = max(LANES / size, 1.0)  # a call, in steps of so few lanes
        self.max_steps = int(FIRST_CHUNK * math.sqrt(self.dear))
        self.costs = self._costs()

    def lanes(self, chosen: np.ndarray) -> OpenLanes:
        """The chosen lanes as they are."""
        return self.open.at(np.flatnonzero(chosen))

    def refill(self) -> None:
        """New lanes in idle places, if it is time for them."""
        if not self.wants:
            return
        idle = np.flatnonzero(~self.busy)
        new = self.work.supply(self.loop, idle.size) if idle.size else []
        if not new:
            return
        size, count = self.busy.size, sum(lanes.points.size for lanes in new)
        # places that stay idle repeat a new lane if they have never had one
        places = idle[:count] if self.busy.any() else idle
        source = np.arange(size)
        source[places] = size + np.arange(places.size) % count
        self.open = joined([self.open, *new]).at(source)
        self.entered[places] = self.open.here[places]
        self.stalled[places] = 0
        self.busy[idle[:count]] = True
        typical, slow, alike = self.costs
        fair = math.sqrt(2 * CALL * self.dear / self.stage.cost * typical)
        fair = min(max(int(fair), SHORTEST_CHUNK), LONGEST_CHUNK)
        if slow:
            self.max_steps = min(slow, LONGEST_RUN) if alike else fair

    def chunk(self) -> None:
        """At most `max_steps` of every lane; those that have ended go on."""
        points, total, before, rows = self.open
        fixed, state = split(self.stage, rows)
        arguments = self.stage.function, np.int32(self.max_steps), fixed, state
        state, status = self.work.call(points[self.busy], *arguments)
        phases, steps = np.asarray(status).astype(np.int64)
        ways = self.ways[phases]  # ENDED is the last
        running = ways == self.loop
        taken = np.where(self.busy, steps - before, 0)
        self.stalled = np.where(self.busy & running & (taken == 0), self.stalled + 1, 0)
        if self.stalled.max() >= STALLED:
            lane = self.stalled.argmax()
            raise RuntimeError(
                "A lane takes no step and comes to no end, after "
                f"{steps[lane]} steps at {self.work.spans(points[[lane]])}."
            )
        rows = *fixed, *map(np.asarray, state)
        self.open = OpenLanes(points, total + taken, steps, rows)
        ended = self.busy & ~running
        self.busy = self.busy & running
        self.work.ran(int(taken.max()) * ended.size)
        if ended.any():
            places = np.flatnonzero(ended)
            for way in set(ways[places].tolist()):
                self.work.give(way, self.open.at(places[ways[places] == way]))
            spent = (steps - self.entered)[places]
            recent = np.concatenate([self.recent[self.loop], spent])
            self.recent[self.loop] = recent[-ended.size :]
            self.costs = self._costs()
        _, slow, alike = self.costs
        mates = np.count_nonzero(self.busy & (steps < OVERDUE * slow))
        self.wants = not (alike and mates > STRAGGLERS * ended.size)
        if not self.wants:
            self.max_steps = min(max(slow // 16, SHORTEST_CHUNK), LONGEST_CHUNK)

    def _costs(self) -> tuple[int, int, bool]:
        """The steps of a usual lane, of the slowest, and whether these are alike."""
        recent = self.recent[self.loop]
        typical, slow = _cost(recent)
        enough = 2 * recent.size >= self.busy.size
        return typical, slow, enough and typical > ALIKE * slow


def _cost(steps: np.ndarray) -> tuple[int, int]:
    """The steps of a usual lane, and of the slowest, both but for stragglers."""
    if not steps.size:
        return 0, 0
    few, ordered = int(STRAGGLERS * steps.size), np.sort(steps)
    slow = int(ordered[-1 - few])
    spent = int(ordered[: steps.size - few].sum()) + few * slow
    return spent // steps.size, slow
