"""What a diffrax user writes: the reference work as one `jit(vmap(diffeqsolve))`.

All lanes in one call, in float64, diffrax's own Tsit5 and step-size controller; the
state once as an array of shape (4,) and once as a tuple of four scalars.

    python benchmarks/peers/naive.py    # ns per lane and step of both
"""

import time

import diffrax as dfx
import jax
import jax.numpy as jnp
import numpy as np

A, B, D = 4 / 3, 1 / 2, 1 / 3  # two uniform rods
TAU_S, TAU_K, V_STRIBECK, V_SMOOTH = 0.012, 0.010, 0.05, 0.01


def friction(u):
    drop = jnp.exp(-((u / V_STRIBECK) ** 2))
    return (TAU_K + (TAU_S - TAU_K) * drop) * jnp.tanh(u / V_SMOOTH)


def accelerations(phi1, phi2, omega1, omega2, q):
    s, c = jnp.sin(phi1 - phi2), jnp.cos(phi1 - phi2)
    f1, f2 = friction(omega1), friction(omega2 - omega1)
    r1 = q * s - 2 * phi1 + phi2 - B * s * omega2**2 - f1 + f2
    r2 = phi1 - phi2 + B * s * omega1**2 - f2
    det = A * D - (B * c) ** 2
    return (D * r1 - B * c * r2) / det, (A * r2 - B * c * r1) / det


def stacked_field(t, y, q):
    phi1, phi2, omega1, omega2 = y
    return jnp.stack([omega1, omega2, *accelerations(phi1, phi2, omega1, omega2, q)])


def tuple_field(t, y, q):
    _, _, omega1, omega2 = y
    return omega1, omega2, *accelerations(*y, q)


def solve(field, y0, q):
    solution = dfx.diffeqsolve(
        dfx.ODETerm(field),
        dfx.Tsit5(),
        t0=0.0,
        t1=100.0,
        dt0=0.01,
        y0=y0,
        args=q,
        stepsize_controller=dfx.PIDController(rtol=1e-6, atol=1e-6),
        saveat=dfx.SaveAt(t1=True),
        max_steps=100_000,
    )
    return jax.tree.map(lambda y: y[-1], solution.ys), solution.stats["num_steps"]


@jax.jit
@jax.vmap
def _stacked(q):
    return solve(stacked_field, jnp.array([0.0, 0.0, 0.0, 0.2]), q)


@jax.jit
@jax.vmap
def _tuple(q):
    start = tuple(jnp.array(x) for x in (0.0, 0.0, 0.0, 0.2))
    return solve(tuple_field, start, q)


def solve_stacked(q):
    """The final states (n, 4) and the numbers of steps (n,) of the loads `q`."""
    with jax.enable_x64(True):
        return _stacked(jnp.asarray(q, jnp.float64))


def solve_tuple(q):
    """The final states, four arrays (n,), and the numbers of steps of the loads `q`."""
    with jax.enable_x64(True):
        return _tuple(jnp.asarray(q, jnp.float64))


def main():
    q = np.linspace(2, 4, 8192)
    for name, run in (("stacked", solve_stacked), ("tuple", solve_tuple)):
        jax.block_until_ready(run(q))  # compiles
        best = np.inf
        for _ in range(2):
            start = time.perf_counter()
            _, steps = jax.block_until_ready(run(q))
            best = min(best, time.perf_counter() - start)
        steps = np.asarray(steps)
        print(
            f"{name}: {best / steps.sum() * 1e9:.0f} ns per lane and step, "
            f"{steps.mean():.1f} steps a lane"
        )


if __name__ == "__main__":
    main()
