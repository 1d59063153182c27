"""Compiled programs on a disk: the next process starts without compiling."""

import os
from pathlib import Path

import jax


def configure_cache(folder: str | os.PathLike | None = None) -> str:
    """Let JAX keep compiled programs in a folder, for the processes that follow.

    Sets JAX's own persistent compilation cache for this process and, by environment
    variables, for its children, such as the workers of a local Dask cluster. A program
    is found again by the same versions of JAX and jaxlib with the same XLA flags on the
    same kind of processor. Tracing, a second or two a scene, is still done anew. The
    folder may be deleted at any time.

    **Arguments:** `folder`: made if need be; None is `ziegler_jax` in the user's cache
    folder (`$XDG_CACHE_HOME` or `~/.cache`).

    **Returns:** a sentence that says where.
    """
    if folder is None:
        home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
        folder = Path(home) / "ziegler_jax"
    folder = Path(folder).absolute()
    folder.mkdir(parents=True, exist_ok=True)
    settings = {
        "jax_compilation_cache_dir": str(folder),
        "jax_persistent_cache_min_compile_time_secs": 0.5,
    }
    for name, value in settings.items():
        jax.config.update(name, value)
        os.environ[name.upper()] = str(value)
    return f"Compiled programs are kept in {folder}."
