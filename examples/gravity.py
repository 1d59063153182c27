"""Gravity: the critical load of a column that stands, and of one that hangs."""

import jax
import numpy as np

import ziegler_jax as zj

jax.config.update("jax_enable_x64", True)


def point(g):  # in k/(m l); upwards is a column that hangs
    gravity = zj.Gravity(g)
    return {"q_cr": zj.critical_load(zj.uniform_rods(gravity=gravity)).q_cr}


ds = zj.sweep(point, g=np.linspace(-0.4, 0.4, 9))
print(ds.q_cr.to_series())
slope = jax.grad(lambda g: point(g)["q_cr"])(0.0)
print("d q_cr / d g without weight:", slope)
