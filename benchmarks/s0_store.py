"""The price of a store: its overhead, its memory.

- `overhead`: the main job with and without a store, in turns: wall and CPU seconds.
- `memory`: peak memory of a process that sweeps 10^6 and 10^7 points of a cheap scene,
  and of one that finds them all in their store and reads every byte to check it.

Prints one JSON line a part; together some five minutes on two cores.

    python benchmarks/s0_store.py [overhead memory] [--main 105780] [--cheap 1e7]
        [--repeats 3]
"""

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from measure import arguments, interleaved, paired, report

import ziegler_jax as zj
from ziegler_jax import __main__ as job

CHEAP = """
import sys, time
import numpy as np
import ziegler_jax as zj
side = round(float(sys.argv[1]) ** (1 / 3))
axis = np.linspace(0.0, 1.0, side)
began = time.perf_counter(), time.process_time()
found = zj.sweep(lambda x, y, z: {"sum": x + y + z, "product": x * y * z},
                 x=axis, y=axis, z=axis, store=sys.argv[2], progress=False)
took = time.perf_counter() - began[0], time.process_time() - began[1]
a = found.attrs
assert a["points_done"] == side**3
corner = found["sum"].isel(x=-1, y=-1, z=slice(-3, None)).values
assert (corner == 2 + axis[-3:]).all()
# not by `resource`: there a process begins with the peak of the one that made it
peak = [x for x in open("/proc/self/status") if x.startswith("VmHWM")][0]
print(a["points"], a["points_per_second"], *took, peak.split()[1])
"""


def overhead(folder, points, repeats):
    """The main job with and without a store."""
    zj.configure_cpu()
    q, mu = job.grid(points)
    cpu = {"memory": [], "store": []}

    def run(name, **options):
        before = time.process_time()
        found = zj.sweep(
            job.point, where=lambda mu_s, mu_k, q: mu_k <= mu_s,
            q=q, mu_s=mu, mu_k=mu, progress=False, **options,
        )  # fmt: skip
        cpu[name].append(time.process_time() - before)
        return found.attrs["points"]

    store = {"store": zj.Store(folder / "main.zarr", overwrite=True)}
    contestants = {
        "memory": lambda: run("memory"),
        "store": lambda: run("store", **store),
    }
    seconds = interleaved(contestants, repeats)
    ratio, spread = paired(seconds["store"], seconds["memory"])
    cpu_ratio, _ = paired(cpu["store"][1:], cpu["memory"][1:])
    return {
        "points": run("memory"),
        "seconds": {name: float(np.median(s)) for name, s in seconds.items()},
        "ratio": ratio,
        "ratio_range": spread,
        "ratio_of_cpu_seconds": cpu_ratio,
    }


def memory(folder, points):
    """Peak memory of a process, at a tenth of the points and at all."""

    def swept(count, store):
        done = subprocess.run(
            [sys.executable, "-c", CHEAP, str(count), str(store)],
            capture_output=True, text=True, check=True,
        )  # fmt: skip
        return map(float, done.stdout.split())

    peaks, speed = [], []
    for count in (points / 10, points):
        store = folder / f"{count:.0f}.zarr"
        found, rate, _, _, peak = swept(count, store)
        peaks.append(peak / 1e6)
        speed.append(rate)
    # what it finds complete it only checks; its files are still in memory
    _, _, wall, cpu, again = swept(points, store)
    sizes = [p.stat().st_size for p in store.rglob("*") if p.is_file()]
    return {
        "points": int(found),
        "peak_memory_GB": peaks,
        "points_per_second": speed,
        "store_GB": sum(sizes) / 1e9,
        "store_files": len(sizes),
        "again": {"seconds": wall, "cpu_seconds": cpu, "peak_memory_GB": again / 1e6},
    }


def main():
    options = arguments(
        __doc__, which=("overhead", "memory"), main=job.POINTS, cheap=1e7, repeats=3
    )
    for part in options.which:
        with tempfile.TemporaryDirectory() as name:
            if part == "overhead":
                found = overhead(Path(name), options.main, options.repeats)
            else:
                found = memory(Path(name), options.cheap)
        report("s0_store", part=part, **found)


if __name__ == "__main__":
    main()
