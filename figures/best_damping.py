"""The best ratio of small dampings, by gradient and by scan, and what moves q_cr."""

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import style

import ziegler_jax as zj


def main():
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.4), width_ratios=(1.2, 1))
    columns = (
        (style.SEED, zj.uniform_rods, zj.plot.BLUE, "-"),
        (
            style.ZIEGLER,
            lambda **parts: zj.point_masses(2, 1, **parts),
            zj.plot.VERMILLION,
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
        left.plot(ratio, best.load.q, "*", color=colour, mec="k", mew=0.8, ms=18)
        left.annotate(
            f"{ratio:.3f}",
            (ratio, float(best.load.q)),
            (0, 11),
            textcoords="offset points",
            ha="center",
        )
        print(name, ratio, x[np.argmax(scan)], float(best.load.q))
    left.set_ylim(None, 2.75)
    left.set_xlabel("ratio $c_1/c_2$ of vanishing damping")
    left.set_ylabel("critical load $q_{cr}$")
    left.set_title("Curve: scan. Points: steps of stabilise", loc="left")
    left.legend(loc="lower right")
    left.spines[["top", "right"]].set_visible(False)
    column = zj.uniform_rods(damping=zj.Viscous(0.1, 0.1))
    zj.plot.sensitivity(zj.sensitivity(column), right)
    figure.tight_layout()
    style.save(figure, __file__)


if __name__ == "__main__":
    main()
