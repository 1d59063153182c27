# %% [markdown]
# # Your own column and map
#
# A column is a value, every question about it is a function, and `sweep` computes any
# such function over named axes. This page builds a column, follows one motion to its
# end, and then does the same for a few hundred columns at once.

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
# `Column` takes any inertia: at small angles the mass matrix is [[a, b], [b, d]]. This
# one has a heavy knee and a stiffer spring at the base. `m2` and `s1` are needed only
# where friction acts on the joints' reactions.

# %%
own = zj.Column(q=1.8, a=1.9, b=0.5, d=1 / 3, kappa=1.5, friction=friction)
own

# %% [markdown]
# ## One motion
#
# `State` is a start: angles and rates of both rods. `trajectory` gives the motion at
# the times that you name. This kick grows: the left picture shows angles over time, the
# right one the phase plane.

# %%
kick = zj.State(omega=(0, 0.3))
motion = zj.trajectory(rods, kick, np.linspace(0, 60, 1201))
ax = zj.plot.time_history(motion)

# %% [markdown]
# ## How it ends
#
# `settle` follows the motion until its end is known. Results print themselves, with
# units and the meaning of their codes: this column has swung up to a cycle.

# %%
zj.settle(rods, kick)

# %% [markdown]
# After a smaller kick the column sticks. Rest and flutter coexist, and the kick
# decides: every map is a map for its kick.

# %%
zj.settle(rods, zj.State(omega=(0, 0.02)))

# %% [markdown]
# ## A map
#
# A *cell* is a function of named numbers that gives a column and its start; a *point*
# computes a result from them. `sweep` computes a point for all combinations of the
# axes, in batches on all cores, always in 64 bits. First it compiles the point, which
# takes [seconds](index.md#the-first-call-compiles); then a bar counts the points.
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
# The result is an `xarray.Dataset`. `sel` picks by value, `pipe` hands the dataset to a
# function that draws it. The flat colour marks columns that came to rest.

# %%
ax = ds.sel(joint=2).pipe(zj.plot.map, "joint_amplitude", x="q", y="mu")

# %% [markdown]
# `outcome` says how the motion of each point ended. Each code has a name and a
# sentence. A point that failed is NaN. An `unsettled` motion still moved after the
# longest time: with little friction, motions decay slowly.

# %%
codes, counts = np.unique(ds.outcome, return_counts=True)
for code, count in zip(codes, counts, strict=True):
    print(count, zj.CODE(int(code)).name, "-", zj.CODE(int(code)).sentence)

# %% [markdown]
# ## From a cell back to its motion
#
# The cell takes any other function: `poincare` computes where its motion passes
# $\phi_1 = 0$.

# %%
section = zj.poincare(*cell(2.2, 0.2), points=5, transient=400)
print("successive phi2 on the section:", section.phi[:, 1])

# %% [markdown]
# All five passages agree: the motion is on a cycle of one return.
#
# ## A sharp boundary
#
# A grid shows a boundary as stairs. `refine` computes more points where neighbours
# differ, and joins the changes to lines. With the label `outcome`, lines separate rest,
# cycles and undecided motions.

# %%
sharp = zj.refine(point, ds, "outcome", width=(2e-3, 0.02), levels=1, audit=50)
ax = sharp.sel(joint=2).pipe(zj.plot.map, "joint_amplitude", x="q", y="mu")
print("the share of the map that may be missed is below", sharp.refine_missed_area)

# %% [markdown]
# ## The record
#
# The attributes of the dataset are the source of the point, its tolerances and the
# versions. `sweep(..., store="map.zarr")` writes all of it to a folder: [Long
# sweeps](long_sweeps.md).

# %%
for name in ("rtol", "transient", "ziegler_jax_version", "jax_version"):
    print(name, "=", ds.attrs.get(name))
print(ds.attrs["scene"])
