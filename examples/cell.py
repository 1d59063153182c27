"""From a cell of a map to its history, phase plane, section and spectrum."""

import jax
import matplotlib.pyplot as plt

import ziegler_jax as zj

jax.config.update("jax_enable_x64", True)


def point(q, mu):
    friction = zj.SmoothCoulomb(mu, pin_radius=0.1, v_smooth=0.05)
    column = zj.uniform_rods(q, friction=friction)
    return zj.settle(column, zj.State(omega=(0, 0.3)), certify=False)


ds = zj.sweep(point, q=[2.0, 2.6, 3.2], mu=[0.05, 0.1])
figure, axes = plt.subplots(2, 2, figsize=(9, 6), layout="constrained")
motion = zj.motion(ds, q=2.6, mu=0.1)
zj.plot.time_history(motion, ax=axes[0])
section = zj.poincare(*zj.scene(ds, q=2.6, mu=0.1), points=50)
zj.plot.section(section, ax=axes[1, 0])
zj.plot.spectrum(motion, ax=axes[1, 1])
figure.savefig("cell.png")
