# %% [markdown]
# # Critical loads, gradients and design
#
# Without friction the question of stability is linear, and its answers are exact: the
# critical load, its derivatives in every number of the column, and the parameters that
# raise it most.

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
# ## Gradients
#
# `jax.grad` passes through `critical_load`, though the eigenvalues themselves have an
# infinite slope there: what is differentiated is the boundary, not an eigenvalue.


# %%
def q_cr(x):
    m2, kappa, c1 = x
    column = zj.uniform_rods(m2=m2, kappa=kappa, damping=zj.Viscous(c1, 0.02))
    return zj.critical_load(column).q_cr


x = jnp.array([1.0, 1.0, 0.02])
gradient = jax.grad(q_cr)(x)
step = 1e-5 * jnp.eye(3)
differences = jnp.stack([(q_cr(x + s) - q_cr(x - s)) / 2e-5 for s in step])
print("gradient    ", gradient)
print("differences ", differences)
print("second derivatives\n", jax.hessian(q_cr)(x))

# %% [markdown]
# `sensitivity` makes a table of them. The elasticity is the per cent of load that one
# per cent of the parameter brings.

# %%
table = zj.sensitivity(zj.uniform_rods(damping=zj.Viscous(0.05, 0.02)))
print(table.to_dataframe())

# %% [markdown]
# ## The best column
#
# `stabilise` raises the load within bounds, by a quasi-Newton method on exact
# gradients. A step after which the column would lose its stability in another way first
# is refused.

# %%
damped = zj.uniform_rods(damping=zj.Viscous(0.05, 0.05))
bounds = {"kappa": (0.5, 2.0), "damping.c1": (0.01, 0.3), "damping.c2": (0.01, 0.3)}
best = zj.stabilise(damped, bounds)
print("from", zj.critical_load(damped).q_cr, "to", best.load.q_cr)
print(best.parameters)
print("converged:", best.converged)

# %% [markdown]
# An optimiser of your own is as good: `jax.value_and_grad(q_cr)` is what it needs, and
# [one of the short scripts](examples.md) does that with scipy.
#
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
