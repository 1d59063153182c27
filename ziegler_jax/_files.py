"""Files that are there whole or not at all, and on the disk before they count."""

import hashlib
import json
import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from uuid import uuid4


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


def write_record(path: Path, record: Mapping[str, Any], parts: Path) -> None:
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


def _digest(record: Mapping[str, Any]) -> str:
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
