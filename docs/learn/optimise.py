# %% [markdown]
# # The best column by its gradient
#
# The load at which flutter sets in has exact derivatives in every number of the column.
# This page takes them, and follows them to the best share of damping and of mass
# between the two rods. Each optimum is checked against a scan that knows no gradient.

# %%
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import ziegler_jax as zj

zj.configure_cpu()
jax.config.update("jax_enable_x64", True)

# %% [markdown]
# ## The gradient
#
# `jax.grad` passes through `critical_load`, though the eigenvalues have an infinite
# slope where two of them meet: the boundary of stability is differentiated, not an
# eigenvalue. Differences of loads agree.


# %%
def q_cr(x):
    m2, kappa, c1 = x
    column = zj.uniform_rods(m2=m2, kappa=kappa, damping=zj.Viscous(c1, 0.02))
    return zj.critical_load(column).q_cr


x = jnp.array([1.0, 1.0, 0.02])
step = 1e-5 * jnp.eye(3)
print("gradient    ", jax.grad(q_cr)(x))
print("differences ", jnp.stack([(q_cr(x + s) - q_cr(x - s)) / 2e-5 for s in step]))
print("second derivatives\n", jax.hessian(q_cr)(x))

# %% [markdown]
# `sensitivity` makes a table of them. The elasticity is the per cent of load that one
# per cent of the parameter brings.

# %%
table = zj.sensitivity(zj.uniform_rods(damping=zj.Viscous(0.05, 0.02)))
print(table.to_dataframe())

# %% [markdown]
# ## The best share of small damping
#
# Damping that vanishes lowers the critical load, by an amount that depends on its share
# between the joints alone. `stabilise` raises the load within bounds, by a quasi-Newton
# method (BFGS) on the exact gradient. It takes a function that makes a column of named
# numbers.


# %%
def damped(share):
    return zj.uniform_rods(damping=zj.Viscous(1e-9 * share, 1e-9 * (1 - share)))


best = zj.stabilise(damped, {"share": (0.001, 0.999)})
print("best share", best.parameters["share"], "q_cr", best.load.q_cr)
print("undamped  ", zj.critical_load(zj.uniform_rods()).q_cr)

# %% [markdown]
# The best share of the damping of joint 1 gives back the load of the undamped column:
# all others lose some of it. The scan agrees to its spacing.

# %%
scan = zj.sweep(
    lambda share: zj.critical_load(damped(share)),
    share=np.linspace(0.001, 0.999, 999),
    progress=False,
)
top = int(np.argmax(scan.q_cr.values))
print("scan", scan.share[top].item(), scan.q_cr[top].item())
assert abs(scan.share[top].item() - best.parameters["share"]) < 1e-3

figure, ax = plt.subplots(layout="constrained")
ax.plot(scan.share, scan.q_cr, label="scan")
ax.plot(best.history.share, best.history.q_cr, "o", label="steps of stabilise")
ax.set(xlabel="share of damping in joint 1", ylabel="critical load q_cr")
ax.legend()

# %% [markdown]
# ## Mass and damping together
#
# A column has a mass of 2 and a damping of 0.1, to be shared out between its rods and
# joints. Rod 1 may have 20 % to 80 % of the mass.


# %%
def shared(mass, damping):
    law = zj.Viscous(0.1 * damping, 0.1 * (1 - damping))
    return zj.uniform_rods(m1=2 * mass, m2=2 * (1 - mass), damping=law)


bounds = {"mass": (0.2, 0.8), "damping": (0.05, 0.99)}
best = zj.stabilise(shared, bounds, start={"mass": 0.3, "damping": 0.3})
print(best.parameters, "q_cr", best.load.q_cr, "converged", best.converged)

# %% [markdown]
# The mass ends on its bound, since within these bounds a lighter rod 2 helps; the
# damping has its best share inside. A map of the same function, from a sweep, agrees.

# %%
plane = zj.sweep(
    lambda mass, damping: zj.critical_load(shared(mass, damping)),
    mass=np.linspace(0.2, 0.8, 121),
    damping=np.linspace(0.05, 0.99, 189),
    progress=False,
)
where = plane.q_cr.argmax(...)
at = {name: plane[name][i].item() for name, i in where.items()}
print("scan", at, plane.q_cr.max().item())
assert all(abs(at[name] - best.parameters[name]) < 5e-3 for name in at)
assert plane.q_cr.max().item() <= best.load.q_cr

figure, ax = plt.subplots(layout="constrained")
lines = ax.contour(plane.mass, plane.damping, plane.q_cr.T, levels=15)
ax.clabel(lines)
ax.plot(best.history.mass, best.history.damping, "ko-", label="steps of stabilise")
ax.set(xlabel="share of mass in rod 1", ylabel="share of damping in joint 1")
ax.legend()

# %% [markdown]
# A step after which the column would lose its stability in another way first, by
# divergence say, is refused. The result is a local maximum: begin at several places.
#
# ## An optimiser of your own, and friction
#
# Costs and constraints of your own go to any optimiser that takes a gradient:
# `jax.value_and_grad(q_cr)` is all that it needs. One of the [short
# scripts](examples.md) does that with scipy.
#
# With friction, `critical_load` refuses. The load from which a flutter cycle exists is
# then the fold of its branch, `zj.bifurcation`, and that load has derivatives in the
# friction, the damping and the masses as well ([an
# example](onset.md#the-unstable-branch)).
