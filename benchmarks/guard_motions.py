"""What `guard.py` holds of motions: the references, uneven times, and maps."""

import functools
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from guard_lines import UNIT, array, counts, dry, number, scene_of_the_main_job, whole

import ziegler_jax as zj

REFERENCE = Path(__file__).parents[1] / "tests" / "reference"

# ---- motions at given times


METHODS = {"Taylor": zj.Taylor(), "Tsit5": zj.Explicit()}


@functools.partial(jax.jit, static_argnames="method")
def stick_slip(q, tau_s, tau_k, phi, omega, ts, tol, method):
    friction = dry(tuple(tau_s), tuple(tau_k))
    column = zj.uniform_rods(q, friction=friction)
    start = zj.State(tuple(phi), tuple(omega))
    return zj.trajectory(
        column, start, ts, method=zj.Method(rtol=tol, atol=tol, solver=METHODS[method])
    )


@functools.partial(jax.jit, static_argnames="kind")
def motion(q, c, phi, omega, ts, tol, kind):
    column = zj.uniform_rods(q)
    if kind == "damped":
        column = zj.uniform_rods(q, damping=zj.Viscous(c[0], c[1]))
    elif kind == "smoothed":
        law = zj.SmoothCoulomb(
            0.012, 0.01, pin_radius=1.0, v_stribeck=0.05, v_smooth=0.01, load=UNIT
        )
        column = zj.uniform_rods(q, friction=law)
    start = zj.State(tuple(phi), tuple(omega))
    return zj.trajectory(column, start, ts, method=zj.Method(rtol=tol, atol=tol))


def states(found):
    return np.concatenate([found.phi, found.omega], axis=1)


def read(name, *keys):
    with np.load(REFERENCE / f"{name}.npz") as file:
        return [np.asarray(file[key], float) for key in keys]


def references():
    """Errors of the reference motions, and digests of what was computed."""
    lines = {}
    for path in sorted(REFERENCE.glob("fric_*.npz")):
        case = path.stem
        numbers = read(case, "q", "Ts", "Tk", "phi0", "w0", "t")
        y, modes, times = read(case, "y", "ev_mode", "ev_t")
        for method, tol in (("Taylor", 1e-9), ("Taylor", 1e-11), ("Tsit5", 1e-9)):
            found = stick_slip(*numbers, tol, method=method)
            events, count = found.events, int(found.events.count)
            name = f"{case}, {method} {tol:g}"
            same = min(count, len(times))
            late = np.abs(np.asarray(events.times)[:same] - times[:same])
            wrong = np.asarray(events.modes)[:same] != modes[:same]
            lines |= {
                f"{name}: error": number(np.abs(states(found) - y).max(), 0.01),
                f"{name}: states": array(states(found), 1e-10),
                f"{name}: events": whole(count),
                f"{name}: modes off": whole(wrong.sum() + abs(count - len(times))),
                f"{name}: modes": array(events.modes[:count], 0.0),
                f"{name}: joints": array(events.joints[:count], 0.0),
                f"{name}: error of times": number(late.max(), 0.01),
                f"{name}: times": array(events.times[:count], 1e-10),
                f"{name}: steps": whole(found.steps),
            }
    for path in sorted(REFERENCE.glob("[df]*ed_*.npz")) + sorted(
        REFERENCE.glob("free_*.npz")
    ):
        name = path.stem
        kind = name.split("_")[0]
        q, phi, omega, ts, ref = read(name, "q", "phi0", "w0", "t", "ref")
        until = ts <= (read(name, "Tstar")[0] if kind == "free" else np.inf)
        c = read(name, "c")[0] if kind == "damped" else np.zeros(2)
        for tol in (1e-9, 1e-11):
            found = motion(q, c, phi, omega, ts, tol, kind)
            y = states(found)[until]
            error = number(np.abs(y - ref[until]).max(), 0.01)
            lines |= {
                f"{name}, {tol:g}: error": error,
                f"{name}, {tol:g}: states": array(y, 1e-10),
                f"{name}, {tol:g}: steps": whole(found.steps),
            }
    return lines


def between_steps():
    """Motions at times that lie on no grid of steps."""
    q, phi, omega = np.float64(2.2), np.array([0.1, -0.05]), np.array([0.0, 0.2])
    c = np.array([0.05, 0.02])
    uneven = np.linspace(0, 1, 1001) ** 1.37
    lines = {}
    for kind in ("free", "damped", "smoothed"):
        found = motion(q, c, phi, omega, 20 * uneven, 1e-8, kind)
        lines[f"{kind} at uneven times"] = array(states(found))
        lines[f"{kind} at uneven times: steps"] = whole(found.steps)
    uneven, tau = np.linspace(0, 1, 1201) ** 1.37, np.array([0.05, 0.05])
    for method in METHODS:
        found = stick_slip(
            q, tau, 0.8 * tau, phi, omega, 20 * uneven, 1e-8,
            method=method,
        )  # fmt: skip
        name = f"set-valued at uneven times, {method}"
        lines[name] = array(states(found))
        lines[f"{name}: steps"] = whole(found.steps)
    return lines


