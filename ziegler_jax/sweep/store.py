"""A sweep's store: a Zarr group that grows block by block and outlives its writer.

- `map.zarr/`: the Dataset. A chunk of each variable is a block, with a checksum that
  Zarr itself writes and reads (crc32c); a chunk that is not there reads as NaN, and as
  0 (`not_computed`) for codes.
- `map.zarr/sweep-record/`: `sweep.json` and its copy, which say what the sweep is and
  hold the text of all Zarr metadata; `run.json`, what the last run cost; `blocks/`, a
  marker for each finished block, with length and checksum of its chunks; `parts/`,
  files that are being written. Every record carries a checksum of its own.

A block's chunks are written first, codes after numbers, and are on the disk before its
marker is. Each file appears whole, by a rename: a reader never sees half of one. A
block without a marker, or with one that its chunks do not bear out, is computed again.
"""

import os
import warnings
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypedDict, cast

import numpy as np
import xarray as xr
import zarr
from zarr.abc.buffer import Buffer
from zarr.storage import LocalStore, MemoryStore

from ..results import coordinate
from .partition import Block, Blocks, Tally
from .provenance import difference, digest_of
from .store_creation import clear_away, create, place, remove
from .store_files import (
    RECORD,
    RECORDS,
    end_of,
    layout,
    listed,
    locked_store,
    read_or_none,
    recorded,
    says,
    sum_of,
    tail,
    write,
    write_record,
)


@dataclass(frozen=True)
class Store:
    """Where a sweep keeps its results.

    **Arguments:** `path`: a folder, e.g. `"map.zarr"`; `overwrite`: whether the sweep
    that is in it is replaced.

    **Raises:** `ValueError` for what breaks a rule.
    """

    path: str | os.PathLike
    overwrite: bool = False

    def __post_init__(self):
        """Check them."""
        place(self.path)
        if not isinstance(self.overwrite, bool):
            raise ValueError(
                "Argument `overwrite` must be True or False, but is "
                f"{self.overwrite!r}."
            )


def prepared(
    path: str | os.PathLike,
    template: xr.Dataset,
    blocks: Blocks,
    identity: Mapping[str, object],
    overwrite: bool,
) -> "SweepStore":
    """The store to go on with, made if need be.

    **Arguments:** `template`: the Dataset with nothing computed.

    **Raises:** `ValueError` if what is there is another sweep's, or no store at all.
    """
    path = place(path)
    if overwrite and path.is_dir() and any(path.iterdir()):
        remove(path)
    if not path.exists() or (path.is_dir() and not any(path.iterdir())):
        made, lock = create(path, template, blocks, identity)
        if made:
            return SweepStore(path, lock)
    store = SweepStore(path)  # made by another, now or long ago
    other = difference(store.record["identity"], identity)
    if other is not None:
        raise ValueError(
            f"Argument `store` must be this sweep's, but {str(path)!r} {other}. "
            "`zj.Store(path, overwrite=True)` replaces it."
        )
    return store


def open_sweep(store: str | os.PathLike) -> xr.Dataset:
    """The Dataset of a sweep's store, finished or not, read where it is looked at.

    What has not been computed yet is NaN and its `outcome` is `not_computed`. It may be
    called while the sweep is running, and sees what was finished then. Every chunk has
    a checksum: one that was damaged since raises where it is read, and never gives a
    number.

    **Arguments:** `store`: what `sweep` was given as such, a folder.

    **Returns:** an `xarray.Dataset`, its arrays still on the disk. Beside what the
    sweep wrote, its attributes hold `points` and `points_done`, `blocks` and
    `blocks_done`.

    **Raises:** `ValueError` if the folder is no sweep's store, or a file that it cannot
    be read without is damaged. It warns of blocks whose chunks are gone or too short.
    """
    return opened(SweepStore(place(store)))


def opened(store: "SweepStore") -> xr.Dataset:
    """The Dataset of a store."""
    damaged = store.damaged_metadata() or store.damaged_coordinates()
    if damaged:
        raise ValueError(
            f"Argument `store` must be whole, but {damaged[0]!r} in {str(store.path)!r}"
            " is damaged. The same sweep mends it."
        )
    # chunks=None: without Dask; Zarr 3 has no consolidated metadata
    ds = xr.open_zarr(LocalStore(store.path), consolidated=False, chunks=None)  # pyright: ignore[reportArgumentType]
    labels = store.record["labels"]
    coords = {name: coordinate(name, values) for name, values in labels.items()}
    ds = ds.set_coords(list(store.record["identity"]["axes"]))
    ds = ds[store.record["names"]].assign_coords(coords)
    marks = store.marks()
    gone = [number for number, mark in marks.items() if not store.seems_intact(mark)]
    if gone:
        warnings.warn(
            f"Of the store {str(store.path)!r} these blocks are damaged, and count as "
            f"not computed: {', '.join(map(str, sorted(gone)))}. The same sweep "
            "computes them again.",
            stacklevel=3,
        )
    done = [mark for number, mark in marks.items() if number not in gone]
    progress = {
        "points": store.record["points"],
        "points_done": sum(mark["points"] for mark in done),
        "blocks": store.record["blocks"],
        "blocks_done": len(done),
    }
    run = read_or_none(store.folder / "run.json") or {}
    return ds.assign_attrs({**run, **progress})


