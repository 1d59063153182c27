"""Time per point against threads and against the number of points, and peak memory.

The reference work of `a0_throughput.py`: 4096 columns on one thread and on all, in
turns; then the same 4096 columns repeated up to `--points`. Prints one JSON line; two
minutes with a million points.

    python benchmarks/a2_scaling.py [--points 1000000]
"""

import argparse
import json
import math
import resource

import numpy as np
from a0_throughput import smooth
from measure import machine, paired, rounded

import ziegler_jax as zj

LOADS = 4096


def repeated(q, copy):
    """The reference work; `copy` counts repetitions of the same points."""
    del copy
    return smooth(q)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--points", type=int, default=1_000_000)
    options = parser.parse_args()
    zj.configure_cpu()
    q = np.linspace(2, 4, LOADS)
    found = {}

    def run(threads, copies=1):
        name = f"{threads} threads, {copies} copies"
        found[name] = zj.sweep(
            repeated,
            q=q,
            copy=np.arange(copies),
            lanes=zj.Lanes(threads=threads),
            progress=False,
        ).attrs
        return found[name]["run_seconds"] / found[name]["points"]

    cores = machine()["cores"]
    turns = [(run(1), run(cores)) for _ in range(1 + 9)][1:]  # after a warm-up
    speedup, spread = paired(*zip(*turns, strict=True))
    copies = math.ceil(options.points / LOADS)
    few = [run(cores) for _ in range(3)]
    many = run(cores, copies)
    few += [run(cores) for _ in range(3)]
    result = {
        "benchmark": "a2_scaling",
        "threads": cores,
        "speedup": speedup,
        "speedup_range": spread,
        "points": [LOADS, LOADS * copies],
        "microseconds_a_point": [float(np.median(few)) * 1e6, many * 1e6],
        "ratio_many_to_few": many / float(np.median(few)),
        "peak_memory_GB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6,
        **machine(),
    }
    print(json.dumps(rounded(result)))


if __name__ == "__main__":
    main()
