"""The pool of points that run: lanes wait before the stages of their point.

A thread takes a batch of waiting lanes from the latest stage that fills one, runs it
through that stage (at a loop a chunk of steps), and puts each lane before its next
stage. Later stages come first, so that few lanes are open.
"""

from __future__ import annotations

import itertools
import math
import threading
import time
import warnings
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from dataclasses import dataclass
from typing import NamedTuple, TypeVar, TypeVarTuple

import jax
import numpy as np

from ..numerics.rules import whole_number
from ..runtime import own_flags
from .program import Compiled
from .stages import Stage

# Chunk length trades the cost of a call, with what Python does between two, about that
# of so many steps of 128 lanes, against lanes that idle once they have ended, for half
# a chunk each: the sum is least at sqrt(2 CALL steps). Values of 70 to 150 could not be
# told apart on two kinds of processor.
CALL, LANES = 100, 128
SHORTEST_CHUNK, FIRST_CHUNK, LONGEST_CHUNK = 64, 128, 1024
LAST_CHUNK = 4096  # where no lane waits for a place; but Ctrl-C has to wait for it
# Where lanes cost alike, a chunk is a lane's whole run: none idles for long, and calls
# are few. A few stragglers wait until they fill a batch.
ALIKE, STRAGGLERS, LONGEST_RUN = 0.8, 0.05, 16384
# A lane makes no step in a chunk where a motion of its sequence ends as it begins.
STALLED = 8
# Every so many calls one is made twice: it costs 0.4 % and must give the same bits.
CANARY = 256
LATE = 0.5  # seconds that results may wait for others
_CALLS = itertools.count(1)  # of this process: a cluster's blocks make a few each


@dataclass(frozen=True)
class Lanes:
    """Options of how a sweep computes its points: batches and threads.

    A lane is a point while it runs.

    **Arguments:**

    - `batch_size`: lanes in a batch. None is 8192 for points without a motion. With
        motions it is 128 (64 or 32 for sweeps of no more than two of these), or 384
        where `configure_cpu()` was needed and not called. It is rounded up to a
        multiple of 32, which fills a processor's vectors: so the result of a lane
        depends neither on its batch mates nor on its place. Another batch size is
        another program; sizes of 32, 64 and 128 gave the same bits wherever they were
        compared, others agree to rounding.
    - `threads`: None uses every core that the process may use.

    **Raises:** `ValueError` for a number that breaks a rule.
    """

    batch_size: int | None = None
    threads: int | None = None

    def __post_init__(self):
        """Check them."""
        for name in ("batch_size", "threads"):
            if getattr(self, name) is not None:
                whole_number(name, getattr(self, name))


# the values of the parameters at places of a grid, by their names
Values = Callable[[np.ndarray], dict[str, np.ndarray]]
# told of places, their results (lanes behind) and their steps
Put = Callable[[np.ndarray, list[np.ndarray], np.ndarray], object]
Inputs = TypeVarTuple("Inputs")
Output = TypeVar("Output")


class Effort(NamedTuple):
    """The cost of some lanes."""

    seconds: float
    own_steps: int  # of the lanes
    all_steps: int  # that their batches ran
    canary_checks: int  # calls that were made twice
    canary_mismatches: int  # and gave other numbers the second time

    @property
    def useful_steps(self) -> float:
        """The share of the lanes' own steps; NaN where no loop was cut."""
        return self.own_steps / self.all_steps if self.all_steps else float("nan")

    def plus(self, other: Effort) -> Effort:
        """The cost of these and of others."""
        steps = self.own_steps + other.own_steps, self.all_steps + other.all_steps
        checks = self.canary_checks + other.canary_checks
        mismatches = self.canary_mismatches + other.canary_mismatches
        return Effort(self.seconds + other.seconds, *steps, checks, mismatches)


NO_EFFORT = Effort(0.0, 0, 0, 0, 0)


