"""Are certified cycles cycles? Each is followed on by a code that shares nothing.

Random cells of the main job's map, and loads between the last stuck and the first
moving one of random rows. From where a certified motion ended it is continued, in C++
at 1e-9, as `follow_on.py` says. Prints one JSON line a sample.

Besides, of a fresh map: how many ends change at a tolerance of 1e-10, or are elsewhere
by the other code, followed from the kick, and what `follow_again` had said of these.

    python benchmarks/a5_certificates.py [--cells 13500] [--beside 1000]
        [--again 105780] [--seed 0] [--law dry]

`--law dry`: the same cells with `SetValuedCoulomb`, and what windows cost and decide.
"""

import functools

import jax
import numpy as np
from follow_on import (
    OFF,
    PERIODS,
    SPAN,
    certificates,
    swept,
    with_state,
)  # fmt: skip
from measure import arguments, clock, commit, report
from peers.judge import follow

import ziegler_jax as zj
from ziegler_jax import __main__ as job

TOLERANCE, FINEST, LONGEST = 1e-9, 1e-10, 1e4


def settled(cells, law, **options):
    """The main job's point at cells (n, 3) of q, mu_s, mu_k, with its last state."""
    return swept(cells, lambda cell: with_state(job.point(*cell, law=law, **options)))


def cells_of_the_map(count, source):
    q, mu = job.grid(job.POINTS)
    every = np.argwhere(np.tri(mu.size, dtype=bool))
    rows = every[source.integers(len(every), size=count)]
    loads = q[source.integers(q.size, size=count)]
    return np.stack([loads, mu[rows[:, 0]], mu[rows[:, 1]]], axis=1)


def cells_beside_thresholds(count, source, law="smoothed"):
    """Four loads a row, from a cell below the last stuck one to one above the first."""
    cells, q = [], np.linspace(*job.Q_RANGE, job.Q_VALUES)
    step = q[1] - q[0]
    while len(cells) < count:
        rows = np.sort(source.uniform(0.02, 0.4, (64, 2)), axis=1)[:, ::-1]
        every = np.array([(x, *row) for row in rows for x in q])
        outcome = settled(every, law).outcome.values.reshape(len(rows), q.size)
        for row, codes in zip(rows, outcome, strict=True):
            moves = np.flatnonzero(codes == zj.CODE.cycle)
            stuck = np.flatnonzero(codes == zj.CODE.stuck)
            if moves.size and stuck.size:
                low, high = sorted((q[stuck[-1]], q[moves[0]]))
                cells += [(x, *row) for x in source.uniform(low - step, high + step, 4)]
    return np.array(cells[:count])


def columns_of(cells, law):
    """What the judge takes of cells."""
    q, mu_s, mu_k = cells.T
    tau_s, tau_k = mu_s * job.PIN_RADIUS * q, mu_k * job.PIN_RADIUS * q
    v_smooth = 0.0 * tau_s if law == "dry" else tau_s / job.DAMPING_AT_REST
    v_stribeck = np.full_like(q, job.V_STRIBECK)
    return np.stack([q, tau_s, tau_k, v_stribeck, v_smooth], axis=1)


def by_another_code(cells, law):
    """How the judge follows certified cells on."""
    columns = columns_of(cells, law)
    return lambda closed, *rest: follow(columns[closed], *rest, TOLERANCE)[0]


def truth(cells, law):
    ds = settled(cells, law)
    result = certificates(cells, ds, by_another_code(cells, law))
    if law == "dry":
        windows = settled(cells, law, certify=False)
        unsettled = windows.outcome.values == zj.CODE.unsettled
        result["steps_by_windows"] = float(windows.steps.mean())
        result["unsettled_by_windows"] = int(unsettled.sum())
    return result


def elsewhere(cells, ds, law):
    """Which cells another code follows elsewhere, each from its kick, at 1e-10.

    That is for 400 time units after ours has settled, for 20 periods at least, and for
    as long as the largest multiplier takes to shrink what is left to 1e-8, at most for
    1e4: a slow cycle is reached late from a kick. A cycle ends otherwise where an
    amplitude over its last two periods is off by more than 1 % of the largest, rest
    where a rod still moves faster than 1e-3, or has moved by 0.02 in the last 20 time
    units: wherever it rests.
    """
    closed = ds.outcome.values == zj.CODE.cycle
    period = np.where(closed, ds.period.values, 10.0)
    multiplier = np.where(closed, ds.largest_multiplier.values, 0.0)
    periods = np.log(1e-8) / np.log(np.clip(multiplier, 0.1, 0.9999))
    spans = np.maximum(SPAN, np.maximum(PERIODS, periods) * period)
    spans = np.minimum(spans, np.maximum(LONGEST, PERIODS * period))
    start = np.tile([0.0, 0.0, *job.KICK], (len(cells), 1))
    amplitudes, states = follow(
        columns_of(cells, law), start, spans + ds.time.values, 2 * period, FINEST
    )
    joints = ds.joint_amplitude.values[:, 1:]
    ours = np.concatenate([ds.rod_amplitude.values, joints], axis=1)
    near = np.abs(ours - amplitudes).max(axis=1) <= OFF * amplitudes.max(axis=1)
    moved = np.abs(amplitudes[:, :2] - np.abs(states[:, :2])).max(axis=1)
    still = (np.abs(states[:, 2:]).max(axis=1) < 1e-3) & (moved < 0.02)
    return ~np.where(closed, near, still)


