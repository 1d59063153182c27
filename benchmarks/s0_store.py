"""A sweep with a store: killed twenty times, its overhead, its memory.

- `kills`: a sweep of 200 000 points is killed with SIGKILL at random moments, twenty
  times, and then finished; its numbers against an uninterrupted run's, and how many
  blocks were computed although they were committed.
- `overhead`: the main job with and without a store, in turns: wall and CPU seconds.
- `memory`: peak memory of a process that sweeps 10^6 and 10^7 points of a cheap scene,
  and of one that finds them all in their store and reads every byte to check it.
- `repeat`: a small map of the main job's scene, without a store, again and again in one
  process: what lowering it anew costs when nothing has changed.

Prints one JSON line a part; together some eight minutes on two cores.

    python benchmarks/s0_store.py [kills overhead memory repeat] [--points N]
        [--repeats 3]
"""

import argparse
import json
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from measure import interleaved, machine, paired, rounded

import ziegler_jax as zj
from ziegler_jax import __main__ as job

KILLS = 20

SWEEP = """
import logging
import sys
import numpy as np
import ziegler_jax as zj
from ziegler_jax.sweep import grid
log = logging.getLogger("ziegler_jax.sweep")
log.setLevel("INFO")
log.addHandler(logging.FileHandler(sys.argv[2]))
grid.POINTS_A_BLOCK = 2000  # so that many are committed between two kills
zj.configure_cpu()
zj.configure_cache(sys.argv[3])

def point(q, mu):
    friction = zj.SmoothCoulomb(mu, pin_radius=0.05, v_smooth=0.05)
    return zj.settle(
        zj.uniform_rods(q, friction=friction), zj.State(omega=(0.0, 0.3)),
        windows=zj.Windows(40.0, 20.0, 3), method=zj.Method(rtol=1e-5),
    )

count = int(sys.argv[4])
q, mu = np.linspace(1.5, 3.5, count), np.linspace(0.05, 0.3, 100)
# what is left to do before the first lane is small then
zj.sweep(point, q=q[:1], mu=mu[:1], store=sys.argv[1] + ".first", progress=False)
print("ready", flush=True)
zj.sweep(point, q=q, mu=mu, store=sys.argv[1], progress=False)
"""

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


def marks(store):
    """The committed blocks, and when each was written."""
    found = (store / "sweep-record" / "blocks").glob("*[0-9]")
    return {int(path.name): path.stat().st_mtime_ns for path in found}


def kills(folder, points):
    """Kill the sweep again and again."""
    rng = random.Random(1)
    count = max(1, points // 100)

    def begin(name):
        files = [folder / f"{name}.zarr", folder / f"{name}.log", folder / "cache"]
        command = [sys.executable, "-c", SWEEP, *map(str, files), str(count)]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert process.stdout.readline() == "ready\n"
        return process

    process = begin("whole")
    started = time.perf_counter()
    while not (folder / "whole.zarr").exists():
        time.sleep(0.001)
    before_lanes = time.perf_counter() - started
    assert process.wait() == 0
    seconds = time.perf_counter() - started - before_lanes
    store, before, twice, died, committed = folder / "killed.zarr", {}, 0, 0, []
    while died < KILLS:
        process = begin("killed")
        try:
            process.wait(before_lanes + rng.uniform(0.0, seconds / 16))
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGKILL)
        died += process.wait() == -signal.SIGKILL
        after = marks(store)
        twice += sum(before[n] != after.get(n) for n in before)
        if len(after) == len(marks(folder / "whole.zarr")):
            break  # it was faster than its killer
        before = after
        committed.append(len(before))
    assert begin("killed").wait() == 0
    after = marks(store)
    twice += sum(before[n] != after.get(n) for n in before)
    log = [json.loads(x) for x in (folder / "killed.log").read_text().splitlines()]
    one, other = (zj.open_sweep(folder / f"{n}.zarr") for n in ("whole", "killed"))
    chunks = {
        name: [
            path.relative_to(folder / name).as_posix()
            for path in sorted((folder / name).rglob("*"))
        ]
        for name in ("whole.zarr", "killed.zarr")
    }
    return {
        "part": "kills",
        "points": one.attrs["points"],
        "kills": died,
        "blocks": one.attrs["blocks"],
        "blocks_committed_after_each_kill": committed,
        "bit_identical": all(
            one[name].values.tobytes() == other[name].values.tobytes()
            for name in one.variables
        ),
        "same_files": chunks["whole.zarr"] == chunks["killed.zarr"],
        "committed_blocks_computed_again": twice,
        "blocks_logged_twice": len(log) - len({line["block"] for line in log}),
        "seconds_uninterrupted": seconds,
    }


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
        "part": "overhead",
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
        "part": "memory",
        "points": int(found),
        "peak_memory_GB": peaks,
        "points_per_second": speed,
        "store_GB": sum(sizes) / 1e9,
        "store_files": len(sizes),
        "again": {"seconds": wall, "cpu_seconds": cpu, "peak_memory_GB": again / 1e6},
    }


def repeat(points, repeats):
    """A sweep of the main job's scene, the first time and then unchanged."""
    zj.configure_cpu()
    q, mu = job.grid(points)

    def seconds():
        began = time.perf_counter(), time.process_time()
        found = zj.sweep(job.point, q=q, mu_s=mu, mu_k=mu[:1], progress=False)
        ended = time.perf_counter(), time.process_time()
        return found.sizes, [b - a for a, b in zip(began, ended, strict=True)]

    sizes, first = seconds()
    wall, cpu = np.median([seconds()[1] for _ in range(repeats)], axis=0)
    return {
        "part": "repeat",
        "points": sizes["q"] * sizes["mu_s"],
        "first": {"seconds": first[0], "cpu_seconds": first[1]},
        "again": {"seconds": wall, "cpu_seconds": cpu},
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parts = ["kills", "overhead", "memory", "repeat"]
    parser.add_argument("parts", nargs="*", default=parts)
    parser.add_argument("--points", type=float, help="instead of the part's own number")
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    if unknown := set(options.parts) - set(parts):
        parser.error(f"no such part: {' '.join(sorted(unknown))}")
    for part in options.parts:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            if part == "kills":
                result = kills(folder, int(options.points or 200_000))
            elif part == "overhead":
                points = int(options.points or job.POINTS)
                result = overhead(folder, points, options.repeats)
            elif part == "repeat":
                result = repeat(int(options.points or 20), options.repeats)
            else:
                result = memory(folder, options.points or 1e7)
        print(
            json.dumps(rounded({"benchmark": "s0_store", **result, **machine()})),
            flush=True,
        )


if __name__ == "__main__":
    main()
