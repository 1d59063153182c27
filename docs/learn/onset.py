# %% [markdown]
# # Onset, hysteresis and the unstable branch
#
# Dry friction holds the column at rest at every load. Flutter needs a kick, and below
# some load no kick starts it. This page computes how large a kick must be, takes the
# load up and down, and finds the unstable cycle between rest and flutter.

# %%
import jax
import matplotlib.pyplot as plt
import numpy as np

import ziegler_jax as zj

zj.configure_cpu()
jax.config.update("jax_enable_x64", True)


def column(q):
    friction = zj.SetValuedCoulomb(0.1, pin_radius=0.3)
    return zj.uniform_rods(q, friction=friction)


# %% [markdown]
# ## Rest is a set
#
# At rest both joints stick wherever the torques that hold them stay within $\tau_s$.
# This is a region of angles, whose area is the same at every load.

# %%
resting = zj.sticking_set(column(2.0))
phi1, phi2 = np.meshgrid(np.linspace(-0.3, 0.3, 201), np.linspace(-0.3, 0.3, 201))
figure, ax = plt.subplots(layout="constrained")
ax.contourf(phi1, phi2, resting.contains(phi1, phi2), levels=[0.5, 1.5])
ax.set(xlabel="angle of rod 1 (rad)", ylabel="angle of rod 2 (rad)", aspect="equal")
print("area", resting.area, "corners", resting.corners)

# %% [markdown]
# ## The kick that starts flutter
#
# How large must a kick be, as a rate of rod 2? `critical_kick` scans a bracket and
# halves the first interval in which the verdict changes. It judges a motion by rest or
# by a certified cycle, never while the motion lingers. In a sweep it is a curve over
# the load.


# %%
def threshold(q):
    search = zj.Search(scan=6, halvings=6)
    return zj.critical_kick(column(q), zj.State(omega=(0, 1)), (0, 2), search=search)


least = zj.sweep(threshold, q=np.linspace(1.5, 2.7, 7))
figure, ax = plt.subplots(layout="constrained")
ax.errorbar(least.q, least.threshold, least.width / 2, fmt="o-")
ax.set(xlabel="load q", ylabel="rate of rod 2 that starts flutter", ylim=(0, None))
for q, code in zip(least.q.values, least.outcome.values, strict=True):
    print(f"q = {q:.1f}:", zj.CODE(int(code)).name)

# %% [markdown]
# Below the curve the column comes to rest after a kick, above it the column flutters.
# Read the outcome first: `found` means one change along the scanned bracket, `repeated`
# that rest comes back above it, `undecided` that a motion had no verdict in time. All
# codes are in the [reference](../reference/results.md).
#
# The same border the other way round, the load from which one kick starts flutter,
# is `flutter_onset` ([an example](device.md#the-onset-in-newtons)); the least kick over
# *all* directions, and the state on the border, is `least_kick`.
#
# ## Hysteresis
#
# `sweep_up_down` raises the load in steps and lowers it again. Each motion starts from
# the end of the last one, with a small kick. On the way up the column rests until the
# kick is enough; on the way down flutter persists far below that load. Smoothed
# friction with some damping makes this page quick to run.


# %%
def smooth(q):
    friction = zj.SmoothCoulomb(0.1, pin_radius=0.1, v_smooth=0.1)
    return zj.uniform_rods(q, friction=friction, damping=zj.Viscous(0.02, 0.02))


loads = np.linspace(1.4, 2.2, 9)
both = zj.sweep_up_down(smooth, loads, kick=zj.State(omega=(0, 0.1)))

# %% [markdown]
# ## The unstable branch
#
# Between rest and the cycle lies another cycle, which repels: a motion that starts
# beyond it grows, one that starts within it dies. No simulation goes there. Newton's
# method and a continuation do: find the stable cycle, follow it as the load falls,
# round the fold where both cycles meet, and back up as the unstable one.

# %%
settled = zj.settle(smooth(1.62), zj.State(omega=(0, 0.6)), certify=False)
orbit = zj.periodic_orbit(smooth(1.62), settled.final)
arc = zj.Arc(direction=-1, points=50, bounds=(1.4, 2.6))
branch = zj.continue_cycle(smooth, orbit, 1.62, arc=arc)
ax = zj.plot.up_down(both, branch=branch)

# %% [markdown]
# Triangles show the direction of the load; the line is solid where the cycle attracts
# and dashed where it repels. The branch has a list of its special points: here the
# fold.

# %%
kind, where = branch.special.kind[0], branch.special.parameter[0]
print(zj.CODE(int(kind)).name, "at q =", where)
multipliers = np.asarray(branch.special.multipliers[0])
print(
    "multipliers there", np.array2string(multipliers, precision=4, suppress_small=True)
)

# %% [markdown]
# Two multipliers are 1 at the fold: the trivial one along the cycle, and the one of the
# two cycles which meet. Below this load the smoothed column has no flutter cycle on
# this branch, after any kick.
#
# `bifurcation` goes straight to the fold, and its number has derivatives: `jax.grad` of
# it in the friction, the damping or the masses says how the fold moves.
# `bifurcation_curve` follows it over two parameters:
#
# ![Curves of folds](../figures/bifurcation_curves.png)