def run_lanes(
    program: Compiled,
    values: Values,
    points: Iterator[np.ndarray],
    put: Put,
    *,
    threads: int,
    on_batch: Callable[[int, float], object],
) -> Effort:
    """Compute points.

    **Arguments:**

    - `values`: the parameters' values at places.
    - `points`: places, some at a time.
    - `put`: told by any thread of places, their results (lanes behind) and steps.
    - `on_batch`: told the number of finished points and the useful share.
    """
    pool, reported = Pool(program, values, points), 0
    run, started = Run(program, pool, put), time.perf_counter()
    workers = ThreadPoolExecutor(threads)
    try:
        running = {workers.submit(run.thread) for _ in range(threads)}
        while running:
            ended, running = wait(running, 0.1, return_when=FIRST_COMPLETED)
            finished, useful = run.finished, run.effort(0.0).useful_steps
            on_batch(finished - reported, useful)
            reported = finished
            for future in ended:
                future.result()
    finally:
        # Ctrl-C and errors: a batch in flight ends its chunk, nothing more is begun
        pool.close()
        workers.shutdown(wait=True)
    effort = run.effort(time.perf_counter() - started)
    if effort.canary_mismatches:
        warn_of(effort.canary_mismatches, effort.canary_checks)
    return effort


def warn_of(mismatches: int, checks: int) -> None:
    """Say that the same program has given different numbers."""
    warnings.warn(
        f"{mismatches} of {checks} batches that were computed twice gave other numbers "
        "the second time: this processor, or JAX on it, is not to be trusted with "
        "threads. Sweep with `threads=1` and compare.",
        stacklevel=2,
    )


class OpenLanes(NamedTuple):
    """Lanes before a stage; they stand behind in `rows`."""

    points: np.ndarray  # their places
    steps: np.ndarray  # so far
    here: np.ndarray  # of them at the present loop
    came: np.ndarray  # of these before the present phase of the loop
    stalled: np.ndarray  # chunks in a row in which the lane took none
    rows: tuple[np.ndarray, ...]  # the stage's fixed and state arrays

    def at(self, lanes: np.ndarray | slice) -> OpenLanes:
        """The lanes at these places."""
        rows = tuple(row[:, lanes] for row in self.rows)
        points, steps, here, came, stalled = (x[lanes] for x in self[:-1])
        return OpenLanes(points, steps, here, came, stalled, rows)


def joined(parts: list[OpenLanes]) -> OpenLanes:
    """All of them, behind each other."""
    if len(parts) == 1:
        return parts[0]
    *counts, rows = zip(*parts, strict=True)
    rows = tuple(np.concatenate(r, axis=1) for r in zip(*rows, strict=True))
    points, steps, here, came, stalled = map(np.concatenate, counts)
    return OpenLanes(points, steps, here, came, stalled, rows)


class Pool:
    """The lanes that wait before each stage, and the points that have not begun."""

    def __init__(self, program: Compiled, values: Values, source: Iterator[np.ndarray]):
        """`source` gives some points at a time."""
        self.names, self.values, self.source = program.names, values, source
        self.waiting: list[deque[OpenLanes]] = [deque() for _ in program.stages]
        self.counts = np.zeros(len(program.stages), int)
        self.widths = np.array([stage.lanes for stage in program.stages])
        self.changed = threading.Condition()
        self.closed = self.exhausted = False
        self.out = np.zeros(len(program.stages), int)  # batches that are being led
        self.results_at = time.monotonic()

    def take(self) -> tuple[int, OpenLanes, bool] | None:
        """A stage, a batch of lanes for it, and whether no lane waits for a place.

        None where no batch will come any more.
        """
        with self.changed:
            while not self.closed:
                self._begin()
                number = self._chosen()
                if self.counts[number]:
                    self.out[number] += 1
                    lanes = self._some(number)
                    elsewhere = self.out.sum() - self.out[number]
                    waits = elsewhere or self.counts[:-1].any() or not self.exhausted
                    return number, lanes, not waits
                if not self.out.any():
                    return None
                self.changed.wait(0.1)
        return None

    def give(
        self, stage: int, parts: list[tuple[int, OpenLanes]], stay_first: bool
    ) -> None:
        """Let the lanes of a batch wait where they go on.

        Those that stay at its stage may go on first: then slow lanes begin early, and
        few are left in the end.
        """
        with self.changed:
            self.out[stage] -= 1
            for number, lanes in parts:
                waiting = self.waiting[number]
                first = stay_first and number == stage
                (waiting.appendleft if first else waiting.append)(lanes)
                self.counts[number] += lanes.points.size
            self.changed.notify_all()

    def close(self) -> None:
        """Hand out no more."""
        with self.changed:
            self.closed = True
            self.changed.notify_all()

    def _begin(self) -> None:
        """Points for a batch of the first stage, if there are any."""
        while self.counts[0] < self.widths[0] and not self.exhausted:
            points = next(self.source, None)
            if points is None:
                self.exhausted = True
            elif points.size:
                none = np.zeros_like(points)
                values = self.values(points)
                rows = (np.stack([values[name] for name in self.names]),)
                self.waiting[0].append(OpenLanes(points, none, none, none, none, rows))
                self.counts[0] += points.size

    def _chosen(self) -> int:
        """The latest stage that fills a batch, else the fullest; results in time."""
        last = len(self.waiting) - 1
        if self.counts[last] and time.monotonic() > self.results_at + LATE:
            number = last
        else:
            full = np.flatnonzero(self.counts >= self.widths)
            number = int(full[-1] if full.size else self.counts.argmax())
        if number == last:
            self.results_at = time.monotonic()
        return number

    def _some(self, number: int) -> OpenLanes:
        """A batch of those that wait before a stage."""
        parts, waiting, count = [], self.waiting[number], int(self.widths[number])
        while count > 0 and waiting:
            first = waiting.popleft()
            if first.points.size > count:
                waiting.appendleft(first.at(slice(count, None)))
                first = first.at(slice(0, count))
            parts.append(first)
            count -= first.points.size
            self.counts[number] -= first.points.size
        return joined(parts)


