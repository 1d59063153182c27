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
from measure import arguments, report

import ziegler_jax as zj
from ziegler_jax import __main__ as job

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


def cycles(q, v_smooth=None, method=zj.Method()):
    friction = law(TAU, v_smooth, pin_radius=1.0, load=zj.ConstantLoad(1.0))
    column, start = zj.uniform_rods(q=q, friction=friction), zj.State(omega=(0.0, 0.2))
    options = {"windows": ONE_WINDOW, "method": method, "certify": False}
    return zj.settle(column, start, **options)


def on_the_map(q, mu, v_smooth=None, method=zj.Method()):
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
            layer = "" if v_smooth is None else f" {v_smooth:g}"
            options = {"v_smooth": v_smooth, "method": method}
            named[f"{kind}{layer}, {tol:g}"] = options
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


def cost_of_target(table, kind, error):
    """Interpolated along the curve in both logarithms; None where it does not reach."""
    rows = [row for name, row in table.items() if name.startswith(kind)]
    errors = np.array([row["error"][error] for row in rows])
    costs = np.array([row["microseconds_a_lane"] for row in rows])
    if not (errors <= TARGET).any():
        return None
    order = np.argsort(errors)
    x, y = np.log(errors[order]), np.log(costs[order])
    return float(np.exp(np.interp(np.log(TARGET), x, y)))


def main():
    options = arguments(
        __doc__, which=("cycles", "map"), lanes=2048, side=40, repeats=3
    )
    zj.configure_cpu()
    points = {
        "cycles": (cycles, {"q": np.linspace(2.4, 2.8, options.lanes)}),
        "map": (
            on_the_map,
            {
                "q": np.linspace(1, 4, 2 * options.side),
                "mu": np.linspace(0.02, 0.4, options.side),
            },
        ),
    }
    for scene in options.which:
        point, axes = points[scene]
        exact = {"method": zj.Method(rtol=1e-10, atol=1e-10, max_steps=BUDGET)}
        ds = zj.compare(
            point, variants(scene), reference=exact, repeats=options.repeats,
            progress=False, axes=axes,
        )  # fmt: skip
        table = {
            name: {"error": error, "microseconds_a_lane": 1e6 * float(seconds)}
            for (name, error), seconds in zip(
                errors(ds, scene).items(), ds.seconds_a_point.values[1:], strict=True
            )
        }
        over = {}
        for error in ERRORS[scene]:
            costs = {k: cost_of_target(table, k, error) for k in CURVES[scene]}
            mine = costs["set-valued"]
            over[error] = {
                k: c / mine if c and mine else None for k, c in costs.items()
            }
        report(
            "a3_friction", scene=scene, lanes=int(np.prod([len(x) for x in axes.values()])),
            target=TARGET, curves=table, cost_over_set_valued=over,
        )  # fmt: skip


if __name__ == "__main__":
    main()
