"""Regimes and critical loads of a million columns, against `jnp.linalg.eigvals`.

Random columns of seven numbers (load, masses, stiffness, follower fraction, both
dampings), one jitted vmap each, in turns. Eigenvalues are timed on a fiftieth of the
same columns, scaled up, as one LAPACK call a matrix scales; the matrices are made
outside the clock. Prints one JSON line, in seconds.

    python benchmarks/a1_linear.py [--columns 1000000]
"""

import jax
import jax.numpy as jnp
import numpy as np
from measure import arguments, interleaved, ready, report

import ziegler_jax as zj

SHARE = 50
LOW, HIGH = (0.0, 0.3, 0.3, 0.3, 0.4, 0.01, 0.01), (5.0, 3.0, 3.0, 3.0, 1.2, 1.0, 1.0)


def column(q, m1, m2, kappa, eta, c1, c2):
    return zj.uniform_rods(
        q, m1=m1, m2=m2, kappa=kappa, follower=eta, damping=zj.Viscous(c1, c2)
    )


def first_order(*numbers):
    m, c, k = zj.linearise(column(*numbers))
    lower = -jnp.linalg.inv(m) @ jnp.concatenate([k, c], axis=1)
    return jnp.concatenate([jnp.eye(2, 4, 2), lower])


def main():
    count = arguments(__doc__, columns=1_000_000).columns
    jax.config.update("jax_enable_x64", True)
    table = np.random.default_rng(0).uniform(LOW, HIGH, (count, len(LOW))).T
    few = jax.jit(jax.vmap(first_order))(*table[:, : count // SHARE])
    of_all = {"regime": zj.regime, "critical_load": zj.critical_load}
    eigvals = jax.jit(jnp.linalg.eigvals)
    contestants = {"eigvals": lambda: ready(eigvals(few))}
    for name, question in of_all.items():
        program = jax.jit(jax.vmap(lambda *x, ask=question: ask(column(*x))))
        contestants[name] = lambda f=program: ready(f(*table))
    seconds = {n: float(np.min(s)) for n, s in interleaved(contestants, 5).items()}
    seconds["eigvals"] *= SHARE
    over = {f"eigvals_over_{n}": seconds["eigvals"] / seconds[n] for n in of_all}
    report("a1_linear", columns=count, seconds=seconds, **over)


if __name__ == "__main__":
    main()
