"""Rows of the audit: the column with friction."""

import numpy as np
from audit_rows import CONFIRMED, OPEN, REFUTED, TEXT, holds, row


@row("Dry friction in the joints can destabilise", "below_critical(2.0)")
def _(found):
    (free, cycle), small = found
    text = f"at q = 2 a kick of 0.5 swings joint 1 by {free:.2f} without friction, by "
    text += f"{cycle:.2f} with R = 0.03 m; a kick of 0.01 ends {small}"
    good = cycle > 2 * free and small == "stuck"
    return text, holds(good) + " for a kick"


@row(
    "A small velocity of the upper joint loses stability",
    "[zj.CODE(int(settled(law(r), kick=0.1).outcome)).name for r in (0.01, 0.1, 1.0)]",
)
def _(names):
    text = "with friction on pins of 0.01, 0.1, 1 m a kick of 0.1 (0.32 rad/s) at "
    text += "q = 2.6 ends: " + ", ".join(names) + "; onset is an amplitude"
    good = all(name != "stuck" for name in names)
    return text, holds(good, f"{OPEN}: pin radius and kick are not given")


@row("Friction saturates the growth", "linear_with_friction()")
def _(angles):
    text = "the linear column with the same friction grows on: {:.0e}, {:.0e}, {:.0e} "
    text = text.format(*angles) + "at t = 20, 40, 60; geometry bounds the motion"
    return text, holds(angles[2] < 2 * angles[1])


@row(
    "Friction limits the amplitude of vibrations",
    "[(k, float(peak(resolved(2.6, 3000, k))[0]), float(settled(law(0.1), kick=k, "
    "windows=zj.Windows(max_windows=100)).rod_amplitude[0])) for k in (0.02, 2, 4)]",
)
def _(found):
    pairs = ", ".join(f"{free:.2f} and {rub:.2f} at {k:g}" for k, free, rub in found)
    text = f"phi1 swings, without friction and on 100 mm, by kick: {pairs}"
    raised = any(rub > free for _, free, rub in found)
    return text, holds(not raised, f"{REFUTED} as a rule: it depends on the kick")


@row(
    "With friction vibrations reach constant amplitude",
    "[r['kinds'] for r in reading('F')]",
)
def _(kinds):
    text = "load F, kicks of 0.2, 0.7, 2, on pins of 10 mm to 1 m: "
    text += _counted(kinds[1:]) + "; on 1 mm: " + _counted(kinds[:1])
    seen = {name for pin in kinds[1:] for name in pin} - {"stuck"}
    good = seen <= {"cycle", "slow cycle"}
    return text, holds(good) + " from 10 mm on, for kicks that do not end stuck"


@row(
    "Constant amplitude, and never a closed trajectory (the paper against itself)",
    "[np.ptp(crossings(late(r)), axis=0) for r in (0.03, 0.1, 1.0)]",
)
def _(spreads):
    text = "spread of ten settled periods on 0.03, 0.1, 1 m where rod 2 turns: of its "
    text += "angle " + ", ".join(f"{x[1]:.0e}" for x in spreads) + "; of rod 1's angle "
    text += "and rate " + ", ".join(f"{max(x[0], x[2]):.0e}" for x in spreads)
    constant = max(x[1] for x in spreads) < 0.01
    closed = max(max(x) for x in spreads) < 0.01
    return text, holds(constant and not closed)


@row(
    "Friction limits the growth; without friction there are cycles too (the same)",
    "linear_with_friction(), [peak(resolved(q, 3000)).max() for q in (2.55, 2.6)]",
)
def _(found):
    angles, free = found
    text = f"with friction alone (linear column) {angles[2]:.0e} rad at t = 60, with "
    text += (
        f"geometry alone at most {max(free):.2f}: geometry is what bounds; no cycles "
    )
    text += "without friction: see the row on stable limit cycles"
    return text, holds(angles[2] < 2 * angles[1])


@row(
    "Friction alters the attractor and the motion after the onset",
    "section(resolved(2.6, 3000), 1500), [section(late(r))[0] for r in (0.03, 0.1, 1)]",
)
def _(found):
    (free, _), rubbed = found
    text = f"distinct turning points: {free} without friction, {rubbed} with, on 0.03, "
    return text + "0.1, 1 m", holds(max(rubbed) < free)


@row(
    "Without friction lines are clean; friction blurs and fills the phase plane",
    "section(resolved(2.6, 3000), 1500), [section(late(r))[0] for r in (0.03, 0.1, 1)]"
    ", [-1 / r['floquet'] for r in reading('F')]",
)
def _(found):
    (free, _), rubbed, wait = found
    text = f"{free} distinct turning points without friction, {rubbed} with: the other "
    text += "way round. Only the way there is long: an e-folding takes "
    text += f"{wait[1]:.0f} on a pin of 10 mm, {wait[3]:.0f} on 100 mm"
    return text, holds(min(rubbed) > free)


def _counted(kinds):
    """How often each kind of motion came out."""
    names = [name for pin in kinds for name in pin]
    return ", ".join(f"{names.count(x)} {x}" for x in dict.fromkeys(names))


