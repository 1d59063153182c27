"""Are certified cycles cycles? Each is followed on by a code that shares nothing.

Random cells of the main job's map, and loads between the last stuck and the first
moving one of random rows. From where a certified motion ended it is continued, in C++
at 1e-9, as `follow_on.py` says. Prints one JSON line a sample.

Besides, of a sample of cells: how many settle elsewhere at a tolerance of 1e-8 (beside
thresholds 1e-10), and how many of these `Growth()` calls sensitive.

    python benchmarks/a5_certificates.py [--cells 13500] [--beside 1000] [--again 8000]
        [--again-beside 2000] [--seed 0] [--law dry]

`--law dry`: the same cells with `SetValuedCoulomb`, and what windows cost and decide.
"""

import functools

import jax
import numpy as np
from follow_on import OFF, certificates, swept, with_state
from measure import arguments, commit, report
from peers.judge import follow

import ziegler_jax as zj
from ziegler_jax import __main__ as job

TOLERANCE = 1e-9


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


def by_another_code(cells, law):
    """How the judge follows certified cells on."""
    q, mu_s, mu_k = cells.T
    tau_s, tau_k = mu_s * job.PIN_RADIUS * q, mu_k * job.PIN_RADIUS * q
    v_smooth = 0.0 * tau_s if law == "dry" else tau_s / job.DAMPING_AT_REST
    v_stribeck = np.full_like(q, job.V_STRIBECK)
    columns = np.stack([q, tau_s, tau_k, v_stribeck, v_smooth], axis=1)
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


def sensitive(cells, law, rtol):
    """Which ends change at a finer tolerance: by outcome, or amplitudes by 1 %."""
    point = functools.partial(job.point, law=law)
    usual = swept(cells, lambda cell: point(*cell, observers=(zj.Growth(),)))
    method = zj.Method(rtol=rtol)
    fine = swept(cells, lambda cell: point(*cell, observers=(), method=method))
    ends, others = usual.outcome.values, fine.outcome.values
    settled = [zj.CODE.cycle, zj.CODE.stuck]
    both = np.isin(ends, settled) & np.isin(others, settled)
    closed = both & (ends == zj.CODE.cycle) & (others == ends)
    off = np.abs(usual.joint_amplitude - fine.joint_amplitude).max("joint").values
    off = off > OFF * usual.joint_amplitude.max("joint").values
    changed = both & ((ends != others) | (closed & off))
    called = usual.sensitive.values == 1
    late = (usual.time.values > job.LATE) & np.isin(ends, settled)
    cycles = ends == zj.CODE.cycle
    return {
        "points": len(cells),
        "finer_tolerance": rtol,
        "settled_twice": int(both.sum()),
        "changed": int(changed.sum()),
        "changed_and_sensitive": int((changed & called).sum()),
        "growths_of_changed": np.sort(usual.growth.values[changed]).tolist(),
        "settled_and_sensitive": int((both & called).sum()),
        "changed_and_late": int((changed & late).sum()),
        "late": int(late.sum()),
        "cycles": int(cycles.sum()),
        "sensitive_cycles": int((cycles & called).sum()),
    }


def main():
    options = arguments(
        __doc__, cells=13_500, beside=1000, again=8000, again_beside=2000, seed=0,
        law="smoothed",
    )  # fmt: skip
    zj.configure_cpu()
    jax.config.update("jax_enable_x64", True)  # for tables of cells
    source, law = np.random.default_rng(options.seed), options.law
    beside = functools.partial(cells_beside_thresholds, law=law)
    fine, finer = (functools.partial(sensitive, rtol=tol) for tol in (1e-8, 1e-10))
    for name, count, drawn, judged in (
        ("map", options.cells, cells_of_the_map, truth),
        ("thresholds", options.beside, beside, truth),
        ("sensitive", options.again, cells_of_the_map, fine),
        ("sensitive beside thresholds", options.again_beside, beside, finer),
    ):
        if count:
            head = {"about": lambda: {"commit": commit()}, "sample": name}
            report("a5_certificates", **head, **judged(drawn(count, source), law))


if __name__ == "__main__":
    main()
