"""The hand-written AVX-512 kernel of `lanes.cpp`, compiled when first used.

The shared library is kept in the user's cache folder under a name that carries the
hash of the source and of the compiler's options, so a changed source compiles anew.
"""

import ctypes
import functools
import hashlib
import os
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
from measure import clock

NAME = "C++ AVX-512"
SOURCE = Path(__file__).with_name("lanes.cpp")
OPTIONS = ("-std=c++17", "-march=native", "-fopenmp", "-shared", "-fPIC")


def built(source, options):
    """A source file as a library of this processor, compiled once for each content.

    **Raises:** `RuntimeError` where there is no g++, or where it cannot compile it.
    """
    compiler = shutil.which("g++")
    if compiler is None:
        raise RuntimeError("The C++ peers need g++, but no g++ is on the PATH.")
    cpu = Path("/proc/cpuinfo")
    lines = cpu.read_text().splitlines() if cpu.exists() else []
    flags = [x for x in lines if x.startswith("flags")][:1]
    key = source.read_bytes() + repr((options, flags)).encode()
    cache = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))
    folder = cache / "ziegler_jax"
    target = folder / f"{source.stem}-{hashlib.sha256(key).hexdigest()[:16]}.so"
    if not target.exists():
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder) as scratch:
            made = Path(scratch) / "library.so"
            command = [compiler, *options, str(source), "-o", str(made)]
            command += ["-lmvec", "-lm"]
            done = subprocess.run(command, capture_output=True, text=True)
            if done.returncode:
                raise RuntimeError(f"g++ could not compile {source}: {done.stderr}")
            made.replace(target)
    return ctypes.CDLL(str(target))


class Lanes(NamedTuple):
    """What the kernel returns for n lanes."""

    amplitude: np.ndarray
    """(n, 3): largest |phi1|, |phi2|, |phi2 - phi1| over t = 80..100 (0: not asked)."""
    state: np.ndarray
    """(n, 4): phi1, phi2, omega1, omega2 at t = 100."""
    steps: np.ndarray
    """(n,): attempted steps, the rejected ones included."""


@functools.cache
def library(plain: bool = False):
    """The compiled kernel as a ctypes function.

    **Arguments:** `plain`: with the C library's vector functions, not with tables.

    **Raises:** `RuntimeError` as `built`; the kernel needs AVX-512.
    """
    options = (*OPTIONS, "-Ofast", *(("-DLIBRARY",) if plain else ()))
    function = built(SOURCE, options).ziegler_lanes
    array = np.ctypeslib.ndpointer(np.float64, flags="C_CONTIGUOUS")
    function.argtypes = [ctypes.c_long, array, ctypes.c_int, ctypes.c_int, *[array] * 3]
    function.restype = None
    return function


def solve(q, *, threads: int = 2, observe: bool = True, plain: bool = False) -> Lanes:
    """Every lane from t = 0 to 100, one for each load.

    **Arguments:**

    - `q`: (n,) follower loads, finite (the kernel has no step budget).
    - `threads`: OpenMP threads.
    - `observe`: whether to land on t = 80 and to take the amplitudes from there on.
    - `plain`: see `library`.
    """
    q = np.ascontiguousarray(q, np.float64)
    if q.ndim != 1 or not np.isfinite(q).all():
        raise ValueError("Argument `q` must be a row of finite loads.")
    out = Lanes(np.empty((q.size, 3)), np.empty((q.size, 4)), np.empty(q.size))
    library(plain)(q.size, q, threads, observe, *out)
    return out


def run(scene, q, start, span, rtol):
    """As `peers` describes; the kernel knows one scene at one tolerance."""
    known = ("smooth", (0.0, 0.0, 0.0, 0.2), 100.0, 1e-6)
    if (scene.name, tuple(start), span, rtol) != known:
        raise NotImplementedError
    solve(q[:1], threads=1, observe=False)  # compiles
    begun = clock()
    out = solve(q, threads=os.cpu_count() or 1, observe=False)
    return out.state, clock() - begun
