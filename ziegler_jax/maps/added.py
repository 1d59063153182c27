"""Variables that are added to a finished sweep's store, beside its own."""

import os
import shutil

import xarray as xr
from zarr.codecs import Crc32cCodec, ZstdCodec

from ..sweep.store import SweepStore, place

CODECS = {"compressors": (ZstdCodec(), Crc32cCodec())}  # those of the sweep's own


def add_variables(path: str | os.PathLike, variables: xr.Dataset) -> None:
    """Write variables into a store, or replace them, in their order.

    Each is there as a whole or not at all, whenever the process ends. After a power
    loss chunks may be missing, which read as 0.

    **Raises:** `ValueError` if the folder is no store, or another sweep writes to it;
    `OSError` if it cannot be written to.
    """
    with SweepStore(place(path)) as store:
        store.claim()
        new = store.folder / "parts" / "added"
        shutil.rmtree(new, ignore_errors=True)  # of a process that was killed
        how = {"zarr_format": 3, "consolidated": False}
        variables.to_zarr(new, encoding={name: CODECS for name in variables}, **how)  # pyright: ignore[reportArgumentType]
        for name in map(str, variables):
            shutil.rmtree(store.path / name, ignore_errors=True)
            os.rename(new / name, store.path / name)
        shutil.rmtree(new, ignore_errors=True)
