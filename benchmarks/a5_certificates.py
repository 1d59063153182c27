"""Are certified cycles cycles? Each is followed on by a code that shares nothing.

Random cells of the main job's map, and loads between the last stuck and the first
moving one of random rows. From where a certified motion ended it is continued, in C++
at 1e-9, for 400 time units and 20 periods at least, 1500 where its multiplier is above
0.95. A certificate is false where a rod's or a joint's amplitude over the last two
periods is off by more than 1 % of the largest. Prints one JSON line a sample.

Besides, of a sample of cells: how many settle elsewhere at a tolerance of 1e-8, and how
many of these `Growth()` calls sensitive.

    python benchmarks/a5_certificates.py [--cells 13500] [--beside 1000] [--again 8000]
        [--seed 0] [--law dry]

`--law dry`: the same cells with `SetValuedCoulomb`, and what windows cost and decide.
"""

import argparse
import json

import jax
import jax.numpy as jnp
import numpy as np
from measure import commit, rounded
from peers.judge import follow

import ziegler_jax as zj
from ziegler_jax.__main__ import (
    DAMPING_AT_REST,
    KICK,
    LATE,
    PIN_RADIUS,
    POINTS,
    Q_RANGE,
    Q_VALUES,
    SETTLE,
    V_STRIBECK,
    grid,
    point,
)

KINDS = tuple(
    zj.CODE[word]
    for word in "no_passages unstable_near slow aperiodic growing lasting".split()
)
SPAN, PERIODS, SLOW, SLOW_SPAN = 400.0, 20, 0.95, 1500.0
TOLERANCE, OFF = 1e-9, 0.01


def dry(q, mu_s, mu_k, **options):
    """The main job's column with dry friction."""
    law = zj.SetValuedCoulomb(mu_s, mu_k, pin_radius=PIN_RADIUS)
    column = zj.uniform_rods(q=q, friction=law)
    return zj.settle(column, zj.State(omega=KICK), **{**SETTLE, **options})


def settled(cells, point=point, **options):
    """The main job's point at cells (n, 3) of q, mu_s, mu_k, with its last state."""
    table = jnp.asarray(cells)

    def at(cell):
        q, mu_s, mu_k = table[cell.astype(int)]
        result = point(q, mu_s, mu_k, **options)
        state = zj.Variable(jnp.stack(result.final.y), "state", dims=("i",))
        return {**result.variables(), "state": state}

    return zj.sweep(at, cell=np.arange(len(cells)))


def columns(cells, point=point):
    q, mu_s, mu_k = cells.T
    tau_s, tau_k = mu_s * PIN_RADIUS * q, mu_k * PIN_RADIUS * q
    smooth = 0.0 * tau_s if point is dry else tau_s / DAMPING_AT_REST
    return np.stack([q, tau_s, tau_k, np.full_like(q, V_STRIBECK), smooth], axis=1)


def judged(cells, ds, point=point):
    """By how much each certified amplitude is off after the continuation."""
    closed = np.flatnonzero(ds.outcome == zj.CODE.cycle)
    some = ds.isel(cell=closed)
    period = some.period.values
    spans = np.maximum(SPAN, PERIODS * period)
    slow = some.largest_multiplier.values > SLOW
    spans = np.where(slow, np.maximum(spans, SLOW_SPAN), spans)
    found, _ = follow(
        columns(cells[closed], point), some.state.values, spans, 2 * period, TOLERANCE
    )
    said = np.stack(
        [*some.rod_amplitude.values.T, some.joint_amplitude.values[:, 1]], axis=1
    )
    return closed, np.abs(said - found).max(axis=1) / found.max(axis=1)


def cells_of_the_map(count, source):
    q, mu = grid(POINTS)
    every = np.argwhere(np.tri(mu.size, dtype=bool))
    rows = every[source.integers(len(every), size=count)]
    return np.stack(
        [q[source.integers(q.size, size=count)], mu[rows[:, 0]], mu[rows[:, 1]]], axis=1
    )


def cells_beside_thresholds(count, source, point=point):
    """Four loads a row, from a cell below the last stuck one to one above the first."""
    cells, q = [], np.linspace(*Q_RANGE, Q_VALUES)
    while len(cells) < count:
        rows = np.sort(source.uniform(0.02, 0.4, (64, 2)), axis=1)[:, ::-1]
        every = np.array([(x, *row) for row in rows for x in q])
        outcome = settled(every, point).outcome.values.reshape(len(rows), q.size)
        for row, codes in zip(rows, outcome, strict=True):
            moves = np.flatnonzero(codes == zj.CODE.cycle)
            stuck = np.flatnonzero(codes == zj.CODE.stuck)
            if moves.size and stuck.size:
                low, high = sorted((q[stuck[-1]], q[moves[0]]))
                step = q[1] - q[0]
                cells += [(x, *row) for x in source.uniform(low - step, high + step, 4)]
    return np.array(cells[:count])


