"""From a cell of a map to its history, phase plane, section and spectrum."""

import jax
import matplotlib.pyplot as plt
import numpy as np

import ziegler_jax as zj

jax.config.update("jax_enable_x64", True)


def cell(q, mu):  # a column and its start
    friction = zj.SmoothCoulomb(mu, pin_radius=0.1, v_smooth=0.05)
    return zj.uniform_rods(q, friction=friction), zj.State(omega=(0, 0.3))


def point(q, mu):
    return zj.settle(*cell(q, mu))


ds = zj.sweep(point, q=[2.0, 2.6, 3.2], mu=[0.05, 0.1])
figure, axes = plt.subplots(2, 2, figsize=(9, 6), layout="constrained")
motion = zj.trajectory(*cell(2.6, 0.1), np.linspace(0, 200, 4001))
zj.plot.time_history(motion, ax=axes[0])
section = zj.poincare(*cell(2.6, 0.1), points=50)
zj.plot.section(section, ax=axes[1, 0])
zj.plot.spectrum(motion, ax=axes[1, 1])
figure.savefig("cell.png")
zj.plot.page(ds, cell, "cells.html", x="q", y="mu", cells=ds.q.size * ds.mu.size)
