# %% [markdown]
# # Your own column and map
#
# A column is a value, every question about it is a function, and `sweep` computes any
# such function over named axes. This page builds a column, follows one motion, asks
# what it ends in, and then asks the same of a few hundred columns at once.

# %%
import jax
import numpy as np

import ziegler_jax as zj

zj.configure_cpu()  # before JAX computes anything
jax.config.update("jax_enable_x64", True)  # for what is not in a sweep

# %% [markdown]
# ## A column
#
# Lengths are in l (rod 1), torques in k (the spring of joint 2), times in $\sqrt{m
# l^2/k}$. The load is one number, $q = F l/k$. Two constructors make the usual columns;
# a load at q = 1.8 is below the flutter of both.

# %%
friction = zj.SetValuedCoulomb(0.15, 0.12, pin_radius=0.1)  # static, kinetic
rods = zj.uniform_rods(q=1.8, friction=friction)
masses = zj.point_masses(2, 1, q=1.8, friction=friction)  # Ziegler's, knee and tip

for column in (zj.uniform_rods(), zj.point_masses(2, 1)):
    print(
        "without friction and damping it flutters from", zj.critical_load(column).q_cr
    )

# %% [markdown]
# Any other column is its inertia: at small angles the mass matrix is [[a, b], [b, d]].
# Here is one with a heavy knee and a stiffer spring at the base. `m2` and `s1` are only
# needed if friction rests on the joints' reactions.

# %%
own = zj.Column(q=1.8, a=1.9, b=0.5, d=1 / 3, kappa=1.5, friction=friction)
own

# %% [markdown]
# ## One motion
#
# `State` is a start: angles and rates of both rods. `trajectory` gives the motion at
# the times that you name. Here a kick grows: left the angles over time, right the phase
# plane.

# %%
kick = zj.State(omega=(0, 0.3))
motion = zj.trajectory(rods, kick, np.linspace(0, 60, 1201))
ax = zj.plot.time_history(motion)

# %% [markdown]
# ## What it ends in
#
# `settle` follows the motion until that is known. Results print themselves, with units
# and the meaning of their codes: here the column has swung itself up to a cycle.

# %%
zj.settle(rods, kick)

# %% [markdown]
# A smaller kick ends stuck. Rest and flutter coexist, and the kick decides: keep this
# in mind for every map.

# %%
zj.settle(rods, zj.State(omega=(0, 0.02)))

# %% [markdown]
# ## A map
#
# A *cell* is a function of named numbers that gives a column and its start; a *point*
# asks something of them. `sweep` computes a point for all combinations of
# the axes, in batches on all cores, always in 64 bits. The bar says how many points are
# done; before it, seconds go into compiling the point: some for a motion, tens for
# thresholds, verdicts and least kicks. Where no bar is shown, they pass silently.
# `zj.configure_cache()` keeps compiled programs for the next process.


# %%
def cell(q, mu):
    friction = zj.SetValuedCoulomb(mu, pin_radius=0.1)
    column = zj.point_masses(2, 1, q=q, friction=friction)
    return column, zj.State(omega=(0, 0.3))


def point(q, mu):
    return zj.settle(*cell(q, mu))


ds = zj.sweep(point, q=np.linspace(1, 3, 31), mu=np.linspace(0.02, 0.3, 15))

# %% [markdown]
# What comes back is an `xarray.Dataset`. `sel` picks by value, `pipe` hands the dataset
# to what draws it. The flat colour is where the column came to rest.

# %%
ax = ds.sel(joint=2).pipe(zj.plot.map, "joint_amplitude", x="q", y="mu")

# %% [markdown]
# `outcome` says of each point how its motion ended. Codes have names, and names have
# sentences; what failed is NaN, never a number that looks right. What is `unsettled`
# still moved after the longest time: here, with little friction, motions decay slowly.

# %%
codes, counts = np.unique(ds.outcome, return_counts=True)
for code, count in zip(codes, counts, strict=True):
    print(count, zj.CODE(int(code)).name, "-", zj.CODE(int(code)).sentence)

# %% [markdown]
# ## From a cell back to its motion
#
# Ask the cell another question: here, where its motion passes $\phi_1 = 0$.

# %%
section = zj.poincare(*cell(2.2, 0.2), points=5, transient=400)
print("successive phi2 on the section:", section.phi[:, 1])

# %% [markdown]
# All five passages agree: the motion is on a cycle of one return.
#
# ## A sharp boundary
#
# A grid shows a boundary as stairs. `refine` computes more points where neighbours
# differ, and joins the changes to lines. Here the label is `outcome`: lines part rest,
# cycles and what stayed undecided.

# %%
sharp = zj.refine(point, ds, "outcome", width=(2e-3, 0.02), levels=1, audit=50)
ax = sharp.sel(joint=2).pipe(zj.plot.map, "joint_amplitude", x="q", y="mu")
print("the share of the map that may be missed is below", sharp.refine_missed_area)

# %% [markdown]
# ## What to keep
#
# The dataset's attributes hold the scene's source, the numbers that it read, tolerances
# and versions. `sweep(..., store="map.zarr")` keeps it all in a folder: [Long
# sweeps](long_sweeps.md).

# %%
for name in ("rtol", "transient", "ziegler_jax_version", "jax_version"):
    print(name, "=", ds.attrs.get(name))
print(ds.attrs["scene"])
