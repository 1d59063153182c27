"""Seconds of the scenes that `guard.py --times` compares, each in a fresh process."""

import numpy as np
from guard_lines import UNIT, scene_of_the_main_job

import ziegler_jax as zj

Q = np.linspace(2, 4, 8192)


def one_window(law):
    """`a0_throughput`'s lane."""

    def point(q):
        return zj.settle(
            zj.uniform_rods(q=q, friction=law),
            zj.State(omega=(0.0, 0.2)),
            windows=zj.Windows(transient=80.0, length=20.0, max_windows=1),
            certify=False,
        )

    return point


def smooth():
    law = zj.SmoothCoulomb(
        0.012, 0.010, pin_radius=1.0, v_stribeck=0.05, v_smooth=0.01, load=UNIT
    )
    point = one_window(law)
    return lambda: zj.sweep(point, q=Q, progress=False)


def frictionless():
    point = one_window(None)
    return lambda: zj.sweep(point, q=Q, progress=False)


def set_valued_map():
    """`a3_friction`'s map."""
    _, pin, kick, settle = scene_of_the_main_job()

    def point(q, mu):
        column = zj.uniform_rods(q=q, friction=zj.SetValuedCoulomb(mu, **pin))
        return zj.settle(column, zj.State(omega=kick), **settle, certify=False)

    axes = {"q": np.linspace(1, 4, 97), "mu": np.linspace(0.02, 0.4, 40)}
    return lambda: zj.sweep(point, progress=False, **axes)


def main_job():
    from ziegler_jax import __main__ as job

    q, mu = job.grid(20_000)
    return lambda: zj.sweep(
        job.point, where=lambda mu_s, mu_k, q: mu_k <= mu_s, q=q, mu_s=mu, mu_k=mu,
        progress=False,
    )  # fmt: skip


SCENES = {
    "a0, smooth": smooth,
    "a0, frictionless": frictionless,
    "a3's map": set_valued_map,
    "main job, 20000 points": main_job,
}


def measured(zj, name):
    """Seconds to compile, and of a sweep whose program is compiled."""
    run = SCENES[name]()
    compiling = run().attrs["compile_seconds"]
    return {"compile": compiling, "run": run().attrs["run_seconds"]}
