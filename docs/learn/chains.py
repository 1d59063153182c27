# %% [markdown]
# # From Ziegler to Beck: more rods
#
# A column of two rods is the smallest that flutters. A `Chain` has up to sixteen, with
# rest angles, a tip mass, gravity and more. This page computes Beck's column in rods,
# the effect of friction on it, and a bent and heavy chain.

# %%
import jax
import matplotlib.pyplot as plt
import numpy as np

import ziegler_jax as zj

jax.config.update("jax_enable_x64", True)

# %% [markdown]
# ## The load of the beam
#
# `beck(n)` is a cantilever of n equal rods, scaled so that its load is $P L^2/(EI)$.
# With more rods the critical load nears that of the beam, as 1/n; a polynomial in 1/n
# through some of them meets it.

# %%
counts = [2, 4, 6, 8, 10, 12, 14, 16]
loads = [float(zj.critical_load(zj.beck(n)).q_cr) for n in counts]
limit = np.polyfit(1 / np.array(counts[2:]), loads[2:], 5)[-1]
fig, ax = plt.subplots(figsize=(6, 3.4), layout="constrained")
ax.plot(1 / np.array(counts), loads, "o-", label="n rods")
ax.plot(0, limit, "s", color="C3", label=f"limit: {limit:.4f} (Beck: 20.0510)")
ax.set(xlabel="1/n", ylabel=r"critical load $P L^2/(EI)$")
ax.legend()
# %% [markdown]
# ## Small damping
#
# As for two rods, damping however small lowers the load, for this chain to about half;
# the amount depends on the share of each joint. Derivatives exist as for two rods.

# %%
damped = zj.beck(4, damping=zj.Viscous(0.01, 0.01, 0.01, 0.01))
names = [f"damping.{c}" for c in ("c1", "c2", "c3", "c4")]
table = zj.sensitivity(damped, parameters=names)
print(f"undamped {loads[1]:.3f}, damped {table.q_cr:.3f}")
table.elasticity.to_series()

# %% [markdown]
# ## Friction in the joints
#
# `zj.Chain(q, lengths=(1, 1, 1))` has rods, masses and springs of 1, its load is
# q = F l/k; that of `beck(n)` is $n^2$ times as large, $P L^2/(EI)$.
#
# The last rod of a chain of three is kicked, at each load and friction of a small map.
# Coloured cells flutter on a certified cycle, plain ones have come to rest. Dotted
# motions still approach their cycle at the end of the time: at small friction this is
# slow.

# %%
windows = zj.Windows(transient=20.0, length=8.0, max_windows=10)
kick = zj.State(omega=(0.0, 0.0, 0.5))


def cell(q, tau):
    law = zj.SmoothCoulomb(tau, pin_radius=1.0, v_smooth=0.1, load=zj.ConstantLoad(1.0))
    return zj.beck(3, q, friction=law), kick


ds = zj.sweep(
    lambda q, tau: zj.settle(*cell(q, tau), windows=windows),
    q=np.linspace(6, 18, 13), tau=np.linspace(0.01, 0.13, 9), progress=False,
)  # fmt: skip
ax = ds.sel(rod=3).pipe(zj.plot.map, "rod_amplitude", x="tau", y="q")
ax.set(xlabel=r"friction $\tau$ ($EI/L$)", ylabel=r"load $P L^2/(EI)$")
# %% [markdown]
# ## Bent and heavy
#
# Rest angles bend the column, gravity pulls on it. Its equilibrium is off the vertical:
# the linear functions treat motions about it, and flutter swings about it.

# %%
bent = zj.beck(3, 14.0, friction=cell(14.0, 0.03)[0].friction,
               rest_angles=0.05, gravity=zj.Gravity(1.0))  # fmt: skip
end = zj.settle(bent, kick, windows=windows, observers=(zj.Mean(),))
end

# %%
ts = np.linspace(0, 20, 2001)
motion = zj.trajectory(bent, kick, ts)
axes = zj.plot.time_history(motion)
axes[0].set(xlabel=r"time ($\sqrt{\rho A L^4/(EI)}$)", title="$q = 14$, bent and heavy")
axes[1].set(ylabel=r"rate ($\sqrt{EI/(\rho A L^4)}$)")
