"""Lanes between the stages of a point, and the calls that lead them on."""

import itertools
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol, TypeVar, TypeVarTuple

import jax
import numpy as np

from ..numerics.numbers import whole_number
from ..runtime import own_flags
from .axes import parameters
from .stages import Stage

# Every so many calls one is made twice: it costs 0.4 % and must give the same bits.
CANARY = 256
LATE = 0.5  # seconds that results may wait for others
PAUSE = 0.001  # seconds after which a thread without lanes looks again at the latest
_CALLS = itertools.count(1)  # of this process: a cluster's blocks make a few each


class Queue:
    """The points that wait, handed out in order to any thread."""

    def __init__(self, source: Iterator[np.ndarray]):
        """`source` gives some points at a time."""
        self.source, self.closed = source, False
        self.waiting = np.zeros(0, np.int64)
        self.lock = threading.Lock()

    def take(self, count: int) -> np.ndarray:
        """So many points, fewer only at the end."""
        taken = [np.zeros(0, np.int64)]
        with self.lock:
            while count and not self.closed:
                self._fill()
                part, self.waiting = self.waiting[:count], self.waiting[count:]
                if not part.size:  # the end
                    break
                taken.append(part)
                count -= part.size
        return np.concatenate(taken)

    def ready(self) -> int:
        """How many points are known to wait: 0 only at the end."""
        with self.lock:
            self._fill()
            return 0 if self.closed else self.waiting.size

    def _fill(self) -> None:
        if not self.waiting.size and not self.closed:
            self.waiting = next(self.source, self.waiting)

    def close(self) -> None:
        """Hand out no more."""
        with self.lock:
            self.closed = True


@dataclass(frozen=True)
class Lanes:
    """How the lanes of a sweep run.

    **Arguments:**

    - `batch_size`: lanes a batch. None is 8192 for points that follow no motion, and
        else 128 (64 or 32 for sweeps of no more than two of these), or 384 where
        `configure_cpu()` was needed and not called. It is rounded up to a multiple of
        32, whole vectors of a processor: so a lane's result depends
        neither on its batch mates nor on its place. Another batch size is another
        program; those of 32, 64 and 128 lanes gave the same bits wherever they were
        compared, others are equal to rounding.
    - `threads`: None uses every core that the process may use.

    **Raises:** `ValueError` for what breaks a rule.
    """

    batch_size: int | None = None
    threads: int | None = None

    def __post_init__(self):
        """Check them."""
        for name in ("batch_size", "threads"):
            if getattr(self, name) is not None:
                whole_number(name, getattr(self, name))


class OpenLanes(NamedTuple):
    """Lanes between two stages; they stand behind in `rows`."""

    points: np.ndarray  # places in the grid
    steps: np.ndarray  # so far
    here: np.ndarray  # of them in the present loop
    rows: tuple[np.ndarray, ...]  # the next stage's fixed and state arrays

    def at(self, lanes: np.ndarray) -> "OpenLanes":
        """The lanes at these places."""
        rows = tuple(row.take(lanes, axis=1) for row in self.rows)
        return OpenLanes(self.points[lanes], self.steps[lanes], self.here[lanes], rows)

    def between(self, begin: int, end: int | None) -> "OpenLanes":
        """Those at the places from `begin` on and before `end`; nothing is copied."""
        cut = slice(begin, end)
        rows = tuple(row[:, cut] for row in self.rows)
        return OpenLanes(self.points[cut], self.steps[cut], self.here[cut], rows)


def joined(parts: Sequence[OpenLanes]) -> OpenLanes:
    """All of them, behind each other."""
    if len(parts) == 1:
        return parts[0]
    *counts, rows = zip(*parts, strict=True)
    rows = tuple(np.concatenate(r, axis=1) for r in zip(*rows, strict=True))
    points, steps, here = map(np.concatenate, counts)
    return OpenLanes(points, steps, here, rows)


class Batch(Protocol):
    """Lanes at a loop, as `scheduler` runs them."""

    loop: int
    busy: np.ndarray  # which of its places hold a lane

    def lanes(self, chosen: np.ndarray) -> OpenLanes:
        """The chosen lanes as they are."""
        ...