class Run:
    """The pool's lanes, led by threads, and a count of their cost."""

    def __init__(self, program: Compiled, pool: Pool, put: Put):
        """`put` takes results."""
        self.program, self.pool, self.put = program, pool, put
        self.lock = threading.Lock()
        self.finished = self.own_steps = self.all_steps = 0
        self.checks = self.mismatches = 0
        # the steps of the last lanes that ended at each stage
        self.recent = [np.zeros(0, np.int64) for _ in program.stages]
        self.alike = [False for _ in program.stages]  # whether these hardly differ

    def effort(self, seconds: float) -> Effort:
        """The cost so far."""
        counts = self.own_steps, self.all_steps, self.checks, self.mismatches
        return Effort(seconds, *counts)

    def thread(self) -> None:
        """Lead batches, one after the other, until there are no more.

        Where lanes cost alike a batch goes on without new ones until few are left in
        it: beside these they would idle for a whole run.
        """
        while (batch := self.pool.take()) is not None:
            number, lanes, last = batch
            few, parts = STRAGGLERS * self.program.stages[number].lanes, []
            while lanes is not None:
                after = self.lead(number, lanes, last)
                parts += [(way, part) for way, part in after if way != number]
                lanes = next((part for way, part in after if way == number), None)
                if lanes is None or not self.alike[number] or lanes.points.size <= few:
                    break
            parts += [] if lanes is None else [(number, lanes)]
            self.pool.give(number, parts, stay_first=not self.alike[number])

    def lead(
        self, number: int, lanes: OpenLanes, last: bool
    ) -> list[tuple[int, OpenLanes]]:
        """Lead a batch through a stage: its lanes, where they go on."""
        stage, count = self.program.stages[number], lanes.points.size
        rows = lanes.rows
        if count < stage.lanes:  # real lanes again: another size is another program
            rows = lanes.at(np.arange(stage.lanes) % count).rows
        fixed, state = split(stage, rows)
        if stage.is_loop:
            steps = np.int32(LAST_CHUNK if last else self.chunk(number, lanes))
            state, status = self.call(lanes, stage.function, steps, fixed, state)
            rows = tuple(np.asarray(row)[:, :count] for row in state)
            return self.went_on(number, lanes, rows, np.asarray(status)[:, :count])
        after = self.call(lanes, stage.function, fixed, state)
        if number + 1 < len(self.program.stages):
            rows = tuple(np.asarray(row)[:, :count] for part in after for row in part)
            none = np.zeros_like(lanes.points)
            lanes = lanes._replace(here=none, came=none, stalled=none, rows=rows)
            return [(number + 1, lanes)]
        results = self.program.results.unpack([np.asarray(part) for part in after])
        self.put(lanes.points, [r[..., :count] for r in results], lanes.steps)
        with self.lock:
            self.finished += count
            self.own_steps += int(lanes.steps.sum())
        return []

    def went_on(
        self,
        number: int,
        lanes: OpenLanes,
        state: tuple[np.ndarray, ...],
        status: np.ndarray,
    ) -> list[tuple[int, OpenLanes]]:
        """The lanes of a loop, each before the stage at which it goes on."""
        stage = self.program.stages[number]
        phases, here = status.astype(np.int64)
        next_stage = np.array(stage.ways)[phases]  # ENDED is the last
        taken, stays = here - lanes.here, next_stage == number
        stalled = np.where(stays & (taken == 0), lanes.stalled + 1, 0)
        if stalled.max() >= STALLED:
            lane = [stalled.argmax()]
            raise RuntimeError(
                "A lane takes no step and comes to no end, after "
                f"{here[lane][0]} steps at {self.spans(lanes.points[lane])}."
            )
        with self.lock:
            self.all_steps += int(taken.max()) * stage.lanes
            ended = (here - lanes.came)[~stays]
            self.recent[number] = np.append(self.recent[number], ended)[-stage.lanes :]
        came = np.where(stays, lanes.came, here)
        rows = *split(stage, lanes.rows)[0], *state
        steps = lanes.steps + taken
        after = OpenLanes(lanes.points, steps, here, came, stalled, rows)
        if stays.all():
            return [(number, after)]
        ways = sorted(set(next_stage.tolist()))
        return [(way, after.at(np.flatnonzero(next_stage == way))) for way in ways]

    def chunk(self, number: int, lanes: OpenLanes) -> int:
        """How many steps of a loop are run at a time."""
        stage, recent = self.program.stages[number], self.recent[number]
        dear = max(LANES / stage.lanes, 1.0)  # a call, in steps of so few lanes
        if not recent.size:
            return int(FIRST_CHUNK * math.sqrt(dear))
        few, ordered = int(STRAGGLERS * recent.size), np.sort(recent)
        slow = int(ordered[-1 - few])
        typical = np.minimum(ordered, slow).mean()
        alike = 2 * recent.size >= stage.lanes and typical > ALIKE * slow > 0
        self.alike[number] = bool(alike)
        if alike:
            left = slow - int((lanes.here - lanes.came).min())
            return min(max(left, slow // 16, SHORTEST_CHUNK), LONGEST_RUN)
        fair = math.sqrt(2 * CALL * dear / stage.cost * typical)
        return min(max(int(fair), SHORTEST_CHUNK), LONGEST_CHUNK)

    def call(
        self,
        lanes: OpenLanes,
        function: Callable[[*Inputs], Output],
        *arguments: *Inputs,
    ) -> Output:
        """Run a program and wait for it; now and then a second time, to compare."""
        after = self._call(lanes, function, *arguments)
        if next(_CALLS) % CANARY == 0:
            same = _same_bits(after, self._call(lanes, function, *arguments))
            with self.lock:
                self.checks += 1
                self.mismatches += not same
        return after

    def _call(
        self,
        lanes: OpenLanes,
        function: Callable[[*Inputs], Output],
        *arguments: *Inputs,
    ) -> Output:
        """One call; what it raises says at which points."""
        try:
            with own_flags(), jax.enable_x64(True):  # a thread's own
                return jax.block_until_ready(function(*arguments))
        except Exception as error:
            error.add_note(f"In a batch of points with {self.spans(lanes.points)}.")
            raise

    def spans(self, points: np.ndarray) -> str:
        """Where these points lie."""
        values = self.pool.values(points).items()
        return ", ".join(f"{v.min():.17g} <= {n} <= {v.max():.17g}" for n, v in values)


def split(
    stage: Stage, rows: tuple[np.ndarray, ...]
) -> tuple[tuple[np.ndarray, ...], tuple[np.ndarray, ...]]:
    """A stage's fixed arrays and its state."""
    count = len(stage.fixed.used)
    return tuple(rows[:count]), tuple(rows[count:])


def _same_bits(one: Output, other: Output) -> bool:
    pairs = zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True)
    return all(np.asarray(a).tobytes() == np.asarray(b).tobytes() for a, b in pairs)