# ---- maps


def map_lines(name, ds):
    outcome = ds.outcome.values
    settled = np.isin(outcome, (zj.CODE.repeats, zj.CODE.cycle, zj.CODE.stuck))
    lines = counts(f"{name}, outcomes", outcome)
    for part in ("rod_amplitude", "joint_amplitude"):
        lines[f"{name}, {part}"] = array(ds[part], 1e-9, settled[..., None])
    if "stick_fraction" in ds:
        lines[f"{name}, stick_fraction"] = array(
            ds.stick_fraction, 1e-6, settled[..., None]
        )
    if "windows" in ds:
        lines[f"{name}, windows"] = array(ds.windows, 0.0)
    return lines | {
        f"{name}, steps": array(ds.steps, 1e-3, sample=0),
        f"{name}, all steps": number(ds.steps.sum(), 1e-3),
    }


def main_map(watch, certify=False):
    """2000 random points of the main job, judged by windows."""
    point, *_ = scene_of_the_main_job()
    rng = np.random.default_rng(20250601)
    q, mu_s = rng.uniform(1, 4, 2000), rng.uniform(0.02, 0.4, 2000)
    mu_k = rng.uniform(0.02, mu_s)

    def cell(i):
        cells = [jnp.asarray(table)[i.astype(int)] for table in (q, mu_s, mu_k)]
        return point(*cells, certify=certify)

    run = functools.partial(zj.sweep, cell, i=np.arange(2000.0), progress=False)
    if not certify:
        return map_lines("main map", watch("smoothed", run))
    ds = watch("shots", run)
    closed = ds.outcome.values == zj.CODE.cycle
    return map_lines("certified map", ds) | {
        "certified map, period": array(ds.period, 1e-6, closed),
        "certified map, multiplier": array(ds.largest_multiplier, 1e-4, closed),
    }


def set_valued_map(watch):
    """500 points of the main job's map with set-valued friction, mu_s = mu_k."""
    _, pin, kick, settle = scene_of_the_main_job()

    def point(q, mu):
        law = zj.SetValuedCoulomb(mu, **pin)
        return zj.settle(
            zj.uniform_rods(q=q, friction=law),
            zj.State(omega=kick),
            **settle,
            certify=False,
        )

    axes = {"q": np.linspace(1, 4, 25), "mu": np.linspace(0.02, 0.4, 20)}
    run = functools.partial(zj.sweep, point, progress=False, **axes)
    return map_lines("set-valued map", watch("set-valued, Taylor", run))


LAWS = {
    "frictionless": (None, None),
    "smoothed, Tsit5": (
        zj.SmoothCoulomb(
            0.026, 0.02, pin_radius=1.0, v_stribeck=0.05, v_smooth=0.01, load=UNIT
        ),
        zj.Explicit(),
    ),
    "set-valued, Tsit5": (dry(0.026), zj.Explicit()),
    "smoothed, Rosenbrock": (
        zj.SmoothCoulomb(0.026, pin_radius=1.0, v_smooth=1e-4, load=UNIT),
        zj.Rosenbrock(),
    ),
}


def other_lanes(watch):
    """Lanes of other kinds, 64 loads each, with all that observers tell."""
    lines = {}
    for name, (law, solver) in LAWS.items():

        def point(q, law=law, solver=solver):
            observers = () if law is None else (zj.StickFraction(), zj.Period())
            return zj.settle(
                zj.uniform_rods(q=q, friction=law),
                zj.State(omega=(0.0, 0.2)),
                windows=zj.Windows(transient=30.0, length=20.0, max_windows=4),
                observers=observers,
                method=zj.Method(solver=solver),
                certify=False,
            )

        run = functools.partial(
            zj.sweep,
            point,
            q=np.linspace(1.8, 2.5, 64),
            lanes=zj.Lanes(batch_size=128),  # whose instructions are counted
            progress=False,
        )
        ds = watch(name, run)
        lines |= map_lines(name, ds)
        if "period" in ds:
            lines[f"{name}, period"] = array(ds.period, 1e-9)
    return lines


def given_times():
    """All that moves at given times: some share their programs."""
    return references() | between_steps()


SECTIONS = {
    "motions": given_times,
    "set-valued map": set_valued_map,
    "other lanes": other_lanes,
    "main map": main_map,
    "certified map": functools.partial(main_map, certify=True),
}
