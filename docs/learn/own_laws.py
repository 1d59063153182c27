# %% [markdown]
# # Your own friction, damping and observer
#
# A law is a small class: its numbers are its fields, and one method is its equation.
# Sweeps, certificates, derivatives and stores treat it like a law of the package.

# %%
import warnings

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import ziegler_jax as zj

zj.configure_cpu()
jax.config.update("jax_enable_x64", True)

# %% [markdown]
# ## Friction
#
# A friction law of the joints' rates derives from `AbstractRateFriction` and gives
# three things: `levers`, the torque of each joint per unit of normal load; `load_law`,
# the normal load; `rate_cut`, the rate below which a joint counts as at rest. The
# package checks `rules`: a point whose numbers break one ends with the code `invalid`.
#
# This one saturates like a root instead of a hyperbolic tangent, $\mu u/\sqrt{u^2 +
# v^2}$.


# %%
class Root(zj.AbstractRateFriction):
    rules = {"mu": "nonnegative", "radius": "nonnegative", "v": "positive"}
    mu: float
    radius: float
    v: float

    def levers(self, u1, u2):
        one, two = (u / jnp.sqrt(u * u + self.v**2) for u in (u1, u2))
        return self.radius * self.mu * one, self.radius * self.mu * two

    def load_law(self):
        return zj.FollowerLoad()  # N = |q|

    def rate_cut(self):
        return self.v


# %% [markdown]
# Plot a law before you use it: the torque over the rate, beside a law of the package.

# %%
u = np.linspace(-0.2, 0.2, 401)
usual = zj.SmoothCoulomb(0.1, pin_radius=0.1, v_smooth=0.02)
figure, ax = plt.subplots(layout="constrained")
ax.plot(u, Root(0.1, 0.1, 0.02).levers(u, u)[0], label="root")
ax.plot(u, usual.levers(u, u)[0], label="tanh")
ax.set(xlabel="rate of the joint", ylabel="torque per unit of normal load")
ax.legend()

# %% [markdown]
# ## Damping
#
# Damping is a matrix C with torques $-C\omega$ on the rods; it may depend on the rates.
# Quadratic damping $c\,|u|\,u$ in both joints:


# %%
class Quadratic(zj.AbstractDamping):
    rules = {"c": "nonnegative"}
    c: float

    def matrix(self, cos_d, omega):
        c1, c2 = self.c * abs(omega[0]), self.c * abs(omega[1] - omega[0])
        return (c1 + c2, -c2), (-c2, c2)


# %% [markdown]
# At rest this law has no damping, so it does not enter the linear column. q_cr is that
# of the column without damping.

# %%
print(zj.critical_load(zj.uniform_rods(damping=Quadratic(0.05))).q_cr)
print(zj.critical_load(zj.uniform_rods()).q_cr)

# %% [markdown]
# ## An observer
#
# An observer keeps running numbers along the settled motion: `init` at its beginning,
# `step` after each step (`step.y1` is the state there: both angles, both rates),
# `result` at its end. A `Variable` says what the number is called, with its unit and
# dimensions.


# %%
class PeakRate(zj.AbstractObserver):
    name = "peak_rate"

    def init(self, system, t, y):
        return abs(y[2]), abs(y[3] - y[2])

    def step(self, system, state, step):
        w1, w2 = step.y1.omega
        return jnp.maximum(state[0], abs(w1)), jnp.maximum(state[1], abs(w2 - w1))

    def result(self, system, state, span, y):
        rates, unit = jnp.stack(state), "sqrt(k/(m l^2))"
        return {"peak_rate": zj.Variable(rates, "largest joint rate", unit, ("joint",))}


# %% [markdown]
# `integrand` names functions to integrate along the motion; each step then has their
# integrals, of the order of the method, as `step.integrals`. This observer integrates
# the power lost by friction in each joint, torque times rate. `system` has the numbers
# of the column, computed once.


# %%
class Losses(zj.AbstractObserver):
    name = "losses"

    def integrand(self, system, y):
        t1, t2 = system.friction_torques(y)
        return t1 * y[2], t2 * (y[3] - y[2])

    def init(self, system, t, y):
        return 0.0 * y[0], 0.0 * y[0]

    def step(self, system, state, step):
        return state[0] + step.integrals[0], state[1] + step.integrals[1]

    def result(self, system, state, span, y):
        means, unit = jnp.stack(state) / span, "k sqrt(k/(m l^2))"
        return {"loss": zj.Variable(means, "power lost in the joint", unit, ("joint",))}


# %% [markdown]
# It also has `system.power(y)`, `system.energy(y)` and `system.field(t, y)`.
#
# ## All of it in a map


# %%
def point(q, mu):
    friction, damping = Root(mu, 0.1, 0.02), Quadratic(0.05)
    column = zj.uniform_rods(q, friction=friction, damping=damping)
    start = zj.State(omega=(0, 0.3))
    observers = (PeakRate(), Losses(), zj.EnergyBalance())
    return zj.settle(column, start, observers=observers, certify=False)


ds = zj.sweep(point, q=np.linspace(1.5, 3, 16), mu=np.linspace(0.02, 0.2, 8))
ax = ds.sel(joint=2).pipe(zj.plot.map, "peak_rate", x="q", y="mu")

# %% [markdown]
# ## Is the law right?
#
# Check a law by a balance that is independent of its code. `EnergyBalance` integrates
# the powers along the motion: the work of the load must equal the losses by damping and
# friction, to the error of the integration. And the losses of both joints must add up
# to its power of friction.

# %%
cycles = ds.where(ds.outcome == zj.CODE.repeats)
imbalance = abs(cycles.energy_imbalance / cycles.follower_power).max().item()
print(f"largest imbalance, relative to the load's power: {imbalance:.1e}")
apart = abs(cycles.loss.sum("joint") / cycles.friction_power - 1).max().item()
print(f"losses of the joints against the power of friction: {apart:.1e}")
assert imbalance < 1e-3 and apart < 1e-12

# %% [markdown]
# ## Two things to know
#
# Write a law's numbers as its own fields. JAX remembers a global that a law reads as it
# was when first traced: within one point, and outside of `sweep` for good.
#
# A number that breaks one of the `rules` gives the outcome `invalid` and NaN. A sweep
# warns of such points at its end; this warning is expected here.

# %%
with warnings.catch_warnings():
    warnings.simplefilter("ignore", UserWarning)
    bad = zj.sweep(point, q=[2.0], mu=[-0.1, 0.1], progress=False)
print([zj.CODE(int(code)).name for code in bad.outcome.values.ravel()])
