"""The critical load of 100 000 columns with uncertain springs, masses and damping."""

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr

import ziegler_jax as zj

SAMPLES = 100_000


def point(kappa, m2, c):
    damping = zj.Viscous(c, c)
    return zj.critical_load(zj.uniform_rods(kappa=kappa, m2=m2, damping=damping))


random = np.random.default_rng(0)
drawn = {
    "kappa": random.normal(1, 0.05, SAMPLES),
    "m2": random.normal(1, 0.05, SAMPLES),
    "c": random.uniform(0.01, 0.05, SAMPLES),
}
ds = zj.sweep(point, **{n: xr.DataArray(x, dims="sample") for n, x in drawn.items()})
plt.hist(ds.q_cr, bins=100)
plt.savefig("samples.png")
