"""Extreme cases: each ends with its expected outcome, and right where it ends well.

Every case of `extreme_cases` runs with each explicit method and `Rosenbrock()`; and
with set-valued friction (`Taylor()`, and StickSlip on Tsit5) where the case is not one
of the smoothed law's rates. The end state's error is against scipy (DOP853, or Radau
where friction or damping is stiff) at 1e-12, of a field that is written once more here;
in tolerances of the largest number of the end state. It may be `EACH` tolerances for
each unit by which the motion itself magnifies a change of its start, by scipy too, and
never more than a hundredth of that number. The truth of set-valued friction is scipy's
where there is no friction; with mu_s = mu_k the smoothed law's at v_smooth = 1e-8; else
its outcome alone is judged. Writes results/extreme.md and results/extreme.json, unless
only some cases are asked for; three minutes.

    python benchmarks/c0_extreme.py [--only "v_smooth"]
"""

import json
import time
from typing import NamedTuple

import jax
import numpy as np
import ours
from extreme_cases import CASES, ENDED, NOTES, USUAL
from measure import RESULTS, arguments, report, rounded, save
from scenes import models
from scipy.integrate import solve_ivp

import ziegler_jax as zj

SOLVERS = ours.SOLVERS | ours.STIFF_SOLVERS
STICK_SLIP = {"Taylor8": zj.Taylor(), "StickSlip": zj.Explicit()}
MAX_STEPS = 200_000
FINEST = 1e-12  # what the reference is good for
EACH = 100.0  # what an error may be, in tolerances, where a motion magnifies nothing
SHIFT = 1e-9  # of a start, to see what the motion magnifies it to
LIMIT_V = 1e-8  # v_smooth of the law that stands for set-valued friction
FOLLOWED = {"escape": 1e12}  # to the end of its span
SMOOTH_ONLY = "v_smooth", "v_stribeck"


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
        found = zj.settle(
            column_of(n, set_valued),
            start,
            windows=zj.Windows(
                transient=0.0,
                length=n["span"],
                max_windows=1,
                escape=n["escape"],
            ),
            method=zj.Method(
                rtol=n["tol"], atol=n["tol"], solver=solver, max_steps=steps
            ),
            certify=False,
        )
        return found.outcome, found.final.y, found.steps

    return run


def plain_field(t, y, n):
    _, _, w1, w2 = y

    def torque(u):
        bell = np.exp(-((u / n["v_stribeck"]) ** 2))
        peak = n["mu_k"] + (n["mu_s"] - n["mu_k"]) * bell
        return peak * np.tanh(u / n["v_smooth"]) + n["c"] * u

    torques = torque(w1), torque(w2 - w1)
    inertia = n["a"], n["b"], n["d"]
    rates = models.accelerations(np, n["q"], torques, *y, inertia, n["kappa"], n["eta"])
    return np.array([w1, w2, *rates])


class Truth(NamedTuple):
    """The end state, by how much a change of the start has grown, and how exact."""

    end: np.ndarray
    growth: float
    exact: float = FINEST

    def bound(self, tol):
        """What an error may be, in tolerances of the largest number."""
        return min(EACH * max(1.0, self.growth), 0.01 / tol)


def truth_of(n):
    y0 = np.array([n["phi1"], n["phi2"], n["omega1"], n["omega2"]])
    scale = max(1.0, np.abs(y0).max())
    end = reference(n, y0)
    moved = np.array([reference(n, y0 + s) for s in scale * SHIFT * np.eye(4)])
    return Truth(end, float(np.abs(moved - end).max() / (scale * SHIFT)))


def reference(n, y0):
    """The end state by scipy."""
    a, b, d = n["a"], n["b"], n["d"]
    decay = (n["mu_s"] / n["v_smooth"] + n["c"]) * (a + 2 * b + 2 * d) / (a * d - b * b)
    method = "Radau" if decay > 300 else "DOP853"
    scale = max(1.0, np.abs(y0).max())
    end = solve_ivp(
        plain_field, (0, n["span"]), y0, method, args=(n,), rtol=1e-12,
        atol=1e-13 * scale,
    )  # fmt: skip
    if not end.success:
        raise RuntimeError(f"scipy: {end.message}")
    return end.y[:, -1]


def judged(case, solver, name, error, bound):
    """Whether a row is as expected."""
    if solver not in ("Rodas5P", *STICK_SLIP) and name in case.explicit:
        return True
    return name in case.outcomes and (error is None or error <= bound)


