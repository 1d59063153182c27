"""A sweep's store: a Zarr group that grows block by block and outlives its writer.

- `map.zarr/`: the Dataset. A chunk of each variable is a block, with a checksum that
  Zarr itself writes and reads (crc32c); a chunk that is not there reads as NaN, and as
  0 (`not_computed`) for codes.
- `map.zarr/sweep-record/`: `sweep.json` and its copy, which say what the sweep is and
  describe its dataset; `run.json`, what the last run cost; `blocks/`, a mark for each
  finished block, with length and checksum of its chunks; `parts/`, files that are being
  written; `lock`. Every record carries a checksum of its own.

A block's chunks are written first, codes after numbers, and are on the disk before its
mark is. Each file appears whole, by a rename: a reader never sees half of one. A block
without a mark, or with one that its chunks do not bear out, is computed again.

A store may come from a stranger, or have been worked on since. So nothing in it says
what is to be run or written where: the sweep's own variables are laid out from shapes,
types and names, with fixed codecs, and Zarr is shown these and the chunks that a mark
bears out, through a store in memory. Whatever else lies in the folder stays there.
"""

from __future__ import annotations

import functools
import hashlib
import json
import math
import os
import shutil
import time
import warnings
import zlib
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from uuid import uuid4

import numpy as np
import xarray as xr
import zarr
from zarr.abc.buffer import Buffer
from zarr.buffer import cpu
from zarr.codecs import Crc32cCodec, ZstdCodec
from zarr.storage import MemoryStore

from ..results import coordinate
from .assembly import Tally
from .grid import Block, Grid, check_name
from .provenance import difference, difference_of_meaning

