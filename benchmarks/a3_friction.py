"""Set-valued against smoothed friction: cost a lane, and cost at a given error.

First a map of the main job's scene with mu_s = mu_k: seconds of set-valued lanes
against smoothed ones. Then friction cycles (tau = 0.026, q = 2.4..2.8): the largest
error of the amplitudes of both rods and joint 2, against the set-valued law at 1e-10,
and what it costs. The smoothed law's error goes with v_smooth; it is run at tolerances
that add little to it, by an explicit method and by a stiff one. Moreau's time stepping
is the tests' second code on every 32nd lane, once a step length, its lanes in one
batch on one thread: its cost counts as that of half a thread. Prints one JSON line,
which goes to `results/a3_friction.json` with a picture beside it; about two minutes.

    python benchmarks/a3_friction.py [--repeats 3]
"""

import argparse
import json
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib
import numpy as np
from measure import clock, interleaved, machine, paired, ready, rounded, save

import ziegler_jax as zj
from ziegler_jax.__main__ import KICK, PIN_RADIUS, SETTLE

sys.path.append(str(Path(__file__).parents[1] / "tests"))
import moreau

matplotlib.use("agg")

TARGET = 1e-4
TAU, SPEED, TRANSIENT, WINDOW = 0.026, 0.2, 200.0, 40.0
EXACT = (None, 1e-10, None)
SMOOTHED = ((1e-2, 1e-6), (1e-3, 1e-6), (3e-4, 1e-8), (1e-4, 1e-8), (3e-5, 1e-8))
STIFF = ((1e-2, 1e-6), (1e-3, 1e-6), (3e-4, 1e-7), (1e-4, 1e-7), (3e-5, 1e-7))
# kind: v_smooth (None: set-valued), tolerance, solver
CURVES = {
    "set-valued": [(None, tol, None) for tol in (1e-4, 3e-5, 2e-5, 1e-5, 1e-6, 1e-7)],
    "smoothed": [(v, tol, None) for v, tol in SMOOTHED],
    "smoothed, stiff": [(v, tol, zj.Rosenbrock()) for v, tol in STIFF],
}
CONTESTANTS = {
    (kind, *contestant[:2]): contestant
    for kind, contestants in CURVES.items()
    for contestant in contestants
}
STEPS_A_UNIT = (25, 100, 400, 1600)  # Moreau's
EVERY = 32


def law(mu, v_smooth, **parts):
    if v_smooth is None:
        return zj.SetValuedCoulomb(mu, **parts)
    return zj.SmoothCoulomb(mu, v_smooth=v_smooth, **parts)


def map_point(v_smooth):
    def point(q, mu):
        friction = law(mu, v_smooth, pin_radius=PIN_RADIUS)
        column = zj.uniform_rods(q=q, friction=friction)
        return zj.settle(column, zj.State(omega=KICK), **SETTLE)

    return point


def cycle_point(v_smooth, tol, solver=None):
    def point(q):
        load = zj.ConstantLoad(1.0)
        friction = law(TAU, v_smooth, pin_radius=1.0, load=load)
        column = zj.uniform_rods(q=q, friction=friction)
        options = {"transient": TRANSIENT, "window": WINDOW, "max_windows": 1}
        start = zj.State(omega=(0.0, SPEED))
        return zj.settle(
            column,
            start,
            solver=solver,
            rtol=tol,
            atol=tol,
            max_steps=10_000_000,
            **options,
        )

    return point


def amplitudes(ds):
    knee = ds.joint_amplitude.sel(joint=[2]).values
    return np.concatenate([ds.rod_amplitude.values, knee], axis=-1)


@jax.jit
def time_stepping(q, steps):
    """The amplitudes by Moreau's scheme with so many steps a unit of time."""
    zero = jnp.zeros_like(q)
    h = 1.0 / steps

    def one(i, now):
        y, torques, seen = now
        y, torques = moreau.step(q, (TAU, TAU), h, y, torques, jnp)
        new = jnp.abs(jnp.stack([y[0], y[1], y[1] - y[0]]))
        watched = i >= TRANSIENT * steps
        return y, torques, jnp.where(watched, jnp.maximum(seen, new), seen)

    y = zero, zero, zero, zero + SPEED
    now = y, (zero, zero), jnp.zeros((3, q.size))
    count = jnp.asarray((TRANSIENT + WINDOW) * steps, int)
    return jax.lax.fori_loop(0, count, one, now)[2].T


