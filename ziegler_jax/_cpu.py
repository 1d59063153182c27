"""Cores, and the one XLA setting that must be chosen before JAX's backend starts."""

import os
import re
from importlib import metadata

_OPTION = "xla_cpu_small_while_loop_byte_threshold=1000000000"
# jaxlib versions [from, below) whose loops gain from it (measured: 0.10.2 by 1.8 times;
# 0.12 compiles whole loops by itself and gains nothing).
_GAINS = ((0, 10, 2), (0, 11, 0))


def configure_cpu() -> str:
    """Let XLA compile a whole solve into one kernel, where that is not the default.

    Puts one option into the environment variable `XLA_FLAGS`, for this process and its
    children. Call it before JAX computes anything. Without it everything works, on
    jaxlib 0.10 at about half the speed. It never sets what the installed jaxlib might
    not know: an unknown flag would abort the process.

    **Returns:** a sentence that says what it did.
    """
    if not _gains():
        installed = metadata.version("jaxlib")
        return f"jaxlib {installed} needs no setting: nothing was changed."
    flags = os.environ.get("XLA_FLAGS", "")
    if _OPTION in flags:
        return "XLA_FLAGS holds the option already: nothing was changed."
    if "xla_backend_extra_options" in flags:
        return (
            "XLA_FLAGS has backend options of its own, which were left alone; add "
            f"{_OPTION} to them for speed."
        )
    if _backend_started():
        return (
            "JAX has started its backend already: nothing was changed. Call "
            "configure_cpu() before the first computation."
        )
    option = f"--xla_backend_extra_options={_OPTION}"
    os.environ["XLA_FLAGS"] = f"{flags} {option}".strip()
    return f"{option} was added to XLA_FLAGS."


def compiles_whole_loops() -> bool:
    """Whether XLA makes one kernel of a loop, by itself or because it was told to."""
    return not _gains() or _OPTION in os.environ.get("XLA_FLAGS", "")


def all_cores() -> int:
    """The cores that this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:
        return os.cpu_count() or 1


def _gains() -> bool:
    installed = re.findall(r"\d+", metadata.version("jaxlib"))[:3]
    return _GAINS[0] <= tuple(map(int, installed)) < _GAINS[1]


def _backend_started() -> bool:
    try:
        from jax._src import xla_bridge

        return xla_bridge.backends_are_initialized()
    except (ImportError, AttributeError):  # not public: then assume the best
        return False
