# %% [markdown]
# # Critical loads and regimes
#
# Without friction the question of stability is linear, and its answers are exact: the
# critical load, what damping does to it, the loads of uncertain columns, the regime
# over a plane. Its gradient, and the parameters that raise it most, have [a page of
# their own](optimise.md).

# %%
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import xarray as xr

import ziegler_jax as zj

zj.configure_cpu()
jax.config.update("jax_enable_x64", True)

# %% [markdown]
# ## The critical load
#
# `critical_load` returns the load, the frequency at which it flutters, and an outcome.

# %%
result = zj.critical_load(zj.uniform_rods())
print(result)
print("closed form", (18 - 2 * np.sqrt(7)) / 5)

# %% [markdown]
# ## Damping destabilises
#
# A little damping in the joints does not raise the load: it lowers it by a third, to a
# limit that depends only on the ratio of the two dampings. That is Ziegler's paradox.

# %%
for c in (None, 1e-6, 0.01, 0.1):
    damping = None if c is None else zj.Viscous(c, c)
    print("c =", c, "q_cr =", zj.critical_load(zj.uniform_rods(damping=damping)).q_cr)

# %%
angle = np.linspace(0.001, np.pi / 2 - 0.001, 200)  # c1 : c2 as cos : sin


def limit(angle):
    damping = zj.Viscous(1e-9 * jnp.cos(angle), 1e-9 * jnp.sin(angle))
    return zj.critical_load(zj.uniform_rods(damping=damping))


ds = zj.sweep(limit, angle=angle)
figure, ax = plt.subplots(layout="constrained")
ax.plot(np.tan(angle), ds.q_cr, label="limit of small damping")
ax.axhline(result.q_cr, color="grey", linestyle="--", label="no damping")
ax.set(xscale="log", xlabel="c2 / c1", ylabel="critical load")
ax.legend()

# %% [markdown]
# ## Uncertain parameters
#
# Parameters that share a dimension vary together: a sample is one point. A hundred
# thousand columns take a second or two.


# %%
def drawn(kappa, m2, c):
    return zj.critical_load(
        zj.uniform_rods(kappa=kappa, m2=m2, damping=zj.Viscous(c, c))
    )


random = np.random.default_rng(0)
N = 100_000
samples = {
    "kappa": random.normal(1, 0.05, N),
    "m2": random.normal(1, 0.05, N),
    "c": random.uniform(0.01, 0.05, N),
}
ds = zj.sweep(drawn, **{k: xr.DataArray(v, dims="sample") for k, v in samples.items()})
low, high = np.quantile(ds.q_cr, [0.05, 0.95])
print(f"nine of ten columns flutter between q = {low:.3f} and {high:.3f}")

# %%
figure, ax = plt.subplots(layout="constrained")
ax.hist(ds.q_cr, bins=80)
ax.set(xlabel="critical load", ylabel="columns")

# %% [markdown]
# ## Which regime, over a plane
#
# `regime` tells stable, flutter and divergence apart without eigenvalues; a million
# columns take seconds. Here the load turns only in part with rod 2: a follower fraction
# of 0 is a dead load, which buckles the column; 1 is the follower load, which flutters.


# %%
def stability(q, eta):
    column = zj.uniform_rods(q, follower=eta, damping=zj.Viscous(0.02, 0.02))
    return {"regime": zj.regime(column)}


plane = zj.sweep(stability, q=np.linspace(0, 5, 251), eta=np.linspace(0, 1.2, 241))
ax = plane.pipe(zj.plot.map, "regime", x="q", y="eta")

# %% [markdown]
# ## And with friction?
#
# These functions refuse friction, and say why.

# %%
try:
    zj.critical_load(zj.uniform_rods(friction=zj.SetValuedCoulomb(0.1, pin_radius=0.1)))
except ValueError as error:
    print(error)
