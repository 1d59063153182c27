"""diffrax as its users write it: one `jit(vmap(diffeqsolve))` of all lanes."""

import functools

import diffrax as dfx
import jax
import jax.numpy as jnp
import numpy as np
from measure import clock, ready
from scenes import accelerations

NAMES = ("Tsit5", "Dopri8", "Kvaerno5")


@functools.cache
def compiled(scene, solver):
    """One program for all tolerances."""

    def field(t, y, q):
        phi1, phi2, w1, w2 = y
        return jnp.stack([w1, w2, *accelerations(jnp, scene, q, phi1, phi2, w1, w2)])

    def solve(q, y0, span, tol):
        solution = dfx.diffeqsolve(
            dfx.ODETerm(field),
            getattr(dfx, solver)(),
            t0=0.0,
            t1=span,
            dt0=0.01,
            y0=y0,
            args=q,
            stepsize_controller=dfx.PIDController(rtol=tol, atol=tol),
            saveat=dfx.SaveAt(t1=True),
            max_steps=10_000_000,
            throw=False,
        )
        assert solution.ys is not None
        return solution.ys[-1]

    return jax.jit(jax.vmap(solve, in_axes=(0, None, None, None)))


def run(scene, q, start, span, rtol, solver="Tsit5"):
    with jax.enable_x64(True):
        solve = compiled(scene, solver)
        y0 = jnp.asarray(start)
        ready(solve(q, y0, 0.05, rtol))  # compiles: one program for all spans
        begun = clock()
        states = ready(solve(q, y0, span, rtol))
        return np.asarray(states), clock() - begun
