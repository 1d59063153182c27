"""Set-valued against smoothed friction: cost a lane, and cost at a given error.

First a map of the main job's scene with mu_s = mu_k: seconds of set-valued lanes
against smoothed ones. Then error against run time, by the amplitudes of both rods and
joint 2 against the set-valued law's at finer tolerances. On friction cycles
(tau = 0.026, q = 2.4..2.8) the error is the largest of all lanes; on the map it is that
of the median lane and of the 90th in a hundred, of those that the truth calls cycle or
stuck (on the others amplitudes are a matter of chance; what spends its budget errs
infinitely). The smoothed law's error goes with v_smooth; it is run at tolerances that
add little to it, by an explicit method and by a stiff one. Moreau's time stepping is
the tests' second code, on every 32nd lane of the cycles and once a step length; one
thread runs it, and its cost is processor time over the number of cores. Prints one
JSON line, which goes to `results/a3_friction.json` with a picture beside it; about
four minutes.

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
        (NO_LAYER, tol) for tol in (1e-4, 3e-5, 2e-5, 1.5e-5, 1.2e-5, 1e-5, 1e-6, 1e-7)
    ],
    "smoothed": [(1e-2, 1e-6), (1e-3, 1e-6)]
    + [(v, 1e-8) for v in (3e-4, 1e-4, 8e-5, 6e-5, 3e-5)],
    "smoothed, stiff": [(1e-2, 1e-6), (1e-3, 1e-6)]
    + [(3e-4, 1e-7)]
    + [(v, 3e-8) for v in (1e-4, 6e-5, 3e-5, 1e-5)],
}
MAP_CURVES = {
    "set-valued": [(NO_LAYER, tol) for tol in (1e-4, 3e-5, 1e-5, 3e-6, 1e-6)],
    "smoothed": [(1e-3, 1e-6), (3e-4, 1e-7), (1e-4, 1e-7), (3e-5, 1e-7)],
    "smoothed, stiff": [(v, 1e-6) for v in (1e-3, 1e-4, 1e-5, 3e-6, 1e-6, 3e-7, 1e-7)],
}
MAP_AXES = {"q": np.linspace(1, 4, 97), "mu": np.linspace(0.02, 0.4, 40)}
MAP_BUDGET = 200_000  # steps; usual lanes need 2000 to 15 000
QUANTILES = {"median": 0.5, "90 %": 0.9}
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
        return zj.settle(column, zj.State(omega=KICK), **SETTLE, certify=False)

    return point


def map_point_of(kind):
    """The same with `v_smooth` and the tolerance as axes."""

    def point(q, mu, v_smooth, tol):
        v = None if kind == "set-valued" else v_smooth
        column = zj.uniform_rods(q=q, friction=law(mu, v, pin_radius=PIN_RADIUS))
        solver = zj.Rosenbrock() if kind == "smoothed, stiff" else None
        method = zj.Method(solver, tol, max_steps=MAP_BUDGET)
        return zj.settle(
            column, zj.State(omega=KICK), **SETTLE, method=method, certify=False
        )

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
            windows=zj.Windows(transient=TRANSIENT, length=WINDOW, max_windows=1),
            method=zj.Method(
                solver=zj.Rosenbrock() if kind == "smoothed, stiff" else None,
                rtol=tol,
                atol=tol,
                max_steps=10_000_000,
            ),
            certify=False,
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


def map_table():
    """Errors and microseconds a lane on the map, each point of the curves once."""
    points = {kind: map_point_of(kind) for kind in MAP_CURVES}

    def run(kind, v_smooth, tol, axes=MAP_AXES):
        ends = {"v_smooth": [v_smooth], "tol": [tol]}
        start = time.perf_counter()
        ds = zj.sweep(points[kind], progress=False, **axes, **ends)
        return ds, time.perf_counter() - start

    exact, _ = run("set-valued", NO_LAYER, 1e-9)
    truth = amplitudes(exact)
    codes = exact.outcome.isel(v_smooth=0, tol=0).values
    settled = np.isin(codes, (zj.CODE.repeats, zj.CODE.cycle, zj.CODE.stuck))
    table = {}
    for kind, rows in MAP_CURVES.items():
        run(kind, *rows[0], axes={"q": [2.0], "mu": [0.1]})  # compiles
        for v_smooth, tol in rows:
            ds, seconds = run(kind, v_smooth, tol)
            error = np.abs(amplitudes(ds) - truth).max(axis=-1)[settled]
            error[np.isnan(error)] = np.inf
            layer = "" if kind == "set-valued" else f" {v_smooth:g}"
            table[f"{kind}{layer}, {tol:g}"] = {
                "kind": kind,
                "error": {
                    name: float(np.quantile(error, share, method="higher"))
                    for name, share in QUANTILES.items()
                },
                "microseconds_a_lane": seconds / codes.size * 1e6,
            }
    return table


def cheapest(table, kind, between=False, quantile=None):
    """What the target costs: of those that reach it, or between two on the curve."""
    rows = [row for row in table.values() if row["kind"] == kind]
    errors = [row["error"] for row in rows]
    error = np.array(errors if quantile is None else [e[quantile] for e in errors])
    cost = np.array([row["microseconds_a_lane"] for row in rows])
    if not (error <= TARGET).any():
        return None
    if not between or (error <= TARGET).all():
        return float(cost[error <= TARGET].min())
    order = np.argsort(error)
    x, y = np.log(error[order]), np.log(cost[order])
    return float(np.exp(np.interp(np.log(TARGET), x, y)))


def draw(cycles, on_map, path):
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(
        1, 2, figsize=(10.0, 4.4), sharey=True, layout="constrained"
    )
    styles = ("o-", "s--", "^-.", "D:")
    kinds = dict(zip((*CURVES, "Moreau's time stepping"), styles, strict=True))
    for ax, table in zip(axes, (cycles, on_map), strict=True):
        for kind, style in kinds.items():
            rows = [row for row in table.values() if row["kind"] == kind]
            errors = [row["error"] for row in rows]
            if table is on_map:
                errors = [e["90 %"] for e in errors]
            ax.loglog(
                [row["microseconds_a_lane"] for row in rows],
                errors,
                style,
                color="C3" if kind == "set-valued" else "0.35",
                label=kind,
            )
        ax.axhline(TARGET, color="0.8", zorder=0)
        ax.set_xlabel("microseconds a lane")
    axes[1].set_xlim(80, 8000)  # else its minor ticks have labels that overlap
    axes[0].set_title("cycles (T = 240): the largest of all lanes", fontsize=10)
    axes[1].set_title("map of the main job: 90 % of the lanes err less", fontsize=10)
    axes[0].set_ylabel("error of the amplitudes (rad)")
    axes[0].legend(frameon=False)
    figure.savefig(path, dpi=130)
    plt.close(figure)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--lanes", type=int, default=2048)
    options = parser.parse_args()
    repeats = options.repeats
    zj.configure_cpu()

    axes = MAP_AXES
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
        """Of each smoothed method; None where it does not reach the target."""
        theirs = [costs["smoothed"], costs["smoothed, stiff"]]
        mine = costs["set-valued"]
        ratios = [cost / mine if cost and mine else None for cost in theirs]
        return dict(zip(("explicit", "stiff"), ratios, strict=True))

    on_map = map_table()
    map_costs = {
        name: {kind: cheapest(on_map, kind, True, name) for kind in MAP_CURVES}
        for name in QUANTILES
    }

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
        "map": on_map,
        "map_microseconds_to_target_interpolated": map_costs,
        "map_smoothed_over_set_valued": {n: ratio(c) for n, c in map_costs.items()},
        **machine(),
    }
    draw(table, on_map, save("a3_friction", result))
    print(json.dumps(rounded(result)))


if __name__ == "__main__":
    main()
