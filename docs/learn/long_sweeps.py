# %% [markdown]
# # Long sweeps, stores and Dask
#
# A map of a million points runs for hours, on a machine that may be switched off, or on
# a cluster. A sweep with a *store* keeps every finished block, goes on where it was,
# and ends in the same numbers to the last bit.

# %%
import numpy as np
from distributed import Client, LocalCluster

import ziegler_jax as zj

zj.configure_cache("programs")  # keeps compiled programs for later processes


def point(q, kappa):
    column = zj.uniform_rods(q, kappa=kappa, damping=zj.Viscous(0.01, 0.02))
    return {"regime": zj.regime(column), "growth": zj.spectral_abscissa(column)}


q, low, high = (
    np.linspace(0, 6, 200),
    np.linspace(0.5, 1.5, 100),
    np.linspace(1.6, 3, 80),
)

# %% [markdown]
# ## A store
#
# `store` is a folder. Stop the sweep whenever you like: the same call with the same
# store computes what is missing and nothing else. It keeps a sixteenth of the
# points at a time (about 256 at least, 16 000 at most), as soon as they are whole. The
# logger `ziegler_jax.sweep` says of each where it lies, what it cost and how its points
# ended: `logging.basicConfig(filename="low.log", level="INFO")` keeps that.

# %%
ds = zj.sweep(point, q=q, kappa=low, store="low.zarr")
print(ds.attrs["points_done"], "of", ds.attrs["points"], "points")

# %%
again = zj.sweep(point, q=q, kappa=low, store="low.zarr")  # nothing is left to do
assert again.growth.equals(ds.growth)

# %% [markdown]
# A store belongs to its scene. A sweep of another scene, other axes or other tolerances
# is refused, not mixed in:


# %%
def other(q, kappa):
    column = zj.uniform_rods(q, kappa=kappa, damping=zj.Viscous(0.03, 0.02))
    return {"regime": zj.regime(column), "growth": zj.spectral_abscissa(column)}


try:
    zj.sweep(other, q=q, kappa=low, store="low.zarr")
except ValueError as error:
    print(error)

# %% [markdown]
# `zj.Store("low.zarr", overwrite=True)` replaces what is there. `open_sweep` reads a
# store at any time, also while it is being written, from another process; every chunk
# has a checksum, so that a damaged one raises and never gives a number. It runs nothing
# that is in the folder: [what opening a store does](../reference/stores.md).

# %%
zj.open_sweep("low.zarr").growth

# %% [markdown]
# ## Longer axes
#
# A map becomes larger by merging: overlapping points must agree to the last bit.

# %%
second = zj.sweep(point, q=q, kappa=high)
whole = zj.merge(zj.open_sweep("low.zarr"), second)
ax = whole.pipe(zj.plot.map, "regime", x="q", y="kappa")

# %% [markdown]
# ## Only some points
#
# `where` chooses points by their values: the rest stays NaN, and costs nothing. With
# that, a coarse map can come first, and fine parts where it is worth it.


# %%
def kick(q, mu, rtol=1e-6):
    column = zj.uniform_rods(q, friction=zj.SetValuedCoulomb(mu, pin_radius=0.1))
    start = zj.State(omega=(0, 0.3))
    return zj.settle(column, start, method=zj.Method(rtol=rtol))


coarse = zj.sweep(
    kick,
    where=lambda q, mu: mu < 0.1 * q,
    store="kick.zarr",
    q=np.linspace(1, 3, 25),
    mu=np.linspace(0.02, 0.3, 15),
)
ax = coarse.sel(joint=2).pipe(zj.plot.map, "joint_amplitude", x="q", y="mu")

# %% [markdown]
# ## What it cost, and whether it was computed right
#
# The attributes say. One batch in 256 is computed twice and must give the same bits: a
# processor that computes wrong would be seen. (This map is too small for one.)

# %%
for name in (
    "run_seconds",
    "points_per_second",
    "useful_step_fraction",
    "canary_checks",
):
    print(name, "=", coarse.attrs[name])

# %% [markdown]
# How wrong is the map? `compare` computes points of it by several methods: the usual
# one and, as the reference, one with a hundred times finer tolerance. The point takes
# the tolerance as an argument. Each cell has a difference, the sample its quantiles.

# %%
plane = {"q": np.linspace(1.5, 2.5, 15), "mu": np.linspace(0.05, 0.2, 8)}
both = zj.compare(kick, {"usual": {}}, reference={"rtol": 1e-8}, sample=40, **plane)
usual = both.sel(variant="usual")
print("share with another outcome", usual.changed_share.item())
print("quantiles  ", both["quantile"].values)
print("differences", usual.joint_amplitude_difference_quantiles.values)

# %% [markdown]
# ## A cluster
#
# With a Dask `client` blocks become tasks of its workers, on this machine or on many;
# the store must be where all of them can write. Numbers are the same as without, to the
# last bit.

# %%
with (
    LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
    Client(cluster) as client,
):
    far = zj.sweep(point, q=q, kappa=low, client=client, store="dask.zarr").load()
assert far.growth.equals(ds.growth)
print("the cluster's numbers are the same")

# %% [markdown]
# In a script, not a notebook, what starts the cluster belongs into a function behind
# the usual test of `__name__`, as in [this one](examples.md#dask_clusterpy): workers
# import the script.
#
# ## A batch system
#
# The tasks of a job array need no Dask: each computes a part of an axis into a store
# of its own, and their union is the map. A task that was stopped is submitted once more
# and goes on. Here three parts follow each other; under Slurm the number of the task is
# `int(os.environ["SLURM_ARRAY_TASK_ID"])`.

# %%
for task in range(3):
    part = np.array_split(q, 3)[task]
    zj.sweep(point, q=part, kappa=low, store=f"part_{task}.zarr")

# %% [markdown]
# When all are done:

# %%
parts = [zj.open_sweep(f"part_{task}.zarr") for task in range(3)]
assert zj.merge(*parts).growth.equals(ds.growth)
print("their union is the same map")

# %% [markdown]
# ## When it is killed
#
# Nothing is lost but the blocks that were not finished. Ctrl-C ends a sweep as soon as
# the present batch is done; what was finished stays. To see how far a run is from
# another terminal:

# %%
watch = zj.open_sweep("kick.zarr")
print(watch.attrs["blocks_done"], "of", watch.attrs["blocks"], "blocks")
print((watch.outcome == zj.CODE.not_computed).sum().item(), "points not computed")
