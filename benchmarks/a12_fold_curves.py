"""Curves of folds over friction: how many points, how exact, in which time.

Uniform rods with set-valued friction, equal torques tau from 0.0025 to 0.3 in both
joints, as in `figures/bifurcation_curves.py`: each fold of four branches is followed
through both parameters, its points spread evenly. Prints one JSON line a curve and one
for all.

    python benchmarks/a12_fold_curves.py [--points 334]
"""

import time

import jax
import jax.numpy as jnp
import numpy as np
from measure import arguments, report
from ours import dry

import ziegler_jax as zj

TAU = (0.0025, 0.3)
CURVES = {"lowest": (0.03, 0), "upper": (0.1, 0), "way": (0.1, 1), "other": (0.2, 0)}


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
    points = arguments(__doc__, points=334).points
    jax.config.update("jax_enable_x64", True)
    zj.configure_cpu()
    follow, compiling = compiled(zj.Course(points=points, second=TAU))
    curves, seconds = run(follow)
    count = 0
    for name, curve in curves.items():
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
            seconds=seconds[name],
        )
    total = {"points": count, "seconds": sum(seconds.values())}
    report("a12_fold_curves", **total, compile_cpu_seconds=compiling)


if __name__ == "__main__":
    main()
