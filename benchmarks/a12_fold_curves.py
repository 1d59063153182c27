"""Curves of folds over friction: how many points, how exact, in which time.

Uniform rods with set-valued friction, equal torques tau from 0.0025 to 0.3 in both
joints, as in `figures/bifurcation_curves.py`: each fold of four branches is followed
through both parameters, its points spread evenly. Prints one JSON line a curve and one
for all.

    python benchmarks/a12_fold_curves.py [--points 334]
"""

import functools
import time

import jax
import jax.numpy as jnp
import numpy as np
from measure import arguments, report
from ours import dry

import ziegler_jax as zj

TAU = (0.0025, 0.3)
CURVES = {"lowest": (0.03, 0), "upper": (0.1, 0), "way": (0.1, 1), "other": (0.2, 0)}


def follow(tau, which, points):
    """From a torque and a fold's place down the branch to its curve."""
    settled = zj.settle(dry(1.95, tau), zj.State(omega=(0.0, 3.0)), certify=False)
    orbit = zj.periodic_orbit(dry(1.95, tau), settled.final)
    arc = zj.Arc(direction=-1, bounds=(1.2, 2.0))
    branch = zj.continue_cycle(lambda q: dry(q, tau), orbit, 1.95, arc=arc)
    start = jax.tree.map(lambda x: jnp.roll(x, -which, axis=0), branch.special)
    course = zj.Course(points=points, second=TAU)
    return zj.bifurcation_curve(dry, "fold", start, second=tau, course=course)


def main():
    points = arguments(__doc__, points=334).points
    jax.config.update("jax_enable_x64", True)
    zj.configure_cpu()
    begun = time.process_time()
    program = jax.jit(functools.partial(follow, points=points)).lower(0.1, 0).compile()
    compiling, seconds, count = time.process_time() - begun, [], 0
    for name, start in CURVES.items():
        begun = time.perf_counter()
        curve = jax.tree.map(np.asarray, program(*start))
        seconds.append(time.perf_counter() - begun)
        there = np.isfinite(curve.points.first)
        count += int(there.sum())
        report(
            "a12_fold_curves",
            digits=7,
            about=dict,
            curve=name,
            points=int(there.sum()),
            residual=float(curve.points.residual[there].max()),
            ends=[zj.CODE(int(end)).name for end in curve.ends],
            torque=curve.points.second[there][[0, -1]].tolist(),
            load=curve.points.first[there][[0, -1]].tolist(),
            seconds=seconds[-1],
        )
    total = {"points": count, "seconds": sum(seconds)}
    report("a12_fold_curves", **total, compile_cpu_seconds=compiling)


if __name__ == "__main__":
    main()
