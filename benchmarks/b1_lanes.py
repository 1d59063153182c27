"""Cost of a lane against the number of lanes, and of threads; peak memory.

The scene `smooth` of `scenes.py` at 1e-6, Tsit5: 64 to a million lanes, each with the
program compiled, and the C++ kernel's beside them; then `--threaded` lanes on 1 to all
threads, in turns. Prints one JSON line a number of lanes and one for threads; three
minutes with the defaults.

    python benchmarks/b1_lanes.py [--lanes 1048576] [--threaded 65536] [--rounds 7]
"""

import os
import resource

import numpy as np
import ours
from measure import arguments, commit, interleaved, paired, report
from peers import cpp
from scenes import SCENES, START

import ziegler_jax as zj

COUNTS = (64, 256, 1024, 4096, 2**14, 2**17, 2**20)
SCENE, TOLERANCE = SCENES["smooth"], 1e-6
LONG = 8192  # as many lanes are run once


def solved(count, **options):
    loads = SCENE.loads(count)
    return ours.solved(SCENE, loads, START, SCENE.span, TOLERANCE, **options)


def kernel(lanes):
    """Seconds of the C++ kernel; NaN where it cannot be compiled."""
    try:
        return cpp.run(SCENE, SCENE.loads(lanes), START, SCENE.span, TOLERANCE)[1]
    except RuntimeError:
        return np.nan


def by_threads(count, rounds):
    """Speed-ups over one thread, and their ranges."""
    cores = os.cpu_count() or 1
    counts = sorted({1, *range(2, cores + 1, max(1, cores // 8)), cores})
    runs = {n: lambda n=n: solved(count, lanes=zj.Lanes(threads=n)) for n in counts}
    seconds = interleaved(runs, rounds)
    return {n: paired(seconds[1], seconds[n]) for n in runs}


def main():
    options = arguments(__doc__, lanes=COUNTS[-1], threaded=65_536, rounds=7)
    zj.configure_cpu()
    for lanes in (n for n in COUNTS if n <= options.lanes):
        repeats = range(5 if lanes <= LONG else 1)
        runs = [solved(lanes) for _ in repeats]
        report(
            "b1_lanes",
            about=lambda: {"commit": commit()},
            lanes=lanes,
            microseconds_a_lane=float(np.median([s for _, s in runs])) / lanes * 1e6,
            cpp=float(np.median([kernel(lanes) for _ in repeats])) / lanes * 1e6,
            useful_step_fraction=runs[-1][0].attrs["useful_step_fraction"],
        )
    report(
        "b1_lanes",
        threaded_lanes=options.threaded,
        speed_up_and_range=by_threads(options.threaded, options.rounds),
        peak_memory_GB=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6,
    )


if __name__ == "__main__":
    main()
