"""A sweep's blocks in memory, and whether there is room for them."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from .partition import Block, Blocks, Tally

SHARE = 0.5  # of the free memory that a sweep may fill


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


def free_memory() -> int | None:
    """Bytes that this process may still take; None where the system does not say."""
    found = []
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
        sizes = dict(line.split(":") for line in lines)
        found.append(1024 * int(sizes["MemAvailable"].split()[0]))
    except (OSError, KeyError, ValueError):
        pass
    try:  # a container's limit
        group = Path("/sys/fs/cgroup")
        limit = int((group / "memory.max").read_text())
        found.append(limit - int((group / "memory.current").read_text()))
    except (OSError, ValueError):
        pass
    if not found:
        try:
            found.append(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
        except (AttributeError, ValueError, OSError):
            return None
    return min(found)


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

    def __exit__(self, *_: Any) -> None:
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
        attributes = {**self.template.attrs, **attributes}
        return xr.Dataset(data, self.template.coords, attributes)
