"""The paper's Figure 3, the column without friction at q = 2.6, into seed_fig3.png.

Neither the printed equations nor the right ones close into a limit cycle, nor does a
stiff BDF method at the paper's tolerance, which feeds the motion energy.
"""

import numpy as np
import seed_style as style
from scipy.integrate import solve_ivp

import ziegler_jax as zj

Q, KICK, SPAN = 2.6, 0.02, 400.0
LONG = 3000.0  # where the method's error shows


def as_printed(t, y, q):
    """Eq (3) of the paper, letter for letter, in its own time.

    Row 1 lacks + phi2'^2 sin D; row 2 has phi2'^2 where phi1'^2 belongs.
    """
    phi1, phi2, w1, w2 = y
    s, c = np.sin(phi1 - phi2), np.cos(phi1 - phi2)
    r1, r2 = q * s - 2 * phi1 + phi2, w2**2 * s + phi1 - phi2
    det = 16 / 9 - c * c
    return [w1, w2, (2 / 3 * r1 - c * r2) / det, (8 / 3 * r2 - c * r1) / det]


def printed(q, span, kick=KICK):
    """A run of Eq (3) as printed, in the units of Eq (2)."""
    ts = np.linspace(0, span, round(20 * span) + 1)
    rate = np.array([1, 1, style.SEED_TIME, style.SEED_TIME])  # of the paper's time
    run = (0, ts[-1] * style.SEED_TIME), [0, 0, 0, kick] / rate, "DOP853"
    tight = {"t_eval": ts * style.SEED_TIME, "rtol": 1e-10, "atol": 1e-12}
    y = solve_ivp(lambda t, y: as_printed(t, y, q), *run, **tight).y
    return style.motion_of(ts, y * rate[:, None])


def resolved(q, span, kick=KICK, **options):
    """A run of the right equations by this engine."""
    ts = np.linspace(0, span, round(20 * span) + 1)
    column = zj.uniform_rods(q=q)
    return zj.trajectory(column, zj.State(omega=(0.0, kick)), ts, **options)


def main():
    figure, axes = style.rows(3)
    titles = "Eq (3) as printed: bursts", "right equations, resolved: bursts, no cycle"
    for panels, run, title in zip(axes[:2], (printed, resolved), titles, strict=True):
        style.draw(panels, run(Q, SPAN), title)
    motion = style.stiff(Q, LONG, KICK)
    first, last = style.part(motion, 0, SPAN), style.part(motion, LONG - SPAN, LONG)
    grown = " to ".join(f"{np.abs(x.phi[:, 1]).max():.2f}" for x in (first, last))
    title = f"the same by BDF at error $10^{{-5}}$: it feeds the motion, {grown} rad"
    style.draw(axes[2], last, title)
    style.save(figure, __file__)


if __name__ == "__main__":
    main()
