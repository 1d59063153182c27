"""Where cycles bifurcate over load and friction: folds, and what ends their curves."""

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import style

import ziegler_jax as zj

STARTS = {  # a torque, and which fold down the branch of its cycle at q = 1.95
    (0.03, 0): (zj.plot.BLUE, "folds of the lowest cycle"),
    (0.1, 0): (zj.plot.VERMILLION, "joint 2 sticks once more"),
    (0.1, 1): (zj.plot.PURPLE, "the way to another cycle"),
    (0.2, 0): (zj.plot.GREEN, "folds of that"),
}


def cycle(q, tau):
    settled = zj.settle(style.dry(q, tau), zj.State(omega=(0.0, 3.0)), certify=False)
    return zj.periodic_orbit(style.dry(q, tau), settled.final)


@jax.jit
def curves(tau, which):
    arc = zj.Arc(direction=-1, bounds=(1.2, 2.0))
    start = cycle(1.95, tau), 1.95
    branch = zj.continue_cycle(lambda q: style.dry(q, tau), *start, arc=arc)
    folds = jax.tree.map(lambda x: jnp.roll(x, -which, axis=0), branch.special)
    course = zj.Course(points=334, second=(0.0025, 0.3))
    return zj.bifurcation_curve(style.dry, "fold", folds, second=tau, course=course)


@jax.jit
def onset(q, tau):
    given = {"first": q, "second": tau}
    course = zj.Course(points=100, second=(0.008, 0.05), first=(1.7, 2.6))
    given |= {"start": cycle(q, tau), "course": course}
    return zj.bifurcation_curve(style.dry, "sticking_2", **given)


def main():
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.6), layout="constrained")
    for start, (colour, label) in STARTS.items():
        curve = curves(*start)
        points = curve.points
        grazes = np.asarray(curve.ends) == zj.CURVE.modes_change
        ends = np.flatnonzero(np.isfinite(points.first))[[0, -1]][grazes]
        for ax in (left, right):
            ax.plot(points.second, points.first, color=colour, lw=2.5, label=label)
            ax.plot(points.second[ends], points.first[ends], "o", color=colour)
    points = onset(2.5, 0.023).points
    left.plot(points.second, points.first, "k--", label="joint 2 begins to stick")
    for ax in (left, right):
        ax.set_xlabel(r"friction torque $\tau$ in both joints")
        ax.spines[["top", "right"]].set_visible(False)
    left.legend(loc="lower right")
    right.set(xlim=(0, 0.1), ylim=(1.25, 1.75), title="the same, close up")
    left.set(
        ylabel="follower load $q = F l/k$",
        title="folds of cycles; dots: stick and slip in another order beyond",
    )
    figure.suptitle("Set-valued friction, both torques constant and equal")
    style.save(figure, __file__)


if __name__ == "__main__":
    main()
