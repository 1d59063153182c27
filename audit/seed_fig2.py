"""The paper's Figure 2, the column under its critical load 2.54, into seed_fig2.png.

2.54 lies below q_cr = 2.5417: two close frequencies beat. The first half of a beat
looks like flutter; the whole run is bounded. At q_cr itself it grows linearly.
"""

import numpy as np
import seed_style as style

import ziegler_jax as zj

KICK = zj.State(omega=(0.0, 1e-4))  # rod 2, as in the paper; so small, it is linear
Q = 2.54


def run(q, span):
    return zj.trajectory(zj.uniform_rods(q=q), KICK, np.linspace(0, span, 4001))


def main():
    figure, axes = style.rows(3)
    spectrum = np.abs(np.imag(zj.spectrum(zj.uniform_rods(q=Q))))
    beat = 2 * np.pi / (spectrum.max() - spectrum.min())
    style.draw(axes[0], run(Q, beat / 2), f"$q = {Q}$, half a beat looks like flutter")
    style.draw(
        axes[1],
        run(Q, 4 * beat),
        f"$q = {Q}$, four beats of {style.seconds(beat):.1f} s: bounded",
    )
    q_cr = float(zj.critical_load(zj.uniform_rods()).q_cr)
    style.draw(
        axes[2],
        run(q_cr, 4 * beat),
        f"$q = q_{{cr}}$ = {q_cr:.6f}: it grows as $t$, not as an exponential",
    )
    style.save(figure, __file__)


if __name__ == "__main__":
    main()
