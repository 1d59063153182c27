"""Is the least kick the least?

Twenty columns and loads with set-valued friction: `least_kick` against random kicks,
whose directions are uniform in the norm of the energy and whose energies are uniform
up to 1.25 of the least one; both have the same windows and tolerances, and each of the
random kicks is followed until it repeats or rests. Then 0.998 and 1.002 of the least
kick itself. Prints one JSON line a case and one for all.

    python benchmarks/a9_least_kick.py [--random 100000] [--cases 20]
        [--groups rates angles both]
"""

import jax
import numpy as np
from follow_on import swept
from measure import arguments, commit, report

import ziegler_jax as zj

# q, mu_s, mu_k of joint 1, of joint 2, kappa, eta, (a, b, d), c
ROD, POINTS = (4 / 3, 1 / 2, 1 / 3), (3.0, 1.0, 1.0)
CASES = {
    "rates": [
        (1.40, 0.01, 0.01, 0.01, 0.01, 1.0, 1.0, ROD, 0.0),
        (1.60, 0.02, 0.02, 0.02, 0.02, 1.0, 1.0, ROD, 0.0),
        (1.80, 0.05, 0.05, 0.05, 0.05, 1.0, 1.0, ROD, 0.0),
        (2.00, 0.10, 0.10, 0.10, 0.10, 1.0, 1.0, ROD, 0.0),
        (2.30, 0.02, 0.02, 0.02, 0.02, 1.0, 1.0, ROD, 0.0),
        (2.50, 0.16, 0.16, 0.16, 0.16, 1.0, 1.0, ROD, 0.0),
        (2.10, 0.06, 0.04, 0.06, 0.04, 1.0, 1.0, ROD, 0.0),
        (2.00, 0.03, 0.03, 0.02, 0.02, 1.0, 1.0, ROD, 0.0),
        (2.20, 0.01, 0.01, 0.04, 0.04, 1.0, 1.0, ROD, 0.0),
        (1.90, 0.03, 0.03, 0.03, 0.03, 1.0, 1.0, POINTS, 0.0),
        (2.20, 0.03, 0.025, 0.02, 0.015, 1.5, 1.0, POINTS, 0.01),
        (2.40, 0.03, 0.03, 0.03, 0.03, 0.8, 0.95, ROD, 0.02),
    ],
}
CASES["angles"] = CASES["both"] = [
    (1.80, 0.02, 0.02, 0.02, 0.02, 1.0, 1.0, ROD, 0.0),
    (2.10, 0.05, 0.05, 0.05, 0.05, 1.0, 1.0, ROD, 0.0),
    (2.40, 0.03, 0.02, 0.03, 0.02, 1.0, 1.0, ROD, 0.0),
    (2.00, 0.03, 0.03, 0.03, 0.03, 1.0, 1.0, POINTS, 0.0),
]
# free numbers of each group
FREE = {"rates": (2, 3), "angles": (0, 1), "both": (0, 1, 2, 3)}
FLUTTER = (zj.CODE.cycle, zj.CODE.repeats, zj.CODE.escaped)
NAMES = [code.name for code in FLUTTER]
HIGHEST, ABOVE = 600.0, 1.25  # energies over the torque squared, over the least
WINDOWS = zj.Windows(transient=0.0, length=40.0, max_windows=200)
METHOD = zj.Method(rtol=1e-8)


def numbers(cases):
    """A case a row."""
    return np.array([[*case[:7], *case[7], case[8]] for case in cases])


def column(row):
    q, s1, k1, s2, k2, kappa, eta, a, b, d, c = (row[i] for i in range(11))
    law = zj.SetValuedCoulomb(
        (s1, s2), (k1, k2), pin_radius=1.0, load=zj.ConstantLoad(1.0)
    )
    return zj.Column(q, a, b, d, kappa, eta, zj.Viscous(c, c), law)


