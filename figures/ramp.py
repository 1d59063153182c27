"""A load ramped up and down through dry friction's onset, beside the staircase."""

import colours
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import style

import ziegler_jax as zj

LOW, HIGH, KICK, BETWEEN = 1.2, 2.6, 0.2, 100.0  # a tap each so many time units
SHORT = 0.2  # a tap
LOADS = np.linspace(LOW, HIGH, 43)
SCENES = ((0.04, 0.04), (0.06, 0.03))  # tau_s, tau_k
RATES = (1.4e-3, 2e-4)
WAYS = (("down", "v", colours.BLUE), ("up", "^", colours.VERMILLION))


class Taps(zj.AbstractForce):
    """Half a sine of 0.2 time units, with the momentum of the staircase's kicks."""

    autonomous = False
    kick: float
    between: float

    def torques(self, t, phi, omega):
        """On both rods, of which the tap changes rod 2's rate alone."""
        place = jnp.mod(t, self.between) / SHORT
        push = jnp.where(place < 1, jnp.pi / 2 * jnp.sin(jnp.pi * place) / SHORT, 0.0)
        return (
            self.kick / 2 * jnp.cos(phi[0] - phi[1]) * push,
            self.kick / 3 * push,
        )


def ramped(mu_s, mu_k, rate):
    """The load and joint 2's largest angle in the last third before each tap."""
    turn = np.round((HIGH - LOW) / rate / BETWEEN) * BETWEEN
    history = zj.LoadHistory((0.0, turn, 2 * turn), (0.0, HIGH - LOW, 0.0))
    law = style.dry(0.0, mu_s, mu_k).friction
    column = zj.uniform_rods(LOW, friction=law, forces=(history, Taps(KICK, BETWEEN)))
    # steps end on all of them: no tap is missed
    offsets = np.concatenate([[0.05, 0.1, 0.15, 0.2], np.arange(0.25, 100.1, 0.25)])
    count = round(2 * turn / BETWEEN)
    ts = (BETWEEN * np.arange(count)[:, None] + offsets).ravel()
    ts = np.concatenate([[0.0], ts])
    motion = jax.jit(lambda: zj.trajectory(column, zj.State(), ts))()
    assert motion.outcome == zj.CODE.complete, motion
    angle = np.abs(motion.phi[1:, 1] - motion.phi[1:, 0]).reshape(count, -1)
    middle = (np.arange(count) + 0.83) * BETWEEN
    loads = LOW + np.interp(middle, history.times, history.loads)
    return loads, angle[:, 270:].max(axis=1), middle < turn


def staircase(mu_s, ratio):
    return zj.sweep_up_down(
        lambda q: style.dry(q, mu_s, ratio * mu_s),
        LOADS,
        kick=zj.State(omega=(0.0, KICK)),
    )


def main():
    figure, axes = plt.subplots(2, 3, figsize=(11, 6), sharex=True, sharey="row")
    for row, (s, k) in zip(axes, SCENES, strict=True):
        ds = zj.sweep(staircase, mu_s=[s], ratio=[k / s]).isel(mu_s=0, ratio=0)
        for branch, mark, colour in WAYS:
            way = ds.sel(branch=branch, joint=2)
            look = {"color": colour, "mfc": "none", "ms": 4, "label": branch}
            row[0].plot(way.q, way.joint_amplitude, mark, **look)
        for ax, rate in zip(row[1:], RATES, strict=True):
            loads, peaks, up = ramped(s, k, rate)
            for (branch, mark, colour), which in zip(WAYS, (~up, up), strict=True):
                look = {"color": colour, "mfc": "none", "ms": 4, "lw": 0.6}
                ax.plot(loads[which], peaks[which], mark + "-", **look, label=branch)
            ax.set_title(rf"ramp, {rate:g} $\sqrt{{k/(m l^2)}}$", loc="left")
        torques = rf"$\tau_s = {s:g}\,k$, $\tau_k = {k:g}\,k$"
        row[0].set_title(f"stairs, {torques}", loc="left")
        row[0].set_ylabel(r"largest $|\varphi_2 - \varphi_1|$ (rad)")
    for ax in axes[1]:
        ax.set_xlabel("load $q = Fl/k$")
    axes[0, 0].legend(title="load goes")
    for ax in axes.flat:
        ax.spines[["top", "right"]].set_visible(False)
    figure.suptitle(
        rf"Dry friction; stairs: $\dot\varphi_2$ is kicked by {KICK} "
        r"$\sqrt{k/(m l^2)}$ at each load; "
        "\n"
        rf"ramps: it is tapped with the same momentum every {BETWEEN:g} "
        r"$\sqrt{m l^2/k}$",
        fontsize=12,
    )
    figure.tight_layout()
    style.save(figure, __file__)


if __name__ == "__main__":
    main()
