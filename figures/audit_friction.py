"""Rows of the audit: the column with friction."""

from audit_rows import OPEN, REFUTED, holds, row


@row("Dry friction in the joints can destabilise", "below_critical(2.0)")
def _(found):
    (free, cycle), small = found
    text = f"at q = 2 a kick of 0.5 swings joint 1 by {free:.2f} without friction, by "
    text += f"{cycle:.2f} with R = 0.03 m; a kick of 0.01 ends {small}"
    good = cycle > 2 * free and small == "stuck"
    return text, holds(good) + " for a kick; at rest friction holds it at every load"


@row(
    "A small velocity of the upper joint loses stability",
    "[zj.OUTCOME(int(settled(law(r), kick=0.1).outcome)).name "
    "for r in (0.01, 0.1, 1.0)]",
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
    "max_windows=100).amplitude.rod[0])) for k in (0.02, 2, 4)]",
)
def _(found):
    pairs = ", ".join(f"{free:.2f} and {rub:.2f} at {k:g}" for k, free, rub in found)
    text = f"phi1 swings, without friction and on 100 mm, by kick: {pairs}"
    raised = any(rub > free for _, free, rub in found)
    return text, holds(not raised, f"{REFUTED} as a rule: it depends on the kick")


@row(
    "With friction vibrations reach constant amplitude",
    "[r['outcome'] for r in reading('F')]",
)
def _(names):
    text = "pins of 1 mm to 1 m, load F: " + ", ".join(names)
    return text, holds(all(name == "cycle" for name in names))


@row(
    "Friction alters the attractor and the motion after the onset",
    "section(resolved(2.6, 3000), 1500), [r['turns'][0] for r in reading('F')]",
)
def _(found):
    (free, _), rubbed = found
    text = f"distinct turning points: {free} without friction, {rubbed} with: there is "
    text += "no attractor without"
    return text, holds(max(rubbed) < free)


@row(
    "Without friction lines are clean; friction blurs and fills the phase plane",
    "section(resolved(2.6, 3000), 1500), [r['turns'][0] for r in reading('F')], "
    "[-1 / r['exponent'] for r in reading('F')]",
)
def _(found):
    (free, _), rubbed, wait = found
    text = f"{free} distinct turning points without friction, {rubbed} with: the other "
    text += "way round. Only the way there is long: an e-folding takes "
    text += f"{wait[1]:.0f} on a pin of 10 mm, {wait[3]:.0f} on 100 mm"
    return text, holds(min(rubbed) > free)


def _of_reading(rows):
    moving = [r for r in rows if r["outcome"] != "stuck"]
    text = "exponent across the flow, on pins of "
    text += ", ".join(f"{r['radius']:g} m: {r['exponent']:.4f}" for r in moving)
    turns = [r["turns"][0] for r in moving]
    text += f"; distinct turning points {turns}"
    chaotic = max(r["exponent"] for r in moving) > 0 or max(turns) > 10
    return text, holds(chaotic)


for _name, _said in (
    ("F", "normal load F, set-valued"),
    ("constant 10 N", "constant normal load, set-valued"),
    ("F, smoothed", "F, smoothed with 0.1 rad/s on every pin"),
    ("|R|, smoothed", "the joint's reaction, smoothed with 0.1 rad/s on every pin"),
):
    row(
        f"Quasi-periodic, dense, chaotic motion at q = 2.6: {_said}",
        f"reading({_name!r})",
    )(_of_reading)


@row(
    "(Fig 4 is that motion)",
    "[MU_K * r * 2.6 for r in (0.001, 1.0)]",
)
def _(torques):
    text = "mu alone leaves the torque open: {:.1e} or {:.2f} k as the program's "
    text = text.format(*torques) + "default radius, one unit, is 1 mm or 1 m"
    missing = "pin radius, normal load, transition velocity, kick, span, an exponent"
    return text, f"{OPEN}: missing {missing}"


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
    "[r['sticks'][1] for r in reading('F')]",
)
def _(sticks):
    text = "joint 2 sticks " + ", ".join(f"{x:.1%}" for x in sticks)
    text += " of the time on pins of 0.001, 0.01, 0.03, 0.1, 0.3, 1 m; joint 1 never"
    return text, f"{OPEN}: the pin radius is not given; none on thin pins"


@row(
    "The friction model tells static from kinetic friction in the run",
    "[regimes(r) for r in (0.01, 0.1, 1.0)]",
)
def _(shares):
    text = "with 0.1 rad/s on every pin, share of time of joint 2 in static friction "
    text += "and in passage (to 1.5 v) on 0.01, 0.1, 1 m: " + ", ".join(
        f"{a:.1%} + {b:.1%}" for a, b in shares
    )
    return text, f"{OPEN}: missing transition velocity and pin radius"
