"""A load that is raised slowly through the onset of flutter, and lowered again."""

import jax
import matplotlib.pyplot as plt
import numpy as np

import ziegler_jax as zj

jax.config.update("jax_enable_x64", True)
ramp = zj.LoadHistory((0, 1000, 2000), (1.0, 2.4, 1.0))  # times, loads
damping = zj.Viscous(0.1, 0.1)
column = zj.uniform_rods(0.0, damping=damping, forces=ramp)
ts = np.linspace(0, 2000, 40001)
motion = zj.trajectory(column, zj.State(omega=(0, 1e-2)), ts)

loads = np.interp(ts, ramp.times, ramp.loads)
flutters = np.flatnonzero(abs(motion.phi[:, 1]) > 0.1)
up, down = loads[flutters[[0, -1]]]
q_cr = float(zj.critical_load(zj.uniform_rods(damping=damping)).q_cr)
print(f"flutter from q = {up:.3f} on, until {down:.3f}; q_cr = {q_cr:.3f}")
plt.plot(loads, motion.phi[:, 1], lw=0.3)
plt.axvline(q_cr, color="k", ls=":")
plt.gca().set(xlabel="load q(t)", ylabel="phi2 (rad)")
plt.savefig("ramp.png")
