"""How a store comes into being, and how one is taken away: as a whole or not at all."""

import hashlib
import os
import shutil
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from uuid import uuid4

import numpy as np
import xarray as xr
import zarr
from zarr.storage import LocalStore

from .partition import Blocks
from .store_files import (
    LAYOUT,
    RECORD,
    RECORDS,
    is_store,
    layout,
    locked,
    locked_store,
    make_folder,
    sync_folder,
    sync_tree,
    write_record,
)

ABANDONED = 60.0  # seconds after which a half-made store without a lock is nobody's


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


def create(
    path: Path, template: xr.Dataset, blocks: Blocks, identity: Mapping[str, Any]
) -> tuple[bool, int | None]:
    """Make a store with nothing computed: whether it was this call, and its lock.

    It is made under a name of its own and renamed, with its lock held: it is there as a
    whole or not at all, and belongs to one.
    """
    make_folder(path.parent)
    clear_away(path)
    new = path.with_name(f"{_hidden(path)}{uuid4().hex}.new")
    lock, made = None, False
    try:
        (new / RECORD).mkdir(parents=True)
        lock = locked(new / RECORD / "lock")
        _write_template(new, template, blocks, identity)
        sync_tree(new)
        try:
            os.rename(new, path)
            made = True
        except OSError:
            if not (path.is_dir() and any(path.iterdir())):
                raise
            shutil.rmtree(new, ignore_errors=True)
        sync_folder(path.parent)
    except BaseException:
        _close(lock)
        shutil.rmtree(new, ignore_errors=True)
        raise
    if made:
        return True, lock
    _close(lock)
    return False, None


def _close(lock: int | None) -> None:
    if lock is not None:
        os.close(lock)


def _write_template(
    new: Path, template: xr.Dataset, blocks: Blocks, identity: Mapping[str, Any]
) -> None:
    """The files of a store in which nothing has been computed."""
    root = zarr.open_group(LocalStore(new), mode="a", attributes=dict(template.attrs))
    root.create_group(RECORD, overwrite=False)
    labels = {}
    for name, variable in template.variables.items():
        values = variable.values
        if name in template.coords and name not in identity["axes"]:
            labels[str(name)] = values.tolist()
            if values.dtype.kind not in "iuf":
                continue  # Zarr has no settled form for strings: the record has them
            values = values.astype(np.float64)  # where NaN says that a chunk is gone
        chunks, fill = values.shape, np.nan
        if name in template.data_vars:
            chunks = (*blocks.chunk, *values.shape[len(blocks.chunk) :])
            fill = values[(0,) * values.ndim]
        array = root.create_array(
            str(name),
            shape=values.shape,
            dtype=values.dtype,
            dimension_names=[str(dim) for dim in variable.dims],
            attributes=dict(variable.attrs),
            **layout(chunks, fill),
        )
        if name in template.coords:
            array[:] = values
    for folder in ("blocks", "parts"):
        (new / RECORD / folder).mkdir()
    metadata = sorted(new.rglob("zarr.json"))
    record = {
        "layout": LAYOUT,
        "run": uuid4().hex,  # the marker of a stranger's block is none
        "names": [str(name) for name in template.data_vars],
        "codes": [str(n) for n, v in template.items() if "flag_values" in v.attrs],
        "labels": labels,
        "points": int(blocks.sizes.sum()),
        "blocks": int(np.count_nonzero(blocks.sizes)),
        "identity": identity,
        "metadata": {f.relative_to(new).as_posix(): f.read_text() for f in metadata},
    }
    for name in RECORDS:
        write_record(new / RECORD / name, record, new / RECORD / "parts")


def remove(path: Path) -> None:
    """Delete a store, and nothing else: at once for whoever looks at its path.

    **Raises:** `ValueError` if the folder is no store, or a sweep writes to it.
    """
    if not is_store(path):
        raise ValueError(
            f"Argument `store` must be a sweep's store, but {str(path)!r} is none."
        )
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
        shutil.rmtree(left, ignore_errors=True)
    for left in path.parent.glob(f"{_hidden(path)}*.new"):
        try:
            if time.time() - left.stat().st_mtime < ABANDONED:
                continue
            (left / RECORD).mkdir(exist_ok=True)
            lock = locked(left / RECORD / "lock")
        except OSError:
            continue  # it has just become a store
        if lock is not None:
            shutil.rmtree(left, ignore_errors=True)
            os.close(lock)
