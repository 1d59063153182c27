"""Stiff friction: what a narrower layer costs, and what other stiff solvers cost.

The friction map's column (uniform rods, N = q, kick 0.3) over q = 1..4 and mu =
0.02..0.4, followed to t = 20. First, v_smooth from 1e-2 to 1e-6: steps and seconds a
lane, errors of the end state in tolerances. Then, at v_smooth = 1e-4, the seconds at
which `Rosenbrock()`, vmapped diffrax `Kvaerno5` and CVODE reach one error. The error is
the 90 % quantile over the lanes of the largest error of the two angles, against
`Rosenbrock()` at 1e-12, of which CVODE at 1e-11 tells how far it is off. A contestant
whose errors do not reach the target on both sides has no number, and a sentence in its
place. As seconds depend on wrappers and on other work of the machine, CVODE's
evaluations of the field are given beside ours (8 a step, and 4 directional derivatives
counted as one each). Writes results/c2_stiff.json; a few minutes.

    python benchmarks/c2_stiff.py [--repeats 3] [--lanes 16]
"""

import argparse
import importlib.util
import json

import numpy as np
from measure import interleaved, machine, paired, rounded, save
from peers import cvode, kvaerno5

import ziegler_jax as zj

SPAN, KICK, PIN_RADIUS = 20.0, 0.3, 0.1
LAYERS = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
TOLERANCES = (1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9)
TARGET = 1e-5
WORK_OF_A_STEP = 12  # evaluations of the field, and directional derivatives of it


def point(q, mu, v_smooth, tol):
    friction = zj.SmoothCoulomb(mu, pin_radius=PIN_RADIUS, v_smooth=v_smooth)
    found = zj.settle(
        zj.uniform_rods(q=q, friction=friction),
        zj.State(omega=(0.0, KICK)),
        windows=zj.Windows(transient=SPAN / 2, length=SPAN / 2, max_windows=1),
        method=zj.Method(rtol=tol, atol=tol, solver=zj.Rosenbrock()),
        certify=False,
    )
    phi1, phi2 = found.final.phi
    return {"phi1": phi1, "phi2": phi2, "steps": found.steps}


def ours(axes, v_smooth, tol):
    ds = zj.sweep(point, progress=False, v_smooth=[v_smooth], tol=[tol], **axes)
    ends = np.stack([ds.phi1.values.ravel(), ds.phi2.values.ravel()], -1)
    return ends, float(ds.steps.mean())


def lanes_of(axes, v_smooth):
    q, mu = (m.ravel() for m in np.meshgrid(axes["q"], axes["mu"], indexing="ij"))
    return q, PIN_RADIUS * q * mu, np.full(q.size, v_smooth)


def error_of(ends, truth):
    return float(np.quantile(np.abs(ends - truth).max(-1), 0.9))


def at_target(errors, costs):
    """The cost of the target error, along the log-log line through the measured."""
    order = np.argsort(errors)
    x, y = np.log(np.array(errors)[order]), np.log(np.array(costs)[order])
    inside = x[0] <= np.log(TARGET) <= x[-1]
    return float(np.exp(np.interp(np.log(TARGET), x, y))) if inside else None


def times_ours(name, cost, mine, errors):
    """How many times our cost, or why that is not known."""
    if cost and mine:
        return cost / mine
    low, high = min(errors), max(errors)
    return f"{name}'s errors, {low:.3g} to {high:.3g}, do not bracket {TARGET:g}."


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--lanes", type=int, default=16, help="values of q and of mu")
    options = parser.parse_args()
    zj.configure_cpu()
    n = options.lanes
    axes = {"q": np.linspace(1, 4, n), "mu": np.linspace(0.02, 0.4, n)}
    start = (0.0, 0.0, 0.0, KICK)
    with_cvode = importlib.util.find_spec("sksundae") is not None

    truths = {v: ours(axes, v, 1e-12)[0] for v in LAYERS}
    runs = {v: lambda v=v: ours(axes, v, 1e-6) for v in LAYERS}
    seconds = interleaved(runs, options.repeats)
    layers = {}
    for v in LAYERS:
        ends, steps = ours(axes, v, 1e-6)
        ratio, _ = paired(seconds[v], seconds[LAYERS[0]])
        errors = {
            f"{tol:g}": error_of(ours(axes, v, tol)[0], truths[v]) / tol
            for tol in (1e-5, 1e-6, 1e-7, 1e-8)
        }
        layers[f"{v:g}"] = {
            "steps_a_lane": steps,
            "seconds_over_those_at_0.01": ratio,
            "error_in_tolerances": errors,
        }

    v = 1e-4
    lanes = lanes_of(axes, v)
    contestants = {
        "rosenbrock": lambda tol: ours(axes, v, tol),
        "kvaerno5": lambda tol: kvaerno5.solve(lanes, start, SPAN, tol),
    }
    if with_cvode:
        contestants["cvode"] = lambda tol: cvode.solve(lanes, start, SPAN, tol)
    table, best, work, ranges, apart = {}, {}, {}, {}, None
    if with_cvode:
        ends, _ = cvode.solve(lanes, start, SPAN, 1e-11)
        apart = error_of(ends[:, :2], truths[v])
    for name, run in contestants.items():
        cost = interleaved(
            {tol: lambda tol=tol, run=run: run(tol) for tol in TOLERANCES},
            options.repeats if name == "rosenbrock" else 1,
        )
        found = [run(tol) for tol in TOLERANCES]
        errors = [error_of(ends[:, :2], truths[v]) for ends, _ in found]
        medians = [float(np.median(cost[tol])) for tol in TOLERANCES]
        table[name] = {
            f"{tol:g}": {"error": e, "microseconds_a_lane": 1e6 * s / n**2}
            for tol, e, s in zip(TOLERANCES, errors, medians, strict=True)
        }
        ranges[name], best[name] = errors, at_target(errors, medians)
        if name != "kvaerno5":
            scale = WORK_OF_A_STEP if name == "rosenbrock" else 1
            counts = [scale * float(np.mean(count)) for _, count in found]
            for entry, count in zip(table[name].values(), counts, strict=True):
                entry["evaluations_a_lane"] = count
            work[name] = at_target(errors, counts)
    others = [name for name in contestants if name != "rosenbrock"]
    result = {
        "benchmark": "c2_stiff",
        "lanes": n * n,
        "layers": layers,
        "at_v_smooth_0.0001": table,
        "cvode_off_the_truth": apart,
        "target_error": TARGET,
        "slower_at_target": {
            name: times_ours(name, best[name], best["rosenbrock"], ranges[name])
            for name in others
        },
        "cvode_evaluations_over_ours_at_target": times_ours(
            "cvode", work.get("cvode"), work["rosenbrock"], ranges["cvode"]
        )
        if with_cvode
        else None,
        **machine(),
    }
    save("c2_stiff", result)
    print(json.dumps(rounded(result)))


if __name__ == "__main__":
    main()
