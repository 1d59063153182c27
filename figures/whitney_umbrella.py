"""Whitney's umbrella: q_cr over both dampings, with eigenvalues lying on it.

Every ray of constant c1/c2 reaches the axis c = 0 at its own load; the undamped load
is the top of the axis, which one ratio alone attains. The points are loads at which
the largest real part of the numeric spectrum changes sign, found by bisection.
"""

import colours
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import style
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

import ziegler_jax as zj

C1, C2 = 1.0, 0.3
POINTS = {"marker": "o", "ls": "none", "color": colours.VERMILLION}
POINTS |= {"ms": 3.5, "mec": "k", "mew": 0.3}


def column(c1, c2, q=0.0):
    return zj.uniform_rods(q, damping=zj.Viscous(c1, c2))


def by_eigenvalues(c1, c2):
    """The load where max Re s changes sign, by bisection on the spectrum alone."""

    def halve(n, q):  # flutter, once begun, lasts to 3.4
        grows = zj.spectral_abscissa(column(c1, c2, q)) > 0
        return q + jnp.where(grows, -1.7, 1.7) * 0.5 ** (n + 1)

    return jax.lax.fori_loop(0, 40, halve, 1.7)


def main():
    exact = jax.vmap(lambda a, b: zj.critical_load(column(a, b)).q_cr)
    # polar mesh: each ray keeps its ratio down to the axis
    r, t = np.meshgrid(np.linspace(1e-9, 1, 60), np.linspace(0, np.pi / 2, 181))
    c1, c2 = C1 * r * np.cos(t), C2 * r * np.sin(t)
    q = jax.vmap(exact)(c1, c2)
    r, t = np.random.default_rng(4).uniform(0.02, 0.98, (2, 170)) ** [[0.5], [1.0]]
    p1, p2 = C1 * r * np.cos(t * np.pi / 2), C2 * r * np.sin(t * np.pi / 2)
    dots = jax.vmap(by_eigenvalues)(p1, p2)
    worst = float(np.max(np.abs(dots - exact(p1, p2))))
    top = float(zj.critical_load(column(0.0, 0.0)).q_cr)

    figure = plt.figure(figsize=(8.5, 6.6))
    ax = figure.add_subplot(projection="3d", computed_zorder=False)
    ax.plot_surface(c1, c2, q, cmap="cividis", alpha=0.75, rcount=90, ccount=60, lw=0)
    for ray in range(0, 181, 20):
        ax.plot(c1[ray], c2[ray], q[ray], color="0.25", lw=0.8)
    ax.plot(p1, p2, dots, **POINTS)
    ax.plot([0, 0], [0, 0], [np.min(q[:, 0]), top], color="k", lw=3)
    ax.plot([0], [0], [top], "D", color=colours.PURPLE, mec="k", ms=9)
    ax.text(0.0, -0.02, top + 0.16, f"undamped {top:.4f}", ha="center")
    ax.set_xlabel(r"$c_1$  ($\sqrt{kml^2}$)", labelpad=13)
    ax.set_ylabel(r"$c_2$  ($\sqrt{kml^2}$)", labelpad=13)
    ax.set_yticks([0.0, 0.1, 0.2, 0.3])
    ax.set_zlabel("$q_{cr} = F_{cr}l/k$")
    ax.view_init(elev=24, azim=38)
    handles = [
        Patch(facecolor="#7C7B78", label="critical load of damped uniform rods"),
        Line2D([], [], **POINTS, label="where max Re $s$ of the spectrum changes sign"),
    ]
    figure.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, 0.93))
    print(f"both differ by at most {worst:.0e}")
    style.save(figure, __file__, pad_inches=0.3)  # the 3D label sticks out


if __name__ == "__main__":
    main()
