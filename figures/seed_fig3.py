"""The seed's Figure 3, the column without friction at q = 2.6, into seed_fig3.png.

Neither the printed equations nor the right ones close into a limit cycle, nor does a
stiff BDF method at the seed's tolerance, which feeds the motion energy.
"""

import numpy as np
import seed_style as style
from scipy.integrate import solve_ivp

import ziegler_jax as zj

Q, KICK, SPAN = 2.6, 0.02, 400.0
LONG = 3000.0  # where the method's error shows


def as_printed(t, y, q):
    """Eq (3) of the seed, letter for letter, in its own time.

    Row 1 lacks + phi2'^2 sin D; row 2 has phi2'^2 where phi1'^2 belongs.
    """
    phi1, phi2, w1, w2 = y
    s, c = np.sin(phi1 - phi2), np.cos(phi1 - phi2)
    mass = np.array([[8 / 3, c], [c, 2 / 3]])
    force = [q * s - 2 * phi1 + phi2, w2**2 * s + phi1 - phi2]
    return [w1, w2, *np.linalg.solve(mass, force)]


def printed(q, span, kick=KICK, **options):
    """A run of Eq (3) as printed, in the units of Eq (2)."""
    ts = np.linspace(0, span * style.SEED_TIME, 8001)
    start, tight = (0, 0, 0, kick / style.SEED_TIME), {"rtol": 1e-10, "atol": 1e-12}
    found = solve_ivp(
        as_printed, (0, ts[-1]), start, "DOP853", ts, args=(q,), **(tight | options)
    )
    y = found.y * np.array([[1, 1, style.SEED_TIME, style.SEED_TIME]]).T
    return style.motion_of(ts / style.SEED_TIME, y)


def stiff(q, span, kick=KICK, error=1e-5):
    """A run of the right equations by scipy's BDF, in place of the seed's HASTIFF."""
    column = zj.uniform_rods(q=q)
    a, b, d = float(column.a), float(column.b), float(column.d)

    def field(t, y):
        phi1, phi2, w1, w2 = y
        s, c = np.sin(phi1 - phi2), np.cos(phi1 - phi2)
        r1, r2 = q * s - 2 * phi1 + phi2 - b * s * w2**2, phi1 - phi2 + b * s * w1**2
        h = b * c
        det = a * d - h * h
        return [w1, w2, (d * r1 - h * r2) / det, (a * r2 - h * r1) / det]

    ts = np.linspace(0, span, round(20 * span) + 1)
    found = solve_ivp(
        field, (0, span), (0, 0, 0, kick), "BDF", ts, rtol=error, atol=error
    )
    return style.motion_of(ts, found.y)


def resolved(q, span, kick=KICK, **options):
    """A run of the right equations by this engine."""
    ts = np.linspace(0, span, round(20 * span) + 1)
    column = zj.uniform_rods(q=q)
    return zj.trajectory(column, zj.State(omega=(0.0, kick)), ts, **options)


def main():
    figure, axes = style.rows(3)
    style.draw(axes[0], printed(Q, SPAN), "Eq (3) as printed: bursts")
    style.draw(
        axes[1], resolved(Q, SPAN), "right equations, resolved: bursts, no cycle"
    )
    motion = stiff(Q, LONG)
    growth = [
        np.abs(motion.phi[part, 1]).max() for part in (slice(8000), slice(-8000, None))
    ]
    style.draw(
        axes[2],
        style.part(motion, LONG - SPAN, LONG),
        "the same by BDF at error $10^{-5}$: it feeds the motion, "
        f"{growth[0]:.2f} to {growth[1]:.2f} rad",
    )
    style.save(figure, __file__)


if __name__ == "__main__":
    main()
