"""Cost of a lane against the number of lanes, and against the number of threads.

The scene `smooth` of `scenes.py` at 1e-6, Tsit5: 64 to a million lanes, each
point of the curve with the program compiled; then 65 536 lanes on 1 to all threads, in
turns, and beside them the C++ kernel's, which tell what the machine gives
(`a2_scaling.py` gives the memory). Prints one JSON line a point; writes
`results/b1_lanes.json` and `.png`. Three minutes with the defaults.

    python benchmarks/b1_lanes.py [--lanes 1048576]
"""

import argparse
import json
import os

import colours
import matplotlib
import numpy as np
import ours
from measure import clock, commit, machine, paired, rounded, save
from peers import cpp
from scenes import SCENES, START

import ziegler_jax as zj

matplotlib.use("agg")
zj.configure_cpu()
LOADS = 8192
THREADED, ROUNDS = 65_536, 7
COUNTS = (64, 256, 1024, 4096, 2**14, 2**17, 2**20)
TOLERANCE = 1e-6


def draw(result, path):
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(
        1, 2, figsize=(8.3, 3.4), layout="constrained", width_ratios=(1.5, 1)
    )
    for name, marker, colour in (
        ("sweep", "o", colours.BLUE),
        ("C++ AVX-512", "s", colours.VERMILLION),
    ):
        points = [p for p in result["lanes"] if name in p]
        x = [p["lanes"] for p in points]
        left.plot(x, [p[name] for p in points], marker + "-", color=colour, label=name)
    left.set(
        xscale="log", yscale="log", xlabel="lanes",
        ylabel=r"time of a lane ($\mu$s)",
    )  # fmt: skip
    left.grid(alpha=0.3)
    left.legend()
    threads = [p["threads"] for p in result["threads"]]
    right.plot(
        threads, [p["speed_up"] for p in result["threads"]], "o-", c=colours.BLUE
    )
    right.plot(threads, threads, ":", color="0.5", label="ideal")
    right.set(xlabel="threads", ylabel="speed-up", xticks=threads)
    right.grid(alpha=0.3)
    right.legend()
    span = SCENES["smooth"].span
    about = f"friction smoothed by tanh, to t = {span:g}, tolerance {TOLERANCE:g}"
    figure.suptitle(about, fontsize=10)
    figure.savefig(path, dpi=130)
    plt.close(figure)


def by_threads(scene, cores, with_cpp):
    """Speed-ups over one thread, of `sweep` and of the C++ kernel, in turns."""
    q = scene.loads(THREADED)

    def ours_on(n):
        return ours.solved(
            scene, q, START, scene.span, TOLERANCE, lanes=zj.Lanes(threads=n)
        )[1]

    def cpp_on(n):
        begun = clock()
        cpp.solve(q, threads=n, observe=False)
        return clock() - begun

    counts = sorted({1, *range(2, cores + 1, max(1, cores // 8)), cores})
    runs = {"speed_up": ours_on} | ({"cpp": cpp_on} if with_cpp else {})
    seconds = {(name, n): [] for n in counts for name in runs}
    for _ in range(1 + ROUNDS):
        for name, n in seconds:
            seconds[name, n].append(runs[name](n))
    points = []
    for n in counts:
        point = {"threads": n}
        for name in runs:  # after a warm-up
            ratio, spread = paired(seconds[name, 1][1:], seconds[name, n][1:])
            point |= {name: ratio, f"{name}_range": spread}
        points.append(point)
    return points


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--lanes", type=int, default=COUNTS[-1])
    most = parser.parse_args().lanes
    scene, cores = SCENES["smooth"], os.cpu_count() or 1
    result = {"benchmark": "b1", "lanes": [], "threads": [], **machine()}
    for lanes in (n for n in COUNTS if n <= most):
        q = scene.loads(lanes)
        repeats = 5 if lanes <= LOADS else 1
        point = {"lanes": q.size}
        runs = [
            ours.solved(scene, q, START, scene.span, TOLERANCE) for _ in range(repeats)
        ]
        point["sweep"] = float(np.median([s for _, s in runs])) / q.size * 1e6
        point["useful_step_fraction"] = runs[-1][0].attrs["useful_step_fraction"]
        try:
            times = [
                cpp.run(scene, q, START, scene.span, TOLERANCE)[1]
                for _ in range(repeats)
            ]
            point[cpp.NAME] = float(np.median(times)) / q.size * 1e6
        except RuntimeError as absent:
            result["absent"] = {"cpp": str(absent)}
        print(
            json.dumps(rounded({"benchmark": "b1", "commit": commit(), **point})),
            flush=True,
        )
        result["lanes"].append(point)
    result["threads"] = by_threads(scene, cores, "absent" not in result)
    for point in result["threads"]:
        print(json.dumps(rounded({"benchmark": "b1", "commit": commit(), **point})))
    draw(result, save("b1_lanes", result))


if __name__ == "__main__":
    main()
