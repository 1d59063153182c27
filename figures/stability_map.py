"""The paper's column over load and follower fraction: where it flutters or buckles."""

import colours
import matplotlib.pyplot as plt
import numpy as np
import style

import ziegler_jax as zj

COLOURS = {
    zj.CODE.marginal: (colours.GREY, 0.3),
    zj.CODE.flutter: (colours.ORANGE, 0.5),
    zj.CODE.divergence: (colours.BLUE, 0.4),
}


def regime(q, eta):
    return {"regime": zj.regime(zj.uniform_rods(q, follower=eta))}


def load(eta, kind):
    return zj.critical_load(zj.uniform_rods(follower=eta), kind)


def main():
    q, eta = np.linspace(0, 6, 1201), np.linspace(-0.5, 1.5, 1001)
    ds = zj.sweep(regime, q=q, eta=eta)
    figure, ax = plt.subplots(figsize=(8, 5))
    zj.plot.map(ds, "regime", x="eta", y="q", ax=ax, legend=False, colours=COLOURS)
    lines = (
        ("flutter", colours.VERMILLION, "-", "$q_{cr}$, flutter"),
        ("divergence", colours.BLUE, "--", "$q_{cr}$, divergence"),
    )
    for kind, colour, dash, label in lines:
        found = zj.sweep(lambda eta, kind=kind: load(eta, kind), eta=eta)
        ax.plot(eta, found.q_cr, dash, color=colour, lw=2.5, label=label)
    seed = zj.critical_load(zj.uniform_rods())
    ax.plot(1, seed.q_cr, "o", color="k", ms=8)
    ax.annotate(
        rf"$\eta = 1$:" "\n" rf"$q_{{cr}}$ = {float(seed.q_cr):.4f}",
        (1, float(seed.q_cr)),
        (6, -10),
        textcoords="offset points",
        va="top",
    )
    ax.text(0.92, 3.6, "flutter", ha="center", fontsize=15)
    ax.text(0.0, 2.6, "divergence", ha="center", va="top", fontsize=15)
    ax.text(1.0, 0.7, "marginal", ha="center", fontsize=15)
    ax.set_xlabel(r"follower fraction $\eta$   (0 dead load, 1 follower load)")
    ax.set_ylabel("load $q = Fl/k$")
    ax.set_ylim(0, 6)
    ax.set_title("Uniform rods without damping: regimes and critical loads", loc="left")
    ax.legend(loc="upper left")
    style.save(figure, __file__)


if __name__ == "__main__":
    main()
