"""What certificates find, and whether thresholds and kinds of motion hold.

- `share`: of random cells of the main job's map that close by windows at 1e-8 (two of
  160 in a row agree to 2e-5), how many are certified; the others by what they are. And
  how many of those that two usual windows call repeated are none of these, or repeat
  with an amplitude that is off by more than 1 %.
- `kicks`: critical kicks of random columns with set-valued friction. The kicks at both
  ends of the interval are followed ten times as long, at 1e-10 instead of 1e-8: below
  it must rest, above not.
- `onsets`: onset loads over 20 x 20 static and kinetic coefficients (set-valued, both
  pins 0.05, load F, kick 0.3, bracket 0.5 to 4, all else by default). Motions at both
  ends of the last intervals are followed by other steps to t = 40 000. And `--scanned`
  of the cells where the verdict changes more than once, each by a scan of 400 loads.
- `kinds`: random scenes of three families. What `settle` calls at rest, on a torus,
  chaotic or periodic is followed from the same start at 1e-9 to t = 40 000: false is a
  rest that moves, a torus or chaos that rests or closes, a period that rests.

Prints one JSON line each; some ten minutes.

    python benchmarks/a13_certified_truth.py [share kicks onsets kinds]
        [--cells 2000] [--columns 200] [--side 20] [--scanned 20] [--scenes 1600]
        [--seed 0]
"""

from collections import Counter

import diffrax as dfx
import jax
import jax.numpy as jnp
import numpy as np
from a5_certificates import cells_of_the_map, settled
from follow_on import OFF, RESTS, last_intervals, outcomes, swept
from measure import arguments, commit, report

import ziegler_jax as zj
from ziegler_jax import __main__ as job

TRUTH = zj.Windows(
    transient=job.WINDOWS.transient, length=job.WINDOWS.length, max_windows=160,
    agreement=2e-5,
)  # fmt: skip
LENGTH, WINDOWS_OF_A_VERDICT = 40.0, 1000  # `critical_kick`'s own
FOLLOWED = 10  # times as long as a verdict may take
KICK, BRACKET, LOADS = zj.State(omega=(0.0, 0.3)), (0.5, 4.0), 401


def share(options, source):
    cells = cells_of_the_map(options.cells, source)
    fine = {"windows": TRUTH, "method": zj.Method(rtol=1e-8), "certify": False}
    exact = swept(cells, lambda cell: job.point(*cell, **fine))
    usual = swept(cells, lambda cell: job.point(*cell, certify=False))
    ds = settled(cells, "smoothed")
    true = exact.outcome.values == zj.CODE.repeats
    certified = true & (ds.outcome.values == zj.CODE.cycle)
    missed = ds.isel(place=np.flatnonzero(true & ~certified))
    repeats = usual.outcome.values == zj.CODE.repeats
    off = np.abs(usual.joint_amplitude - exact.joint_amplitude).max("joint").values
    off = off > OFF * exact.joint_amplitude.max("joint").values
    return {
        "cells": len(cells),
        "true_cycles": int(true.sum()),
        "certified": int(certified.sum()),
        "share": certified.sum() / true.sum(),
        "others": outcomes(missed.outcome),
        "others_undecided": outcomes(missed.undecided),
        "repeats_by_windows": int(repeats.sum()),
        "not_confirmed": int((repeats & (~true | off)).sum()),
    }


def kicks(options, source):
    count, horizon = options.columns, FOLLOWED * LENGTH * WINDOWS_OF_A_VERDICT
    q, angle = source.uniform(1.3, 2.3, count), source.uniform(0, 2 * np.pi, count)
    tau = 10 ** source.uniform(-2.5, -1, count)
    ratio = source.uniform(0.7, 1.0, count)  # kinetic over static
    table = np.stack([q, tau, ratio, np.cos(angle), np.sin(angle)], axis=1)

    def scene(row):
        q, tau, ratio, *kick = row
        load = zj.ConstantLoad(1.0)
        law = zj.SetValuedCoulomb(tau, ratio * tau, pin_radius=1.0, load=load)
        # a threshold is about proportional to the torque
        return zj.uniform_rods(q=q, friction=law), [40 * tau * x for x in kick]

    def threshold(row):
        column, kick = scene(row)
        direction, windows = zj.State(omega=tuple(kick)), zj.Windows(length=LENGTH)
        return zj.critical_kick(column, direction, (0.01, 4.0), windows=windows)

    def outcome_at(known, sizes):
        def point(row):
            column, kick = scene(row[:-1])
            start = zj.State(omega=tuple(row[-1] * x for x in kick))
            return zj.settle(
                column, start,
                windows=zj.Windows(transient=horizon, length=LENGTH, max_windows=1),
                method=zj.Method(rtol=1e-10, max_steps=100_000_000), certify=False,
            )  # fmt: skip

        return swept(np.column_stack([table[known], sizes]), point).outcome.values

    ds = swept(table, threshold)
    width = float((ds.width / ds.threshold).median())
    result = {"columns": count, "relative_width_median": width}
    return result | {"followed_for": horizon} | last_intervals(ds, outcome_at)


