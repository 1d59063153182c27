"""Rows of the audit: a claim, the line that computes, the rule that judges.

Here the linear column and the one without friction.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

Q_CR = (18 - 2 * np.sqrt(7)) / 5  # by hand, from Eq (7)
CONFIRMED, REFUTED, OPEN = "confirmed", "refuted", "cannot be decided"


class Row(NamedTuple):
    """A claim of the seed and how it is decided."""

    claim: str
    line: str
    judge: Callable[[Any], tuple[str, str]]


ROWS: list[Row] = []


def row(claim: str, line: str):
    """Add a row; the function decorated is its rule."""

    def add(judge):
        ROWS.append(Row(claim, line, judge))
        return judge

    return add


def holds(good: Any, otherwise: str = REFUTED) -> str:
    return CONFIRMED if bool(good) else otherwise


# The linear column --------------------------------------------------------------------


@row(
    "Flutter sets in where natural frequencies coalesce",
    "[float(np.ptp(np.abs(zj.spectrum(zj.uniform_rods(q=q)).imag))) "
    "for q in (2.5, 2.5416, 2.6)]",
)
def _(gaps):
    text = "gap of the frequencies at q = 2.5, 2.5416, 2.6: {:.3f}, {:.3f}, {:.0e}"
    return text.format(*gaps), holds(gaps[0] > gaps[1] > 1e-3 and gaps[2] < 1e-6)


@row(
    "Eq (7): 7 r^4 + (54 - 15 q) r^2 + 9 = 0 from Eq (6)",
    "max(abs(7 * r**4 + (54 - 15 * q) * r**2 + 9) for q in (1, 2.6, 4, 5) "
    "for r in np.asarray(zj.spectrum(zj.uniform_rods(q=q))) / 2**0.5)",
)
def _(residual):
    return f"residual at the eigenvalues: {residual:.0e}", holds(residual < 1e-6)


@row("Eq (8): q_cr = 2.54", "float(zj.critical_load(zj.uniform_rods()).q)")
def _(q):
    return f"{q:.6f} = (18 - 2 sqrt 7)/5", holds(round(q, 2) == 2.54)


@row(
    "Eq (2), time in sqrt(m l^2/k), belongs to Eqs (3) to (6)",
    "np.array([[8/3, 1], [1, 2/3]]) / zj.linearise(zj.uniform_rods()).mass",
)
def _(ratio):
    ratio = np.asarray(ratio)
    text = f"M of Eq (6) is {ratio.min():.3f} times the column's, K is the same: "
    text += "the seed's time is sqrt 2 times that of Eq (2); loads do not change"
    return text, holds(np.allclose(ratio, 1))


@row(
    "I_zz = 1/2 m L^2 about the centre of mass",
    "[float(zj.critical_load(zj.Column(0.0, 5/4 + i, 1/2, 1/4 + i)).q) "
    "for i in (1/12, 1/2)]",
)
def _(q):
    text = "q_cr with 1/12: {:.4f}, with 1/2: {:.4f}; Eq (6) needs 1/12".format(*q)
    return text, holds(round(q[1], 2) == 2.54)


@row(
    "m, l, k merely scale: thresholds and dynamics stay the same",
    "[settled(READINGS['F, smoothed'](0.1)).amplitude.joint, "
    "settled(softer(READINGS['F, smoothed'](0.1), 10)).amplitude.joint]",
)
def _(amplitudes):
    one, two = (float(x[0]) for x in amplitudes)
    text = "true without friction (the load is F l/k). With it the transition rate in "
    text += "rad/s is 10 times faster on a column 10 times slower: joint 1 swings "
    text += f"{one:.3f} and {two:.3f}"
    good = abs(one - two) < 1e-3
    return text, holds(good, f"{CONFIRMED} without friction, {REFUTED} with it")


@row(
    "Gravity can be neglected",
    "[float(flutter_under_gravity(weight)) for weight in (0, 9.81 / 10)]",
)
def _(q):
    text = "m g l/k = 0.98 with the seed's numbers: upright q_cr falls "
    text += "from {:.2f} to {:.2f}"
    verdict = f"{REFUTED} upright; holds where the plane of motion is horizontal"
    return text.format(*q), holds(abs(q[0] - q[1]) < 0.01, verdict)


@row(
    "Damping can lower the critical load (Ziegler's paradox)",
    "[float(zj.critical_load(zj.uniform_rods(damping=zj.Viscous(c, c))).q) "
    "for c in (1e-8, 0.1)]",
)
def _(q):
    text = "q_cr with c1 = c2 = 1e-8: {:.4f} (74/45), 0.1: {:.4f}".format(*q)
    return text, holds(max(q) < Q_CR)


@row(
    "Above the threshold the linear model grows exponentially",
    "(growth(2.6), float(zj.spectral_abscissa(zj.uniform_rods(q=2.6))))",
)
def _(rates):
    text = "rate at q = 2.6 of a run {:.4f}, of the spectrum {:.4f}".format(*rates)
    return text, holds(abs(rates[0] - rates[1]) < 1e-2)


@row(
    "Fig 2: at the critical load 2.54 amplitudes grow, spirals unfold",
    "[peak(resolved(2.54, 2000, 1e-4), *t)[1] for t in ((0, 37), (37, 2000))]",
)
def _(peaks):
    first, later = peaks
    text = f"largest phi2 in the first half beat (11.6 s) {first:.2e}, in the next "
    text += f"26 beats {later:.2e}: it beats, below q_cr; at q_cr growth is linear"
    return text, holds(later > 2 * first)


# The nonlinear column without friction ------------------------------------------------


@row("Eq (3) linearised is Eq (4)", "printed_linear_error()")
def _(error):
    return f"largest difference of the Jacobians {error:.0e}", holds(error < 1e-6)


@row(
    "Eq (3) are Lagrange's equations of the column",
    "printed_energy(), right_energy()",
)
def _(energies):
    (low, high), right = energies
    text = f"without load the energy runs from {low:.2f} to {high:.2f} of its start "
    text += f"(right equations: {right[0]:.6f} to {right[1]:.6f}). Row 1 lacks "
    text += "+ phi2'^2 sin D, row 2 has phi2'^2 for phi1'^2"
    return text, holds(high - low < 1e-3)


@row("Flutter is observed for q > 2.6", "[growth(q) for q in (2.55, 2.58, 2.6)]")
def _(rates):
    text = "growth rates of the nonlinear column at 2.55, 2.58, 2.60: "
    return text + "{:.3f}, {:.3f}, {:.3f}".format(*rates), holds(rates[1] < 1e-3)


@row(
    "Geometric nonlinearity moves the onset from 2.54 to 2.6",
    "onset()",
)
def _(q):
    text = f"the nonlinear column's growth vanishes at q = {q:.4f}: cubic terms cannot "
    return text + "move it", holds(abs(q - 2.6) < 0.01)


@row(
    "Nonlinearities are neglected in classical Lagrange equations",
    "np.subtract(*[zj.vector_field(0.0, (0.5 * x, 0.0, 0.0, x), "
    "zj.uniform_rods(q=2.6))[2] / x for x in (1.0, 1e-3)])",
)
def _(difference):
    text = "the right Lagrange equations differ from their linear part by "
    return text + f"{abs(difference):.2f} at 0.5 rad", REFUTED


@row("The motion first grows, drawing energy from the load", "work()")
def _(works):
    gain, load = (float(x) for x in works)
    text = f"to t = 20 the energy gains {gain:.4f}, the load's work is {load:.4f}"
    return text, holds(gain > 0 and abs(gain - load) < 1e-3 * gain)


@row("It does not tend to infinity", "peak(resolved(2.6, 3000))")
def _(angles):
    text = "largest angles to t = 3000: {:.3f}, {:.3f}".format(*angles)
    return text, holds(max(angles) < np.pi)


@row(
    "Fig 3: at q = 2.6 it closes into a stable, complex limit cycle",
    "section(resolved(2.6, 3000), 1500)",
)
def _(turns):
    text = "{} of {} turning points differ by more than 1 %: a chain of bursts".format(
        *turns
    )
    return text, holds(turns[0] < 10)


@row("Without friction there are stable limit cycles", "reversal(2.6), volume(2.6)")
def _(values):
    back, volume = values
    text = f"reversed after t = 40 the motion returns to {back:.0e} of its size, and "
    text += f"the flow's volume changes by {abs(volume - 1):.0e}: nothing can attract"
    return text, holds(abs(volume - 1) > 1e-3)


@row("Eq (3) as printed closes into a cycle", "section(printed(2.6, 3000), 1500)")
def _(turns):
    text = "{} of {} turning points differ by more than 1 %".format(*turns)
    return text, holds(turns[0] < 10)


@row(
    "(Its integrator's dissipation closes it: BDF at error 1e-5)",
    "section(m := stiff(2.6, 3000), 1500), peak(m, 0, 300)[1], peak(m, 2700)[1]",
)
def _(values):
    (found, count), first, last = values
    text = f"{found} of {count} turning points differ; largest phi2 from {first:.3f} "
    text += f"to {last:.3f}: scipy's BDF feeds the bursts and closes nothing"
    missing = "; of HASTIFF itself: order and step limits are not given"
    return text, holds(found < 10) + missing


@row("Error = 1e-5 keeps artificial damping away", "bdf_energy()")
def _(left):
    text = f"at q = 0, t = 1000 (316 s), BDF at 1e-5 leaves {left:.3f} of the energy"
    return text, holds(abs(left - 1) < 0.01)
