"""A sweep's store: a Zarr group that grows block by block and outlives its writer.

- `map.zarr/`: the Dataset. A chunk of each variable is a block; a chunk that is not
  there reads as NaN, and as 0 (`not_computed`) for codes.
- `map.zarr/progress/`: `sweep.json` with the sweep's fingerprint, and in `blocks/` a
  file for each finished block, its commit marker.

A block's chunks are written first, codes after numbers, its marker last. Each file
appears whole, by a rename: a reader never sees half of one. What has no marker is
computed again.
"""

import json
import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal
from uuid import uuid4

import numpy as np
import xarray as xr
import zarr

from ._blocks import Block, Blocks, Tally
from ._fingerprint import difference, only_budgets_grew
from .outcome import OUTCOME

Resume = Literal["same", "unsettled", "overwrite"]
_AGAIN = (OUTCOME.unsettled, OUTCOME.budget_spent)  # what a larger budget may change
_MEANINGS = " ".join(code.name for code in OUTCOME)


def prepared(
    path: str | os.PathLike,
    template: xr.Dataset,
    blocks: Blocks,
    fingerprint: Mapping[str, Any],
    resume: Resume,
) -> "Store":
    """The store to go on with, made if need be.

    **Arguments:** `template`: the Dataset with nothing computed.

    **Raises:** `ValueError` if what is there is another sweep's, or no store at all.
    """
    path = Path(path).absolute()
    if not path.exists() or (path.is_dir() and not any(path.iterdir())):
        return Store.create(path, template, blocks, fingerprint)
    if resume == "overwrite":
        _remove(path)
        return Store.create(path, template, blocks, fingerprint)
    store = Store(path)
    there = store.record["fingerprint"]
    other = difference(there, fingerprint)
    if other is None:
        return store
    if resume == "unsettled":
        other = only_budgets_grew(there, fingerprint)
        if other is None and not store.outcomes():
            other = "has no `outcome` that says which points are unsettled"
        if other is None:
            store.begin_again(fingerprint)
            return store
    raise ValueError(
        f"Argument `store` must be this sweep's, but {str(path)!r} {other}. "
        '`resume="overwrite"` replaces it.'
    )


def open_sweep(path: str | os.PathLike) -> xr.Dataset:
    """The Dataset of a sweep's store, finished or not, read where it is looked at.

    What has not been computed yet is NaN and its `outcome` is `not_computed`. It may be
    called while the sweep is running, and sees what was finished then.

    **Arguments:** `path`: what `sweep` was given as `store`.

    **Returns:** an `xarray.Dataset`, its arrays still on the disk. Beside what the
    sweep wrote, its attributes hold `points` and `points_done`, `blocks` and
    `blocks_done`.

    **Raises:** `ValueError` if the folder is no sweep's store.
    """
    store = Store(path)
    # chunks=None: without Dask; Zarr 3 has no consolidated metadata
    ds = xr.open_zarr(store.path, consolidated=False, chunks=None)
    run = store.record["runs"][-1]
    marks = [mark for mark in store.marks().values() if mark["run"] == run]
    progress = {
        "points": store.record["points"],
        "points_done": sum(mark["points"] for mark in marks),
        "blocks": store.record["blocks"],
        "blocks_done": len(marks),
    }
    return ds[store.record["names"]].assign_attrs(progress)


class Memory:
    """Keeps blocks in arrays of the whole grid."""

    def __init__(self, template: xr.Dataset):
        """`template`: the Dataset with nothing computed."""
        self.template = template
        self.arrays = {str(n): v.values.copy() for n, v in template.data_vars.items()}

    def __enter__(self) -> "Memory":
        """Nothing to open."""
        return self

    def __exit__(self, *_: Any) -> None:
        """Nothing to close."""

    def missing(self, blocks: Blocks) -> dict[int, int]:
        """How many points are still to be computed, by block."""
        return {n: int(blocks.sizes[n]) for n in np.flatnonzero(blocks.sizes).tolist()}

    def work(self, block: Block) -> tuple[Block, np.ndarray, Any]:
        """A block, which of its points to compute, and what is known of the others."""
        known = {name: a[block.region].copy() for name, a in self.arrays.items()}
        return block, block.chosen, known

    def keep(self, block: Block, arrays: Mapping[str, Any], tally: Tally) -> None:
        """Take a whole block."""
        del tally
        for name, values in arrays.items():
            self.arrays[name][block.region] = values

    def dataset(self, attributes: Mapping[str, Any]) -> xr.Dataset:
        """The sweep's result."""
        data = {
            n: (v.dims, self.arrays[str(n)], v.attrs)
            for n, v in self.template.data_vars.items()
        }
        return xr.Dataset(data, self.template.coords, attributes)


