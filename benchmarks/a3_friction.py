"""Set-valued against smoothed friction: the cost of a lane at a given error.

Amplitudes of both rods and joints against the set-valued law's at a finer tolerance, on
two scenes. On friction cycles (tau = 0.026, q = 2.4..2.8) the error is the largest of
all lanes; on a map of the main job's scene with mu_s = mu_k it is that of the median
lane and of the 90th in a hundred, of those that the truth calls a cycle or stuck (on
the others amplitudes are a matter of chance; what spends its budget errs infinitely).
The smoothed law's error goes with v_smooth; it is run at tolerances that add little to
it, by an explicit method and by a stiff one. Prints one JSON line a scene, with the
microseconds a lane of each point of the curves, and how many times set-valued
friction's the cost of an error of 1e-4 is, interpolated; some ten minutes, most of
them to compile.

    python benchmarks/a3_friction.py [cycles map] [--lanes 2048] [--side 40]
        [--repeats 3]
"""

import numpy as np
from b0_work_precision import cost_at
from measure import arguments, report

import ziegler_jax as zj
from ziegler_jax import __main__ as job

USUAL = zj.Method()
TARGET, TAU, BUDGET = 1e-4, 0.026, 10_000_000
MAP_BUDGET = 200_000  # steps; usual lanes need 2000 to 15 000
ONE_WINDOW = zj.Windows(transient=200.0, length=40.0, max_windows=1)
# v_smooth (none: set-valued) and tolerance of each curve's points
CURVES = {
    "cycles": {
        "set-valued": [(None, tol) for tol in (1e-4, 3e-5, 1.5e-5, 1e-5, 1e-6)],
        "smoothed": [(1e-3, 1e-6), (3e-4, 1e-8), (1e-4, 1e-8), (6e-5, 1e-8)],
        "stiff": [(1e-3, 1e-6), (3e-4, 1e-7), (1e-4, 3e-8), (3e-5, 3e-8)],
    },
    "map": {
        "set-valued": [(None, tol) for tol in (1e-4, 3e-5, 1e-5, 1e-6)],
        "smoothed": [(1e-2, 1e-6), (1e-3, 1e-6), (1e-4, 1e-7), (3e-5, 1e-7)],
        "stiff": [(v, 1e-6) for v in (1e-3, 1e-4, 1e-5, 1e-6, 1e-7)],
    },
}
ERRORS = {"cycles": {"largest": 1.0}, "map": {"median": 0.5, "90 %": 0.9}}


def law(mu, v_smooth, **parts):
    if v_smooth is None:
        return zj.SetValuedCoulomb(mu, **parts)
    return zj.SmoothCoulomb(mu, v_smooth=v_smooth, **parts)


def cycles(q, v_smooth=None, method=USUAL):
    friction = law(TAU, v_smooth, pin_radius=1.0, load=zj.ConstantLoad(1.0))
    column, start = zj.uniform_rods(q=q, friction=friction), zj.State(omega=(0.0, 0.2))
    options = {"windows": ONE_WINDOW, "method": method, "certify": False}
    return zj.settle(column, start, **options)


def on_the_map(q, mu, v_smooth=None, method=USUAL):
    friction = law(mu, v_smooth, pin_radius=job.PIN_RADIUS)
    column, start = zj.uniform_rods(q=q, friction=friction), zj.State(omega=job.KICK)
    return zj.settle(column, start, **job.SETTLE, method=method, certify=False)


def variants(scene):
    """By name the arguments of each point of the curves."""
    budget = MAP_BUDGET if scene == "map" else BUDGET
    named = {}
    for kind, rows in CURVES[scene].items():
        for v_smooth, tol in rows:
            solver = zj.Rosenbrock() if kind == "stiff" else None
            method = zj.Method(solver, tol, tol, max_steps=budget)
            name = f"{kind} {tol:g}" + ("" if v_smooth is None else f", {v_smooth:g}")
            named[name] = {"v_smooth": v_smooth, "method": method}
    return named


def errors(ds, scene):
    """Of each variant: the errors that count, by name."""
    codes = ds.outcome.sel(variant="reference").values
    settled = np.isin(codes, (zj.CODE.repeats, zj.CODE.cycle, zj.CODE.stuck))
    settled |= scene == "cycles"
    parts = ds.joint_amplitude_difference, ds.rod_amplitude_difference
    apart = [np.abs(x.sel(variant=ds.variant[1:]).values).max(axis=-1) for x in parts]
    apart = np.where(np.isnan(np.maximum(*apart)), np.inf, np.maximum(*apart))
    return {
        name: dict(zip(
            ERRORS[scene],
            np.quantile(one[settled], list(ERRORS[scene].values()), method="higher"),
            strict=True,
        ))
        for name, one in zip(ds.variant.values[1:], apart, strict=True)
    }  # fmt: skip


def scene_of(name, options):
    """Its point and its axes."""
    if name == "cycles":
        return cycles, {"q": np.linspace(2.4, 2.8, options.lanes)}
    q, mu = np.linspace(1, 4, 2 * options.side), np.linspace(0.02, 0.4, options.side)
    return on_the_map, {"q": q, "mu": mu}


def main():
    options = arguments(
        __doc__, which=("cycles", "map"), lanes=2048, side=40, repeats=3
    )
    zj.configure_cpu()
    exact = {"method": zj.Method(rtol=1e-10, atol=1e-10, max_steps=BUDGET)}
    for scene in options.which:
        point, axes = scene_of(scene, options)
        ds = zj.compare(
            point, variants(scene), reference=exact, repeats=options.repeats,
            progress=False, axes=axes,
        )  # fmt: skip
        seconds = ds.seconds_a_point.values[1:]
        table = {
            name: {**error, "microseconds": [1e6 * s]}
            for (name, error), s in zip(errors(ds, scene).items(), seconds, strict=True)
        }
        curves = {
            kind: [row for name, row in table.items() if name.startswith(f"{kind} ")]
            for kind in CURVES[scene]
        }
        costs = {
            which: {k: cost_at(rows, TARGET, which)[0] for k, rows in curves.items()}
            for which in ERRORS[scene]
        }
        over = {
            which: {k: c / one["set-valued"] for k, c in one.items()}
            for which, one in costs.items()
        }
        sizes = {name: len(axis) for name, axis in axes.items()}
        report(
            "a3_friction", scene=scene, axes=sizes, target=TARGET, points=table,
            cost_over_set_valued=over,
        )  # fmt: skip


if __name__ == "__main__":
    main()