Inputs = TypeVarTuple("Inputs")
Output = TypeVar("Output")


class Work:
    """The stages, the lanes that wait before each, and where results go."""

    def __init__(self, program, axes, queue, put):
        """Nothing has begun; `put` is told of results."""
        self.program, self.queue, self.put = program, queue, put
        self.stages = program.stages
        self.names, self.axes = program.names, axes
        self.shape = tuple(axis.size for axis in axes.values())
        self.lock = threading.Condition()  # told where lanes wait anew
        self.waiting: list[deque[OpenLanes]] = [deque() for _ in self.stages]
        self.batches: set[Batch] = set()  # that run at a loop
        self.led = 0  # segments that are running: their lanes wait nowhere
        self.finished = self.reported = 0
        self.handed_over = time.monotonic()
        self.own_steps = self.all_steps = 0
        self.checks = self.mismatches = 0

    # Lanes between stages -------------------------------------------------------------

    def give(self, number: int, lanes: OpenLanes) -> None:
        """Let lanes wait before a stage."""
        if lanes.points.size:
            with self.lock:
                self.waiting[number].append(lanes)
                self.lock.notify_all()

    def take(self, number: int, count: int) -> list[OpenLanes]:
        """At most so many of the lanes that wait before a stage."""
        if number == 0:
            points = self.queue.take(count)
            rows = (np.stack(self.values(points)),)
            none = np.zeros_like(points)
            return [OpenLanes(points, none, none, rows)] if points.size else []
        parts: list[OpenLanes] = []
        with self.lock:
            waiting = self.waiting[number]
            while count > 0 and waiting:
                first = waiting.popleft()
                size = first.points.size
                if size > count:
                    waiting.appendleft(first.between(count, None))
                    first = first.between(0, count)
                parts.append(first)
                count -= size
        return parts

    def count(self, number: int) -> int:
        """How many lanes wait before a stage."""
        if number == 0:
            return self.queue.ready()
        with self.lock:
            return sum(lanes.points.size for lanes in self.waiting[number])

    def ready(self, loop: int) -> int:
        """How many lanes could begin a loop's phase."""
        return self.count(loop) + (self.count(loop - 1) if self.begins(loop) else 0)

    def begins(self, loop: int) -> bool:
        """Whether it is the phase in which lanes come to its loop."""
        return loop == self.stages[loop].ways[0]

    def width(self, number: int) -> int:
        """How many lanes a stage takes at a time."""
        return self.stages[number].lanes

    def change(self, old: Batch | None, new: Batch) -> None:
        """One batch less and one more."""
        with self.lock:
            self.batches = (self.batches - {old}) | {new}

    def leave(self, batch: Batch | None) -> bool:
        """Whether a thread without lanes may end: not if more may come its way."""
        with self.lock:
            ends = not self.led and not any(self.waiting[1:-1])
            if ends:
                self.batches.discard(batch)
            else:
                self.lock.wait(PAUSE)
        return ends

    def is_last(self) -> bool:
        """Whether no lane waits for a place at the only loop, and none will come."""
        with self.lock:
            coming = self.led or any(self.waiting[:-1])
        only = len(self.stages) == 3  # a segment before it and one behind
        if self.queue.closed:  # a long call is none to begin
            return False
        return only and not coming and not self.queue.ready()

    def join(self, batch: Batch) -> bool:
        """Leave the last lanes to a fuller batch at their loop, if one has room."""
        mine = np.count_nonzero(batch.busy)
        if not mine or self.led:
            return False
        with self.lock:
            for other in self.batches - {batch}:
                busy = np.count_nonzero(other.busy)
                room = batch.busy.size - mine
                if other.loop == batch.loop and mine <= busy <= room:
                    self.waiting[batch.loop].append(batch.lanes(batch.busy))
                    self.batches.discard(batch)
                    return True
        return False

    def supply(self, loop: int, count: int) -> list[OpenLanes]:
        """At most so many lanes to begin a loop, led there if they are not yet."""
        while self.begins(loop) and self.count(loop) < count and self.segment(loop - 1):
            pass
        return self.take(loop, count)

    def segment(self, number: int) -> bool:
        """Lead a batch through a segment; False if no lane waits."""
        if number == len(self.stages) - 1:
            return self._segment(number)  # to the results
        with self.lock:
            self.led += 1
        try:
            return self._segment(number)
        finally:
            with self.lock:
                self.led -= 1
                self.lock.notify_all()

    def _segment(self, number: int) -> bool:
        stage = self.stages[number]
        parts = self.take(number, stage.lanes)
        if not parts:
            return False
        lanes = joined(parts)
        count = lanes.points.size
        # padded with real lanes: another size would be compiled again
        padded = lanes.at(np.arange(stage.lanes) % count).rows
        after = self.call(lanes.points, stage.function, *split(stage, padded))
        if number + 1 < len(self.stages):
            rows = tuple(np.asarray(row)[:, :count] for part in after for row in part)
            here = np.zeros_like(lanes.here)
            self.give(number + 1, lanes._replace(here=here, rows=rows))
            return True
        results = self.program.results.unpack([np.asarray(part) for part in after])
        self.put(lanes.points, [r[..., :count] for r in results], lanes.steps)
        with self.lock:
            self.finished += count
            self.own_steps += int(lanes.steps.sum())
        return True

    def finish(self, all_of_them: bool = False) -> None:
        """Hand over results: of whole batches, all now and then or where asked to."""
        last = len(self.stages) - 1
        late = time.monotonic() > self.handed_over + LATE
        least = 1 if late or all_of_them else self.stages[last].lanes
        while self.count(last) >= least and self.segment(last):
            self.handed_over = time.monotonic()
            if self.queue.closed:
                return

    # Calls ----------------------------------------------------------------------------

    def values(self, points: np.ndarray) -> list[np.ndarray]:
        """The values of the parameters at these points."""
        places = np.unravel_index(points, self.shape)
        pairs = zip(self.axes.items(), places, strict=True)
        here = parameters({name: axis[place] for (name, axis), place in pairs})
        return [here[name].astype(float) for name in self.names]

    def call(
        self,
        points: np.ndarray,
        function: Callable[[*Inputs], Output],
        *arguments: *Inputs,
    ) -> Output:
        """Run a program and wait for it; now and then a second time, to compare."""
        after = self._run(points, function, *arguments)
        with self.lock:
            check = next(_CALLS) % CANARY == 0
        if check:
            same = _same_bits(after, self._run(points, function, *arguments))
            with self.lock:
                self.checks += 1
                self.mismatches += not same
        return after

    def _run(
        self,
        points: np.ndarray,
        function: Callable[[*Inputs], Output],
        *arguments: *Inputs,
    ) -> Output:
        """One call; what it raises says at which points."""
        try:
            with own_flags(), jax.enable_x64(True):  # a thread's own
                return jax.block_until_ready(function(*arguments))
        except Exception as error:
            error.add_note(f"In a batch of points with {self.spans(points)}.")
            raise

    def spans(self, points: np.ndarray) -> str:
        """Where these points lie."""
        pairs = zip(self.names, self.values(points), strict=True)
        return ", ".join(f"{v.min():.17g} <= {n} <= {v.max():.17g}" for n, v in pairs)

    # Counts ---------------------------------------------------------------------------

    def ran(self, steps: int) -> None:
        """Count the steps that a batch ran."""
        with self.lock:
            self.all_steps += steps

    def useful(self) -> float:
        """The share of steps that belong to lanes which have ended."""
        return self.own_steps / self.all_steps if self.all_steps else float("nan")

    def finished_since(self) -> int:
        """How many points have results since it was last asked."""
        with self.lock:
            since = self.finished - self.reported
            self.reported = self.finished
            return since


def split(
    stage: Stage, rows: tuple[np.ndarray, ...]
) -> tuple[tuple[np.ndarray, ...], tuple[np.ndarray, ...]]:
    """A stage's fixed arrays and its state."""
    count = len(stage.fixed.used)
    return tuple(rows[:count]), tuple(rows[count:])


def _same_bits(one: Output, other: Output) -> bool:
    pairs = zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True)
    return all(np.asarray(a).tobytes() == np.asarray(b).tobytes() for a, b in pairs)