def timed(run, n):
    """Where a motion ends; and how, in how many steps and seconds."""
    started = time.perf_counter()
    code, end, steps = jax.block_until_ready(run(n))
    seconds, name = time.perf_counter() - started, zj.CODE(int(code)).name
    return np.array(end), {"outcome": name, "steps": int(steps), "seconds": seconds}


def row(case, solver, run, truth):
    n = FOLLOWED | case.numbers
    end, found = timed(run, n)
    error = bound = None
    if truth is not None and found["outcome"] in ENDED:
        scale, tol = max(1.0, np.abs(truth.end).max()), max(n["tol"], truth.exact)
        error = float(np.abs(end - truth.end).max() / scale / tol)
        bound = truth.bound(tol)
    return {
        "case": case.name,
        "expected": " or ".join(case.outcomes),
        "bound": bound,
        "solver": solver,
        "error_in_tolerances": error,
        "as_expected": judged(case, solver, found["outcome"], error, bound),
        **found,
    }


def limit(n, growth, run):
    """The end of set-valued friction with equal coefficients, by the smoothed law."""
    start = [n["phi1"], n["phi2"], n["omega1"], n["omega2"]]
    rests = zj.sticking_set(column_of(n, True)).contains(*start[:2])
    if rests and start[2] == start[3] == 0:
        return Truth(np.array(start), 1.0)
    if n["mu_s"] != n["mu_k"]:
        return None
    code, end, _ = run(n | FOLLOWED | {"v_smooth": LIMIT_V, "tol": 1e-11})
    good = zj.CODE(int(code)).name in ENDED
    return Truth(np.array(end), growth, LIMIT_V) if good else None


def written(rows, chosen):
    """The table in Markdown."""
    lines = [
        "# Extreme cases",
        "",
        "Written by `python benchmarks/c0_extreme.py`, which says how. Errors are",
        "of the end state, in tolerances; `chosen` is what `is_stiff` says.",
        "`unsettled` is the end of the one window that each case is given.",
        "An error may be 100 tolerances for each unit by which the motion magnifies a",
        "change of its start, and a hundredth of the motion. Taylor8 and StickSlip are",
        "set-valued friction; where mu_s > mu_k its outcome alone is judged.",
        "Springs make phi + 2 pi another state: wound up by a turn, not the same.",
        "",
        "| case | expected | bound | solver | outcome | error | steps | s | |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for r in rows:
        error = r["error_in_tolerances"]
        mark = " (chosen)" if chosen.get(r["case"]) == r["solver"] else ""
        cells = [
            r["case"], r["expected"],
            "" if error is None else f"{r['bound']:.3g}",
            r["solver"] + mark, r["outcome"], "" if error is None else f"{error:.2g}",
            str(r["steps"]), f"{r['seconds']:.2g}",
            "as expected" if r["as_expected"] else "**not as expected**",
        ]  # fmt: skip
        lines.append("| " + " | ".join(cells) + " |")
    missed = {r["case"] for r in rows if not r["as_expected"]}
    lines += ["", *(f"{name}: {NOTES.get(name, 'not explained')}" for name in missed)]
    return "\n".join(lines) + "\n"


def main():
    options = arguments(__doc__, only="")
    jax.config.update("jax_enable_x64", True)
    rows, chosen = [], {}
    runs = {name: runner(solver) for name, solver in SOLVERS.items()}
    for name, solver in STICK_SLIP.items():
        runs[name] = runner(solver, set_valued=True)
    narrow = runner(SOLVERS["Rodas5P"], steps=10_000_000)
    for run in runs.values():
        jax.block_until_ready(run(FOLLOWED | USUAL))  # compiles
    for case in (case for case in CASES if options.only in case.name):
        numbers = case.numbers
        finite = all(map(np.isfinite, numbers.values()))
        truth = truth_of(numbers) if finite and {*ENDED} & {*case.outcomes} else None
        if finite and "invalid" not in case.outcomes:
            stiff = zj.is_stiff(column_of(numbers), numbers["tol"])
            chosen[case.name] = "Rodas5P" if stiff else "Tsit5"
        for name, run in runs.items():
            if name in STICK_SLIP and case.name.startswith(SMOOTH_ONLY):
                continue
            against = truth
            if name in STICK_SLIP and truth is not None and numbers["mu_s"] > 0:
                against = limit(numbers, truth.growth, narrow)
            rows.append(row(case, name, run, against))
            print(json.dumps(rounded(rows[-1])), flush=True)
    missed = [r for r in rows if not r["as_expected"]]
    result = report("c0_extreme", rows=len(rows), not_as_expected=missed)
    if not options.only:
        save("extreme", result | {"all": rows})
        (RESULTS / "extreme.md").write_text(written(rows, chosen))


if __name__ == "__main__":
    main()
