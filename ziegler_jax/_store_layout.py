"""What lies where in a store, and what its small files say."""

import os
import zlib
from pathlib import Path
from typing import Any

from zarr.codecs import Crc32cCodec, ZstdCodec

from ._files import DamagedFile, locked, read_record

LAYOUT = 2  # of the files; 1 was version 0.1's
RECORD = "sweep-record"  # no variable's name: names have no hyphen
RECORDS = "sweep.json", "sweep.copy.json"


def layout(chunks: tuple[int, ...], fill: Any) -> dict[str, Any]:
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
            "copy. `overwrite=True` replaces the store."
        )
    if is_store(path):
        raise ValueError(
            f"Argument `store` must be a store of this version, but {str(path)!r} was "
            "written by another version of ziegler_jax. `overwrite=True` replaces it."
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
