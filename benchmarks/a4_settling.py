"""What the windows of `settle(certify=False)` cost and decide.

A random sample of the main job's points under several `max_windows` and `agreement`.
A cycle is false where a much finer run (160 windows, 2e-5) finds none, or one with an
amplitude that differs by more than 1 %. Prints one JSON line a setting; two minutes.

    python benchmarks/a4_settling.py [--points 10000]
"""

import argparse
import json

import numpy as np
from measure import commit, rounded

import ziegler_jax as zj
from ziegler_jax.__main__ import POINTS, SETTLE, grid, point

FINEST = (160, 2e-5)
SETTINGS = (FINEST, (10, 1e-3), (40, 1e-3), (40, 2e-4), (40, 5e-5))


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--points", type=int, default=10_000)
    options = parser.parse_args()
    zj.configure_cpu()
    q, mu = grid(POINTS)
    shape = (q.size, mu.size, mu.size)
    chosen = np.random.default_rng(1).random(shape) < options.points / POINTS
    truth = None
    for max_windows, agreement in SETTINGS:
        SETTLE["windows"] = zj.Windows(100, 40, max_windows, agreement)
        SETTLE["certify"] = False
        ds = zj.sweep(
            point,
            where=lambda q, mu_s, mu_k: chosen & (mu_k <= mu_s),
            q=q,
            mu_s=mu,
            mu_k=mu,
        )
        truth = ds if truth is None else truth
        cycles = ds.outcome == zj.CODE.repeats
        apart = abs(ds.joint_amplitude - truth.joint_amplitude).max("joint")
        confirmed = (truth.outcome == zj.CODE.repeats) & (
            apart <= 0.01 * truth.joint_amplitude.max("joint")
        )
        points = int((ds.outcome != zj.CODE.not_computed).sum())
        result = {
            "benchmark": "a4_settling",
            "commit": commit(),
            "points": points,
            "max_windows": max_windows,
            "agreement": agreement,
            "unsettled": float((ds.outcome == zj.CODE.unsettled).sum()) / points,
            "cycles": float(cycles.sum()) / points,
            "false_cycles": float((cycles & ~confirmed).sum()) / points,
            "steps_a_point": float(ds.steps.sum()) / points,
        }
        print(json.dumps(rounded(result)), flush=True)


if __name__ == "__main__":
    main()
