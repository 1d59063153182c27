"""What the paper's figures share: its column in SI units, its colours, its two times.

The paper is "Modeling stability of Ziegler column with consideration of dry
friction", from which this project started. Its mass matrix is doubled and its
stiffness is not, so that its time is sqrt(2) times that of its own Eq (2).
"""

from pathlib import Path

import jax
import matplotlib
import matplotlib.pyplot as plt
import numpy as np
from scipy.integrate import solve_ivp

import ziegler_jax as zj

jax.config.update("jax_enable_x64", True)
matplotlib.use("Agg")
matplotlib.rcParams.update({"font.size": 11, "axes.titlesize": 11})

UNITS = zj.SI(m=1.0, l=1.0, k=10.0)
SEED_TIME = np.sqrt(2.0)  # of the units of Eq (2)
MU_S, MU_K = 0.12, 0.10
SKY = "#56B4E9"  # Okabe and Ito's


def seconds(t):
    """From the units of Eq (2)."""
    return t * UNITS.time


def rows(count):
    """A figure of time histories, each with its phase plane."""
    return plt.subplots(
        count, 2, figsize=(9, 2.75 * count), width_ratios=(2, 1), layout="constrained"
    )


def motion_of(ts, y):
    """A `Trajectory` from another integrator's times and states (4, n)."""
    return zj.Trajectory(ts, y[:2].T, y[2:].T, None, zj.CODE.complete)


def stiff(q, span, kick, error=1e-5):
    """The column without friction by scipy's BDF, in place of the paper's HASTIFF."""
    column = zj.uniform_rods(q=q)
    a, b, d = float(column.a), float(column.b), float(column.d)

    def field(t, y):  # NumPy's: JAX would cost more than the method
        phi1, phi2, w1, w2 = y
        s, c = np.sin(phi1 - phi2), np.cos(phi1 - phi2)
        r1, r2 = q * s - 2 * phi1 + phi2 - b * s * w2**2, phi1 - phi2 + b * s * w1**2
        h = b * c
        det = a * d - h * h
        return [w1, w2, (d * r1 - h * r2) / det, (a * r2 - h * r1) / det]

    ts = np.linspace(0, span, round(20 * span) + 1)
    found = solve_ivp(
        field, (0, span), (0, 0, 0, kick), "BDF", ts, rtol=error, atol=error
    )
    return motion_of(ts, found.y)


def part(motion, begin, end):
    """The part of a motion between two times."""
    ts = np.asarray(motion.ts)
    here = (ts >= begin) & (ts <= end)
    arrays = (np.asarray(x)[here] for x in (ts, motion.phi, motion.omega))
    return zj.Trajectory(*arrays, motion.steps, motion.outcome)


def draw(axes, motion, title):
    """The motion in seconds below and in the paper's time above; the phase plane."""
    history, phase = zj.plot.time_history(motion, ax=axes, units=UNITS)
    history.set_title(title, loc="left")
    history.margins(x=0)
    history.get_legend().remove()
    scale = SEED_TIME / UNITS.time
    other = history.secondary_xaxis(
        "top", functions=(lambda s: s * scale, lambda s: s / scale)
    )
    other.set_xlabel(r"the paper's time, $\sqrt{2}\,t\,/\sqrt{m l^2/k}$ (–)")
    phase.ticklabel_format(scilimits=(-2, 3), useMathText=True)
    for panel, width in ((history, 0.8), (phase, 0.5)):
        for line, depth in zip(panel.lines, (3, 2), strict=True):
            line.set(linewidth=width, zorder=depth)  # phi1 is the smaller one
    return history, phase


def save(figure, script):
    """Write the figure beside its script."""
    named = {}  # one entry a label, from all panels
    for panel in figure.axes:
        handles, labels = panel.get_legend_handles_labels()
        named |= {b: a for a, b in zip(handles, labels, strict=True) if b not in named}
    figure.legend(
        handles=list(named.values()),
        labels=list(named),
        loc="outside upper right",
        ncols=len(named),
        frameon=False,
    )
    figure.savefig(Path(script).with_suffix(".png"), dpi=150)
