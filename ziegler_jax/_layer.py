r"""The fast passage through a friction layer: where two joints at rest go as v -> 0.

The layer of the rule `stribeck-limit`, with $x_i = u_i / v$:

$$T(x) = \tau_s |x| \text{ for } |x| < 1, \quad
\tau_k + (\tau_s - \tau_k)\,e^{-(|x| - 1)} \text{ beyond},$$

with the sign of x. In the time t / v the column does not move while x does,

$$x_1' = \dot\omega_1(T), \qquad x_2' = \dot\omega_2(T) - \dot\omega_1(T),$$

until each joint rests in its layer ($|x_i| \le 1$, it sticks) or has left it.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jax import lax

from ._types import Pair

FAR = 20.0  # there e^-19 of the fall is left: 6e-9
MOST_STEPS = 4000
STEP = 0.1  # against the layer's own rate
AT_REST = 1e-7  # of the rates, against the largest: an equilibrium is reached


def layer_limit(balance: Any, static: Pair, kinetic: Pair, start: Pair, ask: Any):
    """The modes that the layer's passage ends in.

    **Arguments:** `balance`: masses and forces, see `set_valued`; `static`, `kinetic`:
    torques; `start`: where the joints enter, x1 and x2; `ask`: whether to compute it.

    **Returns:** two modes, -1., 0. or 1.; those of the moment if it takes too long.
    """
    a, h, d, r1, r2 = balance
    inverse = 1 / (a * d - h * h)
    # u' = s - W T
    s1 = (d * r1 - h * r2) * inverse
    s2 = (a * r2 - h * r1) * inverse - s1
    w11, w12, w22 = d * inverse, -(d + h) * inverse, (a + 2 * h + d) * inverse
    falls = tuple(s - k for s, k in zip(static, kinetic, strict=True))

    def torque(x, i):
        size = jnp.abs(x)
        outer = kinetic[i] + falls[i] * jnp.exp(-jnp.maximum(size - 1, 0.0))
        return jnp.where(size < 1, static[i] * x, jnp.sign(x) * outer)

    def rates(x1, x2):
        t1, t2 = torque(x1, 0), torque(x2, 1)
        return s1 - w11 * t1 - w12 * t2, s2 - w12 * t1 - w22 * t2

    tiny = jnp.finfo(jnp.result_type(float)).tiny
    largest = jnp.abs(s1) + jnp.abs(s2) + w11 * static[0] + w22 * static[1] + tiny

    def slope(x, i):
        size = jnp.abs(x)
        outer = falls[i] * jnp.exp(-jnp.maximum(size - 1.5, 0.0))
        return jnp.where(size < 1.5, static[i], outer)

    def step(state):
        x1, x2, _, count = state
        a1, a2 = rates(x1, x2)
        h = STEP / (w11 * slope(x1, 0) + w22 * slope(x2, 1) + tiny)
        for x, v in ((x1, a1), (x2, a2)):  # not across a layer unseen
            room = 0.3 * jnp.maximum(0.3, jnp.abs(jnp.abs(x) - 1.0))
            h = jnp.minimum(h, room / (jnp.abs(v) + tiny))
        b1, b2 = rates(x1 + h / 2 * a1, x2 + h / 2 * a2)
        c1, c2 = rates(x1 + h / 2 * b1, x2 + h / 2 * b2)
        e1, e2 = rates(x1 + h * c1, x2 + h * c2)
        y1 = x1 + h / 6 * (a1 + 2 * b1 + 2 * c1 + e1)
        y2 = x2 + h / 6 * (a2 + 2 * b2 + 2 * c2 + e2)
        f1, f2 = rates(y1, y2)

        def over(y, f):
            rests = (jnp.abs(y) <= 1.0) & (jnp.abs(f) < AT_REST * largest)
            gone = (jnp.abs(y) > FAR) & (y * f > 0)
            return rests | gone

        bad = ~(jnp.isfinite(y1) & jnp.isfinite(y2))
        return y1, y2, (over(y1, f1) & over(y2, f2)) | bad, count + 1

    def goes_on(state):
        return ~state[2] & (state[3] < MOST_STEPS)

    zero = jnp.zeros((), jnp.int32)
    done = ~ask
    x1, x2 = jnp.asarray(start[0]) + 0.0 * s1, jnp.asarray(start[1]) + 0.0 * s1
    x1, x2, _, _ = lax.while_loop(goes_on, step, (x1, x2, done, zero))

    def mode(x: jax.Array) -> jax.Array:
        return jnp.where(jnp.abs(x) <= 1.0, 0.0, jnp.sign(x))

    return mode(x1), mode(x2)
