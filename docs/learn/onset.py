# %% [markdown]
# # Onset, hysteresis and the unstable branch
#
# With dry friction the column at rest is held at every load. Flutter needs a kick, and
# there is a load below which no kick makes it. This page asks how large a kick must be,
# lets the load go up and down, and finds what lies between rest and flutter: an
# unstable cycle.

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
# At rest both joints stick wherever the torques that hold them stay within $\tau_s$: a
# region of angles, as large at every load as the friction makes it.

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
# Along a direction of the start, here the rate of rod 2, how large must a kick be?
# `critical_kick` scans a bracket and halves the first interval in which the verdict
# changes. It judges a motion by rest or by a certified cycle, so that a motion that
# lingers decides nothing. In a sweep it is a curve over the load.


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
# Below the curve a kick ends at rest, above it flutter sets in. Read the outcome first:
# `found` means one change along the scanned bracket, `repeated` that rest comes back
# above it, `undecided` that a motion gave no verdict in time. All codes are in the
# [reference](../reference/results.md).
#
# The same border the other way round, the load from which a given kick starts flutter,
# is `flutter_onset` ([an example](device.md#from-which-force-on-exactly)); the least
# kick over *all* directions, and what stands on the border, is `least_kick`.
#
# ## Hysteresis
#
# Let the load go up in steps and down again, each motion going on from where the last
# one ended, with a small kick at every load. On the way up the column rests until the
# kick is enough; on the way down flutter stays far below that load. Smoothed friction
# with some damping keeps this page quick.


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
# Triangles point the way the load went; the line is solid where the cycle attracts and
# dashed where it repels. The branch lists what happens on its way; here that is the
# fold.

# %%
kind, where = branch.special.kind[0], branch.special.parameter[0]
print(zj.CODE(int(kind)).name, "at q =", where)
multipliers = np.asarray(branch.special.multipliers[0])
print(
    "multipliers there", np.array2string(multipliers, precision=4, suppress_small=True)
)

# %% [markdown]
# Two multipliers are 1 at the fold: that of the time along the cycle, and that of the
# two cycles which meet. Below this load the smoothed column has no flutter cycle on
# this branch, however hard it is kicked.
#
# `bifurcation` goes straight to the fold, and its number has derivatives: `jax.grad` of
# it in the friction, the damping or the masses says how the fold moves.
# `bifurcation_curve` follows it over two parameters:
#
# ![Curves of folds](../figures/bifurcation_curves.png)
