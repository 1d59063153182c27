"""A grid cut into blocks: runs of neighbouring points that are kept as one.

A block is a box of the grid, whole along the last axes, a run along one, and a single
value along those in front: in C order its points follow each other. Lanes of several
blocks run in one batch, and a block is handed over when its last point has ended; an
open block thus has a point in some lane, and there are few more of them than lanes in
batches and in the segments before these.
"""

import hashlib
import math
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple, cast

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from ..results import OUTCOMES, Codes, Variable
from ..runtime import free_memory
from .axes import empty, parameters

# Writing a block costs some 10 ms, computing one seconds; its arrays are about 1 MB.
POINTS_A_BLOCK = 16_384
# Points may be slow, each a search of seconds: a small sweep has parts to keep, too.
# Batches in flight hold some 256 points, so that smaller parts were not kept sooner.
PARTS, FEWEST = 16, 256
SHARE = 0.5  # of the free memory that a sweep may fill


class Block(NamedTuple):
    """A part of a grid."""

    number: int
    region: tuple[slice, ...]  # of the grid
    axes: dict[str, np.ndarray]  # their values in the block
    chosen: np.ndarray  # which points are to be computed, in the block's shape

    def ranges(self) -> dict[str, list[float]]:
        """The least and the largest value of each parameter."""
        values = parameters(self.axes)
        return {n: [float(v.min()), float(v.max())] for n, v in values.items()}

    def __str__(self) -> str:
        """Its number and where it lies."""
        spans = [f"{a:.17g} <= {n} <= {b:.17g}" for n, (a, b) in self.ranges().items()]
        return f"block {self.number} ({', '.join(spans)})"


