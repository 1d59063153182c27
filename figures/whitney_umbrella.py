"""Whitney's umbrella: q_cr over both dampings, with eigenvalues lying on it.

Every ray of constant c1/c2 reaches the axis c = 0 at its own load; the undamped load
is the top of the axis, which one ratio alone attains. The points are loads at which
the largest real part of the numeric spectrum changes sign, found by bisection.
"""

import jax
import jax.numpy as jnp
import linear_style as style
import matplotlib.pyplot as plt
import numpy as np

import ziegler_jax as zj

C1, C2 = 1.0, 0.3


def column(c1, c2, q=0.0):
    return zj.uniform_rods(q, damping=zj.Viscous(c1, c2))


def by_eigenvalues(c1, c2):
    """The load where max Re s changes sign, by bisection on the spectrum alone."""

    def halve(_, bracket):
        low, high = bracket
        middle = (low + high) / 2
        grows = zj.spectral_abscissa(column(c1, c2, middle)) > 0
        return jnp.where(grows, low, middle), jnp.where(grows, middle, high)

    # flutter, once begun, lasts to the top of this bracket
    return sum(jax.lax.fori_loop(0, 40, halve, (0.0, 3.4))) / 2


def main():
    # polar mesh: each ray keeps its ratio down to the axis
    angle = np.linspace(0.0, np.pi / 2, 181)
    radius = np.linspace(1e-9, 1, 60)
    t, r = np.meshgrid(angle, radius)
    c1, c2 = C1 * r * np.cos(t), C2 * r * np.sin(t)
    q = jax.vmap(jax.vmap(lambda a, b: zj.critical_load(column(a, b)).q))(c1, c2)
    rng = np.random.default_rng(4)
    u = np.sqrt(rng.uniform(0.02, 1, 170)), rng.uniform(0.02, np.pi / 2 - 0.02, 170)
    p1, p2 = C1 * u[0] * np.cos(u[1]), C2 * u[0] * np.sin(u[1])
    dots = np.asarray(jax.vmap(by_eigenvalues)(p1, p2))
    exact = jax.vmap(lambda a, b: zj.critical_load(column(a, b)).q)(p1, p2)
    worst = float(np.max(np.abs(dots - exact)))

    figure = plt.figure(figsize=(8.5, 6.6))
    ax = figure.add_subplot(projection="3d", computed_zorder=False)
    ax.plot_surface(
        c1, c2, np.asarray(q), cmap="cividis", alpha=0.75, rcount=60, ccount=90, lw=0
    )
    for i in range(0, len(angle), 20):
        ax.plot(c1[:, i], c2[:, i], q[:, i], color="0.25", lw=0.8)
    ax.plot(p1, p2, dots, "o", color=style.ORANGE, ms=3.5, mec="k", mew=0.3)
    top = float(zj.critical_load(column(0.0, 0.0)).q)
    ax.plot([0, 0], [0, 0], [float(np.min(q[0])), top], color="k", lw=3)
    ax.plot([0], [0], [top], "D", color=style.PINK, mec="k", ms=9)
    ax.text(0.0, -0.02, top + 0.16, f"undamped {top:.4f}", ha="center")
    ax.set_xlabel(r"$c_1$  ($\sqrt{kml^2}$)", labelpad=13)
    ax.set_ylabel(r"$c_2$  ($\sqrt{kml^2}$)", labelpad=13)
    ax.set_yticks([0.0, 0.1, 0.2, 0.3])
    ax.set_zlabel("$q_{cr} = F_{cr}l/k$")
    ax.view_init(elev=24, azim=38)
    ax.set_title(
        "Surface: critical_load. Points: sign changes of the numeric spectrum\n"
        f"(uniform rods; they differ by at most {worst:.0e})",
        fontsize=12,
        y=1.0,
    )
    style.save(figure, __file__, pad_inches=0.3)  # the 3D label sticks out


if __name__ == "__main__":
    main()