class Store:
    """Keeps blocks on a disk."""

    def __init__(self, path: str | os.PathLike, mode: Literal["r", "r+"] = "r"):
        """Open a store that is there.

        **Raises:** `ValueError` if none is.
        """
        self.path = Path(path).absolute()
        self.progress = self.path / "progress"
        self.lock: int | None = None
        self.record = _recorded(self.path)
        self._open(mode)

    def _open(self, mode: Literal["r", "r+"]) -> None:
        self.root = zarr.open_group(self.path, mode=mode)
        arrays: list[Any] = [(name, self.root[name]) for name in self.record["names"]]
        # codes last: where there is an outcome, there are its numbers
        self.arrays = dict(sorted(arrays, key=lambda a: "flag_values" in a[1].attrs))

    @classmethod
    def create(
        cls,
        path: Path,
        template: xr.Dataset,
        blocks: Blocks,
        fingerprint: Mapping[str, Any],
    ) -> "Store":
        """Make a store with nothing computed; it is there as a whole or not at all."""
        new = path.with_name(f".{path.name}.new")
        shutil.rmtree(new, ignore_errors=True)
        root = zarr.open_group(new, mode="w-", attributes=dict(template.attrs))
        for name, variable in template.variables.items():
            shape, fill, chunks = variable.shape, 0, variable.shape
            if name in template.data_vars:
                chunks = (*blocks.chunk, *shape[len(blocks.chunk) :])
                fill = variable.values[(0,) * len(shape)]
            array = root.create_array(
                str(name),
                shape=shape,
                dtype=variable.dtype,
                chunks=chunks,
                fill_value=fill,
                dimension_names=[str(dim) for dim in variable.dims],
                attributes=dict(variable.attrs),
            )
            if name in template.coords:
                array[:] = variable.values
        root.create_group("progress")
        (new / "progress" / "blocks").mkdir()
        record = {
            "names": [str(name) for name in template.data_vars],
            "points": int(blocks.sizes.sum()),
            "blocks": int(np.count_nonzero(blocks.sizes)),
            "runs": [uuid4().hex],  # the marker of a stranger's block is none
            "fingerprint": fingerprint,
        }
        _write(new / "progress" / "sweep.json", record)
        os.replace(new, path)
        return cls(path)

    def __enter__(self) -> "Store":
        """Write to it."""
        self.claim()
        return self

    def __exit__(self, *_: Any) -> None:
        """Let others write to it."""
        self.release()

    def claim(self) -> None:
        """Open the store to write to it, alone on this machine.

        **Raises:** `ValueError` if another sweep has; `OSError` if nothing can be
        written there.
        """
        if self.lock is None:
            self.lock = _locked(self.progress / "lock")
        self._open("r+")
        for torn in self.path.rglob("*.partial"):  # of a writer that was killed
            torn.unlink(missing_ok=True)

    def release(self) -> None:
        """Let others write."""
        if self.lock is not None:
            os.close(self.lock)
            self.lock = None

    def begin_again(self, fingerprint: Mapping[str, Any]) -> None:
        """Larger budgets: what was unsettled is to be computed again."""
        self.claim()
        runs = [*self.record["runs"], uuid4().hex]
        self.record |= {"runs": runs, "fingerprint": fingerprint}
        _write(self.progress / "sweep.json", self.record)

    def marks(self) -> dict[int, dict[str, Any]]:
        """The commit markers, by block."""
        paths = (self.progress / "blocks").iterdir()
        return {int(p.name): _read(p) for p in paths if p.name.isdigit()}

    def missing(self, blocks: Blocks) -> dict[int, int]:
        """How many points are still to be computed, by block."""
        *earlier, run = self.record["runs"]
        marks, missing = self.marks(), {}
        for number in np.flatnonzero(blocks.sizes).tolist():
            of = marks[number]["run"] if number in marks else None
            if of in earlier:
                missing[number] = int(self.work(blocks.block(number))[1].sum())
            elif of != run:
                missing[number] = int(blocks.sizes[number])
        return missing

    def work(self, block: Block) -> tuple[Block, np.ndarray, Any]:
        """A block, which of its points to compute, and what is known of the others."""
        chosen = block.chosen
        if self._run_of(block) not in self.record["runs"]:
            return block, chosen, None
        region = (*block.region, ...)
        known = {n: np.array(self.arrays[n][region]) for n in self.record["names"]}
        for name in self.outcomes():
            chosen = chosen & np.isin(known[name], _AGAIN)
        return block, chosen, known

    def outcomes(self) -> list[str]:
        """The variables that say how points ended."""
        attrs = {name: array.attrs for name, array in self.arrays.items()}
        return [n for n, a in attrs.items() if a.get("flag_meanings") == _MEANINGS]

    def holds(self, block: Block) -> bool:
        """Whether the block is finished."""
        return self._run_of(block) == self.record["runs"][-1]

    def keep(self, block: Block, arrays: Mapping[str, Any], tally: Tally) -> None:
        """Write a whole block: its chunks, then its marker.

        **Raises:** `ValueError` if the store has been replaced: a worker may still be
        computing for a sweep that was stopped.
        """
        run = self.record["runs"][-1]
        if _recorded(self.path)["runs"][-1] != run:
            raise ValueError(
                f"Argument `store` must stay this sweep's, but {str(self.path)!r} has "
                "been taken over by another."
            )
        try:
            for name, array in self.arrays.items():
                array[(*block.region, ...)] = arrays[name]
            mark = {**tally._asdict(), "points": int(block.chosen.sum())}
            _write(self._mark(block), {**mark, "run": run})
        except OSError as error:
            error.add_note(
                f"It was writing {block}. What was finished before is in {self.path}, "
                "and the same sweep goes on from there."
            )
            raise

    def dataset(self, attributes: Mapping[str, Any]) -> xr.Dataset:
        """The sweep's result."""
        if self.lock is not None:
            self.root.attrs.update(attributes)
        return open_sweep(self.path)

    def _mark(self, block: Block) -> Path:
        return self.progress / "blocks" / str(block.number)

    def _run_of(self, block: Block) -> str | None:
        """The run that finished a block."""
        try:
            return _read(self._mark(block))["run"]
        except FileNotFoundError:
            return None


