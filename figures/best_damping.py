"""The best ratio of small dampings, by gradient and by scan, and what moves q_cr."""

import colours
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import style

import ziegler_jax as zj

SYMBOLS = {
    "kappa": r"$\kappa$",
    "follower": r"$\eta$",
    "damping.c1": r"$c_1$",
    "damping.c2": r"$c_2$",
}


def draw_elasticities(table, ax):
    """Bars of a table of `zj.sensitivity`, the largest on top."""
    order = np.argsort(np.nan_to_num(np.abs(table.elasticity.values)))
    names = [str(name) for name in table.parameter.values[order]]
    bars = table.elasticity.values[order]
    # blue raises the load, vermillion lowers it: told apart by the side of zero as well
    sides = np.where(bars >= 0, colours.BLUE, colours.VERMILLION)
    ax.barh(names, np.nan_to_num(bars), color=sides)
    ax.set_yticks(range(len(names)), [SYMBOLS.get(n, n) for n in names])
    ax.bar_label(
        ax.containers[-1],
        ["undefined" if np.isnan(x) else f"{x:+.2f}" for x in bars],
        padding=3,
    )
    ax.margins(x=0.16)
    ax.axvline(0, color="0.2", lw=0.8)
    ax.spines[["top", "right", "left"]].set_visible(False)
    ax.tick_params(axis="y", length=0)
    ax.set_xlabel(r"elasticity $(p/q_{cr})\,dq_{cr}/dp$")
    name = "q_{cr}" if table.kind == "flutter" else f"q_\\mathrm{{{table.kind}}}"
    scene = "uniform rods, $c_1 = c_2 = 0.1$"
    ax.set_title(f"{scene}: ${name}$ = {table.q_cr:.4f}", loc="left")


def main():
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.4), width_ratios=(1.2, 1))
    columns = (
        (style.SEED, zj.uniform_rods, colours.BLUE, "-"),
        (
            style.ZIEGLER,
            lambda **parts: zj.point_masses(2, 1, **parts),
            colours.VERMILLION,
            "--",
        ),
    )
    x = np.linspace(np.log(0.05), np.log(300), 2000)
    for name, make, colour, dash in columns:

        def scene(log_ratio, make=make):
            return make(damping=zj.Viscous(1e-9 * jnp.exp(log_ratio), 1e-9))

        scan = jax.vmap(lambda x, f=scene: zj.critical_load(f(x)).q_cr)(x)
        best = zj.stabilise(scene, {"log_ratio": (x[0], x[-1])}, start={"log_ratio": 0})
        path = best.history
        left.semilogx(np.exp(x), scan, dash, color=colour, lw=2.5, label=name)
        left.plot(
            np.exp(path.log_ratio), path.q_cr, "o", color=colour, mec="k", mew=0.6, ms=6
        )
        ratio = np.exp(best.parameters["log_ratio"])
        left.plot(ratio, best.load.q_cr, "*", color=colour, mec="k", mew=0.8, ms=18)
        left.annotate(
            f"{ratio:.3f}",
            (ratio, float(best.load.q_cr)),
            (0, 11),
            textcoords="offset points",
            ha="center",
        )
        print(name, ratio, x[np.argmax(scan)], float(best.load.q_cr))
    left.set_ylim(None, 2.75)
    left.set_xlabel("ratio $c_1/c_2$ of vanishing damping")
    left.set_ylabel("critical load $q_{cr}$")
    left.set_title("Critical load of weakly damped columns", loc="left")
    look = {"color": "white", "mec": "k", "ls": "none"}
    left.plot([], [], "o", ms=6, **look, label="steps of stabilise")
    left.plot([], [], "*", ms=14, **look, label="the best ratio")
    left.legend(loc="lower right")
    left.spines[["top", "right"]].set_visible(False)
    column = zj.uniform_rods(damping=zj.Viscous(0.1, 0.1))
    draw_elasticities(zj.sensitivity(column), right)
    figure.tight_layout()
    style.save(figure, __file__)


if __name__ == "__main__":
    main()