def report(sample, cells, point=point):
    ds = settled(cells, point)
    closed, off = judged(cells, ds, point)
    outcome, kinds = ds.outcome.values, ds.undecided.values
    false = closed[~(off <= OFF)]
    result = {
        "benchmark": "a5_certificates",
        "commit": commit(),
        "sample": sample,
        "points": len(cells),
        "certified": closed.size,
        "false": false.size,
        "false_cells": cells[false].tolist(),
        "amplitude_off_median": float(np.median(off)),
        "amplitude_off_largest": float(off.max()),
        "stuck": int((outcome == zj.CODE.stuck).sum()),
        "undecided": {k.name: int((kinds == k).sum()) for k in KINDS},
        "steps": float(ds.steps.mean()),
        "steps_with_tangents": float((ds.steps + 3 * ds.shot_steps).mean()),
    }
    if point is dry:
        windows = settled(cells, point, certify=False)
        unsettled = windows.outcome.values == zj.CODE.unsettled
        result |= {
            "steps_by_windows": float(windows.steps.mean()),
            "unsettled_by_windows": int(unsettled.sum()),
        }
    print(json.dumps(rounded(result)), flush=True)


def report_sensitive(sample, cells, rtol, point=point):
    """Which ends change at a finer tolerance: by outcome, or amplitudes by 1 %."""
    table = jnp.asarray(cells)

    def at(cell, observers, method):
        numbers = table[cell.astype(int)]
        return point(*numbers, observers=observers, method=method)

    axis = np.arange(len(cells))
    usual = zj.sweep(lambda cell: at(cell, (zj.Growth(),), zj.Method()), cell=axis)
    fine = zj.sweep(lambda cell: at(cell, (), zj.Method(rtol=rtol)), cell=axis)
    ends, others = usual.outcome.values, fine.outcome.values
    settled = [zj.CODE.cycle, zj.CODE.stuck]
    both = np.isin(ends, settled) & np.isin(others, settled)
    closed = both & (ends == zj.CODE.cycle) & (others == ends)
    off = np.abs(usual.joint_amplitude - fine.joint_amplitude).max("joint").values
    off = off > OFF * usual.joint_amplitude.max("joint").values
    changed = both & ((ends != others) | (closed & off))
    sensitive = usual.sensitive.values == 1
    late = (usual.time.values > LATE) & np.isin(ends, settled)
    cycles = ends == zj.CODE.cycle
    result = {
        "benchmark": "a5_certificates",
        "commit": commit(),
        "sample": sample,
        "points": len(cells),
        "finer_tolerance": rtol,
        "settled_twice": int(both.sum()),
        "changed": int(changed.sum()),
        "changed_and_sensitive": int((changed & sensitive).sum()),
        "growths_of_changed": np.sort(usual.growth.values[changed]).tolist(),
        "settled_and_sensitive": int((both & sensitive).sum()),
        "changed_and_late": int((changed & late).sum()),
        "late": int(late.sum()),
        "cycles": int(cycles.sum()),
        "sensitive_cycles": int((cycles & sensitive).sum()),
    }
    print(json.dumps(rounded(result)), flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--cells", type=int, default=13_500)
    parser.add_argument("--beside", type=int, default=1000)
    parser.add_argument("--again", type=int, default=8000)
    parser.add_argument("--again-beside", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--law", choices=("smooth", "dry"), default="smooth")
    options = parser.parse_args()
    zj.configure_cpu()
    jax.config.update("jax_enable_x64", True)  # for tables of cells
    source = np.random.default_rng(options.seed)
    law = dry if options.law == "dry" else point
    if options.cells:
        report("map", cells_of_the_map(options.cells, source), law)
    if options.beside:
        beside = cells_beside_thresholds(options.beside, source, law)
        report("thresholds", beside, law)
    if options.again:
        cells = cells_of_the_map(options.again, source)
        report_sensitive("sensitive", cells, 1e-8, law)
    if options.again_beside:
        beside = cells_beside_thresholds(options.again_beside, source, law)
        report_sensitive("sensitive beside thresholds", beside, 1e-10, law)


if __name__ == "__main__":
    main()
