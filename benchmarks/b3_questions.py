"""Questions about cells of the main map: their costs, and how they end.

At random cells of the main job's map, or at all of them (`--cells 0`): `settle` by
windows, with `StickFraction`; the same with no observer, and with another one; a fixed
span, and a forward derivative of its end by the load; `settle` with certificates;
`settle` by windows, then `periodic_orbit` from where it ended, certified or not, stuck
lanes included; `lyapunov_exponents`; `settle` with the exponents of what has not
settled; certificates under dry friction, and where its outcomes differ. For each:
seconds to trace and compile, seconds of the runs, taken in turns, over those of
windows, steps (one with three tangents counts as four), the share of useful steps, and
the endings. Prints one JSON line a question; some four minutes.

    python benchmarks/b3_questions.py [--cells 8192] [--seed 17] [--repeats 3]
        [--only windows certified]
"""

import jax
import jax.numpy as jnp
import numpy as np
from measure import arguments, paired, report

import ziegler_jax as zj
from ziegler_jax import __main__ as job

OBSERVERS = (zj.Mean, zj.Period, zj.EnergyBalance)


def cells(count, seed):
    """Random ones, or all: load, static and kinetic friction."""
    q, mu = job.grid(105_780)
    static, kinetic = np.tril_indices(mu.size)
    if not count:
        rows = np.tile(np.arange(static.size), q.size)
        return np.repeat(q, static.size), mu[static[rows]], mu[kinetic[rows]]
    rng = np.random.default_rng(seed)
    rows = rng.integers(static.size, size=count)
    return q[rng.integers(q.size, size=count)], mu[static[rows]], mu[kinetic[rows]]


def questions(table):
    """Points of a sweep over the cells' numbers."""
    start = zj.State(omega=job.KICK)

    def numbers(cell):
        return [jnp.asarray(x)[cell.astype(int)] for x in table]

    def column(cell):
        q, mu_s, mu_k = numbers(cell)
        friction = zj.SmoothCoulomb(
            mu_s,
            mu_k,
            pin_radius=job.PIN_RADIUS,
            v_stribeck=job.V_STRIBECK,
            v_smooth=mu_s * job.PIN_RADIUS * q / job.DAMPING_AT_REST,
        )
        return zj.uniform_rods(q=q, friction=friction)

    def settled(cell):
        return job.point(*numbers(cell), certify=False)

    def watched(*observers):
        return lambda cell: job.point(
            *numbers(cell), certify=False, observers=observers
        )

    def span(cell, more=0.0):
        """A fixed one, with a load that is more."""
        q, *mu = numbers(cell)
        options = {"windows": zj.Windows(80.0, 40.0, 1), "certify": False}
        return job.point(q + more, *mu, **options).final.phi[1]

    def derivative(cell):
        value, slope = jax.jvp(lambda more: span(cell, more), (0.0,), (1.0,))
        return {"value": value, "slope": slope}

    def closed(cell):
        method = zj.Method(rtol=1e-8, atol=1e-8)
        orbit = zj.periodic_orbit(column(cell), settled(cell).final, method=method)
        return {"orbit": orbit.outcome, "steps": orbit.steps}

    return {
        "windows": settled,
        "no observer": watched(),
        **{observer.__name__: watched(observer()) for observer in OBSERVERS},
        "span": lambda cell: {"phi_2": span(cell)},
        "derivative": derivative,
        "certified": lambda cell: job.point(*numbers(cell)),
        "dry": lambda cell: job.point(*numbers(cell), law="dry"),
        "windows and periodic_orbit": closed,
        "lyapunov_exponents": lambda cell: zj.lyapunov_exponents(column(cell), start),
        "kind": lambda cell: zj.settle(column(cell), start, exponents=2),
    }


ENDINGS = {"windows and periodic_orbit": "orbit", "kind": "kind"}
LONG = ("lyapunov_exponents", "kind")  # they are asked of half of the cells


def about(name, runs, first):
    """The numbers of one question, the first run compiled apart."""
    ds = runs[-1]
    seconds = [one.attrs["run_seconds"] for one in runs]
    ratio, spread = paired(seconds, first) if name not in LONG else (None, None)
    result = {
        "cells": ds.sizes["cell"],
        "compile_seconds": runs[0].attrs["compile_seconds"],
        "run_seconds": float(np.median(seconds)),
        "over_windows": ratio,
        "over_windows_range": spread,
        "useful_step_fraction": ds.attrs["useful_step_fraction"],
    }
    if "steps" in ds:
        tangents = 3 * ds.shot_steps if "shot_steps" in ds else 0
        result["steps_a_cell"] = float((ds.steps + tangents).mean())
    code = ds.get(ENDINGS.get(name, "outcome"))
    if code is not None:
        ends = zip(*np.unique(code.values, return_counts=True), strict=True)
        result["ended"] = {zj.CODE(int(n)).name: int(c) for n, c in ends}
    return result


def laws_differ(table, smoothed, dry):
    """Where outcomes differ: shares of cells, by the ratio of the coefficients."""
    _, mu_s, mu_k = table
    one, two = smoothed.outcome.values, dry.outcome.values
    differ, ratio = one != two, mu_k / mu_s
    parts = {
        "all": ratio > 0,
        "equal": mu_k == mu_s,
        "at least 0.8": ratio >= 0.8,
        "0.45 to 0.55": (ratio > 0.45) & (ratio < 0.55),
        "below 0.1": ratio < 0.1,
    }
    left = dry.undecided.values[two == zj.CODE.unsettled]
    near = np.isin(left, (zj.CODE.unstable_near, zj.CODE.growing))
    alone = (one == zj.CODE.stuck)[differ]
    return {
        "cells": differ.size,
        "differ": {k: float(differ[x].mean()) for k, x in parts.items() if x.any()},
        "of_these_stuck_under_the_smoothed_law": float(alone.mean()),
        "unsettled": [float((x == zj.CODE.unsettled).mean()) for x in (one, two)],
        "of_dry_unsettled_near_or_growing": float(near.mean()),
    }


def main():
    options = arguments(__doc__, cells=8192, seed=17, repeats=3, only=("",))
    zj.configure_cpu()
    table = cells(options.cells, options.seed)
    count, runs = len(table[0]), {}
    asked = {
        name: point
        for name, point in questions(table).items()
        if name == "windows" or name.startswith(tuple(options.only))
    }
    for _ in range(options.repeats):
        for name, point in asked.items():
            axis = np.arange(float(count // 2 if name in LONG else count))
            ds = zj.sweep(point, cell=axis, progress=False)
            runs.setdefault(name, []).append(ds)
    first = [ds.attrs["run_seconds"] for ds in runs["windows"]]
    for name in asked:
        report("b3_questions", question=name, **about(name, runs[name], first))
    if {"certified", "dry"} <= asked.keys():
        pair = runs["certified"][-1], runs["dry"][-1]
        report("b3_questions", question="both laws", **laws_differ(table, *pair))


if __name__ == "__main__":
    main()
