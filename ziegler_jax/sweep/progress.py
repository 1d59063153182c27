"""The progress of a sweep: a bar for the eye, a line a block for a program."""

import json
import logging
import sys
import threading
import time
import warnings
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TextIO

import numpy as np
from tqdm import tqdm

from ..results import Variable
from .assembly import REMEDIES, Tally
from .grid import Block

TICK = 0.5  # seconds
_LOG = logging.getLogger("ziegler_jax.sweep")


def stream() -> TextIO:
    """Where a bar goes: a notebook shows what goes to stderr as if it were wrong."""
    return sys.stdout if in_notebook() else sys.stderr


def shown(show: bool | None) -> bool:
    """Whether the bar is shown: by default on a terminal and in a notebook."""
    if show is not None:
        return show
    return in_notebook() or (sys.stderr is not None and sys.stderr.isatty())


def in_notebook() -> bool:
    """Whether a notebook's kernel runs this process."""
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    return type(shell).__name__ == "ZMQInteractiveShell"


@contextmanager
def announced(bar: tqdm, what: str) -> Iterator[None]:
    """Say what is being waited for, and for how many seconds, in front of a bar."""
    began, over = time.perf_counter(), threading.Event()

    def tick() -> None:
        while not over.wait(TICK):
            seconds = time.perf_counter() - began
            bar.set_description_str(f"{what}, {seconds:.0f} s")

    ticks = threading.Thread(target=tick, daemon=True)
    if not bar.disable:
        ticks.start()
    try:
        yield
    finally:
        over.set()
        if not bar.disable:
            ticks.join()
            bar.set_description_str("")


@contextmanager
def tracing(show: bool | None) -> Iterator[None]:
    """Say that a scene is traced, before there is a bar of its points."""
    bar = tqdm(file=stream(), bar_format="{desc}", leave=False, disable=not shown(show))
    with bar, announced(bar, "tracing the scene"):
        yield


class Progress:
    """A bar with points per second, useful steps, failures and time left; and a log.

    A message of the logger `ziegler_jax.sweep`, of level INFO, is a JSON object: the
    `block`'s number, the least and the largest value of each axis in `ranges`,
    `points`, `outcomes`, those that `failed`, `seconds` from its first point to its
    last (others ran meanwhile), and the `steps` of its lanes, 0 where they follow no
    motion in chunks. `steps / points` shows a region that is slow by itself.
    """

    def __init__(self, done: int, total: int, show: bool | None):
        """Open the bar."""
        self._lock = threading.Lock()
        self._bar = tqdm(
            file=stream(),
            initial=done,
            total=total,
            unit="point",
            unit_scale=True,
            smoothing=0.05,
            disable=not shown(show),
        )
        self._failures = 0
        self.failed: dict[str, Counter[str]] = {}  # points by variable and code

    def __enter__(self) -> "Progress":
        """Return the bar, which is open already."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close it."""
        self._bar.close()

    @contextmanager
    def compiling(self) -> Iterator[None]:
        """Say that the scene is compiled, and how long that takes."""
        with announced(self._bar, "compiling the scene"):
            yield
        if not self._bar.disable:
            self._bar.unpause()  # points per second are counted from here

    def advance(self, points: int, useful_steps: float) -> None:
        """So many points more have ended."""
        parts = (
            [f"{useful_steps:.0%} useful steps"] if np.isfinite(useful_steps) else []
        )
        parts += [f"{self._failures} failed"] if self._failures else []
        self._bar.set_postfix_str(", ".join(parts), refresh=False)
        self._bar.update(points)

    def finished(self, block: Block, tally: Tally) -> None:
        """A block is whole and kept; called by any thread."""
        with self._lock:
            self._failures += tally.failures
            for name, codes in tally.failed.items():
                self.failed.setdefault(name, Counter()).update(codes)
        if _LOG.isEnabledFor(logging.INFO):
            line = {"block": block.number, "ranges": block.ranges(), **tally._asdict()}
            _LOG.info(json.dumps(line))

    def warn_of_failures(self, points: int, variables: Mapping[str, Variable]) -> None:
        """Say how many points failed, with which code, and what to do."""
        parts = []
        for name, counts in self.failed.items():
            codes = variables[name].codes
            parts += [
                f"At {counts[code.name]} `{name}` is `{code.name}` ({code.sentence}): "
                f"{REMEDIES[code.name]}."
                for code in codes or ()
                if counts[code.name]
            ]
        if parts:
            text = f"Of {points} points some failed. {' '.join(parts)}"
            warnings.warn(text, stacklevel=4)