LAYOUT, WRITTEN_BY = 4, {"1": "0.1", "2": "0.2"}  # of the files, and whose were others
RECORD = "sweep-record"  # no variable's name: names have no hyphen
RECORDS = "sweep.json", "sweep.copy.json"
ABANDONED = 60.0  # seconds after which a half-made store without a lock is nobody's
BAD_JSON = ValueError, KeyError, AttributeError, TypeError, RecursionError
# what an array that is not the sweep's may be read with: Zarr's own, no plug-in's
CODECS = {
    *("bytes", "transpose", "sharding_indexed", "vlen-utf8", "vlen-bytes"),
    *("gzip", "zstd", "blosc", "crc32c"),
}
TYPES = {
    *("bool", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64"),
    *("float16", "float32", "float64", "complex64", "complex128", "string"),
    *("fixed_length_utf32", "numpy.datetime64", "numpy.timedelta64"),
}


@dataclass(frozen=True)
class Store:
    """A folder into which a sweep writes its results.

    **Arguments:** `path`: the folder, e.g. `"map.zarr"`; `overwrite`: whether to
    replace the sweep in it, with all other files of the folder.

    **Raises:** `ValueError` for an argument that breaks a rule.
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


def place(path: str | os.PathLike) -> Path:
    """Where a store lies, behind all links.

    **Raises:** `ValueError` for what can be no store's place.
    """
    text = os.fspath(path) if isinstance(path, str | os.PathLike) else path
    if not isinstance(text, str) or not text or "\0" in text:
        raise ValueError(f"Argument `store` must be a folder's path, but is {text!r}.")
    if "://" in text:
        raise ValueError(
            f"Argument `store` must be a folder of this machine, but is {text!r}: "
            "sweep into a folder and copy it there."
        )
    folder = Path(text).resolve()
    if folder == Path.cwd() or folder in Path.cwd().parents:
        raise ValueError(
            "Argument `store` must be a folder of its own, but is "
            f"{text!r}, which holds the current one: give it a name, e.g. 'map.zarr'."
        )
    return folder


# Files --------------------------------------------------------------------------------


def write(path: Path, content: bytes, parts: Path) -> None:
    """Write a file by a rename, after its bytes have reached the disk.

    **Arguments:** `parts`: the store's folder where it is being written.

    **Raises:** `ValueError` where a link would lead out of the store.
    """
    for folder in (parts, path.parent):
        check_within(folder, parts.parents[1])
        make_folder(folder)
    part = parts / uuid4().hex
    with part.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    if path.is_dir() and not path.is_symlink():  # damage: a folder for a file
        shutil.rmtree(path)
    os.replace(part, path)
    sync_folder(path.parent)


def check_within(path: Path, root: Path) -> None:
    """Refuse what a link leads out of a store, or elsewhere in it.

    **Raises:** `ValueError`.
    """
    inner = path.relative_to(root)
    if path.resolve() != root.resolve() / inner:
        raise ValueError(
            f"Argument `store` must hold no links, but {inner.as_posix()!r} in "
            f"{str(root)!r} is one or lies behind one: nothing is written there."
        )


def make_folder(path: Path) -> None:
    """Make a folder, and those that it lies in, to last."""
    if path.is_dir():
        return
    make_folder(path.parent)
    path.mkdir(exist_ok=True)
    sync_folder(path.parent)


def sync_folder(path: Path) -> None:
    """Let the names in a folder reach the disk."""
    try:
        folder = os.open(path, os.O_RDONLY)
    except PermissionError:  # Windows opens no folders
        return
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def bytes_of(path: Path) -> bytes | None:
    """The bytes of a file; None if there is none, or if reading would wait."""
    try:
        return path.read_bytes() if path.is_file() else None
    except (FileNotFoundError, NotADirectoryError, IsADirectoryError):
        return None


def write_record(path: Path, record: Mapping[str, object], parts: Path) -> None:
    """Write a JSON object with a checksum of what it says."""
    content = json.dumps({"sha256": _digest(record), **record})
    write(path, content.encode(), parts)


def read_record(path: Path) -> dict[str, Any] | None:
    """The record that `write_record` wrote; None if it is damaged or not there."""
    try:
        record = json.loads(bytes_of(path) or b"")
        return record if record.pop("sha256") == _digest(record) else None
    except BAD_JSON:
        return None


def _digest(record: object) -> str:
    return hashlib.sha256(json.dumps(record, sort_keys=True).encode()).hexdigest()


def sum_of(content: bytes) -> list[int]:
    """A chunk's length, checksum, and end: the checksum that Zarr writes behind it."""
    return [len(content), zlib.crc32(content), int.from_bytes(content[-4:], "little")]


def end_of(path: Path) -> list[int]:
    """A chunk's length and end, without reading the rest; nothing if there is none."""
    if not path.is_file():
        return []
    with path.open("rb") as file:
        length = file.seek(0, os.SEEK_END)
        file.seek(max(0, length - 4))
        return [length, int.from_bytes(file.read(4), "little")]


def locked(path: Path) -> int | None:
    """Hold a lock that ends with the process, however it ends; None: another does."""
    file = os.open(path, os.O_RDWR | os.O_CREAT)
    try:
        import fcntl
    except ImportError:  # Windows: two sweeps would compute the same twice
        os.close(file)  # and no folder is renamed with a file open in it
        return os.open(os.devnull, os.O_RDONLY)
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(file)
        return None
    except BaseException:
        os.close(file)
        raise
    return file


def locked_store(path: Path) -> int:
    """The lock of a store.

    **Raises:** `ValueError` if another sweep holds it.
    """
    folder = path / RECORD
    if not folder.is_dir():  # of another version, or just taken away
        folder = path
    check_within(folder / "lock", path)
    lock = locked(folder / "lock")
    if lock is None:
        raise ValueError(
            "Argument `store` must not be written to by another sweep, but "
            f"{str(path)!r} is."
        )
    return lock


# What a store says --------------------------------------------------------------------


def record_of(
    template: xr.Dataset, grid: Grid, identity: Mapping[str, Any]
) -> dict[str, Any]:
    """The record of a sweep in a new store."""
    others = (name for name in template.coords if name not in identity["axes"])
    return {
        "layout": LAYOUT,
        "run": uuid4().hex,  # the mark of a stranger's block is none
        "metadata": template.to_dict(data=False),  # dimensions, types, attributes
        "labels": {str(name): template[name].values.tolist() for name in others},
        "chunk": list(grid.chunk),
        "points": grid.points,
        "blocks": int(np.count_nonzero(grid.sizes)),
        "identity": identity,
        "chunks": {},  # of the coordinates: length, checksum, end
    }


def check_store(path: Path) -> None:
    """Refuse what no sweep wrote, damaged as it may be, and whatever version.

    **Raises:** `ValueError`.
    """
    places = [path / RECORD / name for name in RECORDS]
    if not any(p.is_file() for p in (*places, path / "progress" / "sweep.json")):
        raise ValueError(
            f"Argument `store` must be a sweep's store, but {str(path)!r} is none."
        )


def recorded(path: Path) -> dict[str, Any]:
    """The record of a store's sweep.

    **Raises:** `ValueError` if the folder is no store, of another version, or neither
    copy can be read.
    """
    check_store(path)
    places = [path / RECORD / name for name in RECORDS]
    records = [record for record in map(read_record, places) if record is not None]
    if not records and any(file.is_file() for file in places):
        raise ValueError(
            f"Argument `store` must be a sweep's store, but {str(places[-1])!r} is "
            "damaged, and so is its copy. `zj.Store(path, overwrite=True)` replaces it."
        )
    layout = records[0].get("layout") if records else 1
    if layout != LAYOUT:
        version = WRITTEN_BY.get(str(layout), f"of layout {layout!r}")
        raise ValueError(
            f"Argument `store` must be a store of this version, but {str(path)!r} was "
            f"written by another version of ziegler_jax, {version}. Compute it anew in "
            "another folder, or read it with that version, or its numbers with "
            "`xarray.open_zarr`. `zj.Store(path, overwrite=True)` replaces it."
        )
    return records[0]


Files = dict[str, Buffer]  # Zarr's files in memory, by their keys


def laid_out(record: Mapping[str, Any]) -> tuple[Files, dict[str, zarr.Array]]:
    """The group that a record describes, in memory and without a chunk.

    All that a record says of it are names, dimensions, shapes, types and attributes:
    codecs are fixed.

    **Raises:** what NumPy and Zarr raise where it describes no dataset.
    """
    files: Files = {}
    about, arrays = record["metadata"], {}
    root = zarr.create_group(
        MemoryStore(files), attributes=about["attrs"], zarr_format=3
    )
    root.create_group(RECORD)
    for name, own in {**about["coords"], **about["data_vars"]}.items():
        check_name("Variable", name)
        dtype, chunks = np.dtype(own["dtype"]), tuple(own["shape"])
        if name in about["data_vars"]:
            chunks = (*record["chunk"], *chunks[len(record["chunk"]) :])
        elif dtype.kind not in "iuf":
            continue  # Zarr has no settled form for strings: the record has them
        else:
            dtype = np.dtype(np.float64)
        if dtype.kind not in "biufc":
            raise TypeError(dtype)
        arrays[name] = root.create_array(
            name,
            shape=tuple(own["shape"]),
            dtype=dtype,
            chunks=chunks,
            fill_value=np.nan if dtype.kind in "fc" else 0,
            compressors=(ZstdCodec(), Crc32cCodec()),
            config={"write_empty_chunks": True},  # no chunk is left out
            dimension_names=[str(dim) for dim in own["dims"]],
            attributes={**own["attrs"]},
        )
    return files, arrays


def with_own(theirs: bytes | None, ours: bytes) -> bytes | None:
    """Zarr's metadata in a file, put right; None: it is.

    Attributes that are not the sweep's, and metadata that was consolidated, stay.
    """
    own = json.loads(ours)
    try:
        there = json.loads(theirs or b"")
        attributes = {**there.pop("attributes", {})}
        together = there.pop("consolidated_metadata", None)
    except BAD_JSON:
        return ours
    mine = own.pop("attributes", {})
    changed = {
        k: v for k, v in mine.items() if _digest(attributes.get(k)) != _digest(v)
    }
    if not changed and _digest(there) == _digest(own):
        return None
    whole = {**own, "attributes": {**attributes, **changed}}
    if together is not None:
        whole["consolidated_metadata"] = together
    return json.dumps(whole, indent=2).encode()


# A store comes and goes ---------------------------------------------------------------


def prepared(
    path: str | os.PathLike,
    template: xr.Dataset,
    grid: Grid,
    identity: Mapping[str, Any],
    overwrite: bool,
) -> SweepStore:
    """The store to go on with, made if need be.

    **Arguments:** `template`: the Dataset with nothing computed.

    **Raises:** `ValueError` if what is there is another sweep's, or no store at all.
    """
    path = place(path)
    if overwrite and path.is_dir() and any(path.iterdir()):
        remove(path)
    record = record_of(template, grid, identity)
    if not path.exists() or (path.is_dir() and not any(path.iterdir())):
        lock = create(path, template, record)
        if lock is not None:
            return SweepStore(path, lock)
    store = SweepStore(path)  # made by another, now or long ago
    try:
        other = difference(store.record["identity"], identity)
        if other is None and _shapes(store.record) != _shapes(record):
            other = "is laid out otherwise"
        other = other or difference_of_meaning(store.record, record)
    except BAD_JSON:
        other = "does not say of which sweep"
    if other is not None:
        raise ValueError(
            f"Argument `store` must be this sweep's, but {str(path)!r} {other}. "
            "`zj.Store(path, overwrite=True)` replaces it."
        )
    return store


def _shapes(record: Mapping[str, Any]) -> str:
    """All that decides where a sweep's numbers go: chunks, names, dimensions, types."""
    about = {**record["metadata"]["coords"], **record["metadata"]["data_vars"]}
    shapes = {n: [v["dims"], v["shape"], v["dtype"]] for n, v in about.items()}
    return json.dumps([record["chunk"], shapes, record["labels"]])


def create(path: Path, template: xr.Dataset, record: dict[str, Any]) -> int | None:
    """Make a store with nothing computed: its lock; None: another was faster.

    It is made under a name of its own and renamed, with its lock held: it is there as a
    whole or not at all, and belongs to one.
    """
    make_folder(path.parent)
    clear_away(path)
    new = path.with_name(f"{_hidden(path)}{uuid4().hex}.new")
    lock = None
    try:
        for folder in ("blocks", "parts"):
            (new / RECORD / folder).mkdir(parents=True)
        lock = locked(new / RECORD / "lock")
        files, arrays = laid_out(record)
        for name in arrays:
            if name in template.coords:
                arrays[name][...] = template[name].values.astype(np.float64)
        for key, buffer in files.items():
            write(new / key, buffer.to_bytes(), new / RECORD / "parts")
            if not key.endswith("zarr.json"):
                record["chunks"][key] = sum_of(buffer.to_bytes())
        for name in RECORDS:
            write_record(new / RECORD / name, record, new / RECORD / "parts")
        sync_folder(new / RECORD)
        try:
            os.rename(new, path)
        except OSError:
            if not (path.is_dir() and any(path.iterdir())):
                raise
            shutil.rmtree(new, ignore_errors=True)
            _close(lock)
            lock = None
        sync_folder(path.parent)
        return lock
    except BaseException:
        _close(lock)
        shutil.rmtree(new, ignore_errors=True)
        raise


def _close(lock: int | None) -> None:
    if lock is not None:
        os.close(lock)


def remove(path: Path) -> None:
    """Delete a store, and nothing else: at once for whoever looks at its path.

    **Raises:** `ValueError` if the folder is no store, or a sweep writes to it.
    """
    check_store(path)
    lock = locked_store(path)
    try:
        old = path.with_name(f"{_hidden(path)}{uuid4().hex}.old")
        os.rename(path, old)
        shutil.rmtree(old)
    finally:
        os.close(lock)


def _hidden(path: Path) -> str:
    """How the names of folders beside a store begin that come and go."""
    return f".{hashlib.sha256(path.name.encode()).hexdigest()[:12]}."


def clear_away(path: Path) -> None:
    """Delete what sweeps that were killed left beside the store."""
    for left in path.parent.glob(f"{_hidden(path)}*.old"):
        shutil.rmtree(left, ignore_errors=True)  # not where a link leads
    for left in path.parent.glob(f"{_hidden(path)}*.new"):
        try:
            if time.time() - left.stat().st_mtime < ABANDONED:
                continue
            check_within(left / RECORD / "lock", path.parent)
            (left / RECORD).mkdir(exist_ok=True)
            lock = locked(left / RECORD / "lock")
        except (OSError, ValueError):
            continue  # it has just become a store, or is none
        if lock is not None:
            shutil.rmtree(left, ignore_errors=True)
            os.close(lock)


# A store grows ------------------------------------------------------------------------


Mark = dict[str, Any]  # what a finished block's mark says


class SweepStore:
    """Keeps blocks on a disk."""

    def __init__(self, path: Path, lock: int | None = None):
        """Open a store that is there; `lock`: of one that was just made.

        **Raises:** `ValueError` if none is.
        """
        self.path, self.folder, self.lock = path, path / RECORD, lock
        try:
            self.record = recorded(path)
            self._lay_out()
        except BaseException:
            self.release()
            raise

    def _lay_out(self) -> None:
        """Set the attributes that follow from the record.

        **Raises:** `ValueError` if it describes no sweep's dataset.
        """
        try:
            self.run, self.sums = self.record["run"], {**self.record["chunks"]}
            self.labels = {**self.record["labels"]}
            self.totals = {name: self.record[name] for name in ("points", "blocks")}
            self.files, self.arrays = laid_out(self.record)
            about = self.record["metadata"]["data_vars"]
            # so that where there is an outcome, there are its numbers
            self.names = sorted(about, key=lambda n: "flag_values" in about[n]["attrs"])
            shape, chunk = about[self.names[0]]["shape"], self.record["chunk"]
            self.counts = (*(-(-s // c) for s, c in zip(shape, chunk, strict=False)),)
            others = {n: x for n, x in self.arrays.items() if n not in about}
            self.coordinates = [f"{n}/c{'/0' * x.ndim}" for n, x in others.items()]
        except Exception as error:  # NumPy's and Zarr's, of many kinds
            raise _describes_none(self.path) from error
        self.metadata = {key: text.to_bytes() for key, text in self.files.items()}

    def __enter__(self) -> SweepStore:
        """Return the store: a finished one need not be claimed."""
        return self

    def __exit__(self, *_: object) -> None:
        """Let others write to it."""
        self.release()

    def release(self) -> None:
        """Give the lock back."""
        _close(self.lock)
        self.lock = None

    def claim(self) -> None:
        """Be the only one on this machine who writes to it.

        **Raises:** `ValueError` if another sweep writes to it, or a link would lead out
        of it; `OSError` if nothing can be written there.
        """
        if self.lock is None:
            self.lock = locked_store(self.path)
        try:
            self._check_that_it_is_ours()
            clear_away(self.path)
            parts = self.folder / "parts"
            for name in ("blocks", "parts"):
                check_within(self.folder / name, self.path)
            for name in self.arrays:
                check_within(self.path / name / "c", self.path)
            for part in parts.iterdir() if parts.is_dir() else ():
                if part.is_file():  # of a writer that was killed
                    part.unlink(missing_ok=True)
        except BaseException:
            self.release()
            raise

    def damaged(self) -> list[str]:
        """The damaged files beside blocks, which are mended without computing."""
        records = [(name, read_record(self.folder / name)) for name in RECORDS]
        bad = [n for n, r in records if r is None or r.get("run") != self.run]
        return [*bad, *self._mended_metadata(), *self.damaged_coordinates()]

    def _mended_metadata(self) -> dict[str, bytes]:
        """Zarr's metadata as it should be, where it is not."""
        files = self.metadata.items()
        mended = {k: with_own(bytes_of(self.path / k), text) for k, text in files}
        return {key: text for key, text in mended.items() if text is not None}

    def damaged_coordinates(self) -> list[str]:
        """The files of coordinates that are not as they were written."""
        return [
            key
            for key in self.coordinates
            if sum_of(bytes_of(self.path / key) or b"") != self.sums.get(key)
        ]

    def mend(self, axes: xr.Dataset) -> None:
        """Write again what is damaged beside blocks, once the store is claimed."""
        damaged, parts = self.damaged(), self.folder / "parts"
        for key in self.damaged_coordinates():
            name = key.split("/")[0]
            values = axes[name] if name in axes.coords else self.labels[name]
            content = self._encoded(key, (), np.asarray(values, np.float64))
            write(self.path / key, content, parts)
            self.sums[key] = sum_of(content)
        for key, content in self._mended_metadata().items():
            write(self.path / key, content, parts)
        for name in RECORDS if damaged else ():
            self._write(self.folder / name, {**self.record, "chunks": self.sums})

    def missing(self, grid: Grid) -> dict[int, int]:
        """How many points are still to be computed, by block.

        Every chunk of every finished block is read and compared with its checksum: of
        10^7 points, 0.8 GB in 5000 files, in some two seconds where they are still in
        the system's memory (measured 1.8 s). Where there is something to do the store
        is claimed, and what is damaged beside blocks is mended.

        **Raises:** as `claim`.
        """
        marks = self.marks()
        missing = grid.missing(lambda n: n in marks and self.intact(marks[n]))
        if missing or self.damaged():
            self.claim()
            self.mend(grid.axes)
        return missing

    def holds(self, block: Block) -> bool:
        """Whether the block is finished and undamaged."""
        mark = self._mark(block.number)
        return mark is not None and self.intact(mark)

    def marks(self) -> dict[int, Mark]:
        """The marks, by block; damaged and foreign ones do not count."""
        folder = self.folder / "blocks"
        names = os.listdir(folder) if folder.is_dir() else []
        numbers = [int(name) for name in names if name.isascii() and name.isdigit()]
        marks = ((number, self._mark(number)) for number in numbers)
        return {number: mark for number, mark in marks if mark is not None}

    def _mark(self, number: int) -> Mark | None:
        """The mark of a block; None: it has none that counts."""
        mark = read_record(self.folder / "blocks" / str(number)) or {}
        if [mark.get("run"), mark.get("block")] != [self.run, number]:
            return None
        sums = mark.get("chunks")
        whole = isinstance(mark.get("points"), int) and isinstance(sums, dict)
        return mark if whole and number < math.prod(self.counts) else None

    def intact(self, mark: Mark, read: bool = True) -> bool:
        """Whether a block's chunks are those that were written.

        **Arguments:** `read`: all of them, else by their length and their own checksum.
        That stands at a chunk's end, where Zarr compares it with the rest as it reads.
        """
        try:
            for key in self._keys(mark["block"]).values():
                written, path = mark["chunks"][key], self.path / key
                if read and sum_of(bytes_of(path) or b"") != written:
                    return False
                if not read and end_of(path) != written[::2]:
                    return False
        except (OSError, KeyError, TypeError):
            return False
        return True

    def _keys(self, number: int) -> dict[str, str]:
        """The chunks of a block, by variable."""
        place = [int(i) for i in np.unravel_index(number, self.counts)]
        keys = {}
        for name in self.names:
            inner = [0] * (self.arrays[name].ndim - len(place))
            keys[name] = "/".join([name, "c", *map(str, place + inner)])
        return keys

    def write_block(
        self, block: Block, arrays: Mapping[str, np.ndarray], tally: Tally
    ) -> None:
        """Write a whole block: its chunks, then its mark.

        **Raises:** `ValueError` if the store has been replaced: a worker may still be
        computing for a sweep that was stopped; `OSError` if it cannot be written to.
        """
        try:
            self._check_that_it_is_ours()
            chunks = {}
            for name, key in self._keys(block.number).items():
                content = self._encoded(key, block.region, arrays[name])
                write(self.path / key, content, self.folder / "parts")
                chunks[key] = sum_of(content)
            mark = {**tally._asdict(), "points": int(block.chosen.sum())}
            mark |= {"block": block.number, "run": self.run, "chunks": chunks}
            self._write(self.folder / "blocks" / str(block.number), mark)
        except OSError as error:
            error.add_note(
                f"It was writing {block}. What was finished before is in {self.path}, "
                "and the same sweep goes on from there."
            )
            raise

    def committed(self, done: Collection[int], key: str) -> bytes:
        """A coordinate's file, or a chunk of one of the blocks that are `done`.

        **Raises:** `KeyError` for every other; `ValueError` if it is not as written.
        """
        if key in self.coordinates:
            written = self.sums.get(key)
        else:
            name, kind, *place = *key.split("/"), "", ""
            if name not in self.names or kind != "c":
                raise KeyError(key)
            place = [int(part) for part in place[: len(self.counts)]]
            number = int(np.ravel_multi_index(place, self.counts))
            if number not in done:
                raise KeyError(key)
            mark = self._mark(number)
            written = mark and mark["chunks"].get(key)
        content = bytes_of(self.path / key)
        if content is None or sum_of(content) != written:
            raise ValueError(
                f"File {key!r} of the store {str(self.path)!r} must have the checksum "
                "that its mark says, but was damaged or replaced since. The same sweep "
                "computes it again."
            )
        return content

    def _encoded(
        self, key: str, region: tuple[slice, ...], values: np.ndarray
    ) -> bytes:
        """The chunk file that holds these values: Zarr's own bytes."""
        self.arrays[key.split("/")[0]][(*region, ...)] = values
        return self.files.pop(key).to_bytes()

    def _write(self, path: Path, record: Mapping[str, object]) -> None:
        write_record(path, record, self.folder / "parts")

    def _check_that_it_is_ours(self) -> None:
        if not self.folder.is_dir():
            raise FileNotFoundError(
                f"The store {str(self.path)!r} is gone: it was moved or deleted while "
                "the sweep was running."
            )
        if recorded(self.path).get("run") != self.run:
            raise ValueError(
                f"Argument `store` must stay this sweep's, but {str(self.path)!r} has "
                "been taken over by another."
            )

    def dataset(self, attributes: Mapping[str, object]) -> xr.Dataset:
        """The sweep's result."""
        if attributes:
            self._write(self.folder / "run.json", attributes)
        return opened(self)


# A store is read ----------------------------------------------------------------------


def open_sweep(store: str | os.PathLike) -> xr.Dataset:
    """The dataset of a sweep's store, finished or not, read as far as it is used.

    Points that are not computed yet are NaN, with the `outcome` `not_computed`. The
    sweep may still be running: the dataset has the blocks that are finished by then.
    Every chunk has a checksum: a damaged one raises an error when it is read, and never
    gives a number.

    A store may come from anywhere: opening it runs no code from the folder. Variables
    that were added to it are read as well, if they are Zarr 3 arrays with codecs of
    Zarr itself; other ones are left out, with a warning.

    **Arguments:** `store`: the folder that was `sweep`'s argument `store`.

    **Returns:** an `xarray.Dataset`, its arrays still on the disk. Beside those of the
    sweep it has the attributes `points` and `points_done`, `blocks` and
    `blocks_done`.

    **Raises:** `ValueError` if the folder is no sweep's store, or a coordinate is
    damaged. It warns of blocks whose chunks are gone, too short, or another sweep's:
    they read as not computed.
    """
    return opened(SweepStore(place(store)))


def opened(store: SweepStore) -> xr.Dataset:
    """The Dataset of a store."""
    damaged = store.damaged_coordinates()
    if damaged:
        raise ValueError(
            f"Argument `store` must be whole, but {damaged[0]!r} in {str(store.path)!r}"
            " is damaged. The same sweep mends it."
        )
    marks = store.marks()
    done = {n: mark for n, mark in marks.items() if store.intact(mark, read=False)}
    gone = sorted(marks.keys() - done.keys())
    if gone:
        warnings.warn(
            f"Of the store {str(store.path)!r} these blocks are damaged, and count as "
            f"not computed: {', '.join(map(str, gone))}. The same sweep computes them "
            "again.",
            stacklevel=3,
        )
    ds = _with_foreign(_own(store, done), store)
    progress = {
        **store.totals,
        "points_done": sum(mark["points"] for mark in done.values()),
        "blocks_done": len(done),
    }
    run = read_record(store.folder / "run.json") or {}
    return ds.assign_attrs({**run, **progress})


def _own(store: SweepStore, done: Collection[int]) -> xr.Dataset:
    """The sweep's own variables, of the blocks that are `done`."""
    about, labels = store.record["metadata"], store.labels
    try:
        ds = _shown(store.metadata, functools.partial(store.committed, frozenset(done)))
        coords = {n: coordinate(n, labels[n]) for n in about["coords"] if n in labels}
        ds = ds.set_coords([name for name in about["coords"] if name in store.arrays])
        return ds[list(about["data_vars"])].assign_coords(coords)
    except (*BAD_JSON, OverflowError) as error:  # xarray's, of what a record says
        raise _describes_none(store.path) from error


def _describes_none(path: Path) -> ValueError:
    return ValueError(
        f"Argument `store` must be a sweep's store, but {str(path)!r} describes no "
        "sweep's dataset."
    )


class _Shown(Files):
    """The store as Zarr sees it: settled metadata, and chunks on request."""

    chunk: Callable[[str], bytes]  # in the file of this key; `KeyError` if none is

    def __missing__(self, key: str) -> Buffer:
        """A chunk."""
        return cpu.Buffer.from_bytes(self.chunk(key))


def _shown(metadata: Mapping[str, bytes], chunk: Callable[[str], bytes]) -> xr.Dataset:
    """The Dataset of these arrays as they are, its chunks read when looked at."""
    files = _Shown({k: cpu.Buffer.from_bytes(t) for k, t in metadata.items()})
    files.chunk = chunk
    store = MemoryStore(files, read_only=True)
    # chunks=None: without Dask; not decoded: "days since 2000-01-01" is a sweep's unit
    how = {"consolidated": False, "zarr_format": 3, "chunks": None}
    return xr.open_zarr(store, **how, decode_cf=False)  # pyright: ignore[reportArgumentType]


def _with_foreign(ds: xr.Dataset, store: SweepStore) -> xr.Dataset:
    """With the variables that others added to the store, as far as they are safe."""
    chunk, root = functools.partial(_foreign_chunk, store.path), store.metadata
    left_out = {}
    for folder in sorted(store.path.iterdir()):
        name, text = folder.name, bytes_of(folder / "zarr.json")
        known = text is not None or (folder / ".zarray").is_file()
        if name in (RECORD, *ds.variables) or not known:
            continue
        about, reason = _checked(text)
        if reason is None and about is not None:
            metadata = {"zarr.json": root["zarr.json"], f"{name}/zarr.json": about}
            try:
                one = xr.decode_cf(_shown(metadata, chunk))  # xarray wrote it
                ds = ds.merge(one, join="exact", compat="equals")
            except Exception as error:  # xarray's and Zarr's, of many kinds
                reason = f"cannot stand beside the others ({error})"
        if reason is not None:
            left_out[name] = reason
    for name, reason in left_out.items():
        warnings.warn(
            f"Of the store {str(store.path)!r} the variable {name!r}, which is not the "
            f"sweep's, is left out and not read: it {reason}.",
            stacklevel=4,
        )
    return ds


def _foreign_chunk(path: Path, key: str) -> bytes:
    """A chunk of a variable that is not the sweep's."""
    content = bytes_of(path / key)
    if content is None:
        raise KeyError(key)
    return content


def _checked(text: bytes | None) -> tuple[bytes | None, str | None]:
    """An array's metadata as it may be read, none of a group; else why it may not."""
    try:
        about = json.loads(text or b"")
        if about["zarr_format"] == 3 and about["node_type"] == "group":
            return None, None
        if about["zarr_format"] != 3 or about["node_type"] != "array":
            return None, "is no array of Zarr 3"
        kind = about["data_type"]
        kind = kind if isinstance(kind, str) else kind["name"]
        strange = {*_codecs(about["codecs"])} - CODECS or {kind} - TYPES
        if not strange and not about.get("storage_transformers"):
            return json.dumps(about).encode(), None
        names = ", ".join(sorted(map(repr, strange))) or "a storage transformer"
        return None, f"asks for {names}, which is none of Zarr's own"
    except BAD_JSON:
        return None, "is no array of Zarr 3"


def _codecs(codecs: Collection[Any]) -> Iterator[str]:
    """The names of codecs, and of those within a shard."""
    for codec in codecs:
        yield codec if isinstance(codec, str) else codec["name"]
        inner = {} if isinstance(codec, str) else codec.get("configuration") or {}
        for key in ("codecs", "index_codecs"):
            yield from _codecs(inner.get(key, ()))
