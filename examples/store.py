"""Save a map, go on with it later, make its boundaries sharp, and merge two of them."""

import numpy as np

import ziegler_jax as zj


def point(q, kappa):
    column = zj.uniform_rods(q, kappa=kappa, damping=zj.Viscous(0.01, 0.02))
    return {"regime": zj.regime(column), "growth": zj.spectral_abscissa(column)}


q, low, high = np.linspace(0, 6, 12), [0.5, 1.0, 1.5], [2.0, 2.5, 3.0]
first = zj.sweep(point, q=q, kappa=low, store="low.zarr")
again = zj.sweep(point, q=q, kappa=low, store="low.zarr")  # nothing is left to do
second = zj.sweep(point, q=q, kappa=high)
whole = zj.merge(zj.open_sweep("low.zarr"), second)
sharp = zj.refine(point, whole, "regime", width=1e-3)
sharp.pipe(zj.plot.map, "regime", x="q", y="kappa").figure.savefig("regime.png")
