"""Determinism under threads: one call of a compiled batch, again and again.

A lane's result must not depend on the threads that run beside it, to the last bit. A
public report to JAX (issue 39741, August 2026) has a compiled CPU module that gives
different numbers under threads on an AMD Zen 4. Here each of three programs (smoothed
friction, set-valued friction, no friction) is compiled as a sweep compiles it, for 128
lanes, and called 100 000 times with one and the same input
on two threads, some 3 ms a call; every array that comes back is compared with that of
the first call, bit by bit. About twelve minutes on two cores.

Prints one JSON line and appends it to `results/d0_soak.jsonl`, which so keeps a line
for each version of jax and each processor. The exit status is 1 if a bit differed.

    python benchmarks/d0_soak.py [--calls 100000] [--threads 2] [--out FILE]
"""

import argparse
import json
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from importlib import metadata
from itertools import repeat

import jax
import numpy as np
from measure import RESULTS, machine, ready, rounded

import ziegler_jax as zj
from ziegler_jax.sweep.program import compiled, traced

LANES, SECONDS_A_CALL = 128, 0.003
LOADS = np.linspace(2.0, 2.5, LANES)
LONG = {"windows": zj.Windows(1e4, 100.0, max_windows=2)}  # no lane ends in a call


def smooth(q):
    friction = zj.SmoothCoulomb(
        0.012,
        0.010,
        pin_radius=1.0,
        v_stribeck=0.05,
        v_smooth=0.01,
        load=zj.ConstantLoad(1.0),
    )
    column = zj.uniform_rods(q, friction=friction)
    return zj.settle(
        column,
        zj.State(omega=(0.0, 0.2)),
        method=zj.Method(rtol=1e-4, atol=1e-4),
        **LONG,
        certify=False,
    )


def set_valued(q):
    friction = zj.SetValuedCoulomb(
        0.012, 0.010, pin_radius=1.0, load=zj.ConstantLoad(1.0)
    )
    column = zj.uniform_rods(q, friction=friction)
    return zj.settle(column, zj.State(omega=(0.0, 0.2)), **LONG, certify=False)


def frictionless(q):
    return zj.settle(
        zj.uniform_rods(q), zj.State(omega=(0.0, 0.2)), **LONG, certify=False
    )


PROGRAMS = {
    "smooth": smooth,
    "set_valued": set_valued,
    "frictionless": frictionless,
}


class Batch:
    """One batch of a program's loop at its first chunk."""

    def __init__(self, point):
        """Compile it."""
        self.program = compiled(traced(point, ("q",), LANES))
        begin, self.loop, _ = (stage.function for stage in self.program.stages)
        with jax.enable_x64(True):
            self.input = ready(begin((LOADS[None],), ()))

    def call(self, steps):
        """All arrays of a chunk of at most `steps` steps, as bits."""
        with jax.enable_x64(True):  # a thread's own setting
            found = ready(self.loop(np.int32(steps), *self.input))
        return [bits(np.asarray(array)) for array in jax.tree.leaves(found)]

    def steps(self):
        """So many steps that a call takes `SECONDS_A_CALL`."""
        steps, seconds = 8, 0.0
        while seconds < SECONDS_A_CALL:
            steps += steps // 4
            self.call(steps)
            seconds = min(self.seconds(steps) for _ in range(10))
        return steps

    def seconds(self, steps):
        """Of one call."""
        started = time.perf_counter()
        self.call(steps)
        return time.perf_counter() - started


def bits(array):
    """Integers of the same bytes: -0 is not 0 then, and NaN is NaN."""
    if array.dtype.kind != "f":
        return array
    return array.view(f"i{array.dtype.itemsize}")


def soak(batch, calls, threads):
    """How many of the calls gave other bits, and the steps that a call ran."""
    steps = batch.steps()
    first = [array.copy() for array in batch.call(steps)]

    def differs(_):
        pairs = zip(batch.call(steps), first, strict=True)
        return not all(np.array_equal(now, then) for now, then in pairs)

    def work(share):
        return sum(map(differs, repeat(None, share)))

    shares = [calls // threads + (i < calls % threads) for i in range(threads)]
    started = time.perf_counter()
    with ThreadPoolExecutor(threads) as pool:
        differences = sum(pool.map(work, shares))
    seconds = time.perf_counter() - started
    return {
        "differences": differences,
        "seconds": seconds,
        "ms_a_call": 1e3 * threads * seconds / calls,
        "steps_a_call": steps,
        "arrays": len(first),
        "bytes": sum(array.nbytes for array in first),
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--calls", type=int, default=100_000, help="of each program")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--out", default=RESULTS / "d0_soak.jsonl")
    options = parser.parse_args()
    configured = zj.configure_cpu()
    batches = {name: Batch(point) for name, point in PROGRAMS.items()}
    programs = {
        name: soak(batch, options.calls, options.threads)
        for name, batch in batches.items()
    }
    line = json.dumps(
        rounded(
            {
                "benchmark": "d0_soak",
                "calls": options.calls,
                "threads": options.threads,
                "lanes": LANES,
                "seconds": sum(found["seconds"] for found in programs.values()),
                "differences": sum(found["differences"] for found in programs.values()),
                "programs": programs,
                "configure_cpu": configured,
                **machine(),
                "numpy": metadata.version("numpy"),
            }
        )
    )
    print(line)
    with open(options.out, "a") as file:
        file.write(f"{line}\n")
    sys.exit(any(found["differences"] for found in programs.values()))


if __name__ == "__main__":
    main()
