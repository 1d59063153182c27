"""Blocks that are being filled: results lie here until a block is whole.

Lanes of several blocks run in one batch, and a block is handed over when its last point
has ended; an open block thus has a point in some lane, and there are few more of them
than lanes in batches and in the segments before these.
"""

import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import NamedTuple

import numpy as np
import xarray as xr

from ..results import OUTCOMES, Codes, Variable
from ..runtime import free_memory
from .grid import Block, Grid
from .returned import empty

SHARE = 0.5  # of the free memory that a sweep may fill
_MORE_STEPS = "name more, `Method(max_steps=...)`; where it is stiff, `Rosenbrock()`"
# Codes with which a lane failed, of whatever question, and what to do. A column that
# turned over did not fail, nor did a motion that is undecided, nor a search that found
# rest for a cycle.
REMEDIES = {
    "invalid": "leave such points out by `where`",
    "not_finite": "ask the question there alone, under `jax.debug_nans(True)`",
    "step_vanished": "name larger `Method(rtol=..., atol=...)`, or `Rosenbrock()`",
    "budget_spent": _MORE_STEPS,
    "not_integrated": _MORE_STEPS,
    "no_return": "name a longer `max_time`, or a guess nearer to the cycle",
    "not_converged": "name a guess nearer to the cycle; a branch ends there",
    "chattering": "smooth the friction, e.g. by `SmoothCoulomb`",
}


class Tally(NamedTuple):
    """The cost of a block, and how its points ended."""

    points: int
    seconds: float  # from its first point to its last; others ran meanwhile
    steps: int  # of its lanes; 0 where they follow no motion
    outcomes: dict[str, int]
    failed: dict[str, dict[str, int]]  # points by variable and code, where it failed

    @property
    def failures(self) -> int:
        """Motions that failed."""
        return sum(self.outcomes.get(code, 0) for code in REMEDIES)


class OpenBlock:
    """A block that is being filled."""

    def __init__(self, block: Block, variables: Mapping[str, Variable]):
        """A block without results."""
        self.block, self.variables = block, variables
        self.points = np.flatnonzero(block.chosen)  # places in the block
        shape = block.chosen.shape
        self.arrays = {n: empty(v, shape).copy() for n, v in variables.items()}
        self._flat = [
            np.moveaxis(a.reshape(-1, *a.shape[len(shape) :]), 0, -1)
            for a in self.arrays.values()
        ]
        self._left, self._steps, self._lock = self.points.size, 0, threading.Lock()
        self._began = time.perf_counter()

    def put(
        self, points: np.ndarray, results: list[np.ndarray], steps: np.ndarray
    ) -> bool:
        """Take the results of these places, lanes behind: whether the block is whole.

        Called by any thread; one alone is told that it is.
        """
        for target, result in zip(self._flat, results, strict=True):
            target[..., points] = result
        with self._lock:
            self._left -= points.size
            self._steps += int(steps.sum())
            return not self._left

    def tally(self) -> Tally:
        """The cost of the block, and how its points ended."""
        outcomes: dict[str, int] = {}
        failed: dict[str, dict[str, int]] = {}
        named = zip(self.variables.items(), self._flat, strict=True)
        for (name, variable), values in named:
            # not what a search met on its way, as an onset's `obstacle`
            if variable.codes is not None and not name.endswith("obstacle"):
                failed |= _failed(name, variable.codes, values)
            if variable.codes == OUTCOMES and name.endswith("outcome"):
                here = values[..., self.points].ravel()  # several of a point: branches
                counts = {c.name: int((here == c).sum()) for c in OUTCOMES}
                outcomes = {code: count for code, count in counts.items() if count}
        seconds = time.perf_counter() - self._began
        return Tally(self.points.size, seconds, self._steps, outcomes, failed)


class BlockAssembler:
    """The open blocks of a grid."""

    def __init__(
        self,
        grid: Grid,
        variables: Mapping[str, Variable],
        write_block: Callable[[Block, dict[str, np.ndarray], Tally], None],
    ):
        """`write_block` gets a whole block, its arrays and its tally, in any thread."""
        self.grid, self.variables, self.write_block = grid, variables, write_block
        self.open: dict[int, OpenBlock] = {}

    def points_of(self, blocks: Iterable[int]) -> Iterator[np.ndarray]:
        """The points to compute, as places in the grid, a block at a time."""
        for number in blocks:
            opened = OpenBlock(self.grid.block(number), self.variables)
            self.open[number] = opened
            yield opened.points + self.grid.first(number)

    def put(
        self, points: np.ndarray, results: list[np.ndarray], steps: np.ndarray
    ) -> None:
        """Take the results of these points, lanes behind."""
        numbers = self.grid.number(points)
        several = (numbers != numbers[0]).any()
        for number in np.unique(numbers).tolist() if several else [int(numbers[0])]:
            mine = numbers == number if several else slice(None)
            opened, places = self.open[number], points[mine] - self.grid.first(number)
            if opened.put(places, [r[..., mine] for r in results], steps[mine]):
                del self.open[number]
                self.write_block(opened.block, opened.arrays, opened.tally())


def _failed(name: str, codes: Codes, values: np.ndarray) -> dict[str, dict[str, int]]:
    """At how many points, which stand behind, a code says that the lane failed."""
    values = values.reshape(-1, values.shape[-1])  # several of a point: branches
    failures = [code for code in codes if code.name in REMEDIES]
    counts = {c.name: int((values == c).any(axis=0).sum()) for c in failures}
    counts = {code: count for code, count in counts.items() if count}
    return {name: counts} if counts else {}


def check_room(what: str, size: int) -> None:
    """Refuse what would take more than half of the free memory.

    **Raises:** `ValueError` that says the bytes and names the cure.
    """
    free = free_memory()
    if free is not None and size > SHARE * free:
        raise ValueError(
            f"Argument `store` must be given for a sweep of this size: {what} would "
            f"take {_bytes(size)} of the {_bytes(free)} of free memory. Name a folder, "
            'e.g. `store="map.zarr"`.'
        )


def _bytes(size: int) -> str:
    if size < 1e6:
        return f"{size} bytes"
    return f"{size / 1e9:.3g} GB" if size >= 1e9 else f"{size / 1e6:.3g} MB"


class Memory:
    """Keeps blocks in arrays of the whole grid."""

    def __init__(self, template: xr.Dataset):
        """`template`: the Dataset with nothing computed."""
        self.template = template
        self.arrays = {str(n): v.values.copy() for n, v in template.data_vars.items()}

    def __enter__(self) -> "Memory":
        """Return the arrays: they need no opening."""
        return self

    def __exit__(self, *_: object) -> None:
        """Do nothing: arrays need no closing."""

    def missing(self, grid: Grid) -> dict[int, int]:
        """How many points are to be computed, by block."""
        return grid.missing(lambda _: False)

    def write_block(
        self, block: Block, arrays: Mapping[str, np.ndarray], tally: Tally
    ) -> None:
        """Take a whole block."""
        del tally
        for name, values in arrays.items():
            self.arrays[name][block.region] = values

    def dataset(self, attributes: Mapping[str, object]) -> xr.Dataset:
        """The sweep's result."""
        data = {
            n: (v.dims, self.arrays[str(n)], v.attrs)
            for n, v in self.template.data_vars.items()
        }
        attributes = {**self.template.attrs, **attributes}
        return xr.Dataset(data, self.template.coords, attributes)
