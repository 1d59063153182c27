"""Rows of the audit: a claim, the line that computes, the rule that judges.

Here the linear column and the one without friction.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

Q_CR = (18 - 2 * np.sqrt(7)) / 5  # by hand, from Eq (7)
CONFIRMED, REFUTED, OPEN = "confirmed", "refuted", "cannot be decided"
TEXT = " (a reading of the text alone)"


class Row(NamedTuple):
    """A claim of the paper and how it is decided."""

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
    "Instability, flutter or divergence, goes with frequencies that coalesce",
    "[np.sort(np.abs(zj.spectrum(zj.uniform_rods(q=q, follower=0)).imag))[::2] "
    "for q in (0.3, 0.38)], float(zj.critical_load(zj.uniform_rods(follower=0), "
    "'divergence').q_cr)",
)
def _(found):
    (far, near), q = found
    text = "so for flutter (above). Divergence, under a dead load at q = "
    text += f"{q:.4f}: at 0.38 frequencies are {near[0]:.3f} and {near[1]:.3f}, "
    text += "apart; the lower one goes to 0"
    return text, holds(np.ptp(near) < np.ptp(far))


@row(
    "Only a dynamic criterion finds this loss of stability",
    "[np.linalg.det(zj.linearise(zj.uniform_rods(q=q)).stiffness) "
    "for q in (0, 2.54, 2.6, 10)]",
)
def _(dets):
    text = "det K at q = 0, 2.54, 2.6, 10: " + ", ".join(f"{x:.3f}" for x in dets)
    return text, holds(min(dets) > 0)


@row(
    "The classical column has concentrated masses; q_cr = 2.54",
    "[float(zj.critical_load(c).q_cr) for c in (zj.point_masses(2, 1), "
    "zj.point_masses(1, 1), zj.uniform_rods())]",
)
def _(q):
    text = "q_cr with Ziegler's 2m, m: {:.4f}, with m, m: {:.4f}, uniform rods {:.4f}"
    text = text.format(*q) + ": the abstract's column is not that of the equations"
    return text, holds(round(q[0], 2) == 2.54)


@row(
    "The tracking load's generalised forces are q sin(phi1 - phi2) and 0",
    "force_of_load()",
)
def _(found):
    (first, second), sine = (np.asarray(x) for x in found)
    text = f"by virtual work at the tip {first:.4f} and {abs(second):.0e}; "
    text += f"q sin D is {sine:.4f}"
    return text, holds(abs(first - sine) + abs(second) < 1e-12)


@row(
    "Eq (7): 7 r^4 + (54 - 15 q) r^2 + 9 = 0 from Eq (6)",
    "max(abs(7 * r**4 + (54 - 15 * q) * r**2 + 9) for q in (1, 2.6, 4, 5) "
    "for r in np.asarray(zj.spectrum(zj.uniform_rods(q=q))) / 2**0.5)",
)
def _(residual):
    return f"residual at the eigenvalues: {residual:.0e}", holds(residual < 1e-6)


@row("Eq (8): q_cr = 2.54", "float(zj.critical_load(zj.uniform_rods()).q_cr)")
def _(q):
    return f"{q:.6f} = (18 - 2 sqrt 7)/5", holds(round(q, 2) == 2.54)


@row(
    "Eq (2), time in sqrt(m l^2/k), belongs to Eqs (3) to (6)",
    "np.array([[8/3, 1], [1, 2/3]]) / zj.linearise(zj.uniform_rods(q=2.6)).mass, "
    "np.array([[-0.6, 1.6], [-1, 1]]) / zj.linearise(zj.uniform_rods(q=2.6)).stiffness",
)
def _(ratios):
    mass, stiffness = (np.asarray(x) for x in ratios)
    text = f"at q = 2.6 M of Eq (6) is {mass.min():.3f} to {mass.max():.3f} times the "
    text += f"column's, K {stiffness.min():.3f} to {stiffness.max():.3f} times: "
    text += "the paper's time is sqrt 2 times that of Eq (2); loads do not change"
    return text, holds(np.allclose(mass, stiffness))


@row(
    "I_zz = 1/2 m L^2 about the centre of mass",
    "[float(zj.critical_load(zj.Column(0.0, 5/4 + i, 1/2, 1/4 + i)).q_cr) "
    "for i in (1/12, 1/2)]",
)
def _(q):
    text = "q_cr with 1/12: {:.4f}, with 1/2: {:.4f}; Eq (6) needs 1/12".format(*q)
    return text, holds(round(q[1], 2) == 2.54)


@row(
    "I_xx = I_yy = 1e-6 beside it, so that no matrix is singular",
    "1/2 - 2e-6",
)
def _(excess):
    text = f"I_zz - I_xx - I_yy = {excess:.2f} m l^2, which no body has (at most 0); "
    return text + "motion in the plane uses I_zz alone", holds(excess <= 0)


@row(
    "m, l, k change frequency and force in proportion",
    "zj.SI(m=1, l=1, k=10).time / zj.SI(m=1, l=1, k=40).time, "
    "zj.SI(m=2, l=2, k=20).force / zj.SI(m=1, l=1, k=10).force",
)
def _(found):
    rate, force = found
    text = f"4 k gives {rate:.1f} times the frequency, sqrt(k/(m l^2)); all three "
    text += f"doubled, {force:.1f} times the forces, k/l"
    return text, holds(np.isclose(rate, 4) and np.isclose(force, 2))


@row(
    "m, l, k merely scale: thresholds and dynamics stay the same",
    "[settled(joint(0.1, zj.FollowerLoad(), rate)).joint_amplitude "
    "for rate in (0.1, 1.0)]",
)
def _(amplitudes):
    one, two = (float(x[0]) for x in amplitudes)
    text = "true by the equations without friction (the load is F l/k). With it the "
    text += "transition rate in rad/s is 10 times faster on a column 10 times slower: "
    text += f"joint 1 swings {one:.3f} and {two:.3f}"
    good = abs(one - two) < 1e-3
    return text, holds(good, f"{CONFIRMED} without friction, {REFUTED} with it")


@row(
    "Gravity can be neglected",
    "[float(flutter_under_gravity(weight)) for weight in (0, 9.81 / 10)]",
)
def _(q):
    text = "m g l/k = 0.98 with the paper's numbers: upright q_cr falls "
    text += "from {:.2f} to {:.2f}"
    verdict = f"{REFUTED} upright; holds where the plane of motion is horizontal"
    return text.format(*q), holds(abs(q[0] - q[1]) < 0.01, verdict)


@row(
    "Damping can lower the critical load (Ziegler's paradox)",
    "[float(zj.critical_load(zj.uniform_rods(damping=zj.Viscous(c, c))).q_cr) "
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
    "The linear results (Fig 2's, at 2.54) show an exponential increase",
    "[float(zj.spectral_abscissa(zj.uniform_rods(q=q))) for q in (2.54, 2.6)]",
)
def _(rates):
    text = "growth rate at q = 2.54: {:.0e} (at 2.6: {:.4f})".format(*rates)
    return text, holds(rates[0] > 1e-6)


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
    "Flutter is for q > 2.6, and Fig 3 shows it at q = 2.6 (the paper against itself)",
    "growth(2.6)",
)
def _(rate):
    text = f"growth rate at 2.6: {rate:.3f}; onset lies below, as Fig 3 has it"
    return text, holds(rate < 1e-3)


@row(
    "Geometric nonlinearity moves the onset from 2.54 to 2.6",
    "onset(), [[swing(q, kick) / swing(2.5, kick) for q in (2.55, 2.58)] "
    "for kick in (1e-3, 1e-2, 1e-1)]",
)
def _(found):
    q, ratios = found
    text = f"growth after a kick of 1e-8 vanishes at q = {q:.4f}: cubic terms cannot "
    text += "move it. Finite kicks of 0.001, 0.01, 0.1: it swings, against q = 2.5, "
    text += "{:.0f}, {:.0f}, {:.1f} times as far at 2.55, ".format(
        *(x[0] for x in ratios)
    )
    text += "{:.0f}, {:.0f}, {:.1f} at 2.58".format(*(x[1] for x in ratios))
    late = all(below < 2 for _, below in ratios)  # none flutters below 2.6
    return text, holds(abs(q - 2.6) < 0.01 or late)


@row(
    "The nonlinear onset, 2.6, confirms the linear one with high accuracy",
    "2.6 / float(zj.critical_load(zj.uniform_rods()).q_cr) - 1, onset() / 2.6 - 1",
)
def _(off):
    text = "2.6 is {:.1%} above q_cr, and the nonlinear column's onset {:.1%} from 2.6"
    good = abs(off[0]) < 0.005 / 2.54  # half of the last digit given
    return text.format(*off), holds(good)


@row(
    "Nonlinearities are neglected in classical Lagrange equations",
    "np.subtract(*[zj.vector_field(0.0, (0.5 * x, 0.0, 0.0, x), "
    "zj.uniform_rods(q=2.6))[2] / x for x in (1.0, 1e-3)])",
)
def _(difference):
    text = "the right Lagrange equations differ from their linear part by "
    return text + f"{abs(difference):.2f} at 0.5 rad", holds(abs(difference) < 1e-3)


@row("The motion first grows, drawing energy from the load", "work()")
def _(works):
    gain, load = (float(x) for x in works)
    text = f"to t = 20 the energy gains {gain:.4f}, the load's work is {load:.4f}"
    return text, holds(gain > 0 and abs(gain - load) < 1e-3 * gain)


@row(
    "Beyond the critical force motion does not tend to infinity",
    "[[swing(q, 0.02, t) for t in (1500, 3000)] for q in (2.55, 2.6, 3, 4, 4.6)]",
)
def _(angles):
    text = "largest angle to t = 1500 and 3000 at q = 2.55, 2.6, 3, 4, 4.6: "
    text += ", ".join("{:.2f} {:.2f}".format(*x) for x in angles)
    return text, holds(all(late < 1.5 * early for early, late in angles))


@row(
    "Fig 3: at q = 2.6 it closes into a stable, complex limit cycle",
    "section(resolved(2.6, 3000), 1500)",
)
def _(turns):
    text = "{} of {} turning points differ by more than 1 %: a chain of bursts".format(
        *turns
    )
    return text, holds(turns[0] < 10)


@row("Fig 3's caption: it buzzes and forms a limit cycle", "beats(resolved(2.6, 3000))")
def _(ratio):
    text = f"after t = 1500 rod 2's largest angle in windows of 10 varies {ratio:.0f} "
    text += "times: it buzzes, which a closed cycle cannot"
    return text, holds(ratio < 1.01)


@row(
    "Beyond the critical force steady self-excited vibrations form boundary cycles",
    "[section(resolved(q, 3000), 1500) for q in (2.55, 2.6, 3.0)]",
)
def _(turns):
    text = "turning points that differ by more than 1 %, at q = 2.55, 2.6, 3: "
    text += ", ".join("{} of {}".format(*x) for x in turns)
    return text, holds(any(found < 10 for found, _ in turns))


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