def least(group, table):
    """The least kicks of a group."""
    return swept(
        table,
        lambda row: zj.least_kick(
            column(row),
            (0.0, HIGHEST * row[1] * row[3]),
            directions=zj.Directions(group),
            windows=WINDOWS,
            method=METHOD,
        ),
    )


def fates(row, starts):
    """How motions of one case end."""

    def outcome(y):
        start = zj.State((y[0], y[1]), (y[2], y[3]))
        settled = zj.settle(column(row), start, windows=WINDOWS, method=METHOD)
        return {"outcome": settled.outcome}

    return swept(starts, outcome).outcome.values


def random_kicks(row, free, energy, count, seed):
    """Starts with random directions, and their energies up to `ABOVE` of the least."""
    rng = np.random.default_rng(seed)
    kappa, (a, b, d) = row[5], row[7:10]
    square = np.zeros((4, 4))
    square[:2, :2] = [[kappa + 1, -1], [-1, 1]]
    square[2:, 2:] = [[a, b], [b, d]]
    factor = np.linalg.cholesky(square[np.ix_(free, free)])
    points = rng.normal(size=(count, len(free)))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    starts = np.zeros((count, 4))
    starts[:, free] = np.linalg.solve(factor.T, points.T).T
    wanted = energy * rng.uniform(0, ABOVE, count)
    starts *= np.sqrt(2 * wanted)[:, None]
    phi1, phi2, w1, w2 = starts.T
    kinetic = a * w1**2 + d * w2**2 + 2 * b * np.cos(phi1 - phi2) * w1 * w2
    return starts, (kinetic + kappa * phi1**2 + (phi2 - phi1) ** 2) / 2


def judged(group, table, ds, case, count):
    """One case's least kick against random ones."""
    found = ds.isel(place=case)
    line = {
        "case": f"{group} {case}",
        "q": float(table[case][0]),
        "outcome": zj.CODE(int(found.outcome)).name,
        "edge": zj.CODE(int(found.edge)).name,
        "energy_over_torque": float(found.energy / table[case][1] / table[case][3]),
        "misalignment": float(found.misalignment),
        "motions": int(found.motions),
        "steps": int(found.steps),
    }
    if int(found.outcome) != zj.CODE.found:
        return line
    energy, row = float(found.energy), table[case]
    start = np.concatenate([found.angle.values, found.rate.values])
    around = fates(row, np.outer([0.998, 1.002], start))
    starts, energies = random_kicks(row, FREE[group], energy, count, 7 + case)
    fate = fates(row, starts)
    flutter = np.isin(fate, FLUTTER)
    best = energies[flutter].min() if flutter.any() else np.inf
    return line | {
        "0.998": zj.CODE(int(around[0])).name,
        "1.002": zj.CODE(int(around[1])).name,
        "random": count,
        "flutter": int(flutter.sum()),
        "undecided": int((fate == zj.CODE.unsettled).sum()),
        "percent_over_best": 100 * (energy / best - 1),
    }


def main():
    options = arguments(__doc__, random=100_000, cases=20, groups=tuple(CASES))
    zj.configure_cpu()
    jax.config.update("jax_enable_x64", True)  # for tables of cases
    lines = []
    for group in options.groups:
        table = numbers(CASES[group][: options.cases])
        ds = least(group, table)
        for case in range(len(table)):
            line = judged(group, table, ds, case, options.random)
            lines.append(report("a9_least_kick", about=dict, **line))
    judged_ones = [line for line in lines if "random" in line]
    report(
        "a9_least_kick",
        about=lambda: {"commit": commit()},
        cases=len(lines),
        found=len(judged_ones),
        random_a_case=options.random,
        most_percent_over_best=max(x["percent_over_best"] for x in judged_ones),
        **{
            "rest_at_0.998": sum(x["0.998"] == "stuck" for x in judged_ones),
            "flutter_at_1.002": sum(x["1.002"] in NAMES for x in judged_ones),
        },
    )


if __name__ == "__main__":
    main()
