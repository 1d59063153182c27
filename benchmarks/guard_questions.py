"""What `guard.py` holds of questions: cycles, exponents, thresholds, linear columns."""

import functools

import jax
import numpy as np
from guard_lines import UNIT, array, counts, dry, number, whole

import ziegler_jax as zj

# ---- cycles, exponents, thresholds


def folds():
    """Folds of the cycle under dry friction, where the tests look for them."""

    @jax.jit
    @jax.vmap
    def fold(tau):
        def column(q):
            return zj.uniform_rods(q, friction=dry(tau))

        kicked = zj.settle(column(1.95), zj.State(omega=(0.0, 3.0)), certify=False)
        orbit = zj.periodic_orbit(column(1.95), kicked.final)
        arc = zj.Arc(step=0.05)
        return zj.bifurcation(column, "fold", orbit, 1.95, arc=arc)

    lines, taus = {}, np.array([0.01, 0.03, 0.1, 0.26])
    found = fold(taus)
    for i, tau in enumerate(taus):
        mu = np.asarray(found.cycle.multipliers)[i, 0]
        lines |= {
            f"fold, tau = {tau:g}": number(found.parameter[i], 1e-9),
            f"fold, tau = {tau:g}: period": number(found.cycle.period[i, 0], 1e-9),
            f"fold, tau = {tau:g}: multipliers": array([mu.real, mu.imag], 1e-6),
            f"fold, tau = {tau:g}: outcome": whole(found.outcome[i]),
        }
    return lines


# states near the cycles, as `settle` left them: the guesses stay when it changes
ORBITS = {
    "viscous": ((0.7376236, 1.09815012), (0.43185896, 0.77228693)),
    "smoothed": ((-0.08963199, -0.3424605), (-0.53028201, -1.63913696)),
    "set-valued": ((0.50207059, 1.03285349), (0.54037134, 0.5028051)),
}


def orbit_of(kind):
    def column():
        if kind == "viscous":
            return zj.uniform_rods(2.3, damping=zj.Viscous(0.2, 0.2))
        if kind == "set-valued":
            return zj.uniform_rods(2.6, friction=dry(0.026))
        law = zj.SmoothCoulomb(0.026, pin_radius=1.0, v_smooth=0.1, load=UNIT)
        return zj.uniform_rods(2.6, friction=law)

    def point(tol):
        guess = zj.State(*ORBITS[kind])
        orbit = zj.periodic_orbit(column(), guess, method=zj.Method(rtol=tol, atol=tol))
        parts = {"period": orbit.period, "outcome": orbit.outcome}
        for i in range(4):
            parts[f"re_{i}"] = orbit.multipliers[i].real
            parts[f"im_{i}"] = orbit.multipliers[i].imag
        return parts | {"rod_1": orbit.rod_amplitude[0]}

    return point


def orbits(watch, kind):
    """Periods and multipliers at three tolerances."""
    run = functools.partial(
        zj.sweep,
        orbit_of(kind),
        tol=[1e-6, 1e-8, 1e-10],
        lanes=zj.Lanes(batch_size=128),
        progress=False,
    )
    ds, lines = watch(f"tangents, {kind}", run), {}
    for i, tol in enumerate(ds.tol.values):
        name, at = f"{kind} cycle, {tol:g}", ds.isel(tol=i)
        mu = [float(at[f"{p}_{k}"]) for k in range(4) for p in ("re", "im")]
        lines |= {
            f"{name}: multipliers": array(mu, 1e-10),
            f"{name}: period": number(at.period),
            f"{name}: amplitude": number(at.rod_1),
            f"{name}: outcome": whole(at.outcome),
        }
    return lines


@functools.partial(jax.jit, static_argnames="kind")
def exponents_of(q, tau, tol, kind):
    law = zj.SmoothCoulomb(tau, pin_radius=1.0, v_smooth=0.1, load=UNIT)
    law = dry(tau) if kind == "set-valued" else law
    column, start = zj.uniform_rods(q, friction=law), zj.State(omega=(0.0, 0.3))
    return zj.lyapunov_exponents(
        column,
        start,
        spans=zj.Spans(transient=100.0, length=25.0, count=12),
        method=zj.Method(rtol=tol, atol=tol),
    )


def exponents():
    """Lyapunov exponents of a smooth and of a stick-slip cycle."""
    lines = {}
    for kind, tol in (("smoothed", 1e-8), ("set-valued", 1e-8)):
        found = exponents_of(2.6, 0.026, tol, kind)
        lines |= {
            f"exponents, {kind}": array(found.exponents, 1e-9),
            f"exponents, {kind}: errors": array(found.errors, 1e-9),
            f"exponents, {kind}: steps": whole(found.steps),
            f"exponents, {kind}: outcome": whole(found.outcome),
        }
    return lines


def kick_of(q, tau):
    column = zj.uniform_rods(q, friction=dry(tau))
    return zj.critical_kick(
        column,
        zj.State(omega=(0.0, 1.0)),
        (0.0, 40 * tau),
        search=zj.Search(scan=4, halvings=10),
    )