def onsets(options, source):
    mu = np.linspace(0.02, 0.4, options.side)
    table = np.array([(s, k) for s in mu for k in mu if k <= s])

    def column(q, mu_s, mu_k):
        law = zj.SetValuedCoulomb(mu_s, mu_k, pin_radius=0.05)
        return zj.uniform_rods(q, friction=law)

    def onset(row):
        return zj.flutter_onset(lambda q: column(q, *row), KICK, BRACKET)

    def outcome_at(known, loads, windows=WINDOWS_OF_A_VERDICT):
        horizon = zj.Windows(max_windows=windows)
        method = zj.Method(rtol=1e-8, max_steps=4_000_000)

        def point(row):
            return zj.settle(
                column(*row), KICK, windows=horizon, method=method, certify=True
            )

        return swept(np.column_stack([loads, table[known]]), point).outcome.values

    ds = swept(table, onset)
    result = last_intervals(ds, outcome_at)
    drawn = source.permutation(np.flatnonzero(ds.outcome == zj.CODE.repeated))
    drawn = drawn[: options.scanned]
    if not drawn.size:
        return result
    loads = np.tile(np.linspace(*BRACKET, LOADS), len(drawn))
    codes = outcome_at(np.repeat(drawn, LOADS), loads, windows=200)
    rests = np.isin(codes, RESTS).reshape(-1, LOADS)
    changes = np.abs(np.diff(rests.astype(int), axis=1)).sum(axis=1)
    return result | {"changes_of_repeated": changes.tolist()}


def smoothed_scene(n):
    q, tau, kick, v = 1.2 + 1.6 * n[0], 10 ** (2.2 * n[1] - 3), n[2], n[3]
    v_smooth = tau * 10 ** (1.7 * v - 1)
    law = zj.SmoothCoulomb(
        tau, pin_radius=1.0, v_smooth=v_smooth, load=zj.ConstantLoad(1.0)
    )
    damped = jnp.where(n[4] < 0.3, n[5], 0.0)  # some columns
    damping = zj.Viscous(0.02 * damped, 0.02 * damped)
    start = zj.State(omega=(0.0, 10 ** (6.3 * kick - 6)))
    return zj.uniform_rods(q, friction=law, damping=damping), start


def dry_scene(n):
    mu_k = 0.005 + 0.255 * n[1]
    law = zj.SetValuedCoulomb((1 + 3 * n[2]) * mu_k, mu_k, pin_radius=0.1)
    start = zj.State(omega=(0.0, 10 ** (2 * n[3] - 1.5)))
    return zj.uniform_rods(1 + 6 * n[0], friction=law), start


def viscous_scene(n):
    damping = zj.Viscous(*(10 ** (1.5 * x - 3) for x in (n[1], n[2])))
    column = zj.uniform_rods(
        1.5 + 2 * n[0], damping=damping, follower=0.6 + 0.4 * n[3],
        kappa=0.4 + 1.2 * n[4],
    )  # fmt: skip
    return column, zj.State(omega=(0.0, 3 * n[5]))


FAMILIES = {"smoothed": smoothed_scene, "dry": dry_scene, "viscous": viscous_scene}
CLOSES, MOVES = (zj.CODE.cycle,), (zj.CODE.cycle, zj.CODE.escaped, zj.CODE.unsettled)
FALSE = {  # what a motion must not be that is called so
    **dict.fromkeys(RESTS, MOVES),
    zj.CODE.quasi_periodic: RESTS + CLOSES,
    zj.CODE.chaotic: RESTS + CLOSES,
    zj.CODE.periodic: RESTS,
}


def kinds(options, source):
    count, result = options.scenes // len(FAMILIES) + 1, {}
    for name, scene in FAMILIES.items():

        def called(row, scene=scene):
            windows = zj.Windows(escape=60.0)
            return zj.settle(*scene(row), windows=windows, exponents=2)

        def followed(row, scene=scene):
            column, start = scene(row)
            solver = None if column.sticks else dfx.Dopri8()
            method = zj.Method(solver, rtol=1e-9, max_steps=20_000_000)
            windows = zj.Windows(0.0, 40.0, 1000, escape=60.0)
            options = {"windows": windows, "method": method, "certify": True}
            return zj.settle(column, start, **options)

        table = source.uniform(size=(count, 6))
        kind = swept(table, called).kind.values
        asked = np.flatnonzero(np.isin(kind, list(FALSE)))
        true = swept(table[asked], followed).outcome.values if asked.size else ()
        both = zip(kind[asked], true, strict=True)
        pairs = [(zj.CODE(int(k)), zj.CODE(int(t))) for k, t in both]
        wrong = np.array([was in FALSE[called_so] for called_so, was in pairs], bool)
        result[name] = {
            "scenes": count,
            "called": outcomes(kind),
            "false": int(wrong.sum()),
            "false_scenes": table[asked[wrong]].tolist(),
            "followed_on": dict(Counter(f"{k.name}: {t.name}" for k, t in pairs)),
        }
    return result


REPORTS = {f.__name__: f for f in (share, kicks, onsets, kinds)}


def main():
    options = arguments(
        __doc__, which=tuple(REPORTS), cells=2000, columns=200, side=20, scanned=20,
        scenes=1600, seed=0,
    )  # fmt: skip
    zj.configure_cpu()
    jax.config.update("jax_enable_x64", True)  # for tables of cells
    for name in options.which:
        numbers = REPORTS[name](options, np.random.default_rng(options.seed))
        head = {"about": lambda: {"commit": commit()}, "what": name}
        report("a13_certified_truth", **head, seed=options.seed, **numbers)


if __name__ == "__main__":
    main()
