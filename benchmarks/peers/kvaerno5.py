"""What a diffrax user writes for stiff lanes: `jit(vmap(diffeqsolve(Kvaerno5)))`.

The field is that of `naive`, with the friction of one coefficient and its torque and
smoothing rate per lane.
"""

import diffrax as dfx
import jax
import jax.numpy as jnp
import numpy as np

A, B, D = 4 / 3, 1 / 2, 1 / 3  # two uniform rods


def field(t, y, lane):
    q, tau, v_smooth = lane
    phi1, phi2, omega1, omega2 = y
    s, c = jnp.sin(phi1 - phi2), jnp.cos(phi1 - phi2)
    f1 = tau * jnp.tanh(omega1 / v_smooth)
    f2 = tau * jnp.tanh((omega2 - omega1) / v_smooth)
    r1 = q * s - 2 * phi1 + phi2 - B * s * omega2**2 - f1 + f2
    r2 = phi1 - phi2 + B * s * omega1**2 - f2
    det = A * D - (B * c) ** 2
    w1, w2 = (D * r1 - B * c * r2) / det, (A * r2 - B * c * r1) / det
    return jnp.stack([omega1, omega2, w1, w2])


@jax.jit
def _solve(lanes, y0, span, tol):
    def one(lane):
        solution = dfx.diffeqsolve(
            dfx.ODETerm(field),
            dfx.Kvaerno5(),
            t0=0.0,
            t1=span,
            dt0=0.01,
            y0=y0,
            args=lane,
            stepsize_controller=dfx.PIDController(rtol=tol, atol=tol),
            saveat=dfx.SaveAt(t1=True),
            max_steps=1_000_000,
            throw=False,
        )
        assert solution.ys is not None
        return solution.ys[-1], solution.stats["num_steps"]

    return jax.vmap(one)(lanes)


def solve(lanes, start, span, tol):
    """Final states (n, 4) and steps (n,) of lanes (q, tau, v_smooth), each (n,)."""
    with jax.enable_x64(True):
        lanes = tuple(jnp.asarray(x, jnp.float64) for x in lanes)
        y0 = jnp.asarray(start, jnp.float64)
        return jax.tree.map(np.asarray, _solve(lanes, y0, float(span), float(tol)))