class Mark(TypedDict):
    """What a finished block's marker says, beside its tally."""

    block: int
    run: str
    points: int
    chunks: dict[str, tuple[int, int, int]]  # length, checksum, end


class SweepStore:
    """Keeps blocks on a disk."""

    def __init__(self, path: Path, lock: int | None = None):
        """Open a store that is there; `lock`: of one that was just made.

        **Raises:** `ValueError` if none is.
        """
        self.path, self.folder, self.lock = path, path / RECORD, lock
        try:
            self.record = recorded(path)
        except BaseException:
            self.release()
            raise
        self._encoders: dict[str, tuple[zarr.Array, dict[str, Buffer]]] = {}

    def __enter__(self) -> "SweepStore":
        """Write to it."""
        self.claim()
        return self

    def __exit__(self, *_: object) -> None:
        """Let others write to it."""
        self.release()

    def release(self) -> None:
        """Give the lock back."""
        if self.lock is not None:
            os.close(self.lock)
            self.lock = None

    def claim(self) -> None:
        """Be the only one on this machine who writes to it.

        **Raises:** `ValueError` if another sweep writes to it; `OSError` if nothing can
        be written there.
        """
        if self.lock is None:
            self.lock = locked_store(self.path)
        try:
            self._check_that_it_is_ours()
            clear_away(self.path)
            for part in listed(self.folder / "parts"):  # of a writer that was killed
                if part.is_file():
                    part.unlink(missing_ok=True)
        except BaseException:
            self.release()
            raise

    def damaged_metadata(self) -> list[str]:
        """The files of Zarr's metadata that are not as they were written."""
        metadata = self.record["metadata"].items()
        return [name for name, text in metadata if not says(self.path / name, text)]

    def damaged_coordinates(self) -> list[str]:
        """The coordinates whose values are not those of the sweep."""
        damaged = []
        for name, digest in self._coordinates().items():
            try:
                array = zarr.open_array(LocalStore(self.path / name), mode="r")
                whole = digest_of(np.asarray(array[:])) == digest
            except Exception:  # Zarr's, of many kinds: each of them is damage
                whole = False
            if not whole:
                damaged.append(name)
        return damaged

    def damaged(self) -> list[str]:
        """What is damaged beside blocks, and can be mended without computing."""
        others = self.damaged_metadata() or self.damaged_coordinates()
        return self._damaged_records() + others

    def _damaged_records(self) -> list[str]:
        records = [(name, read_or_none(self.folder / name)) for name in RECORDS]
        return [n for n, r in records if r is None or r["run"] != self.record["run"]]

    def mend(self, axes: Mapping[str, np.ndarray]) -> None:
        """Write again what is damaged beside blocks, once the store is claimed."""
        for name in self._damaged_records():
            self._write(self.folder / name, self.record)
        for name in self.damaged_metadata():
            text = self.record["metadata"][name]
            write(self.path / name, text.encode(), self.folder / "parts")
        for name in self.damaged_coordinates():
            values = axes[name] if name in axes else self.record["labels"][name]
            values = np.asarray(values, np.float64)
            for key, content in self._encoded(name, (), values).items():
                write(self.path / name / key, content, self.folder / "parts")

    def missing(self, blocks: Blocks) -> dict[int, int]:
        """How many points are still to be computed, by block.

        Every chunk of every finished block is read and compared with its checksum: of
        10^7 points, 0.8 GB in 5000 files, in some two seconds where they are still in
        the system's memory (measured 1.8 s).
        """
        marks = self.marks()
        sizes = blocks.sizes
        return {
            number: int(sizes[number])
            for number in np.flatnonzero(sizes).tolist()
            if number not in marks or not self._intact(marks[number])
        }

    def holds(self, block: Block) -> bool:
        """Whether the block is finished and undamaged."""
        mark = self._mark(block.number)
        return mark is not None and self._intact(mark)

    def marks(self) -> dict[int, "Mark"]:
        """The commit markers, by block; damaged and foreign ones do not count."""
        names = [path.name for path in listed(self.folder / "blocks")]
        numbers = [int(name) for name in names if name.isascii() and name.isdigit()]
        marks = ((number, self._mark(number)) for number in numbers)
        return {number: mark for number, mark in marks if mark is not None}

    def write_block(
        self, block: Block, arrays: Mapping[str, np.ndarray], tally: Tally
    ) -> None:
        """Write a whole block: its chunks, then its marker.

        **Raises:** `ValueError` if the store has been replaced: a worker may still be
        computing for a sweep that was stopped; `OSError` if it cannot be written to.
        """
        try:
            self._check_that_it_is_ours()
            chunks = {}
            for name in self._codes_last():
                for key, content in self._encoded(
                    name, block.region, arrays[name]
                ).items():
                    file = f"{name}/{key}"
                    write(self.path / file, content, self.folder / "parts")
                    chunks[file] = [len(content), zlib.crc32(content), tail(content)]
            mark = {**tally._asdict(), "points": int(block.chosen.sum())}
            mark |= {"block": block.number, "run": self.record["run"], "chunks": chunks}
            self._write(self.folder / "blocks" / str(block.number), mark)
        except OSError as error:
            error.add_note(
                f"It was writing {block}. What was finished before is in {self.path}, "
                "and the same sweep goes on from there."
            )
            raise

    def dataset(self, attributes: Mapping[str, object]) -> xr.Dataset:
        """The sweep's result."""
        if self.lock is not None:
            self._write(self.folder / "run.json", dict(attributes))
        return opened(self)

    def _write(self, path: Path, record: Mapping[str, object]) -> None:
        write_record(path, record, self.folder / "parts")

    def _check_that_it_is_ours(self) -> None:
        if not self.folder.is_dir():
            raise FileNotFoundError(
                f"The store {str(self.path)!r} is gone: it was moved or deleted while "
                "the sweep was running."
            )
        if recorded(self.path)["run"] != self.record["run"]:
            raise ValueError(
                f"Argument `store` must stay this sweep's, but {str(self.path)!r} has "
                "been taken over by another."
            )

    def _coordinates(self) -> dict[str, str]:
        """The coordinates that Zarr holds, with hashes of their values."""
        axes = self.record["identity"]["axes"].items()
        digests = {name: digest for name, (*_, digest) in axes}
        for name, values in self.record["labels"].items():
            if f"{name}/zarr.json" in self.record["metadata"]:
                digests[name] = digest_of(np.asarray(values, np.float64))
        return digests

    def _mark(self, number: int) -> "Mark | None":
        """The marker of a block; None: it has none that counts."""
        mark = read_or_none(self.folder / "blocks" / str(number))
        if mark is None or mark.get("run") != self.record["run"]:
            return None
        return cast(Mark, mark) if mark.get("block") == number else None

    def _intact(self, mark: "Mark") -> bool:
        """Whether a block's chunks are those that were written."""
        try:
            return all(
                sum_of(self.path / file) == written
                for file, written in mark["chunks"].items()
            )
        except OSError:
            return False

    def seems_intact(self, mark: "Mark") -> bool:
        """Whether a block's chunks are there, by their length and their own checksum.

        That stands at a chunk's end, where Zarr compares it with the rest as it reads.
        """
        try:
            return all(
                end_of(self.path / file) == (length, end)
                for file, (length, _, end) in mark["chunks"].items()
            )
        except OSError:
            return False

    def _codes_last(self) -> list[str]:
        """The variables, so that where there is an outcome, there are its numbers."""
        return sorted(self.record["names"], key=lambda n: n in self.record["codes"])

    def _encoded(
        self, name: str, region: tuple[slice, ...], values: np.ndarray
    ) -> dict[str, bytes]:
        """The chunk files that hold these values, by their keys: Zarr's own bytes."""
        if name not in self._encoders:
            like = zarr.open_array(LocalStore(self.path / name), mode="r")
            files: dict[str, Buffer] = {}
            array = zarr.create_array(
                MemoryStore(files),
                shape=like.shape,
                dtype=like.dtype,
                **layout(like.chunks, like.fill_value),
            )
            self._encoders[name] = array, files
        array, files = self._encoders[name]
        array[(*region, ...)] = values
        where = [s.start // c for s, c in zip(region, array.chunks, strict=False)]
        where += [0] * (array.ndim - len(where))
        key = "/".join(["c", *map(str, where)])
        return {key: files.pop(key).to_bytes()}
