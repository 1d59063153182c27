# %% [markdown]
# # Stick-slip against smoothed friction
#
# Two laws for the same pin. `SetValuedCoulomb` is dry friction: a joint sticks or
# slips, and motions go from event to event. `SmoothCoulomb` replaces the jump at zero
# rate by a hyperbolic tangent. This page applies both to one column, and shows where
# they differ and how far each can be trusted.

# %%
import jax
import matplotlib.pyplot as plt
import numpy as np

import ziegler_jax as zj

zj.configure_cpu()
jax.config.update("jax_enable_x64", True)

dry = zj.SetValuedCoulomb(0.1, pin_radius=1.0)  # tau = 0.1 q


def column(friction, q=2.0):
    return zj.uniform_rods(q, friction=friction)


# %% [markdown]
# ## A motion that sticks
#
# The set-valued motion lists its events: the times at which a joint changed its mode (0
# sticks, 1 and -1 slip forwards and backwards). Between two events a rate may be
# exactly zero.

# %%
ts = np.linspace(0, 40, 2001)
kick = zj.State(omega=(0, 1.0))
exact = zj.trajectory(column(dry), kick, ts)
rate = np.asarray(exact.omega[:, 1] - exact.omega[:, 0])
print(f"joint 2 has a rate of exactly zero {np.mean(rate == 0):.0%} of the time")
for n in range(int(exact.events.count)):
    time, joint = exact.events.times[n], exact.events.joints[n]
    print(f"t = {time:.4f}: joint {joint}, then both are in {exact.events.modes[n]}")

# %% [markdown]
# The smoothed law never sticks. It creeps, the faster the wider its layer.

# %%
figure, axes = plt.subplots(2, 1, sharex=True, layout="constrained", figsize=(7, 6))
axes[0].plot(ts, exact.phi[:, 1] - exact.phi[:, 0], "k", label="set-valued")
axes[1].semilogy(ts, np.maximum(np.abs(rate), 1e-9), "k")
for v in (0.1, 0.01):
    motion = zj.trajectory(column(dry.smoothed(v)), kick, ts)
    axes[0].plot(ts, motion.phi[:, 1] - motion.phi[:, 0], label=f"v_smooth = {v}")
    axes[1].semilogy(ts, abs(motion.omega[:, 1] - motion.omega[:, 0]))
axes[0].set(ylabel="angle of joint 2")
axes[1].set(ylabel="its rate, absolute", xlabel="time", ylim=(1e-8, None))
axes[0].legend()

# %% [markdown]
# The column stops. The set-valued column stays where it stopped: its rate is zero
# (drawn at the picture's lower edge). The smoothed column slides back to the upright at
# a small rate. A set of resting places has become a slow slide.
#
# ## On a cycle they agree, as the layer narrows
#
# Where joints keep slipping, the smoothed law tends to dry friction. The error of an
# amplitude falls with `v_smooth`, and the price rises: steps must follow the layer.

# %%
cycle = zj.SetValuedCoulomb(0.026, pin_radius=1.0, load=zj.ConstantLoad(1.0))
hard = zj.State(omega=(0, 1.0))
limit = zj.settle(column(cycle, 2.6), hard)
print("set-valued:", limit.joint_amplitude[1], "in", limit.steps, "steps")


# %%
def smoothed(v):
    return zj.settle(column(cycle.smoothed(v), 2.6), hard, certify=False)


ds = zj.sweep(smoothed, v=[0.3, 0.1, 0.03, 0.01, 0.003])
for v in ds.v.values:
    one = ds.sel(v=v, joint=2)
    error = float(one.joint_amplitude - limit.joint_amplitude[1])
    print(f"v_smooth = {v:5}: {error:.5f} too large, {int(one.steps)} steps")

# %% [markdown]
# ## Where they differ
#
# The smoothed column at rest is a viscously damped column, and one with a load above
# its own critical load is unstable *from rest*: a kick of a millionth grows into
# flutter. Dry friction holds that same column.

# %%
tau, v, q = 0.01, 0.05, 1.8
law = zj.SetValuedCoulomb(tau, pin_radius=1.0, load=zj.ConstantLoad(1.0))
tiny = zj.State(omega=(0, 1e-6))
late = np.linspace(0, 2000, 2001)
figure, ax = plt.subplots(layout="constrained")
for name, friction in (("smoothed", law.smoothed(v)), ("set-valued", law)):
    motion = zj.trajectory(column(friction, q), tiny, late)
    ax.semilogy(late, np.maximum(abs(motion.phi[:, 1]), 1e-13), label=name)
ax.set(xlabel="time", ylabel="angle of rod 2, absolute (rad)")
ax.legend()

# %%
tangent = zj.tangent_column(column(law.smoothed(v), q))
print("damping of the smoothed law at rest:", tau / v)
print("regime there:", zj.CODE(int(zj.regime(tangent))).name)
print("growth rate:", zj.spectral_abscissa(tangent))
end = zj.settle(column(law.smoothed(v), q), tiny)
print("and settle says:", zj.CODE(int(end.outcome)).sentence)

# %% [markdown]
# This flutter of the smoothed column is a property of `v_smooth`, not of friction.
# `stuck` means more than slow: the remaining motion must decay. It grows in this case,
# as the regime of the tangent column says.
#
# ## Over a plane
#
# `compare` settles each point under both laws. It gives the differences of their
# numbers and of their outcomes.


# %%
def settled(q, mu, v_smooth=None):
    law = zj.SetValuedCoulomb(mu, pin_radius=0.1)
    friction = law if v_smooth is None else law.smoothed(v_smooth)
    column = zj.uniform_rods(q, friction=friction)
    return zj.settle(column, zj.State(omega=(0, 0.3)), certify=False)


grid = {"q": np.linspace(1.3, 2.9, 9), "mu": np.linspace(0.04, 0.28, 7)}
both = zj.compare(settled, {"smoothed": {"v_smooth": 0.02}}, **grid)
dry, smooth = both.sel(variant="reference"), both.sel(variant="smoothed")
differ = int(smooth.changed.sum())
print(differ, "of", smooth.changed.size, "motions have another outcome")
repeat = (dry.outcome == zj.CODE.repeats) & (smooth.outcome == zj.CODE.repeats)
errors = abs(smooth.sel(joint=2).joint_amplitude_difference.where(repeat))
print("errors of the amplitude where both repeat, in rad:")
print(errors.quantile([0, 0.5, 0.9, 1]).values)
ax = dry.pipe(zj.plot.map, "outcome", x="q", y="mu")

# %%
ax = smooth.pipe(zj.plot.map, "outcome", x="q", y="mu")

# %% [markdown]
# ## Which to take
#
# | question | law |
# |---|---|
# | does it stick, where does it rest, how long does it stick | `SetValuedCoulomb` |
# | onset, least kicks, folds | `SetValuedCoulomb` |
# | amplitudes of a cycle that slips throughout | either |
# | a law over the rate, a multibody program | `SmoothCoulomb` |
#
# Trust a smoothed answer when it no longer depends on `v_smooth`: halve it and compare.
# With $\mu_s > \mu_k$ a set-valued answer depends on the rule that chooses which joint
# breaks loose: as few joints as possible. A smoothed law with $\mu_s > \mu_k$ chooses
# by the shape of its layer, and its motion need not tend to the same one.
