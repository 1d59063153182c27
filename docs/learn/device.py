# %% [markdown]
# # A device in SI units
#
# From a data sheet to a map: a column of two rods, 0.1 kg and 0.2 m each, springs of
# 0.5 N m/rad, pins of 4 mm radius with a friction coefficient of 0.15. At which force
# does it flutter, after which knock, how large, how fast?

# %%
import jax
import matplotlib.pyplot as plt
import numpy as np
import xarray as xr

import ziegler_jax as zj

zj.configure_cpu()
jax.config.update("jax_enable_x64", True)

DEVICE = zj.SI(m=0.1, l=0.2, k=0.5)
print("the unit of time is", DEVICE.time, "s, that of force", DEVICE.force, "N")

# %% [markdown]
# ## The column
#
# Write the column in kilograms, metres, newtons and seconds; `scaled` converts it, with
# all its parts, to the units of the package. `l1`, the length of rod 1, marks a column
# in SI units, which must name all of its masses and lengths.

# %%
RODS = {"m1": 0.1, "m2": 0.1, "l1": 0.2, "l2": 0.2}
DAMPING = zj.Viscous(1e-4, 1e-4)  # N m s/rad


def column(F):
    friction = zj.SetValuedCoulomb(0.15, pin_radius=0.004)
    device = zj.uniform_rods(F, **RODS, friction=friction, damping=DAMPING)
    return DEVICE.scaled(device)


# %% [markdown]
# `k` is the spring of joint 2. Joint 1 has the same, or `kappa` times it: a spring of
# 0.8 N m/rad at the base is `zj.uniform_rods(F, **RODS, kappa=0.8 / 0.5)`.
#
# Without friction and with this damping it would flutter from here on:

# %%
bare = DEVICE.scaled(zj.uniform_rods(0.0, **RODS, damping=DAMPING))
load = zj.critical_load(bare)
print("critical force", load.q_cr * DEVICE.force, "N")
print("frequency there", load.frequency / DEVICE.time / (2 * np.pi), "Hz")

# %% [markdown]
# ## One motion, in seconds
#
# `restore` turns a result back into SI units; its labels and pictures follow.

# %%
seconds = np.linspace(0, 6, 1501)
start = DEVICE.scaled(zj.State(omega=(0, 2.0)))  # rad/s
motion = zj.trajectory(column(6.0), start, seconds / DEVICE.time)
ax = zj.plot.time_history(DEVICE.restore(motion))

# %% [markdown]
# ## How it ends
#
# Without damping and friction a column has no limit cycle: below its critical load it
# swings on, and would be `unsettled`. This one has both.

# %%
windows = DEVICE.scaled(zj.Windows(transient=10.0, length=5.0))  # seconds
observers = (zj.Period(), zj.StickFraction())
end = zj.settle(column(6.0), start, windows=windows, observers=observers)
end = DEVICE.restore(end)
end

# %%
print(f"it swings {float(end.frequency):.2f} times a second, ")
print(f"joint 2 by {np.rad2deg(float(end.joint_amplitude[1])):.0f} degrees")

# %% [markdown]
# ## A map over force and knock


# %%
def point(F, kick):  # newtons, rad/s
    start = DEVICE.scaled(zj.State(omega=(0, kick)))
    return zj.settle(column(F), start, windows=windows)


kick = xr.DataArray(
    np.linspace(0.25, 4, 12), attrs={"long_name": "knock on rod 2", "units": "rad/s"}
)
ds = zj.sweep(point, F=np.linspace(2, 8, 16), kick=kick)
ds = DEVICE.restore(ds)
ax = ds.sel(joint=2).pipe(zj.plot.map, "joint_amplitude", x="F", y="kick")

# %% [markdown]
# On the left the column comes to rest after every knock. The knock that starts flutter
# falls as the force grows. Dotted cells are `unsettled`: they still move, but not on a
# certified cycle. An axis may have its own name and unit, as the knock has.
#
# ## The onset in newtons

# %%
search = zj.Search(scan=6, halvings=6)
onset = zj.flutter_onset(column, start, (2.0, 8.0), search=search)
print(
    zj.CODE(int(onset.outcome)).name, "at", onset.threshold, "N, to", onset.width, "N"
)

# %% [markdown]
# `flutter_onset` varies the argument of your function. The argument of `column` is a
# force in newtons, so the threshold is in newtons.
#
# ## Rougher pins
#
# The friction of a device is usually its least certain number. Vary it.


# %%
def rougher(F, mu):
    friction = zj.SetValuedCoulomb(mu, pin_radius=0.004)
    device = zj.uniform_rods(F, **RODS, friction=friction, damping=DAMPING)
    return zj.settle(DEVICE.scaled(device), start, windows=windows)


ds = zj.sweep(rougher, F=np.linspace(2, 8, 16), mu=np.linspace(0.05, 0.5, 10))
ds = DEVICE.restore(ds)
ax = ds.sel(joint=2).pipe(zj.plot.map, "joint_amplitude", x="F", y="mu")

# %% [markdown]
# ## Friction from a multibody program
#
# Such a program takes coefficients, the pin's radius and a transition velocity of its
# surface. `joint_friction` translates these into a smoothed law on the joints'
# reactions, in SI units: a column takes it as any other law.

# %%
law = DEVICE.joint_friction(0.2, 0.15, pin_radius=0.004, transition_velocity=1e-3)
law

# %%
figure, ax = plt.subplots(layout="constrained")
rate = np.linspace(-1.5, 1.5, 601)  # rad/s
ax.plot(rate, 1000 * law.levers(rate, rate)[0])
ax.set(xlabel="joint rate (rad/s)", ylabel="torque per newton of reaction (N mm/N)")