class Blocks:
    """The blocks of a grid, and which of their points are to be computed."""

    def __init__(
        self,
        grid: dict[str, np.ndarray],
        where: Callable[..., ArrayLike] | np.ndarray | None = None,
        points_a_block: int | None = None,
    ):
        """Cut the grid; ask `where` about every block, unless it is the answer.

        A small grid is cut into `PARTS`, of `FEWEST` points at least.

        **Raises:** `ValueError` if `where` breaks its rules or leaves no point.
        """
        self.grid, self.where = grid, where
        self.shape = tuple(values.size for values in grid.values())
        part = max(math.prod(self.shape) // PARTS, FEWEST)
        points = points_a_block or min(part, POINTS_A_BLOCK)
        self.axis, self.chunk = _cut(self.shape, points)
        self.inner = int(np.prod(self.shape[self.axis + 1 :]))
        self.run = self.chunk[self.axis] * self.inner  # points a whole block
        self.span = self.shape[self.axis] * self.inner  # points along the cut axis
        self.along = -(-self.shape[self.axis] // self.chunk[self.axis])
        self.count = self.along * int(np.prod(self.shape[: self.axis]))
        self._decide()

    @property
    def points(self) -> int:
        """How many points are to be computed."""
        return int(self.sizes.sum())

    def _decide(self) -> None:
        """How many points each block has to compute, and a digest of which."""
        if self.where is None:
            sizes = np.full(self.count, self.run)
            short = self.span - (self.along - 1) * self.run
            sizes[self.along - 1 :: self.along] = short
            self.sizes, self.digest = sizes, "all"
            return
        digest = hashlib.sha256()
        self.sizes = np.zeros(self.count, np.int64)
        for number in range(self.count):
            chosen = self.block(number).chosen
            self.sizes[number] = chosen.sum()
            digest.update(np.packbits(chosen).tobytes())
        if not self.sizes.any():
            raise ValueError("Argument `where` must leave a point, but leaves none.")
        if callable(self.where):
            self._check_pointwise()
        self.digest = digest.hexdigest()

    def _check_pointwise(self) -> None:
        """The first and the last point of a block alone are chosen as within it."""
        block = self.block(int(self.sizes.argmax()))
        for end in (0, -1):
            alone = {name: values[[end]] for name, values in block.axes.items()}
            where = cast(Callable[..., ArrayLike], self.where)
            if evaluate_where(where, alone).item() != block.chosen.flat[end]:
                here = parameters(alone)
                values = ", ".join(f"{name} = {v[0]:g}" for name, v in here.items())
                raise ValueError(
                    "Argument `where` must judge each point by its own values, but "
                    f"judges {values} otherwise when it is alone."
                )

    def block(self, number: int) -> Block:
        """The block of this number, in C order."""
        outer, part = divmod(number, self.along)
        front = np.unravel_index(outer, self.shape[: self.axis])
        first = part * self.chunk[self.axis]
        last = min(first + self.chunk[self.axis], self.shape[self.axis])
        region = (
            *(slice(int(i), int(i) + 1) for i in front),
            slice(first, last),
            *(slice(0, size) for size in self.shape[self.axis + 1 :]),
        )
        pairs = zip(self.grid.items(), region, strict=True)
        axes = {name: values[part] for (name, values), part in pairs}
        if self.where is None:
            chosen = np.ones(tuple(values.size for values in axes.values()), bool)
        elif callable(self.where):
            chosen = evaluate_where(self.where, axes)
        else:
            chosen = self.where[region]
        return Block(number, region, axes, chosen)

    def values(self, points: np.ndarray) -> dict[str, np.ndarray]:
        """The parameters' values at places of the grid, in C order."""
        places = np.unravel_index(points, self.shape)
        pairs = zip(self.grid.items(), places, strict=True)
        here = parameters({name: axis[place] for (name, axis), place in pairs})
        return {name: values.astype(float) for name, values in here.items()}

    def chosen(self) -> np.ndarray:
        """Which points of the whole grid are to be computed."""
        if self.where is None:
            return np.ones(self.shape, bool)
        return (
            evaluate_where(self.where, self.grid)
            if callable(self.where)
            else self.where
        )

    def first(self, number: int) -> int:
        """The place of the block's first point in the grid, in C order."""
        outer, part = divmod(number, self.along)
        return outer * self.span + part * self.run

    def number(self, points: np.ndarray) -> np.ndarray:
        """The blocks that hold these points."""
        outer, within = np.divmod(points, self.span)
        return outer * self.along + within // self.run


def _cut(shape: Sequence[int], points: int) -> tuple[int, tuple[int, ...]]:
    """Which axis is cut, and the shape of a whole block of about so many points."""
    inner = 1
    for axis in reversed(range(len(shape))):
        if inner * shape[axis] > points or axis == 0:
            parts = max(1, round(shape[axis] * inner / points))
            run = -(-shape[axis] // min(parts, shape[axis]))
            return axis, (1,) * axis + (run, *shape[axis + 1 :])
        inner *= shape[axis]
    raise AssertionError("a grid has an axis")


def evaluate_where(
    where: Callable[..., ArrayLike], box: dict[str, np.ndarray]
) -> np.ndarray:
    """Which points of a box `where` chooses.

    **Raises:** `ValueError` if it breaks its rules.
    """
    shape = tuple(axis.size for axis in box.values())
    mesh = {}
    for place, (dim, axis) in enumerate(box.items()):
        along = (-1, *[1] * (len(shape) - 1 - place))  # those in front broadcast
        here = parameters({dim: axis})
        mesh |= {name: values.reshape(along) for name, values in here.items()}
    try:
        chosen = np.asarray(where(**mesh))
        valid = np.broadcast_to(chosen, shape)
    except MemoryError:
        raise
    except Exception as error:
        raise ValueError(
            "Argument `where` must work on arrays that broadcast (use `&`, not `and`), "
            f"but raised {type(error).__name__}: {error}"
        ) from error
    if valid.dtype != bool:
        raise ValueError(
            f"Argument `where` must return booleans, but returned {valid.dtype}."
        )
    return valid


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
    """What a block cost and how its points ended."""

    points: int
    seconds: float  # from its first point to its last; others ran meanwhile
    steps: int  # of its lanes; 0 where they follow no motion
    outcomes: dict[str, int]
    failed: dict[str, dict[str, int]]  # points by variable and code, where it failed

    @property
    def failures(self) -> int:
        """Motions that failed."""
        return sum(self.outcomes.get(code, 0) for code in REMEDIES)


class BlockAssembler:
    """The open blocks: results lie here until their block is whole."""

    def __init__(
        self,
        blocks: Blocks,
        variables: dict[str, Variable],
        write_block: Callable[[Block, dict[str, np.ndarray], Tally], None],
    ):
        """`write_block` gets a whole block, its arrays and its tally, in any thread."""
        self.blocks, self.variables, self.write_block = blocks, variables, write_block
        self.open: dict[int, OpenBlock] = {}
        self.lock = threading.Lock()

    def points_of(self, blocks: Iterable[Block]) -> Iterator[np.ndarray]:
        """The points to compute, as places in the grid, a block at a time."""
        for block in blocks:
            points = np.flatnonzero(block.chosen)
            shape = block.chosen.shape
            arrays = {n: empty(v, shape).copy() for n, v in self.variables.items()}
            with self.lock:
                self.open[block.number] = OpenBlock(block, points, arrays)
            yield points + self.blocks.first(block.number)

    def put(
        self, points: np.ndarray, results: list[np.ndarray], steps: np.ndarray
    ) -> None:
        """Take the results of these points, lanes behind."""
        numbers = self.blocks.number(points)
        several = (numbers != numbers[0]).any()
        for number in np.unique(numbers).tolist() if several else [int(numbers[0])]:
            mine = numbers == number if several else slice(None)
            opened = self.open[number]
            places = points[mine] - self.blocks.first(number)
            for target, result in zip(opened.flat, results, strict=True):
                target[..., places] = result[..., mine]
            with self.lock:
                opened.left -= places.size
                opened.steps += int(steps[mine].sum())
                whole = not opened.left
                if whole:
                    del self.open[number]
            if whole:
                tally = opened.tally(self.variables)
                self.write_block(opened.block, opened.arrays, tally)


class OpenBlock:
    """A block that is being filled."""

    def __init__(self, block: Block, points: np.ndarray, arrays: dict[str, np.ndarray]):
        """Nothing of the block has a result."""
        self.block, self.points, self.left = block, points, points.size
        self.arrays, ndim = arrays, len(block.region)
        self.flat = [
            np.moveaxis(a.reshape(-1, *a.shape[ndim:]), 0, -1) for a in arrays.values()
        ]
        self.steps, self.began = 0, time.perf_counter()

    def tally(self, variables: dict[str, Variable]) -> Tally:
        """What the block cost and how its points ended."""
        outcomes: dict[str, int] = {}
        failed: dict[str, dict[str, int]] = {}
        for (name, variable), values in zip(variables.items(), self.flat, strict=True):
            # not what a search met on its way, as an onset's `obstacle`
            if variable.codes is not None and not name.endswith("obstacle"):
                failed |= _failed(name, variable.codes, values)
            if variable.codes == OUTCOMES and name.endswith("outcome"):
                here = values[..., self.points].ravel()  # several of a point: branches
                counts = {c.name: int((here == c).sum()) for c in OUTCOMES}
                outcomes = {code: count for code, count in counts.items() if count}
        seconds = time.perf_counter() - self.began
        return Tally(self.points.size, seconds, self.steps, outcomes, failed)


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
        """Nothing to open."""
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing to close."""

    def release(self) -> None:
        """Nothing to give back."""

    def missing(self, blocks: Blocks) -> dict[int, int]:
        """How many points are still to be computed, by block."""
        return {n: int(blocks.sizes[n]) for n in np.flatnonzero(blocks.sizes).tolist()}

    def damaged(self) -> list[str]:
        """Nothing."""
        return []

    def mend(self, axes: Mapping[str, np.ndarray]) -> None:
        """Nothing to mend."""

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
