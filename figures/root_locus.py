"""Eigenvalues of the paper's column as the load rises: two frequencies meet at q_cr."""

import colours
import jax
import matplotlib.pyplot as plt
import numpy as np
import style

import ziegler_jax as zj


def main():
    q = np.linspace(0, 6, 2401)
    s = np.asarray(jax.vmap(lambda q: zj.spectrum(zj.uniform_rods(q)))(q))
    begin = zj.critical_load(zj.uniform_rods())
    end = zj.critical_load(zj.uniform_rods(), "flutter_end")
    figure, (left, right) = plt.subplots(1, 2, figsize=(10.5, 4.4), width_ratios=(1, 1))
    for ax, part, name in (
        (left, s.imag, r"frequency $\mathrm{Im}\,s$  ($\sqrt{k/(ml^2)}$)"),
        (right, s.real, r"growth rate $\mathrm{Re}\,s$  ($\sqrt{k/(ml^2)}$)"),
    ):
        ax.axvspan(float(begin.q_cr), float(end.q_cr), color=colours.PALE_ORANGE, lw=0)
        ax.plot(q, part, ".", ms=2.2, color=colours.BLUE)
        ax.axvline(float(begin.q_cr), color=colours.VERMILLION, lw=1.5)
        ax.axvline(float(end.q_cr), color=colours.VERMILLION, lw=1.5, ls="--")
        ax.set_xlabel("load $q = Fl/k$")
        ax.set_title(name, loc="left")
        ax.set_xlim(0, 6)
        ax.spines[["top", "right"]].set_visible(False)
    left.set_ylim(0, 4.1)
    right.set_ylim(-2.2, 2.2)
    left.plot(
        begin.q_cr, begin.frequency, "o", color=colours.VERMILLION, ms=9, zorder=3
    )
    left.annotate(
        f"coalescence\n$q_{{cr}}$ = {float(begin.q_cr):.4f}\n"
        rf"$\omega$ = {float(begin.frequency):.4f}",
        (float(begin.q_cr), float(begin.frequency)),
        (14, 22),
        textcoords="offset points",
    )
    right.text(3.6, -2.0, "flutter", ha="center", color=colours.VERMILLION)
    right.text(5.35, -0.08, "divergence", ha="center", color="0.3")
    right.text(1.2, 0.12, "oscillates", ha="center", color="0.3")
    right.annotate(
        f"end of flutter\n$q$ = {float(end.q_cr):.4f}",
        (float(end.q_cr), 2.15),
        (-10, 0),
        textcoords="offset points",
        ha="right",
        va="top",
    )
    figure.suptitle("Uniform rods without damping", x=0.02, ha="left", size=13)
    figure.tight_layout()
    style.save(figure, __file__)


if __name__ == "__main__":
    main()