def moreau_curve(q, truth):
    """Error and microseconds a lane, by steps a unit of time."""
    rows = {}
    with jax.enable_x64(True):
        lanes = jnp.asarray(q[::EVERY])
        ready(time_stepping(lanes, 1.0))
        for steps in STEPS_A_UNIT:
            start = clock()
            found = ready(time_stepping(lanes, float(steps)))
            seconds = clock() - start
            error = float(np.abs(np.asarray(found) - truth[::EVERY]).max())
            rows[f"Moreau, h = 1/{steps}"] = {
                "kind": "Moreau's time stepping",
                "error": error,
                "microseconds_a_lane": seconds / lanes.size * 1e6,
            }
    return rows


def cheapest(table, kind, between=False):
    """What the target costs: of those that reach it, or between two on the curve."""
    rows = [row for row in table.values() if row["kind"] == kind]
    error = np.array([row["error"] for row in rows])
    cost = np.array([row["microseconds_a_lane"] for row in rows])
    if not (error <= TARGET).any():
        return None
    if not between or (error <= TARGET).all():
        return float(cost[error <= TARGET].min())
    order = np.argsort(error)
    x, y = np.log(error[order]), np.log(cost[order])
    return float(np.exp(np.interp(np.log(TARGET), x, y)))


def draw(table, path):
    import matplotlib.pyplot as plt

    figure, ax = plt.subplots(figsize=(7.0, 4.6), layout="constrained")
    styles = ("o-", "s--", "^-.", "D:")
    for kind, style in zip((*CURVES, "Moreau's time stepping"), styles, strict=True):
        rows = [row for row in table.values() if row["kind"] == kind]
        ax.loglog(
            [row["microseconds_a_lane"] for row in rows],
            [row["error"] for row in rows],
            style,
            color="C3" if kind == "set-valued" else "0.35",
            label=kind,
        )
    ax.axhline(TARGET, color="0.8", zorder=0)
    ax.set_xlabel("microseconds a lane (T = 240)")
    ax.set_ylabel("largest error of the cycle's amplitudes (rad)")
    ax.legend(frameon=False)
    figure.savefig(path, dpi=150)
    plt.close(figure)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--repeats", type=int, default=3)
    repeats = parser.parse_args().repeats
    zj.configure_cpu()

    axes = {"q": np.linspace(1, 4, 97), "mu": np.linspace(0.02, 0.4, 40)}
    points = {v: map_point(v) for v in (None, 1e-2, 1e-3)}
    runs = {
        v: lambda p=p: zj.sweep(p, progress=False, **axes) for v, p in points.items()
    }
    seconds = interleaved(runs, repeats)
    to_1e2, range_1e2 = paired(seconds[None], seconds[1e-2])
    to_1e3, range_1e3 = paired(seconds[None], seconds[1e-3])

    q = np.linspace(2.4, 2.8, 2048)  # a sweep's own cost is spread over them
    found = {}

    def runner(name, contestant):
        point = cycle_point(*contestant)

        def run():
            found[name] = zj.sweep(point, q=q, progress=False)

        return run

    runner("exact", EXACT)()
    truth = amplitudes(found["exact"])
    cost = interleaved({n: runner(n, c) for n, c in CONTESTANTS.items()}, repeats)
    table = {}
    for name in CONTESTANTS:
        kind, v_smooth, tol = name
        label = f"{kind}, {tol:g}" if v_smooth is None else f"{kind} {v_smooth:g}"
        table[label] = {
            "kind": kind,
            "tolerance": tol,
            "error": float(np.abs(amplitudes(found[name]) - truth).max()),
            "microseconds_a_lane": float(np.median(cost[name])) / q.size * 1e6,
        }
    table |= moreau_curve(q, truth)
    kinds = dict.fromkeys(row["kind"] for row in table.values())
    best = {kind: cheapest(table, kind) for kind in kinds}
    on_curve = {kind: cheapest(table, kind, between=True) for kind in kinds}

    def ratio(costs):
        mine, theirs = costs["set-valued"], costs["smoothed"]
        return theirs / mine if mine and theirs else None

    result = {
        "benchmark": "a3_friction",
        "seconds_a_map": {str(v): float(np.median(s)) for v, s in seconds.items()},
        "set_valued_over_smoothed_0.01": to_1e2,
        "set_valued_over_smoothed_0.01_range": range_1e2,
        "set_valued_over_smoothed_0.001": to_1e3,
        "set_valued_over_smoothed_0.001_range": range_1e3,
        "cycles": table,
        "target_error": TARGET,
        "microseconds_to_target": best,
        "smoothed_over_set_valued_at_target": ratio(best),
        "microseconds_to_target_interpolated": on_curve,
        "smoothed_over_set_valued_interpolated": ratio(on_curve),
        **machine(),
    }
    draw(table, save("a3_friction", result))
    print(json.dumps(rounded(result)))


if __name__ == "__main__":
    main()
