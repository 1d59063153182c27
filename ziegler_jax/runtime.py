"""The process: cores, memory, the settings of XLA, JAX's cache and flags, Ctrl-C."""

from __future__ import annotations

import gc
import os
import re
import signal
import tempfile
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from functools import wraps
from importlib import metadata
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import jax
import jax.numpy as jnp

# Options of XLA, and the jaxlib versions [from, below) for which each is set (measured:
# 0.10.2 and 0.12.0).
_WHOLE_LOOPS = "xla_cpu_small_while_loop_byte_threshold=1000000000"
_OPTIONS = {
    # loops run 1.8 times as fast; 0.12 compiles whole loops by itself
    _WHOLE_LOOPS: ((0, 10, 2), (0, 11, 0)),
    # else loops over lanes are written out: a quarter of compiling or more, no gain
    "xla_cpu_disable_loop_unrolling=true": ((0, 10, 2), (0, 13, 0)),
}
# A pass that moves out of a loop what does not change in it: a quarter of a branch's
# compiling, and no gain: maps take 0.98 to 1.03 of the time without it (measured:
# 0.10.2). That which simplifies loops takes as long to compile, but without it a loop
# copies a long trajectory's times at every step.
_WITHOUT = "xla_disable_hlo_passes"
_PASS = "while-loop-invariant-code-motion"


def configure_cpu() -> str:
    """Let XLA compile a whole solve into one kernel, and sooner.

    Puts options into the environment variable `XLA_FLAGS`, for this process and its
    children. Call it before JAX computes anything. Without it everything works, on
    jaxlib 0.10 at about half the speed, on later ones after compiling for longer. It
    never sets what the installed jaxlib might not know: an unknown flag would abort the
    process.

    **Returns:** a sentence that says what it did.
    """
    flags = os.environ.get("XLA_FLAGS", "")
    usual = [option for option in _OPTIONS if _gains(option)]
    if not usual:
        installed = metadata.version("jaxlib")
        return f"jaxlib {installed} needs no setting: nothing was changed."
    missing = ",".join(option for option in usual if option not in flags)
    options, advice = [], ""
    if missing and "xla_backend_extra_options" in flags:
        advice = (
            "XLA_FLAGS has backend options of its own, which were left alone; add "
            f"{missing} to them for speed."
        )
    elif missing:
        options.append(f"--xla_backend_extra_options={missing}")
    if _WITHOUT in flags and _PASS not in flags:
        advice += f" XLA_FLAGS leaves out passes of its own: add {_PASS} to them."
    elif _WITHOUT not in flags:
        options.append(f"--{_WITHOUT}={_PASS}")
    if not options:
        return advice.strip() or (
            "XLA_FLAGS holds the options already: nothing was changed."
        )
    if _backend_started():
        return (
            "JAX has started its backend already: nothing was changed. Call "
            "configure_cpu() before the first computation."
        )
    added = " ".join(options)
    os.environ["XLA_FLAGS"] = f"{flags} {added}".strip()
    return f"{added} was added to XLA_FLAGS. {advice.strip()}".strip()


def compiles_whole_loops() -> bool:
    """Whether XLA makes one kernel of a loop, by itself or because it was told to."""
    return not _gains(_WHOLE_LOOPS) or _WHOLE_LOOPS in os.environ.get("XLA_FLAGS", "")


