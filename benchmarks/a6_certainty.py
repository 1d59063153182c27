"""What certainty costs: the main job's cells certified, over those judged by windows.

Pairs of sweeps in one process, compiled before: the median ratio of their seconds, of
the whole call, which traces its scene anew (`ratio_time`), and of the run alone
(`ratio_run`); and that of their steps, where one with three tangents counts as four.
Besides the seconds (of processor time) that tracing and compiling the certified scene
take, stage by stage: the motion's loop and that of shots are the two largest. Prints
one JSON line.

    python benchmarks/a6_certainty.py [--cells 25000] [--pairs 3] [--compile-only]
"""

import argparse
import json
import time

import numpy as np
from measure import interleaved, machine, paired, rounded

import ziegler_jax as zj
from ziegler_jax.__main__ import grid, point
from ziegler_jax.sweep.program import lowered, own_flags, traced

zj.configure_cpu()
NAMES = ("q", "mu_s", "mu_k")


def by_windows(q, mu_s, mu_k):
    return point(q, mu_s, mu_k, certify=False)


def processor_seconds(run):
    start = time.process_time()
    return run(), time.process_time() - start


def compiled():
    """Seconds to trace all, and to compile each stage."""
    import jax

    scene, tracing = processor_seconds(lambda: traced(point, NAMES, None))
    with own_flags(), jax.enable_x64(True):
        stages = [
            processor_seconds(lowered(stage, scene).lowered.compile)[1]
            for stage in scene.stages
        ]
    loops = sorted(stages)[-2:]
    return {"trace": tracing, "compile": stages, "both_loops": sum(loops)}


def sweeps(cells, datasets):
    q, mu = grid(cells)

    def runner(name, scene):
        def run():
            ds = zj.sweep(
                scene,
                where=lambda q, mu_s, mu_k: mu_k <= mu_s,
                axes={"q": q, "mu_s": mu, "mu_k": mu},
                progress=False,
            )
            datasets[name].append(ds)

        return run

    scenes = {"certified": point, "windows": by_windows}
    return {name: runner(name, scene) for name, scene in scenes.items()}


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--cells", type=int, default=25_000)
    parser.add_argument("--pairs", type=int, default=3)
    parser.add_argument("--compile-only", action="store_true")
    options = parser.parse_args()
    result = {"benchmark": "a6_certainty", **machine(), "seconds": compiled()}
    if not options.compile_only:
        datasets = {"certified": [], "windows": []}
        seconds = interleaved(sweeps(options.cells, datasets), options.pairs)
        ratio, spread = paired(seconds["certified"], seconds["windows"])
        one, other = (datasets[name][-1] for name in ("certified", "windows"))
        # the first of each was the warm-up
        runs = {n: [ds.run_seconds for ds in d[1:]] for n, d in datasets.items()}
        ratio_run, spread_run = paired(runs["certified"], runs["windows"])
        steps = one.steps + 3 * one.shot_steps
        result |= {
            "cells": int((one.outcome > 0).sum()),
            "ratio_time": ratio,
            "ratio_time_range": spread,
            "ratio_run": ratio_run,
            "ratio_run_range": spread_run,
            "ratio_steps": float(steps.sum() / other.steps.sum()),
            "microseconds_a_cell": {
                name: 1e6 * float(np.median(s)) / int((one.outcome > 0).sum())
                for name, s in seconds.items()
            },
            "undecided_share": float((one.outcome == zj.CODE.unsettled).sum())
            / int((one.outcome > 0).sum()),
        }
    print(json.dumps(rounded(result)))


if __name__ == "__main__":
    main()
