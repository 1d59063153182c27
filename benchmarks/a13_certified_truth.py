"""What certificates find and how well, and whether thresholds lie in their widths.

- `share`: of random cells of the main job's map that close by windows at 1e-8 (two of
  160 in a row agree to 2e-5), how many are certified; the others by what they are.
- `amplitudes`: of certified cells against the motion from their last state at 1e-10,
  1500 time units later: after 400 the slowest still draw near.
- `cells`: what becomes of named cells, and of three of each kind.
- `kicks`: critical kicks of random columns with set-valued friction. The kicks at both
  ends of the interval are followed ten times as long, at 1e-10 instead of 1e-8: below
  it must rest, above not.
- `kinds`: random scenes of three families. What `settle` calls at rest, on a torus,
  chaotic or periodic is followed from the same start at 1e-9 to t = 40 000: false is a
  rest that moves, a torus or chaos that rests or closes, a period that rests.

Prints one JSON line each.

    python benchmarks/a13_certified_truth.py [share] [amplitudes] [cells] [kicks]
        [kinds] [--cells 2000] [--columns 200] [--scenes 1600] [--seed 0]
"""

import argparse
import json

import diffrax as dfx
import jax
import jax.numpy as jnp
import numpy as np
from a5_certificates import cells_of_the_map, columns, settled
from measure import commit, rounded

import ziegler_jax as zj
from ziegler_jax.__main__ import WINDOWS, point

KINDS = tuple(
    zj.CODE[word]
    for word in "no_passages unstable_near slow aperiodic growing lasting".split()
)
TRUTH = zj.Windows(
    transient=WINDOWS.transient, length=WINDOWS.length, max_windows=160, agreement=2e-5
)
LATER = zj.Windows(transient=1500.0, length=100.0, max_windows=1)
NAMED = (
    (1.5390625, 0.3903448275862069, 0.11),
    (1.703125, 0.3324137931034483, 0.07),
    (1.523114, 0.326128, 0.094452),
    (1.519090, 0.268554, 0.084581),
)
LENGTH, WINDOWS_OF_A_VERDICT = 40.0, 1000  # `critical_kick`'s own
FOLLOWED = 10  # times as long as a verdict may take


def swept(count, function):
    """A function of the place in a table, at each place."""
    return zj.sweep(function, place=np.arange(count), progress=False)


def outcomes(codes, kinds=None):
    counts = {c.name: int((codes == c).sum()) for c in zj.CODE if (codes == c).any()}
    if kinds is not None:
        counts |= {k.name: int((kinds == k).sum()) for k in KINDS}
    return counts


def report_share(options, source):
    cells = cells_of_the_map(options.cells, source)
    table = jnp.asarray(cells)

    def truth(place):
        fine = {"windows": TRUTH, "method": zj.Method(rtol=1e-8), "certify": False}
        return point(*table[place.astype(int)], **fine)

    true = swept(len(cells), truth).outcome.values == zj.CODE.repeats
    ds = settled(cells)
    certified = true & (ds.outcome.values == zj.CODE.cycle)
    missed = true & ~certified
    return {
        "cells": len(cells),
        "true_cycles": int(true.sum()),
        "certified": int(certified.sum()),
        "share": certified.sum() / true.sum(),
        "others": outcomes(ds.outcome.values[missed], ds.undecided.values[missed]),
    }


def report_amplitudes(options, source):
    cells = cells_of_the_map(options.cells, source)
    ds = settled(cells)
    closed = np.flatnonzero(ds.outcome == zj.CODE.cycle)
    table = jnp.asarray(columns(cells[closed]))
    ends = jnp.asarray(ds.state.values[closed])

    def later(place):
        q, tau_s, tau_k, v_stribeck, v_smooth = table[place.astype(int)]
        law = zj.SmoothCoulomb(
            tau_s / q, tau_k / q, pin_radius=1.0, v_stribeck=v_stribeck,
            v_smooth=v_smooth,
        )  # fmt: skip
        y = ends[place.astype(int)]
        return zj.settle(
            zj.uniform_rods(q=q, friction=law), zj.State((y[0], y[1]), (y[2], y[3])),
            windows=LATER, method=zj.Method(rtol=1e-10), certify=False,
        )  # fmt: skip

    fine = swept(len(closed), later).joint_amplitude.values
    off = np.abs(ds.joint_amplitude.values[closed] - fine).max(axis=1)
    off = off / fine.max(axis=1)
    worst = np.argmax(off)
    return {
        "certified": len(closed),
        "off_median": np.median(off),
        "off_largest": off[worst],
        "worst_cell": cells[closed][worst].tolist(),
        "its_multiplier": float(ds.largest_multiplier[closed[worst]]),
    }


def report_cells(options, source):
    cells = np.concatenate([NAMED, cells_of_the_map(options.cells, source)])
    ds = settled(cells)
    chosen = list(range(len(NAMED)))
    for kind in KINDS:
        found = np.flatnonzero(ds.undecided.values == kind)
        chosen += found[found >= len(NAMED)][:3].tolist()
    names = "time", "period", "largest_multiplier", "returns", "drift"
    return {
        "found": [
            {
                "cell": cells[i].tolist(),
                "outcome": zj.CODE(int(ds.outcome[i])).name,
                "kind": zj.CODE(int(ds.undecided[i])).name,
                "joint_amplitude": ds.joint_amplitude.values[i].tolist(),
                **{name: float(ds[name][i]) for name in names},
            }
            for i in chosen
        ]
    }


