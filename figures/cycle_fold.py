"""Where rest and flutter coexist, and the cycles that meet at the fold between them."""

import colours
import jax
import matplotlib.pyplot as plt
import numpy as np
import style

import ziegler_jax as zj


def scene(tau, q):  # constant torque in both joints, mu_s = mu_k
    law = zj.SetValuedCoulomb(tau, pin_radius=1.0, load=zj.ConstantLoad(1.0))
    column = lambda q: zj.uniform_rods(q, friction=law)  # noqa: E731
    kicked = zj.settle(column(q), zj.State(omega=(0.0, 3.0)), certify=False)
    return column, zj.periodic_orbit(column(q), kicked.final), q


@jax.jit
@jax.vmap
def folds(tau):
    column, orbit, q = scene(tau, 1.95)
    return zj.bifurcation(column, "fold", orbit, q)


@jax.jit
def branch(tau):
    arc = zj.Arc(direction=-1, points=150, step=0.05, bounds=(1.0, 2.75))
    return zj.continue_cycle(*scene(tau, 2.7), arc=arc)


def main():
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(10.5, 4.2))
    tau = np.linspace(0.01, 0.1, 10)  # above, another fold comes first
    fold = np.asarray(folds(tau).parameter)
    tau, fold = tau[np.isfinite(fold)], fold[np.isfinite(fold)]
    q_cr = float(zj.critical_load(zj.uniform_rods()).q_cr)
    both = np.append(14 / 11, fold)  # from its limit on
    left.fill_betweenx(np.append(0, tau), both, 3, color=colours.PALE_ORANGE, lw=0)
    left.plot(fold, tau, "o-", color=colours.BLUE, lw=2.5, label="fold of cycles")
    left.plot(
        14 / 11, 0, "o", color="w", mec=colours.BLUE, label="its limit, $q = 14/11$"
    )
    left.axvline(q_cr, color=colours.VERMILLION, ls="--", label="$q_{cr}$, no friction")
    left.text(0.84, 0.062, "no cycle", fontsize=11)
    left.text(1.56, 0.062, "rest\nand flutter", fontsize=11)
    left.set(xlim=(0.8, 3), ylim=(0, tau.max()), ylabel=r"friction torque $\tau$ ($k$)")
    left.set_title("uniform rods, dry friction", loc="left")
    points = branch(0.1).points
    q, stable = np.asarray(points.parameter), np.asarray(points.stable)
    moduli = np.abs(np.asarray(points.multipliers))
    for kind, dash in ((stable, "-"), (~stable, "--")):
        along = np.where(kind | np.roll(kind, 1), q, np.nan)  # to the next kind's first
        middle.plot(
            along, points.joint_amplitude[:, 1], dash, color=colours.BLUE, lw=2.5
        )
        for i, colour in ((1, colours.BLUE), (2, colours.ORANGE)):
            right.plot(along, moduli[:, i], dash, color=colour, lw=2)
    right.axhline(1, color="0.6", lw=1)
    right.plot([], color=colours.BLUE, label="the largest beside 1")
    right.plot([], color=colours.ORANGE, label="the next")
    middle.set(ylabel=r"largest $|\varphi_2 - \varphi_1|$ (rad)", ylim=(0, None))
    right.set(ylabel="modulus of Floquet multiplier", ylim=(0, 2.5))
    middle.plot([], color=colours.BLUE, lw=2.5, label="stable")
    middle.plot([], "--", color=colours.BLUE, lw=2.5, label="unstable")
    middle.legend(loc="lower right")
    middle.set_title(r"cycles at $\tau = 0.1\,k$", loc="left")
    right.set_title("their multipliers", loc="left")
    for ax in (middle, right):
        ax.set_xlim(1.5, 2.7)
    for ax in (left, middle, right):
        ax.set_xlabel("load $q = Fl/k$")
        ax.spines[["top", "right"]].set_visible(False)
    left.legend(loc="lower right", fontsize=10, frameon=True)
    right.legend(loc="upper right", fontsize=11)
    figure.tight_layout()
    style.save(figure, __file__)


if __name__ == "__main__":
    main()
