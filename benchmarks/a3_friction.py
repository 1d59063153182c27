"""Set-valued against smoothed friction: cost a lane, and cost at a given error.

First a map of the main job's scene with mu_s = mu_k: seconds of set-valued lanes
against smoothed ones. Then friction cycles (tau = 0.026, q = 2.4..2.8): the largest
error of the amplitudes of both rods and joint 2, against the set-valued law at 1e-10,
and what it costs. The smoothed law's error goes with v_smooth; it is run at tolerances
that add little to it, by an explicit method and by a stiff one. Moreau's time stepping
is the tests' second code, on every 32nd lane and once a step length; one thread runs
it, and its cost is processor time over the number of cores. Prints one JSON line,
which goes to `results/a3_friction.json` with a picture beside it; about two minutes.

    python benchmarks/a3_friction.py [--repeats 3] [--lanes 2048]
"""

import argparse
import json
import os
import sys
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib
import numpy as np
from measure import interleaved, machine, paired, ready, rounded, save

import ziegler_jax as zj
from ziegler_jax.__main__ import KICK, PIN_RADIUS, SETTLE

sys.path.append(str(Path(__file__).parents[1] / "tests"))
import moreau

matplotlib.use("agg")

TARGET = 1e-4
TAU, SPEED, TRANSIENT, WINDOW = 0.026, 0.2, 200.0, 40.0
NO_LAYER = 0.0
# v_smooth and tolerance of each curve's points
CURVES = {
    "set-valued": [
        (NO_LAYER, tol) for tol in (1e-4, 3e-5, 2e-5, 1.5e-5, 1e-5, 1e-6, 1e-7)
    ],
    "smoothed": [(1e-2, 1e-6), (1e-3, 1e-6)]
    + [(v, 1e-8) for v in (3e-4, 1e-4, 6e-5, 3e-5)],
    "smoothed, stiff": [(1e-2, 1e-6), (1e-3, 1e-6)]
    + [(v, 1e-7) for v in (3e-4, 1e-4, 6e-5, 3e-5)],
}
CONTESTANTS = [(kind, *point) for kind, points in CURVES.items() for point in points]
STEPS_A_UNIT = (30, 100, 300, 1000)  # Moreau's
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


def cycle_point(kind):
    """One program a curve: `v_smooth` and the tolerance are axes of it."""

    def point(q, v_smooth, tol):
        friction = law(
            TAU,
            None if kind == "set-valued" else v_smooth,
            pin_radius=1.0,
            load=zj.ConstantLoad(1.0),
        )
        return zj.settle(
            zj.uniform_rods(q=q, friction=friction),
            zj.State(omega=(0.0, SPEED)),
            transient=TRANSIENT,
            window=WINDOW,
            max_windows=1,
            solver=zj.Rosenbrock() if kind == "smoothed, stiff" else None,
            rtol=tol,
            atol=tol,
            max_steps=10_000_000,
        )

    return point


def amplitudes(ds):
    ds = ds.isel(v_smooth=0, tol=0)
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
        ready(time_stepping(lanes, 1.0))  # compiles
        for steps in STEPS_A_UNIT:
            start = time.process_time()
            found = ready(time_stepping(lanes, float(steps)))
            seconds = (time.process_time() - start) / (os.cpu_count() or 1)
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
    parser.add_argument("--lanes", type=int, default=2048)
    options = parser.parse_args()
    repeats = options.repeats
    zj.configure_cpu()

    axes = {"q": np.linspace(1, 4, 97), "mu": np.linspace(0.02, 0.4, 40)}
    points = {v: map_point(v) for v in (None, 1e-2, 1e-3)}
    runs = {
        v: lambda p=p: zj.sweep(p, progress=False, **axes) for v, p in points.items()
    }
    seconds = interleaved(runs, repeats)
    to_1e2, range_1e2 = paired(seconds[None], seconds[1e-2])
    to_1e3, range_1e3 = paired(seconds[None], seconds[1e-3])

    q = np.linspace(2.4, 2.8, options.lanes)  # a sweep's own cost is spread over them
    found = {}

    cycles = {kind: cycle_point(kind) for kind in CURVES}

    def runner(kind, v_smooth, tol):
        axes = {"q": q, "v_smooth": [v_smooth], "tol": [tol]}

        def run():
            found[kind, v_smooth, tol] = zj.sweep(cycles[kind], progress=False, **axes)

        return run

    exact = "set-valued", NO_LAYER, 1e-10
    runner(*exact)()
    truth = amplitudes(found[exact])
    cost = interleaved({name: runner(*name) for name in CONTESTANTS}, repeats)
    table = {}
    for name in CONTESTANTS:
        kind, v_smooth, tol = name
        layer = "" if kind == "set-valued" else f" {v_smooth:g}"
        table[f"{kind}{layer}, {tol:g}"] = {
            "kind": kind,
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