def _of_reading(rows):
    text = "second exponent after the hardest kick (its cycle's by Floquet), on "
    text += ", ".join(
        f"{r['radius']:g} m: {r['across']:.4f} +- {r['error']:.4f} "
        + (f"({r['floquet']:.4f})" if r["floquet"] < np.inf else "(-)")
        for r in rows
    )
    text += "; 18 runs: " + _counted([r["kinds"] for r in rows])
    if any(name == "chaotic" for r in rows for name in r["kinds"]):
        return text, CONFIRMED
    open_pins = [f"{r['radius']:g} m" for r in rows if "undecided" in r["kinds"]]
    if not open_pins:
        return text, REFUTED
    there = f"; {OPEN} on {', '.join(open_pins)}: the run does not tell a cycle that "
    there += "is reached too slowly from quasi-periodic motion"
    return text, (REFUTED if len(open_pins) < len(rows) else OPEN) + there


for _name, _said in (
    ("F", "normal load F, set-valued"),
    ("10 N", "constant normal load 10 N, set-valued"),
    ("reaction", "the joint's reaction, set-valued"),
    ("F, smoothed", "F, smoothed with 0.1 rad/s on every pin"),
    (
        "reaction, smoothed",
        "the joint's reaction, smoothed with 0.1 rad/s on every pin",
    ),
):
    row(
        f"Quasi-periodic, dense, chaotic motion at q = 2.6: {_said}",
        f"reading({_name!r})",
    )(_of_reading)


@row(
    "The motion is quasi-periodic and deterministically chaotic (the paper against "
    "itself)",
    "None",
)
def _(_):
    text = "quasi-periodic motion has a largest exponent of 0, chaos a positive one"
    return text, f"{REFUTED} as a pair{TEXT}"


@row(
    "Quasi-periodicity comes of sticking and slipping in turn",
    "[(float(x[1]), r['floquet']) for x, r in zip(sticks(), reading('F'))]",
)
def _(found):
    stick = [(share, rate) for share, rate in found if share > 0.01]
    text = "pins on which joint 2 sticks more than 1 % of the time: " + ", ".join(
        f"{share:.0%}, exponent {rate:.2f}" for share, rate in stick
    )
    return text, holds(any(not rate < 0 for _, rate in stick))


@row(
    "(Fig 4 is that motion)",
    "[MU_K * r * 2.6 for r in (0.001, 1.0)], [x['kinds'] for n in READINGS "
    "for x in reading(n)]",
)
def _(found):
    torques, kinds = found
    text = "mu alone leaves the torque open: {:.1e} or {:.2f} k as the program's "
    text = text.format(*torques) + "default radius, one unit, is 1 mm or 1 m; "
    text += f"of all runs above {_counted(kinds)}"
    missing = "pin radius, normal load, transition velocity, kick, span, an exponent"
    chaotic = any("chaotic" in pin for pin in kinds)
    unsure = chaotic or "undecided" in sum(kinds, [])
    return text, f"{OPEN}: missing {missing}" if unsure else holds(chaotic)


@row(
    "The falling characteristic is needed for stick-slip",
    "[float(settled(law(r, None, m, 0.1)).stick_fraction[1]) "
    "for r in (0.3, 1.0) for m in (0.1, 0.12)]",
)
def _(sticks):
    text = "joint 2 sticks {:.1%} of the time with mu_s = mu_k = 0.1, {:.1%} with 0.12 "
    text += "and 0.1, on 0.3 m; {:.1%} and {:.1%} on 1 m"
    return text.format(*sticks), holds(min(sticks[0], sticks[2]) == 0)


@row(
    "Each cycle dissipates a different amount of energy",
    "[losses(r) for r in (0.03, 0.1, 1.0)]",
)
def _(spreads):
    text = "spread of the loss over ten settled cycles, relative, on 0.03, 0.1, 1 m: "
    text += ", ".join(f"{x:.0e}" for x in spreads)
    return text, holds(max(spreads) > 0.01)


@row(
    "Near the threshold stick-slip is strong",
    "[float(x[1]) for x in sticks()]",
)
def _(sticks):
    text = "joint 2 sticks " + ", ".join(f"{x:.1%}" for x in sticks)
    text += " of the time on pins of 0.001, 0.01, 0.03, 0.1, 0.3, 1 m"
    if min(sticks) > 0.05:
        return text, CONFIRMED
    return text, holds(False) if max(sticks) < 0.05 else f"{OPEN}: pin radius not given"


@row(
    "The friction model tells static from kinetic friction in the run",
    "[regimes(0.1, rate) for rate in (0.01, 0.1, 1.0, 10.0)]",
)
def _(shares):
    text = "on a pin of 0.1 m, joint 2's shares of time in static, passing, dynamic "
    text += "friction, with a transition at 0.01, 0.1, 1, 10 rad/s: " + ", ".join(
        "{:.0%} {:.0%} {:.0%}".format(*x) for x in shares
    )
    told = [min(static, dynamic) > 0.01 for static, _, dynamic in shares]
    missing = f"{OPEN}: missing transition velocity and pin radius"
    return text, holds(all(told), missing if any(told) else REFUTED)


@row(
    "The Adams model ran in a linear and in a nonlinear formulation",
    "None",
)
def _(_):
    text = "one model of rigid bodies is described; how Fig 2 was run is not said"
    return text, f"{OPEN}{TEXT}: missing the linear model"
