"""The critical load, its gradient, and the parameters that raise it most."""

import jax
import numpy as np
from scipy.optimize import minimize

import ziegler_jax as zj

jax.config.update("jax_enable_x64", True)


def q_cr(x):
    m2, kappa, c1 = x
    damping = zj.Viscous(c1, 0.02)
    column = zj.uniform_rods(m2=m2, kappa=kappa, damping=damping)
    return zj.critical_load(column).q_cr


start = np.array([1.0, 1.0, 0.02])  # mass of rod 2, ratio of springs, damping
print("q_cr", q_cr(start), "gradient", jax.grad(q_cr)(start))
cost = jax.value_and_grad(lambda x: -q_cr(x))
bounds = [(0.5, 2), (0.5, 2), (0.001, 0.5)]
best = minimize(cost, start, jac=True, bounds=bounds)
print("best", best.x, "q_cr", -best.fun)