def _recorded(path: Path) -> dict[str, Any]:
    """What the store says of its sweep."""
    try:
        return _read(path / "progress" / "sweep.json")
    except (FileNotFoundError, NotADirectoryError):
        raise ValueError(
            f"Argument `store` must be a sweep's store, but {str(path)!r} is none."
        ) from None


def _remove(path: Path) -> None:
    """Delete a store, and nothing else: at once for whoever looks at its path."""
    _recorded(path)
    lock = _locked(path / "progress" / "lock")
    try:
        for left in path.parent.glob(f".{path.name}.*.old"):  # by one that was killed
            shutil.rmtree(left, ignore_errors=True)
        old = path.with_name(f".{path.name}.{uuid4().hex}.old")
        os.rename(path, old)
        shutil.rmtree(old)
    finally:
        os.close(lock)


def _read(path: Path) -> dict[str, Any]:
    return json.loads(path.read_text())


def _write(path: Path, content: Mapping[str, Any]) -> None:
    """A whole file or none."""
    part = path.with_name(f"{path.name}.{uuid4().hex}.partial")
    part.write_text(json.dumps(content))
    os.replace(part, path)


def _locked(path: Path) -> int:
    """Hold a lock that ends with the process, however it ends."""
    file = os.open(path, os.O_RDWR | os.O_CREAT)
    try:
        import fcntl
    except ImportError:  # Windows: two sweeps would compute the same twice
        return file
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(file)
        raise ValueError(
            f"Argument `store` must not be written to by another sweep, but "
            f"{str(path.parents[1])!r} is."
        ) from None
    return file