def followed_again(points, source, law):
    """A fresh map between the main job's cells, and what `follow_again` marks of it.

    Which ends change at 1e-10 over the whole map, which are unsettled there, and which
    another code finds elsewhere, of all beside another end and 2000 other ones.
    """
    q, mu = job.grid(points)
    q = q[:-1] + source.uniform() * np.diff(q)
    mu = mu[:-1] + source.uniform() * np.diff(mu)
    names = "q", "mu_s", "mu_k", "rtol"
    program = zj.Program(functools.partial(job.point, law=law), names=names)
    usual, finest = (
        zj.sweep(
            program, where=lambda mu_s, mu_k, **_: mu_k <= mu_s,
            q=q, mu_s=mu, mu_k=mu, rtol=rtol, progress=False,
        )
        for rtol in (job.RTOL, FINEST)
    )  # fmt: skip
    began = clock()
    ds = zj.follow_again(program, usual, rtol=job.FINER, late=job.LATE, progress=False)
    seconds = clock() - began
    ds, finest = (
        x.stack(place=names[:3]).transpose("place", ...) for x in (ds, finest)
    )
    again, ends, finer = ds.again.values, ds.outcome.values, finest.outcome.values
    settled = [zj.CODE.cycle, zj.CODE.stuck]
    both = np.isin(ends, settled) & np.isin(finer, settled)
    left = np.isin(ends, settled) & (finer == zj.CODE.unsettled)
    closed = both & (ends == zj.CODE.cycle) & (finer == ends)
    off = np.abs(ds.joint_amplitude - finest.joint_amplitude).max("joint").values
    off = off > OFF * ds.joint_amplitude.max("joint").values
    changed = both & ((ends != finer) | (closed & off))
    marks = dict(enumerate(ds.again.attrs["flag_meanings"].split()))
    inside = [*marks.values()].index("inside")
    beside = np.flatnonzero((again > inside) & np.isin(ends, settled))
    others = np.flatnonzero((again == inside) & np.isin(ends, settled))
    others = source.choice(others, min(2000, others.size), replace=False)
    some = ds.isel(place=np.concatenate([beside, others]))
    table = np.stack([some[n].values for n in names[:3]], axis=1)
    wrong = elsewhere(table, some, law)

    def by_mark(which):
        return {name: int((which == i).sum()) for i, name in marks.items()}

    return {
        "points": int((ends != zj.CODE.not_computed).sum()),
        "settled": int(np.isin(ends, settled).sum()),
        "marks": by_mark(again[ends != zj.CODE.not_computed]),
        "changed_at_1e-10": by_mark(again[changed]),
        "unsettled_at_1e-10": by_mark(again[left]),
        "elsewhere_by_another_code": by_mark(some.again.values[wrong]),
        "judged": by_mark(some.again.values),
        "seconds_again": seconds,
        "seconds_of_the_map": usual.run_seconds + usual.compile_seconds,
    }


def main():
    options = arguments(
        __doc__, cells=13_500, beside=1000, again=job.POINTS, seed=0, law="smoothed"
    )
    zj.configure_cpu()
    jax.config.update("jax_enable_x64", True)  # for tables of cells
    source, law = np.random.default_rng(options.seed), options.law
    beside = functools.partial(cells_beside_thresholds, law=law)
    for name, count, judged in (
        ("map", options.cells, lambda n: truth(cells_of_the_map(n, source), law)),
        ("thresholds", options.beside, lambda n: truth(beside(n, source), law)),
        ("again", options.again, lambda n: followed_again(n, source, law)),
    ):
        if count:
            head = {"about": lambda: {"commit": commit()}, "sample": name, "law": law}
            report("a5_certificates", **head, **judged(count))


if __name__ == "__main__":
    main()
