"""Curves of folds over friction: how many points, how exact, in which time.

Uniform rods with set-valued friction, equal torques tau from 0.0025 to 0.3 in both
joints, as in `figures/bifurcation_curves.py`: each fold of four branches is followed
through both parameters; points are spread evenly, and once more put at known folds,
which another code gave to five digits. Prints one JSON line a curve and one for all.

    python benchmarks/a12_fold_curves.py [--points 334]
"""

import argparse
import json
import time

import jax
import jax.numpy as jnp
import numpy as np
from measure import machine, rounded
from ours import dry

import ziegler_jax as zj

TAU = (0.0025, 0.3)
CURVES = {"lowest": (0.03, 0), "upper": (0.1, 0), "way": (0.1, 1), "other": (0.2, 0)}
KNOWN = [  # torque, curve, load
    (0.01, "lowest", 1.28802),
    (0.03, "lowest", 1.32807),
    (0.1, "upper", 1.57105),
    (0.1, "other", 1.61206),
    (0.26, "other", 1.86140),
]


def compiled(course):
    """From a torque and a fold's place down the branch to its curve, compiled."""

    def follow(tau, which):
        kick = zj.State(omega=(0.0, 3.0))
        settled = zj.settle(dry(1.95, tau), kick, certify=False)
        orbit = zj.periodic_orbit(dry(1.95, tau), settled.final)
        arc = zj.Arc(direction=-1, bounds=(1.2, 2.0))
        branch = zj.continue_cycle(lambda q: dry(q, tau), orbit, 1.95, arc=arc)
        start = jax.tree.map(lambda x: jnp.roll(x, -which, axis=0), branch.special)
        return zj.bifurcation_curve(dry, "fold", start, second=tau, course=course)

    start = time.process_time()
    program = jax.jit(follow).lower(0.1, 0).compile()
    return program, time.process_time() - start


def run(follow):
    """The curves, one after the other, and seconds of each from its branch on."""
    curves, seconds = {}, {}
    for name, start in CURVES.items():
        begin = time.perf_counter()
        curves[name] = jax.tree.map(np.asarray, follow(*start))
        seconds[name] = time.perf_counter() - begin
    return curves, seconds


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--points", type=int, default=334)
    points = parser.parse_args().points
    jax.config.update("jax_enable_x64", True)
    zj.configure_cpu()
    follow, compiling = compiled(zj.Course(points=points, second=TAU))
    curves, seconds = run(follow)
    for name, curve in curves.items():
        there = np.isfinite(curve.points.first)
        line = {
            "curve": name,
            "points": int(there.sum()),
            "residual": float(curve.points.residual[there].max()),
            "ends": [zj.CODE(int(end)).name for end in curve.ends],
            "torque": [float(x) for x in curve.points.second[there][[0, -1]]],
            "load": [float(x) for x in curve.points.first[there][[0, -1]]],
            "seconds": seconds[name],
        }
        print(json.dumps(rounded(line, 7)), flush=True)
    values = sorted({tau for tau, _, _ in KNOWN})
    exact, _ = compiled(zj.Course(values=np.array(values), second=TAU))
    at, _ = run(exact)
    apart = {
        f"{known} at {tau}": float(
            abs(at[name].points.first[values.index(tau)] - known)
        )
        for tau, name, known in KNOWN
    }
    there = [np.isfinite(curve.points.first) for curve in curves.values()]
    result = {
        "benchmark": "a12_fold_curves",
        **machine(),
        "points": int(sum(one.sum() for one in there)),
        "compile_cpu_seconds": compiling,
        "seconds": sum(seconds.values()),
        "load_differs_by": apart,
    }
    print(json.dumps(rounded(result)))


if __name__ == "__main__":
    main()
