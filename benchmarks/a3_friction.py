"""Set-valued against smoothed friction: cost a lane, and cost at a given error.

First a map of the main job's scene with mu_s = mu_k: seconds of set-valued lanes
against smoothed ones. Then friction cycles (tau = 0.026, q = 2.4..2.8): the largest
error of the amplitudes of both rods and joint 2, against the set-valued law at 1e-10,
and what it costs. The smoothed law's error goes with v_smooth; it is run at tolerances
that add little to it. Prints one JSON line; about two minutes.

    python benchmarks/a3_friction.py [--repeats 3]
"""

import argparse
import json

import numpy as np
from measure import interleaved, machine, paired, rounded

import ziegler_jax as zj
from ziegler_jax.__main__ import KICK, PIN_RADIUS, SETTLE

TARGET = 1e-4
EXACT = ("exact", None, 1e-10)
SMOOTHED = ((1e-2, 1e-6), (1e-3, 1e-6), (3e-4, 1e-8), (1e-4, 1e-8), (3e-5, 1e-8))
# name, v_smooth (None: set-valued), tolerance
CONTESTANTS = [
    *(
        (f"set-valued, {tol:g}", None, tol)
        for tol in (1e-4, 3e-5, 2e-5, 1e-5, 1e-6, 1e-7)
    ),
    *((f"smoothed {v:g}, {tol:g}", v, tol) for v, tol in SMOOTHED),
]


def law(mu, v_smooth, **parts):
    if v_smooth is None:
        return zj.SetValuedCoulomb(mu, **parts)
    return zj.SmoothCoulomb(mu, v_smooth=v_smooth, **parts)


def map_point(v_smooth):
    def point(q, mu):
        friction = law(mu, v_smooth, pin_radius=PIN_RADIUS)
        column = zj.uniform_rods(q=q, friction=friction)
        return zj.settle(column, zj.State(omega=KICK), **SETTLE)

    return point


def cycle_point(v_smooth, tol):
    def point(q):
        load = zj.ConstantLoad(1.0)
        friction = law(0.026, v_smooth, pin_radius=1.0, load=load)
        column = zj.uniform_rods(q=q, friction=friction)
        options = {"transient": 200.0, "window": 40.0, "max_windows": 1}
        start = zj.State(omega=(0.0, 0.2))
        return zj.settle(
            column, start, rtol=tol, atol=tol, max_steps=10_000_000, **options
        )

    return point


def amplitudes(ds):
    knee = ds.joint_amplitude.sel(joint=[2]).values
    return np.concatenate([ds.rod_amplitude.values, knee], axis=-1)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--repeats", type=int, default=3)
    repeats = parser.parse_args().repeats
    zj.configure_cpu()

    axes = {"q": np.linspace(1, 4, 97), "mu": np.linspace(0.02, 0.4, 40)}
    points = {v: map_point(v) for v in (None, 1e-2, 1e-3)}
    runs = {
        v: lambda p=p: zj.sweep(p, progress=False, **axes) for v, p in points.items()
    }
    seconds = interleaved(runs, repeats)
    to_1e2, range_1e2 = paired(seconds[None], seconds[1e-2])
    to_1e3, range_1e3 = paired(seconds[None], seconds[1e-3])

    q = np.linspace(2.4, 2.8, 2048)  # a sweep's own cost is spread over them
    found = {}

    def runner(name, v_smooth, tol):
        point = cycle_point(v_smooth, tol)

        def run():
            found[name] = zj.sweep(point, q=q, progress=False)

        return run

    runner(*EXACT)()
    truth = amplitudes(found["exact"])
    cost = interleaved({c[0]: runner(*c) for c in CONTESTANTS}, repeats)
    table, cheapest = {}, {"set-valued": [], "smoothed": []}
    for name, v_smooth, _ in CONTESTANTS:
        error = float(np.abs(amplitudes(found[name]) - truth).max())
        micro = float(np.median(cost[name])) / q.size * 1e6
        table[name] = {"error": error, "microseconds_a_lane": micro}
        if error <= TARGET:
            kind = "set-valued" if v_smooth is None else "smoothed"
            cheapest[kind].append(micro)
    best = {kind: min(costs, default=None) for kind, costs in cheapest.items()}
    mine, theirs = best["set-valued"], best["smoothed"]
    result = {
        "benchmark": "a3_friction",
        "seconds_a_map": {str(v): float(np.median(s)) for v, s in seconds.items()},
        "set_valued_over_smoothed_0.01": to_1e2,
        "set_valued_over_smoothed_0.01_range": range_1e2,
        "set_valued_over_smoothed_0.001": to_1e3,
        "set_valued_over_smoothed_0.001_range": range_1e3,
        "cycles": table,
        "target_error": TARGET,
        "microseconds_to_target": best,
        "smoothed_over_set_valued_at_target": theirs / mine
        if theirs and mine
        else None,
        **machine(),
    }
    print(json.dumps(rounded(result)))


if __name__ == "__main__":
    main()
