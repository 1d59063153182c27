"""Extreme cases: each ends with its expected outcome, and right where it ends well.

Every case of `extreme_cases` runs with each explicit method and `Rosenbrock()`, in 64
bits, and some in 32; and with set-valued friction (StickSlip, on Tsit5) where the case
is not one of the smoothed law's rates. The end state's error is against scipy (DOP853,
or Radau where friction or damping is stiff) at 1e-12, of a field that is written once
more here; in tolerances of the largest number of the end state. Set-valued friction has
such a reference only where there is no friction. Writes results/extreme.md and
results/extreme.json; a minute and a half, most of it compiling and scipy.

    python benchmarks/c0_extreme.py
"""

import json
import time
from pathlib import Path

import diffrax as dfx
import jax
import numpy as np
from extreme_cases import CASES, LONG, LONG_AMPLITUDE, LONG_BOUND, NOTES, USUAL
from measure import machine, rounded
from scipy.integrate import solve_ivp

import ziegler_jax as zj
from ziegler_jax._choice import is_stiff
from ziegler_jax.solvers.tableaus import CALVO7, VERN9

RESULTS = Path(__file__).parent / "results"
SOLVERS = {
    "Tsit5": zj.Explicit(),
    "Calvo7": zj.Explicit(*CALVO7),
    "Dopri8": zj.Explicit(dfx.Dopri8.tableau),
    "Vern9": zj.Explicit(*VERN9),
    "Rodas5P": zj.Rosenbrock(),
}
STICK_SLIP = "StickSlip"
MAX_STEPS = 200_000
FINEST = 1e-12  # what the reference is good for
SMOOTH_ONLY = "v_smooth", "v_stribeck"
IN_32_BITS = ("mu_s = mu_k", "q = 0", "v_smooth 1e-4", "tau 10", "a load that is NaN")


def column_of(n, set_valued=False):
    torque = {"pin_radius": 1.0, "load": zj.ConstantLoad(1.0)}
    if set_valued:
        friction = zj.SetValuedCoulomb(n["mu_s"], n["mu_k"], **torque)
    else:
        rates = {name: n[name] for name in ("v_stribeck", "v_smooth")}
        friction = zj.SmoothCoulomb(n["mu_s"], n["mu_k"], **rates, **torque)
    damping = zj.Viscous(n["c"], n["c"])
    inertia = n["a"], n["b"], n["d"]
    return zj.Column(
        n["q"], *inertia, n["kappa"], n["eta"], damping=damping, friction=friction
    )


def runner(solver, steps=MAX_STEPS, set_valued=False):
    @jax.jit
    def run(n):
        start = zj.State((n["phi1"], n["phi2"]), (n["omega1"], n["omega2"]))
        window = {"transient": n["lead"], "window": n["span"] - n["lead"]}
        found = zj.settle(
            column_of(n, set_valued), start, **window, max_windows=1, rtol=n["tol"],
            atol=n["tol"], escape=n["escape"], solver=solver, max_steps=steps,
        )  # fmt: skip
        return found.outcome, found.final.y, found.steps, found.amplitude.joint

    return run


def plain_field(t, y, n):
    phi1, phi2, w1, w2 = y
    s, c = np.sin(phi1 - phi2), np.cos(phi1 - phi2)

    def torque(u):
        bell = np.exp(-((u / n["v_stribeck"]) ** 2))
        peak = n["mu_k"] + (n["mu_s"] - n["mu_k"]) * bell
        return peak * np.tanh(u / n["v_smooth"]) + n["c"] * u

    t1, t2 = torque(w1), torque(w2 - w1)
    a, b, d, q, eta = (n[k] for k in ("a", "b", "d", "q", "eta"))
    r1 = q * np.sin(phi1 - eta * phi2) - n["kappa"] * phi1 - (phi1 - phi2)
    r1 += -b * s * w2**2 - t1 + t2
    r2 = q * np.sin((1 - eta) * phi2) + phi1 - phi2 + b * s * w1**2 - t2
    det = (a * d - b * b) + (b * s) ** 2  # nothing cancels beside the constants
    return np.array([w1, w2, (d * r1 - b * c * r2) / det, (a * r2 - b * c * r1) / det])


def reference(n):
    """The end state by scipy, and the method."""
    y0 = [n["phi1"], n["phi2"], n["omega1"], n["omega2"]]
    a, b, d = n["a"], n["b"], n["d"]
    decay = (n["mu_s"] / n["v_smooth"] + n["c"]) * (a + 2 * b + 2 * d) / (a * d - b * b)
    method = "Radau" if decay > 300 else "DOP853"
    scale = max(1.0, np.abs(y0).max())
    end = solve_ivp(
        plain_field, (0, n["span"]), y0, method, args=(n,), rtol=1e-12,
        atol=1e-13 * scale,
    )  # fmt: skip
    return end.y[:, -1], method


def judged(case, solver, code, error):
    """Whether a row is as expected."""
    name = zj.OUTCOME(code).name
    if solver not in ("Rodas5P", STICK_SLIP) and name in case.explicit:
        return True
    if name not in case.outcomes:
        return False
    return error is None or error <= case.bound


