"""The paper's Figure 4, friction 0.12 and 0.10 at q = 2.6, into seed_fig4.png.

The pin radius R is not given; the joints carry the follower force here. On 10 mm to 1 m
what is kicked hard enough to slip ends on one closed cycle (orange). A thin pin only
takes long: its transient fills the phase plane.
"""

import numpy as np
import seed_style as style

import ziegler_jax as zj

Q = 2.6
RUNS = (  # pin radius (m), kick, span, when the cycle is drawn
    (0.01, 0.2, 400.0, 2000.0),
    (0.1, 0.2, 60.0, 400.0),
    (1.0, 2.0, 60.0, 400.0),
)
CYCLE, SAMPLES = 8.0, 800  # a little longer than any period


def main():
    figure, axes = style.rows(len(RUNS))
    for panels, (radius, kick, span, late) in zip(axes, RUNS, strict=True):
        law = zj.SetValuedCoulomb(style.MU_S, style.MU_K, pin_radius=radius)
        column = zj.uniform_rods(q=Q, friction=law)
        first, last = np.linspace(0, span, 6000), late + np.linspace(0, CYCLE, SAMPLES)
        motion = zj.trajectory(
            column, zj.State(omega=(0.0, kick)), np.concatenate([first, last])
        )
        shown = style.part(motion, 0, span)
        kick_si = kick / style.UNITS.time
        history, phase = style.draw(
            panels, shown, f"$R = {radius:g}$ m, kick {kick_si:.2g} rad/s"
        )
        cycle = style.UNITS.restore(style.part(motion, late, np.inf))
        black = {"color": "black", "lw": 1.6, "zorder": 4}
        phase.plot(cycle.phi[:, 0], cycle.omega[:, 0], **black)
        phase.plot(cycle.phi[:, 1], cycle.omega[:, 1], label="settled", **black)
        rate = np.asarray(shown.omega[:, 1] - shown.omega[:, 0])
        history.fill_between(
            style.seconds(np.asarray(shown.ts)),
            0,
            1,
            where=rate == 0.0,
            transform=history.get_xaxis_transform(),
            color=style.SKY,
            alpha=0.7,
            lw=0,
            zorder=0,
            label="joint 2 sticks",
        )
    style.save(figure, __file__)


if __name__ == "__main__":
    main()