def report_kicks(options, source):
    count, horizon = options.columns, FOLLOWED * LENGTH * WINDOWS_OF_A_VERDICT
    q, angle = source.uniform(1.3, 2.3, count), source.uniform(0, 2 * np.pi, count)
    tau = 10 ** source.uniform(-2.5, -1, count)
    ratio = source.uniform(0.7, 1.0, count)  # kinetic over static
    table = jnp.asarray(np.stack([q, tau, ratio, np.cos(angle), np.sin(angle)], axis=1))

    def scene(place):
        q, tau, ratio, *kick = table[place.astype(int)]
        load = zj.ConstantLoad(1.0)
        law = zj.SetValuedCoulomb(tau, ratio * tau, pin_radius=1.0, load=load)
        # a threshold is about proportional to the torque
        return zj.uniform_rods(q=q, friction=law), [40 * tau * x for x in kick]

    def found(place):
        column, kick = scene(place)
        direction, windows = zj.State(omega=tuple(kick)), zj.Windows(length=LENGTH)
        return zj.critical_kick(column, direction, (0.01, 4.0), windows=windows)

    ds = swept(count, found)
    known = np.flatnonzero(np.isfinite(ds.threshold.values))
    middle, width = ds.threshold.values[known], ds.width.values[known]
    ends = jnp.asarray(np.stack([middle - width / 2, middle + width / 2], axis=1))
    long = zj.Windows(transient=horizon, length=LENGTH, max_windows=1)

    def followed(place, end):
        column, kick = scene(jnp.asarray(known)[place.astype(int)])
        size = ends[place.astype(int), end.astype(int)]
        start = zj.State(omega=tuple(size * x for x in kick))
        method = zj.Method(rtol=1e-10, max_steps=100_000_000)
        return zj.settle(column, start, windows=long, method=method, certify=False)

    again = zj.sweep(
        followed, place=np.arange(len(known)), end=[0, 1], progress=False
    ).outcome.values
    rests = again == zj.CODE.stuck
    moves = np.isin(again, [zj.CODE[name] for name in ("unsettled", "escaped")])
    rises = ds.rises.values[known] > 0
    inside = np.where(rises, rests[:, 0] & moves[:, 1], rests[:, 1] & moves[:, 0])
    return {
        "columns": count,
        "found": len(known),
        "others": {
            c.name: int((ds.outcome.values == c).sum())
            for c in zj.CODE
            if (ds.outcome.values == c).any()
        },
        "relative_width_median": np.median(width / middle),
        "followed_for": horizon,
        "inside": int(inside.sum()),
        "not_inside": known[~inside].tolist(),
        "below_ends_as": outcomes(again[:, 0]),
        "above_ends_as": outcomes(again[:, 1]),
    }


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
RESTS, CLOSES = (zj.CODE.stuck, zj.CODE.rest), (zj.CODE.cycle,)
FALSE = {  # what a motion must not be that is called so
    zj.CODE.stuck: (*CLOSES, zj.CODE.escaped, zj.CODE.unsettled),
    zj.CODE.rest: (*CLOSES, zj.CODE.escaped, zj.CODE.unsettled),
    zj.CODE.quasi_periodic: RESTS + CLOSES,
    zj.CODE.chaotic: RESTS + CLOSES,
    zj.CODE.periodic: RESTS,
}


def called(scene, table):
    """What kind of motion each scene leads to."""
    numbers, windows = jnp.asarray(table), zj.Windows(escape=60.0)

    def point(place):
        return zj.settle(
            *scene(numbers[place.astype(int)]), windows=windows, exponents=2
        )

    return swept(len(table), point).kind.values


def followed_on(scene, table):
    """The outcome of each scene to t = 40 000, at 1e-9."""
    numbers, windows = jnp.asarray(table), zj.Windows(0.0, 40.0, 1000, escape=60.0)

    def point(place):
        column, start = scene(numbers[place.astype(int)])
        solver = None if column.sticks else dfx.Dopri8()
        method = zj.Method(solver, rtol=1e-9, max_steps=20_000_000)
        return zj.settle(column, start, windows=windows, method=method, certify=True)

    return swept(len(table), point).outcome.values


def report_kinds(options, source):
    count, result = options.scenes // len(FAMILIES) + 1, {}
    for name, scene in FAMILIES.items():
        table = source.uniform(size=(count, 6))
        kinds = called(scene, table)
        asked = np.flatnonzero(np.isin(kinds, list(FALSE)))
        true = followed_on(scene, table[asked])
        pairs = [
            (zj.CODE(int(k)), zj.CODE(int(t)))
            for k, t in zip(kinds[asked], true, strict=True)
        ]
        wrong = np.array([was in FALSE[kind] for kind, was in pairs])
        result[name] = {
            "scenes": count,
            "called": outcomes(kinds),
            "false": int(wrong.sum()),
            "false_scenes": table[asked[wrong]].tolist(),
            "followed_on": {
                f"{kind.name}: {was.name}": pairs.count((kind, was))
                for kind, was in sorted(set(pairs))
            },
        }
    return result


REPORTS = {
    "share": report_share,
    "amplitudes": report_amplitudes,
    "cells": report_cells,
    "kicks": report_kicks,
    "kinds": report_kinds,
}


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("which", nargs="*", default=list(REPORTS))
    parser.add_argument("--cells", type=int, default=2000)
    parser.add_argument("--columns", type=int, default=200)
    parser.add_argument("--scenes", type=int, default=1600)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    zj.configure_cpu()
    jax.config.update("jax_enable_x64", True)  # for tables of cells
    for name in options.which:
        found = REPORTS[name](options, np.random.default_rng(options.seed))
        head = {"benchmark": "a13_certified_truth", "commit": commit(), "what": name}
        print(json.dumps(rounded({**head, "seed": options.seed, **found})), flush=True)


if __name__ == "__main__":
    main()