def onset_of(tau, kick):
    return zj.flutter_onset(
        lambda q: zj.uniform_rods(q, friction=dry(tau)),
        zj.State(omega=(0.0, kick)),
        (1.0, 2.4),
        search=zj.Search(scan=4, halvings=9),
    )


def thresholds():
    """Critical kicks and an onset load, with the widths of their last intervals."""
    options = {"lanes": zj.Lanes(4), "progress": False}
    kicks = zj.sweep(kick_of, q=[1.8, 2.0, 2.4], tau=[0.02], **options)
    onset = zj.sweep(onset_of, tau=[0.03], kick=[0.8], **options)
    lines = {}
    for name, ds in (("critical_kick", kicks), ("flutter_onset", onset)):
        lines |= {
            f"{name}: values": array(ds.threshold, 1e-12),
            f"{name}: widths": array(ds.width, 1e-12),
            f"{name}: steps": array(ds.steps, 1e-3),
        } | counts(name, ds.outcome)
    return lines


KINDS = {  # q, tau, v_smooth, c, kick
    "stuck": (1.2, 0.05, 0.1, 0.0, 0.2),
    "cycle": (2.6, 0.026, 0.1, 0.0, 0.3),
    "viscous cycle": (2.3, 0.0, 0.01, 0.2, 0.3),
    "conservative": (2.0, 0.0, 0.01, 0.0, 0.2),
}


def kinds():
    """Motions of four kinds."""

    @jax.jit
    @jax.vmap
    def judge(n):
        law = zj.SmoothCoulomb(n[1], pin_radius=1.0, v_smooth=n[2], load=UNIT)
        column = zj.uniform_rods(n[0], friction=law, damping=zj.Viscous(n[3], n[3]))
        return zj.settle(column, zj.State(omega=(0.0, n[4])), exponents=2)

    found, lines = judge(np.array(list(KINDS.values()))), {}
    for i, name in enumerate(KINDS):
        lines |= {
            f"kind, {name}": whole(found.kind[i]),
            f"kind, {name}: period": number(found.period[i], 1e-9),
            f"kind, {name}: exponents": array(found.exponents[i], 1e-8),
            f"kind, {name}: steps": whole(found.steps[i]),
        }
    return lines


# ---- the linear column


def columns():
    """A few columns by name."""
    return {
        "rods": zj.uniform_rods(1.5),
        "damped rods": zj.uniform_rods(1.5, damping=zj.Viscous(0.05, 0.02)),
        "Ziegler": zj.point_masses(2, 1, q=1.5, damping=zj.Viscous(0.1, 0.1)),
        "air": zj.uniform_rods(1.5, damping=zj.Air(0.1, 0.1)),
        "subtangential": zj.Column(
            1.2, 1.3, 0.4, 0.6, 0.8, 0.7, zj.Viscous(0.3, 0.1), l2=1.2
        ),
        "dead load": zj.uniform_rods(1.5, follower=0.0),
    }


def linear():
    """Critical loads, spectra and sensitivities of a few columns."""
    lines = {}
    for name, column in columns().items():
        for kind in ("flutter", "divergence"):
            found = zj.critical_load(column, kind)
            lines |= {
                f"{name}, {kind}": number(found.q_cr),
                f"{name}, {kind}: frequency": number(found.frequency),
                f"{name}, {kind}: outcome": whole(found.outcome),
            }
        roots = np.sort_complex(np.asarray(zj.spectrum(column)))
        lines[f"{name}, spectrum"] = array([roots.real, roots.imag], 1e-11)
        lines[f"{name}, regime"] = whole(zj.regime(column))
    for name in ("damped rods", "Ziegler", "subtangential"):
        table = zj.sensitivity(columns()[name])
        lines[f"{name}, elasticities"] = array(table.elasticity, 1e-10)

    def critical(q, c1, c2):
        column = zj.uniform_rods(q, damping=zj.Viscous(c1, c2))
        load, abscissa = zj.critical_load(column), zj.spectral_abscissa(column)
        return {"load": load.q_cr, "regime": zj.regime(column), "abscissa": abscissa}

    c = np.geomspace(1e-3, 3, 12)
    ds = zj.sweep(critical, q=np.linspace(0.5, 4, 12), c1=c, c2=c, progress=False)
    for name, tolerance in (("load", 1e-11), ("regime", 0.0), ("abscissa", 1e-10)):
        lines[f"linear map, {name}"] = array(ds[name], tolerance)
    return lines


SECTIONS = {
    "orbits, set-valued": functools.partial(orbits, kind="set-valued"),
    "folds": folds,
    "orbits, smoothed": functools.partial(orbits, kind="smoothed"),
    "thresholds": thresholds,
    "orbits, viscous": functools.partial(orbits, kind="viscous"),
    "exponents": exponents,
    "kinds": kinds,
    "linear": linear,
}
