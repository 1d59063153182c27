"""Where cycles fold over load and friction, where folds end and sticking begins."""

import colours
import jax
import matplotlib.pyplot as plt
import numpy as np
import style

import ziegler_jax as zj

STARTS = {  # a torque, and which fold down the branch of its cycle at q = 1.95
    (0.03, 0): ("o-", colours.BLUE, "folds of the lowest cycle"),
    (0.1, 0): ("s-", colours.VERMILLION, "the same, joint 2 sticks once more"),
    (0.1, 1): ("^-.", colours.PURPLE, "folds on the way to another cycle"),
    (0.2, 0): ("D-", colours.GREEN, "folds of that cycle"),
}


def cycle(q, tau):
    settled = zj.settle(style.dry(q, tau), zj.State(omega=(0.0, 3.0)), certify=False)
    return zj.periodic_orbit(style.dry(q, tau), settled.final)


@jax.jit
def folds(tau, which):
    arc, orbit = zj.Arc(direction=-1, bounds=(1.2, 2.0)), cycle(1.95, tau)
    branch = zj.continue_cycle(lambda q: style.dry(q, tau), orbit, 1.95, arc=arc)
    start = jax.tree.map(lambda x: jax.numpy.roll(x, -which, axis=0), branch.special)
    course = zj.Course(points=334, second=(0.0025, 0.3))
    return zj.bifurcation_curve(style.dry, "fold", start, second=tau, course=course)


def change_of_modes(kind, q, tau):
    course = zj.Course(points=100, second=(0.008, 0.1), first=(1.2, 2.6))
    given = {"first": q, "second": tau, "start": cycle(q, tau), "course": course}
    return zj.bifurcation_curve(style.dry, kind, **given).points


def main():
    figure, axes = plt.subplots(1, 2, figsize=(11, 5), layout="constrained")
    for start, (line, colour, label) in STARTS.items():
        curve = folds(*start)
        x, y = curve.points.second, curve.points.first
        grazing = np.asarray(curve.ends) == zj.CODE.modes_change
        ends = np.flatnonzero(np.isfinite(y))[[0, -1]][grazing].tolist()
        for ax, shown in zip(axes, (label, None), strict=True):
            ax.plot(x, y, line, color=colour, lw=2.5, label=shown, markevery=ends)
            ax.set_xlabel(r"friction torque $\tau$ in both joints ($k$)")
    points = jax.jit(change_of_modes, static_argnums=0)("sticking_2", 2.5, 0.023)
    axes[0].plot(points.second, points.first, "k--", label="joint 2 begins to stick")
    points = jax.jit(change_of_modes, static_argnums=0)("grazing_2", 1.48, 0.05)
    axes[1].plot(points.second, points.first, "k:", lw=2, label="joint 2 grazes")
    axes[0].plot([], [], "ko", ls="none", label="an end where modes change")
    axes[0].set(ylabel="follower load $q = F l/k$")
    axes[0].set_title("Folds of cycles: uniform rods, dry friction")
    axes[1].set(xlim=(0, 0.1), ylim=(1.25, 1.75), title="the same at small torques")
    figure.legend(loc="outside lower center", ncols=3)
    style.save(figure, __file__)


if __name__ == "__main__":
    main()