def all_cores() -> int:
    """The cores that this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:
        return os.cpu_count() or 1


def _gains(option: str) -> bool:
    """Whether the installed jaxlib gains from it."""
    installed = re.findall(r"\d+", metadata.version("jaxlib"))[:3]
    first, below = _OPTIONS[option]
    return first <= tuple(map(int, installed)) < below


def _backend_started() -> bool:
    try:
        from jax._src import xla_bridge

        return xla_bridge.backends_are_initialized()
    except (ImportError, AttributeError):  # not public: then assume the best
        return False


_forked = False  # from a process in which JAX had started
_asked = False  # whether anything was computed here, where JAX does not tell


def _after_fork() -> None:
    global _forked
    _forked = _backend_started() or _asked


if hasattr(os, "register_at_fork"):  # Windows forks no process
    os.register_at_fork(after_in_child=_after_fork)


def refuse_forked() -> None:
    """Refuse to compute in a process forked from one in which JAX had started.

    The threads of JAX are not in it: the first computation would wait for ever. Every
    public function that computes asks here. Methods of laws and columns do not, and
    wait, as whatever of JAX's own is called: it has no place to ask.

    **Raises:** `RuntimeError`.
    """
    global _asked
    _asked = True
    if _forked:
        raise RuntimeError(
            "This process was forked from one in which JAX had started, and its threads"
            " are not in it: what is computed here would wait for ever. Start processes"
            ' by `spawn`: `multiprocessing.get_context("spawn")`, or'
            ' `ProcessPoolExecutor(mp_context=get_context("spawn"))`.'
        )


def configure_cache(folder: str | os.PathLike | None = None) -> str:
    """Let JAX keep compiled programs in a folder, for the processes that follow.

    Sets JAX's own persistent compilation cache for this process and, by environment
    variables, for its children, such as the workers of a local Dask cluster. A program
    is found again by the same versions of JAX and jaxlib with the same XLA flags on the
    same kind of processor. Tracing, a second or two a scene, is still done anew. The
    folder may be deleted at any time.

    **Arguments:** `folder`: made if need be; None is `ziegler_jax` in the user's cache
    folder (`$XDG_CACHE_HOME` or `~/.cache`).

    **Returns:** a sentence that says where; where the folder cannot be written to a
    warning, and nothing is set.
    """
    if folder is None:
        home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
        folder = Path(home) / "ziegler_jax"
    folder = Path(folder).absolute()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        sentence = (
            f"Compiled programs are not kept: {folder} cannot be written to ({error}); "
            "name another folder, `configure_cache(folder)`."
        )
        warnings.warn(sentence, stacklevel=2)
        return sentence
    settings = {
        "jax_compilation_cache_dir": str(folder),
        "jax_persistent_cache_min_compile_time_secs": 0.5,
    }
    for name, value in settings.items():
        jax.config.update(name, value)
        os.environ[name.upper()] = str(value)
    return f"Compiled programs are kept in {folder}."


@contextmanager
def paused_collector() -> Iterator[None]:
    """Leave garbage alone: the collector walks what is traced again and again."""
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()


@contextmanager
def held_interrupts() -> Iterator[None]:
    """Raise a Ctrl-C at the end of this block, not within it; a second one at once.

    Python drops a `KeyboardInterrupt` that meets a finaliser or a collector's callback
    ("Exception ignored in ..."), and tracing is full of them: the sweep then went on to
    its end. One that meets a function called from compiled code can leave the tables of
    JAX half-written. A compilation does not stop for it anyway.

    A handler that is not Python's own is left alone, and so are other threads than the
    main one, which get no signals.
    """
    own = threading.current_thread() is threading.main_thread()
    if not own or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    pressed = []

    def hold(*_: object) -> None:
        pressed.append(True)
        signal.signal(signal.SIGINT, signal.default_int_handler)

    signal.signal(signal.SIGINT, hold)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        if pressed:
            raise KeyboardInterrupt


@contextmanager
def quiet_compiler() -> Iterator[None]:
    """Compile without XLA's log: its alarm of a slow compilation is no error.

    What does go wrong is raised. Afterwards the log says again what JAX had it say.
    """
    try:
        from jaxlib.utils import absl_set_min_log_level as least
    except ImportError:  # not public: then it is heard
        yield
        return
    least(3)
    try:
        yield
    finally:
        least(int(os.environ.get("TF_CPP_MIN_LOG_LEVEL", "1")))


def own_flags() -> AbstractContextManager[ExitStack | None]:
    """A context without JAX's debugging flags; nothing where none is set.

    The flags are for the user's numbers. Infinity and NaN stand for "none" in many
    places here, by design, and loops of compiled programs are what a motion is made of.
    A motion that does end in NaN is told of by `motion.not_finite`.
    """
    config: Any = jax.config
    nans, infs = config.jax_debug_nans, config.jax_debug_infs
    if not (nans or infs or config.jax_disable_jit):
        return nullcontext()
    flags = ExitStack()
    flags.enter_context(jax.debug_nans(False))
    flags.enter_context(jax.debug_infs(False))
    flags.enter_context(jax.disable_jit(False))
    return flags


Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def requires_x64(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """A public function that computes: in 64 bits, and whatever is being debugged.

    JAX computes in 32 bits unless it is told otherwise, and most numbers here would be
    wrong in them without a word.
    """
    name = getattr(function, "__name__", "this")

    @wraps(function)
    def computed(*args: Arguments.args, **options: Arguments.kwargs) -> Result:
        refuse_forked()
        if jnp.result_type(float) != jnp.float64:
            raise ValueError(
                f"`{name}` must compute in 64-bit arithmetic, but JAX is set to 32 "
                'bits; type `jax.config.update("jax_enable_x64", True)` before it, '
                "or use `sweep`."
            )
        with own_flags():
            return function(*args, **options)

    return computed


def free_memory() -> int | None:
    """Bytes that this process may still take; None where the system does not say."""
    bounds = []
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
        sizes = dict(line.split(":") for line in lines)
        bounds.append(1024 * int(sizes["MemAvailable"].split()[0]))
    except (OSError, KeyError, ValueError):
        pass
    try:  # a container's limit
        group = Path("/sys/fs/cgroup")
        limit = int((group / "memory.max").read_text())
        bounds.append(limit - int((group / "memory.current").read_text()))
    except (OSError, ValueError):
        pass
    if not bounds:
        try:
            bounds.append(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
        except (AttributeError, ValueError, OSError):
            return None
    return min(bounds)
