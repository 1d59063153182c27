# %% [markdown]
# # Long sweeps, stores and Dask
#
# A map of a million points runs for hours, on a machine that may be switched off, or on
# a cluster. A sweep with a *store* writes every finished block, continues after a stop,
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
# store computes the missing points only. A block is a sixteenth of the points (about
# 256 at least, 16 000 at most), and is written as soon as it is finished. The logger
# `ziegler_jax.sweep` has the place, cost and outcomes of each block:
# `logging.basicConfig(filename="low.log", level="INFO")` writes them to a file.

# %%
ds = zj.sweep(point, q=q, kappa=low, store="low.zarr")
print(ds.attrs["points_done"], "of", ds.attrs["points"], "points")

# %%
again = zj.sweep(point, q=q, kappa=low, store="low.zarr")  # nothing is left to do
assert again.growth.equals(ds.growth)

# %% [markdown]
# A store belongs to its point. It refuses a sweep of another point, other axes or other
# tolerances:


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
# store at any time, also while it is being written, from another process. Every chunk
# has a checksum: a damaged one raises an error and never gives a number. No code from
# the folder runs: [stores](../reference/stores.md).

# %%
zj.open_sweep("low.zarr").growth

# %% [markdown]
# ## Longer axes
#
# `merge` joins maps: overlapping points must agree to the last bit.

# %%
second = zj.sweep(point, q=q, kappa=high)
longer = zj.merge(zj.open_sweep("low.zarr"), second)
ax = longer.pipe(zj.plot.map, "regime", x="q", y="kappa")

# %% [markdown]
# ## Only some points
#
# `where` selects points by their values: the others stay NaN and are not computed. So a
# coarse map can come first, and finer ones only where they are needed.


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
# ## Cost and correctness
#
# The attributes have the cost. One batch in 256 is computed twice and must give the
# same bits, which detects a faulty processor. (This map is too small for such a batch.)

# %%
for name in (
    "run_seconds",
    "points_per_second",
    "useful_step_fraction",
    "canary_checks",
):
    print(name, "=", coarse.attrs[name])

# %% [markdown]
# `compare` measures the error of the map: it computes a sample of its points by several
# methods, the usual one and, as the reference, one with a hundred times finer
# tolerance. The point takes the tolerance as an argument. The result has the difference
# of each point and its quantiles over the sample.

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
# With a Dask `client` blocks become tasks of its workers, on one machine or on many.
# All workers must be able to write to the store. Numbers are the same as without a
# cluster, to the last bit.

# %%
with (
    LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
    Client(cluster) as client,
):
    far = zj.sweep(point, q=q, kappa=low, client=client, store="dask.zarr").load()
assert far.growth.equals(ds.growth)
print("the cluster's numbers are the same")

# %% [markdown]
# In a script, start the cluster in a function behind the usual test of `__name__`, as
# in [this one](examples.md#dask_clusterpy): workers import the script.
#
# ## A batch system
#
# The tasks of a job array need no Dask: each computes a part of an axis into its own
# store, and their union is the map. A task that was stopped is submitted again and
# continues. In this notebook three parts run one after the other; under Slurm the
# number of the task is `int(os.environ["SLURM_ARRAY_TASK_ID"])`.

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
# ## Killed sweeps
#
# A killed sweep loses its unfinished blocks only. Ctrl-C ends a sweep as soon as the
# present batch is done; finished blocks stay. Another terminal shows the progress:

# %%
watch = zj.open_sweep("kick.zarr")
print(watch.attrs["blocks_done"], "of", watch.attrs["blocks"], "blocks")
print((watch.outcome == zj.CODE.not_computed).sum().item(), "points not computed")
