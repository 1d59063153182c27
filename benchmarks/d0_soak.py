"""Determinism under threads: one batch of lanes, again and again.

A lane's result must not depend on the threads that run beside it, to the last bit. A
public report to JAX (issue 39741, August 2026) has a compiled CPU module that gives
different numbers under threads on an AMD Zen 4. Here each of three programs (smoothed
friction, set-valued friction, no friction) is compiled once, for batches of 128 lanes,
and swept again and again, a hundred copies of the same loads on two threads; the states
at the end of every lane are compared with those of the first copy, bit by bit.

Prints one JSON line and appends it to `results/d0_soak.jsonl`, which so keeps a line
for each version of jax and each processor. The exit status is 1 if a bit differed.

    python benchmarks/d0_soak.py [--sweeps 100] [--copies 100] [--threads 2]
        [--out FILE]
"""

import functools
import json
import sys
import time
from importlib import metadata

import numpy as np
import ours
from measure import RESULTS, arguments, report
from scenes import SCENES

import ziegler_jax as zj

LOADS = np.linspace(2.0, 2.5, 128)
DRY = zj.SetValuedCoulomb(0.012, 0.01, pin_radius=1.0, load=zj.ConstantLoad(1.0))
COLUMNS = {
    "smooth": functools.partial(ours.column_of, SCENES["smooth"]),
    "set_valued": functools.partial(zj.uniform_rods, friction=DRY),
    "frictionless": zj.uniform_rods,
}


def program_of(column):
    """Of a load and a number that changes nothing: the state at the end, and steps."""

    def point(q, copy):
        start = zj.State(omega=(0.0, 0.2 + 0.0 * copy))
        windows = zj.Windows(10.0, 5.0, max_windows=1)
        settled = zj.settle(column(q), start, windows=windows, certify=False)
        names = ("phi1", "phi2", "omega1", "omega2", "steps")
        return dict(zip(names, (*settled.final.y, settled.steps), strict=True))

    return zj.Program(point, lanes=zj.Lanes(batch_size=LOADS.size))


def soak(program, options):
    """How many lanes gave other bits than the first copy of their load."""
    first, differences, started = None, 0, time.perf_counter()
    lanes, copies = zj.Lanes(threads=options.threads), np.arange(options.copies)
    for _ in range(options.sweeps):
        ds = zj.sweep(program, lanes=lanes, q=LOADS, copy=copies, progress=False)
        bits = np.stack([ds[name].values.astype(float) for name in ds]).view(np.int64)
        first = bits[..., :1].copy() if first is None else first
        differences += int((bits != first).any(axis=0).sum())
    return {"differences": differences, "seconds": time.perf_counter() - started}


def main():
    options = arguments(
        __doc__, sweeps=100, copies=100, threads=2, out=str(RESULTS / "d0_soak.jsonl")
    )
    configured = zj.configure_cpu()
    programs = {
        name: soak(program_of(column), options) for name, column in COLUMNS.items()
    }
    differences = sum(each["differences"] for each in programs.values())
    line = report(
        "d0_soak",
        sweeps=options.sweeps,
        copies=options.copies,
        threads=options.threads,
        lanes=LOADS.size,
        differences=differences,
        programs=programs,
        configure_cpu=configured,
        numpy=metadata.version("numpy"),
    )
    with open(options.out, "a") as file:
        file.write(f"{json.dumps(line)}\n")
    sys.exit(differences > 0)


if __name__ == "__main__":
    main()
