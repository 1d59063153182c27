"""What a first call costs: tracing and compiling, scene by scene, and a small sweep.

Each of a few processes traces a scene and compiles its programs one after the other:
processor seconds, medians, beside those of a loop in Python, as they follow the hour of
a machine that others use. Then one first call of `sweep`, of four points, with JAX's
cache empty, and one of the next process, which finds there what took more than half a
second to compile. Last, for two of the scenes, the microseconds of a lane in sweeps of
64 that were compiled before, with tracing and without. Imports are not timed. Prints
one JSON line a scene; about three minutes.

    python benchmarks/b4_first_call.py [--processes 5] [--scenes one_window ...]
"""

import json
import os
import subprocess
import sys
import tempfile
import time

import jax
import numpy as np
from measure import arguments, report

import ziegler_jax as zj
from ziegler_jax.__main__ import point
from ziegler_jax.sweep.program import lowered, own_flags, traced

ONE_WINDOW = zj.Windows(transient=100, length=40, max_windows=1)
START = zj.State(omega=(0.0, 0.3))
Q, MU = np.linspace(1.8, 3.5, 8), np.linspace(0.1, 0.4, 8)
REPEATS = 9


def one_window(q, mu):
    return point(q, mu, 0.8 * mu, certify=False, windows=ONE_WINDOW)


def certified_map(q, mu):
    return point(q, mu, 0.8 * mu)


def verdict_map(q, mu):
    friction = zj.SmoothCoulomb(
        mu, 0.8 * mu, pin_radius=0.05, v_stribeck=0.1, v_smooth=0.01
    )
    return zj.settle(zj.uniform_rods(q, friction=friction), START, exponents=2)


def joint_reactions(q, mu):
    friction = zj.SetValuedCoulomb(
        mu, 0.8 * mu, pin_radius=0.05, load=zj.JointReaction()
    )
    return zj.settle(zj.uniform_rods(q, friction=friction), START)


SCENES = {
    f.__name__: f for f in (one_window, certified_map, verdict_map, joint_reactions)
}
SMALL = ("one_window", "certified_map")


def python_loop():
    """Processor seconds of ten million additions: a measure of the machine's hour."""
    start, total = time.process_time(), 0
    for i in range(10_000_000):
        total += i
    return time.process_time() - start


def compiling(scene):
    """Processor seconds to trace it, and to compile all its programs."""
    zj.configure_cpu()
    loop = python_loop()
    start = time.process_time()
    known = traced(SCENES[scene], ("q", "mu"), None)
    stages = [lowered(stage, known).lowered for stage in known.stages]
    middle = time.process_time()
    with own_flags(), jax.enable_x64(True):
        for stage in stages:
            stage.compile()
    seconds = {"trace": middle - start, "compile": time.process_time() - middle}
    return {**seconds, "python_loop": (loop + python_loop()) / 2}


def first_call(scene):
    """Seconds of a first sweep of four points, with the cache as it is."""
    zj.configure_cpu()
    zj.configure_cache(os.environ["JAX_COMPILATION_CACHE_DIR"])
    start = time.perf_counter()
    zj.sweep(SCENES[scene], q=Q[:2], mu=MU[:2], progress=False)
    return {"first_call": time.perf_counter() - start}


def small_sweep(scene):
    """Microseconds a lane of sweeps of 64, of the run and of the whole call."""
    zj.configure_cpu()
    run, whole = [], []
    for _ in range(1 + REPEATS):
        start = time.perf_counter()
        ds = zj.sweep(SCENES[scene], q=Q, mu=MU, progress=False)
        whole.append((time.perf_counter() - start) / 64e-6)
        run.append(ds.attrs["run_seconds"] / 64e-6)
    medians = (float(np.median(x[1:])) for x in (run, whole))
    return dict(zip(("run", "with_tracing"), medians, strict=True))


MEASURES = {f.__name__: f for f in (compiling, first_call, small_sweep)}


def alone(measure, scene, **environment):
    """What a measure gives in a process of its own."""
    command = [sys.executable, __file__, "--measure", measure, "--scenes", scene]
    own = {k: v for k, v in os.environ.items() if k != "JAX_COMPILATION_CACHE_DIR"}
    done = subprocess.run(
        command, stdout=subprocess.PIPE, text=True, check=True, env=own | environment
    )
    return json.loads(done.stdout)


def main():
    options = arguments(__doc__, processes=5, scenes=tuple(SCENES), measure="")
    if options.measure:  # one, in this process
        print(json.dumps(MEASURES[options.measure](*options.scenes)))
        return
    for scene in options.scenes:
        rows = [alone("compiling", scene) for _ in range(options.processes)]
        with tempfile.TemporaryDirectory() as folder:
            cache = {"JAX_COMPILATION_CACHE_DIR": folder}
            calls = [alone("first_call", scene, **cache) for _ in range(2)]
        small = alone("small_sweep", scene) if scene in SMALL else None
        report(
            "b4_first_call",
            scene=scene,
            processor_seconds={
                k: float(np.median([r[k] for r in rows])) for k in rows[0]
            },
            first_call_seconds={
                "cache_empty": calls[0]["first_call"],
                "cache_full": calls[1]["first_call"],
            },
            microseconds_of_64_lanes=small,
        )


if __name__ == "__main__":
    main()
