"""diffrax as its users write it: one `jit(vmap(diffeqsolve))` of all lanes.

The state is an array of four numbers; with `stacked=False` a tuple of four scalars.
"""

import functools

import diffrax as dfx
import jax
import jax.numpy as jnp
import numpy as np
from measure import clock, ready
from scenes import accelerations

NAME, LANES = "diffrax vmap", 512


@functools.cache
def compiled(scene, method="Tsit5", stacked=True):
    """One program for all tolerances: (q, y0, span, tol) to the last states."""

    def field(t, y, q):
        phi1, phi2, w1, w2 = y
        rates = w1, w2, *accelerations(jnp, scene, q, phi1, phi2, w1, w2)
        return jnp.stack(rates) if stacked else rates

    def solve(q, y0, span, tol):
        solution = dfx.diffeqsolve(
            dfx.ODETerm(field),
            getattr(dfx, method)(),
            t0=0.0,
            t1=span,
            dt0=0.01,
            y0=jnp.stack(y0) if stacked else y0,
            args=q,
            stepsize_controller=dfx.PIDController(rtol=tol, atol=tol),
            saveat=dfx.SaveAt(t1=True),
            max_steps=10_000_000,
            throw=False,
        )
        assert solution.ys is not None
        return jax.tree.map(lambda y: y[-1], solution.ys)

    return jax.jit(jax.vmap(solve, in_axes=(0, None, None, None)))


def solve(scene, q, start, span, rtol, method="Tsit5", stacked=True):
    """The states at `span`: (n, 4), or four arrays (n,) where they are not stacked."""
    with jax.enable_x64(True):
        y0 = tuple(jnp.asarray(x) for x in start)
        return ready(compiled(scene, method, stacked)(q, y0, span, rtol))


def run(scene, q, start, span, rtol, method="Tsit5"):
    solve(scene, q, start, 0.05, rtol, method)  # compiles: one program for all spans
    begun = clock()
    states = solve(scene, q, start, span, rtol, method)
    return np.asarray(states), clock() - begun
