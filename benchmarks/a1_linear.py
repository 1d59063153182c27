"""Regimes and critical loads of a million columns, against `jnp.linalg.eigvals`.

Random columns of six parameters (loads, masses, stiffness, follower fraction, both
dampings), one jitted vmap each, best of five runs after the first. Eigenvalues are
timed on a subsample of 20 000 of the same columns, scaled up to the million, as one
LAPACK call a matrix scales; the matrices are made outside the clock. Prints one JSON
line, in seconds.
"""

import json
import os
import time

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from measure import machine  # noqa: E402

import ziegler_jax as zj  # noqa: E402

COUNT, SAMPLE = 1_000_000, 20_000


def scene(q, m1, m2, kappa, eta, c1, c2):
    return zj.uniform_rods(
        q, m1=m1, m2=m2, kappa=kappa, follower=eta, damping=zj.Viscous(c1, c2)
    )


def regimes(*p):
    return zj.regime(scene(*p))


def critical_loads(*p):
    return zj.critical_load(scene(*p))


def first_order(*p):
    m, c, k = zj.linearise(scene(*p))
    lower = -jnp.linalg.inv(m) @ jnp.concatenate([k, c], axis=1)
    upper = jnp.concatenate([jnp.zeros((2, 2)), jnp.eye(2)], axis=1)
    return jnp.concatenate([upper, lower])


def seconds(function, *arguments, repeats=5):
    jax.block_until_ready(function(*arguments))  # compiles
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        jax.block_until_ready(function(*arguments))
        times.append(time.perf_counter() - start)
    return min(times)


def main():
    rng = np.random.default_rng(0)
    low = np.array([0.0, 0.3, 0.3, 0.3, 0.4, 0.01, 0.01])
    high = np.array([5.0, 3.0, 3.0, 3.0, 1.2, 1.0, 1.0])
    p = jnp.asarray(rng.uniform(low, high, (COUNT, 7)).T)
    regime = seconds(jax.jit(jax.vmap(regimes)), *p)
    critical = seconds(jax.jit(jax.vmap(critical_loads)), *p)
    matrices = jax.jit(jax.vmap(first_order))(*p[:, :SAMPLE])
    eigvals = seconds(jax.jit(jnp.linalg.eigvals), matrices) * COUNT / SAMPLE
    result = {
        "benchmark": "a1_linear",
        "points": COUNT,
        "cores": os.cpu_count(),
        "regime_s": round(regime, 4),
        "critical_load_s": round(critical, 4),
        "eigvals_s": round(eigvals, 2),
        "eigvals_timed_on": SAMPLE,
        "eigvals_over_regime": round(eigvals / regime, 1),
        "eigvals_over_critical_load": round(eigvals / critical, 1),
        "backend": jax.default_backend(),
        **machine(),
    }
    print(json.dumps(result))


if __name__ == "__main__":
    main()
