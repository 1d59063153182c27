"""A store's small files: what lies where, what they say, how they are written.

A file is there whole or not at all, and on the disk before it counts.
"""

import hashlib
import json
import os
import shutil
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict
from uuid import uuid4

from zarr.abc.codec import BytesBytesCodec
from zarr.codecs import Crc32cCodec, ZstdCodec

if TYPE_CHECKING:  # Zarr's own, of no public name
    from zarr.core.array_spec import ArrayConfigParams


class DamagedFile(ValueError):
    """A file that is there, but not as it was written."""


def write(path: Path, content: bytes, parts: Path) -> None:
    """Write a file by a rename, after its bytes have reached the disk.

    **Arguments:** `parts`: a folder of the same file system, where it is being written.
    """
    make_folder(parts)
    part = parts / uuid4().hex
    with part.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    make_folder(path.parent)
    if path.is_dir():  # damage: a folder where a file should be
        shutil.rmtree(path)
    os.replace(part, path)
    sync_folder(path.parent)


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


def sync_tree(path: Path) -> None:
    """Let a folder with all that is in it reach the disk."""
    for folder, _, names in os.walk(path):
        for name in names:
            with open(Path(folder) / name, "rb+") as file:
                os.fsync(file.fileno())
        sync_folder(Path(folder))


def write_record(path: Path, record: Mapping[str, object], parts: Path) -> None:
    """Write a JSON object with a checksum of what it says."""
    content = json.dumps({"sha256": _digest(record), **record})
    write(path, content.encode(), parts)


def read_record(path: Path) -> dict[str, Any]:
    """Read what `write_record` wrote.

    **Raises:** `DamagedFile` if it says something else; `FileNotFoundError`.
    """
    try:
        record = json.loads(path.read_bytes())
        digest = record.pop("sha256")
    except (ValueError, KeyError, AttributeError, TypeError, IsADirectoryError):
        record, digest = {}, None
    if digest != _digest(record):
        raise DamagedFile(f"{str(path)!r} is damaged")
    return record


def _digest(record: Mapping[str, object]) -> str:
    return hashlib.sha256(json.dumps(record, sort_keys=True).encode()).hexdigest()


def locked(path: Path) -> int | None:
    """Hold a lock that ends with the process, however it ends; None: another does."""
    file = os.open(path, os.O_RDWR | os.O_CREAT)
    try:
        import fcntl
    except ImportError:  # Windows: two sweeps would compute the same twice
        return file
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(file)
        return None
    except BaseException:
        os.close(file)
        raise
    return file


LAYOUT = 2  # of the files; 1 was version 0.1's
RECORD = "sweep-record"  # no variable's name: names have no hyphen
RECORDS = "sweep.json", "sweep.copy.json"


class Layout(TypedDict):
    """What Zarr is told of it."""

    chunks: tuple[int, ...]
    fill_value: float
    compressors: tuple[BytesBytesCodec, ...]
    config: "ArrayConfigParams"


def layout(chunks: tuple[int, ...], fill: float) -> Layout:
    """How arrays are laid out: with checksums, and no chunk left out as empty."""
    return {
        "chunks": chunks,
        "fill_value": fill,
        "compressors": (ZstdCodec(), Crc32cCodec()),
        "config": {"write_empty_chunks": True},
    }


def recorded(path: Path) -> dict[str, Any]:
    """What the store says of its sweep.

    **Raises:** `ValueError` if the folder is no store, or neither copy can be read.
    """
    damage = None
    for name in RECORDS:
        try:
            record = read_record(path / RECORD / name)
        except DamagedFile as error:
            damage = error
        except (FileNotFoundError, NotADirectoryError):
            pass
        else:
            if record["layout"] != LAYOUT:
                break
            return record
    if damage is not None:
        raise ValueError(
            f"Argument `store` must be a sweep's store, but {damage}, and so is its "
            "copy. `zj.Store(path, overwrite=True)` replaces it."
        )
    if is_store(path):
        raise ValueError(
            f"Argument `store` must be a store of this version, but {str(path)!r} was "
            "written by another version of ziegler_jax. "
            "`zj.Store(path, overwrite=True)` replaces it."
        )
    raise ValueError(
        f"Argument `store` must be a sweep's store, but {str(path)!r} is none."
    )


def is_store(path: Path) -> bool:
    """Whether a sweep wrote this folder, damaged as it may be, and whatever version."""
    places = [path / RECORD / name for name in RECORDS]
    return any(p.is_file() for p in (*places, path / "progress" / "sweep.json"))


def locked_store(path: Path) -> int:
    """The lock of a store.

    **Raises:** `ValueError` if another sweep holds it.
    """
    folder = path / RECORD
    if not folder.is_dir():  # of another version, or just taken away
        folder = path
    lock = locked(folder / "lock")
    if lock is None:
        raise ValueError(
            "Argument `store` must not be written to by another sweep, but "
            f"{str(path)!r} is."
        )
    return lock


def read_or_none(path: Path) -> dict[str, Any] | None:
    """A record; None if it is damaged or not there."""
    try:
        return read_record(path)
    except (DamagedFile, FileNotFoundError, NotADirectoryError):
        return None


def listed(folder: Path) -> list[Path]:
    """What lies in a folder; nothing if it is not there, as after some copies."""
    try:
        return list(folder.iterdir())
    except FileNotFoundError:
        return []


def says(path: Path, text: str) -> bool:
    """Whether a file holds this text."""
    try:
        return path.read_bytes() == text.encode()
    except (FileNotFoundError, NotADirectoryError, IsADirectoryError):
        return False


def sum_of(path: Path) -> list[int]:
    """A chunk's length, checksum and end."""
    content = path.read_bytes()
    return [len(content), zlib.crc32(content), tail(content)]


def end_of(path: Path) -> tuple[int, int]:
    """A chunk's length and end, without reading the rest."""
    with path.open("rb") as file:
        length = file.seek(0, os.SEEK_END)
        file.seek(max(0, length - 4))
        return length, tail(file.read())


def tail(content: bytes) -> int:
    """The last four bytes: the checksum that Zarr writes behind a chunk."""
    return int.from_bytes(content[-4:], "little")
