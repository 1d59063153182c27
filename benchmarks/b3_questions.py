"""Questions of more than one motion, and of long ones, over cells of the main map.

At random cells of the main job's map: `settle` alone; `settle`, then `periodic_orbit`
from where it ended, certified or not, stuck lanes included; `lyapunov_exponents`;
`settle` with the exponents of what has not settled. Seconds without compiling, seconds
to trace and compile, the share of useful steps, and how they ended. Prints one JSON
line; writes `results/b3_questions.json`. Some three minutes.

    python benchmarks/b3_questions.py [--cells 8192] [--seed 17]
"""

import argparse
import json

import jax.numpy as jnp
import numpy as np
from measure import machine, rounded, save

import ziegler_jax as zj
from ziegler_jax import __main__ as job

zj.configure_cpu()


def cells(count, seed):
    """Random ones: load, static and kinetic friction."""
    q, mu = job.grid(105_780)
    static, kinetic = np.tril_indices(mu.size)
    rng = np.random.default_rng(seed)
    rows = rng.integers(static.size, size=count)
    return q[rng.integers(q.size, size=count)], mu[static[rows]], mu[kinetic[rows]]


def questions(table):
    """Points of a sweep over the cells' numbers."""
    start = zj.State(omega=job.KICK)

    def column(cell):
        i = cell.astype(int)
        q, mu_s, mu_k = (jnp.asarray(x)[i] for x in table)
        friction = zj.SmoothCoulomb(
            mu_s,
            mu_k,
            pin_radius=job.PIN_RADIUS,
            v_stribeck=job.V_STRIBECK,
            v_smooth=mu_s * job.PIN_RADIUS * q / job.DAMPING_AT_REST,
        )
        return zj.uniform_rods(q=q, friction=friction)

    def settled(cell):
        return zj.settle(column(cell), start, **job.SETTLE, certify=False)

    def closed(cell):
        motion = settled(cell)
        orbit = zj.periodic_orbit(
            column(cell), motion.final, method=zj.Method(rtol=1e-8, atol=1e-8)
        )
        return {
            "outcome": motion.outcome,
            "orbit": orbit.outcome,
            "steps": orbit.steps,
            "amplitude": orbit.joint_amplitude[1] / motion.joint_amplitude[1],
        }

    def exponents(cell):
        return zj.lyapunov_exponents(column(cell), start)

    def judged(cell):
        return zj.settle(column(cell), start, exponents=2)

    return {
        "settle": (settled, 1.0, "outcome"),
        "settle and periodic_orbit": (closed, 1.0, "orbit"),
        "lyapunov_exponents": (exponents, 0.5, "outcome"),
        "kind": (judged, 0.5, "kind"),
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--cells", type=int, default=8192)
    parser.add_argument("--seed", type=int, default=17)
    arguments = parser.parse_args()
    table = cells(arguments.cells, arguments.seed)
    result = {"benchmark": "b3", **machine(), "cells": arguments.cells}
    for name, (point, share, code) in questions(table).items():
        axis = np.arange(float(int(share * arguments.cells)))
        ds = zj.sweep(point, cell=axis, progress=False)
        ends = np.unique(ds[code].values.astype(int), return_counts=True)
        pairs = zip(*ends, strict=True)
        result[name] = {
            "cells": axis.size,
            "compile_seconds": ds.attrs["compile_seconds"],
            "run_seconds": ds.attrs["run_seconds"],
            "useful_step_fraction": ds.attrs["useful_step_fraction"],
            "ended": {zj.CODE(int(n)).name: int(c) for n, c in pairs},
        }
        print(name, rounded(result[name]), flush=True)
    both, alone = result["settle and periodic_orbit"], result["settle"]
    result["orbit_over_settle"] = both["run_seconds"] / alone["run_seconds"]
    print(json.dumps(rounded(result)))
    save("b3_questions", result)


if __name__ == "__main__":
    main()