def row(case, solver, run, truth, bits=64):
    n = {"escape": 1e12, "lead": 0.0} | case.numbers
    tol = n["tol"] = max(n["tol"], 1e-5) if bits == 32 else n["tol"]
    started = time.perf_counter()
    code, end, steps, _ = jax.block_until_ready(run(n))
    seconds = time.perf_counter() - started
    error = None
    ended = zj.OUTCOME(int(code)).name in ("unsettled", "stuck")
    if solver == STICK_SLIP and n["mu_s"] > 0:
        truth = None  # of the smoothed law
    if truth is not None and ended:
        scale = max(1.0, np.abs(truth).max())
        error = float(np.abs(np.array(end) - truth).max() / scale / max(tol, FINEST))
    return {
        "case": case.name,
        "bits": bits,
        "expected": " or ".join(case.outcomes),
        "bound": case.bound,
        "solver": solver,
        "outcome": zj.OUTCOME(int(code)).name,
        "error_in_tolerances": error,
        "steps": int(steps),
        "seconds": seconds,
        "as_expected": judged(case, solver, int(code), error),
    }


def long_row(solver, run):
    n = {"escape": 1e12} | LONG.numbers
    n["lead"] = n["span"] - 40.0
    started = time.perf_counter()
    code, _, steps, joint = jax.block_until_ready(run(n))
    error = abs(float(joint[1]) - LONG_AMPLITUDE)
    return {
        "case": LONG.name,
        "bits": 64,
        "expected": "amplitude 0.63443",
        "bound": LONG_BOUND / LONG.numbers["tol"],
        "solver": solver,
        "outcome": zj.OUTCOME(int(code)).name,
        "error_in_tolerances": error / LONG.numbers["tol"],
        "steps": int(steps),
        "seconds": time.perf_counter() - started,
        "as_expected": error <= LONG_BOUND,
    }


def written(rows, chosen):
    """The table in Markdown."""
    lines = [
        "# Extreme cases",
        "",
        "Written by `python benchmarks/c0_extreme.py`, which says how. Errors are",
        'of the end state, in tolerances; `auto` is what `solver="auto"` takes.',
        "`unsettled` is the end of the one window that each case is given.",
        "StickSlip is set-valued friction, which has a reference where mu_s = 0.",
        "Springs make phi + 2 pi another state: wound up by a turn, not the same.",
        "",
        "| case | bits | expected | bound | solver | outcome | error | steps | s | |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for r in rows:
        error = r["error_in_tolerances"]
        auto = " (auto)" if chosen.get(r["case"]) == r["solver"] else ""
        cells = [
            r["case"], str(r["bits"]), r["expected"], f"{r['bound']:.3g}",
            r["solver"] + auto, r["outcome"], "" if error is None else f"{error:.2g}",
            str(r["steps"]), f"{r['seconds']:.2g}",
            "as expected" if r["as_expected"] else "**not as expected**",
        ]  # fmt: skip
        lines.append("| " + " | ".join(cells) + " |")
    missed = {r["case"] for r in rows if not r["as_expected"]}
    lines += ["", *(f"{name}: {NOTES.get(name, 'not explained')}" for name in missed)]
    return "\n".join(lines) + "\n"


def main():
    jax.config.update("jax_enable_x64", True)
    rows, chosen, truths = [], {}, {}
    runs = {name: runner(solver) for name, solver in SOLVERS.items()}
    runs[STICK_SLIP] = runner(zj.Explicit(), set_valued=True)
    first = {"escape": 1e12, "lead": 0.0} | USUAL
    for run in runs.values():
        jax.block_until_ready(run(first))  # compiles
    for case in CASES:
        finite = all(map(np.isfinite, case.numbers.values()))
        ends = finite and {"unsettled", "stuck"} & set(case.outcomes)
        truths[case.name] = reference(case.numbers)[0] if ends else None
        if finite and "invalid" not in case.outcomes:
            stiff = is_stiff(column_of(case.numbers), case.numbers["tol"])
            chosen[case.name] = "Rodas5P" if stiff else "Tsit5"
        for name, run in runs.items():
            if name == STICK_SLIP and case.name.startswith(SMOOTH_ONLY):
                continue
            rows.append(row(case, name, run, truths[case.name]))
            print(json.dumps(rounded(rows[-1])), flush=True)
    for name, solver in SOLVERS.items():
        rows.append(long_row(name, runner(solver, steps=100_000_000)))
    with jax.enable_x64(False):
        for name in ("Tsit5", "Rodas5P"):
            run = runner(SOLVERS[name])
            for case in CASES:
                if case.name in IN_32_BITS:
                    rows.append(row(case, name, run, truths[case.name], bits=32))
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / "extreme.md").write_text(written(rows, chosen))
    missed = [r for r in rows if not r["as_expected"]]
    result = {"rows": len(rows), "not_as_expected": missed, **machine()}
    (RESULTS / "extreme.json").write_text(json.dumps(rounded(result | {"all": rows})))
    print(json.dumps(rounded({"benchmark": "c0_extreme", **result})))


if __name__ == "__main__":
    main()
