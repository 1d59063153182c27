r"""The fast passage through a friction layer: where two joints at rest go as v -> 0.

The layer of the rule `stribeck-limit`, with $x_i = u_i / v$:

$$T(x) = \tau_s |x| \text{ for } |x| < 1, \quad
\tau_k + (\tau_s - \tau_k)\,e^{-(|x| - 1)} \text{ beyond},$$

with the sign of x. In the time t / v the column does not move while x does,

$$x_1' = \dot\omega_1(T), \qquad x_2' = \dot\omega_2(T) - \dot\omega_1(T),$$

until each joint rests in its layer ($|x_i| \le 1$, it sticks) or has left it. Within
both layers the motion is linear, and with $e = x - x^*$ about its equilibrium
$V = \sum_i \tau_{s,i} e_i^2$ falls: once the ellipse V = const. lies within
$|x_i| \le 1$ the joints are caught there, and the passage is over.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jax import lax

from ._materialise import materialise
from ._types import Pair

FAR = 12.0  # there e^-11 of the fall is left: 2e-5
MOST_STEPS = 1000
SHARE = 0.1  # of the way to the layer's edge, or of half its width, a step
GROWTH = 0.1  # what flies apart grows by so much a step
GAMMA = 1.0 - 0.5**0.5  # L-stable


def layer_limit(balance: Any, static: Pair, kinetic: Pair, start: Pair, ask: Any):
    """The modes that the layer's passage ends in.

    **Arguments:** `balance`: masses and forces, see `set_valued`; `static`, `kinetic`:
    torques; `start`: where the joints enter, x1 and x2; `ask`: whether to compute it.

    **Returns:** two modes, -1., 0. or 1., and whether the passage came to its end.
    """
    a, h, d, r1, r2 = balance[:5]
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
    # where the layers' linear parts would come to rest: both, or one beside a slip
    held1, held2 = balance.held()
    rest1 = held1 / jnp.maximum(static[0], tiny)
    rest2 = held2 / jnp.maximum(static[1], tiny)
    within = (jnp.abs(rest1) <= 1.0) & (jnp.abs(rest2) <= 1.0)
    room1 = static[0] * (1.0 - jnp.abs(rest1)) ** 2
    room2 = static[1] * (1.0 - jnp.abs(rest2)) ** 2
    room = jnp.where(within, jnp.minimum(room1, room2), -1.0)

    def slope(x, i):
        size = jnp.abs(x)
        outer = -falls[i] * jnp.exp(-jnp.maximum(size - 1, 0.0))
        return jnp.where(size < 1, static[i], outer)

    def linear(x1, x2):
        """The rates, the torques' slopes and the length of a step from here."""
        v1, v2 = rates(x1, x2)
        d1, d2 = slope(x1, 0), slope(x2, 1)
        grows = w11 * jnp.maximum(-d1, 0.0) + w22 * jnp.maximum(-d2, 0.0)
        ds = GROWTH / (grows + tiny)
        for x, v in ((x1, v1), (x2, v2)):
            way = SHARE * jnp.maximum(0.5, jnp.abs(jnp.abs(x) - 1.0))
            ds = jnp.minimum(ds, way / (jnp.abs(v) + tiny))
        return v1, v2, d1, d2, ds

    def solve(v1, v2, d1, d2, ds):
        """(I - gamma ds J)^-1 v with J = -W T'."""
        g = GAMMA * ds
        m11, m12 = 1 + g * w11 * d1, g * w12 * d2
        m21, m22 = g * w12 * d1, 1 + g * w22 * d2
        over = 1 / (m11 * m22 - m12 * m21)
        return (m22 * v1 - m12 * v2) * over, (m11 * v2 - m21 * v1) * over

    def step(state):
        x1, x2, _, count = state
        # ROS2: a joint that rests in its layer is stiff beside one on its way to it
        v1, v2, d1, d2, ds = materialise(x1, linear, x1, x2)
        a1, a2 = materialise(x1, solve, v1, v2, d1, d2, ds)

        def second():
            f1, f2 = rates(x1 + ds * a1, x2 + ds * a2)
            return solve(f1 - 2 * a1, f2 - 2 * a2, d1, d2, ds)

        b1, b2 = materialise(x1, second)
        y1 = x1 + ds * (1.5 * a1 + 0.5 * b1)
        y2 = x2 + ds * (1.5 * a2 + 0.5 * b2)
        f1, f2 = materialise(x1, rates, y1, y2)
        level = static[0] * (y1 - rest1) ** 2 + static[1] * (y2 - rest2) ** 2
        inner1, inner2 = jnp.abs(y1) <= 1.0, jnp.abs(y2) <= 1.0
        caught = inner1 & inner2 & (level <= room)
        far1, far2 = jnp.abs(y1) > FAR, jnp.abs(y2) > FAR
        t1, t2 = torque(y1, 0), torque(y2, 1)
        beside1, beside2 = balance.held1(t2), balance.held2(t1)
        # one has left if it is driven on while the other rests
        fits1 = inner1 & (jnp.abs(beside1) <= static[0])
        fits2 = inner2 & (jnp.abs(beside2) <= static[1])
        caught |= fits1 & far2 & (held2 * y2 > t2 * y2)
        caught |= fits2 & far1 & (held1 * y1 > t1 * y1)
        caught |= far1 & far2 & (y1 * f1 > 0) & (y2 * f2 > 0)
        bad = ~(jnp.isfinite(y1) & jnp.isfinite(y2))
        return y1, y2, caught | bad, count + 1

    def goes_on(state):
        return ~state[2] & (state[3] < MOST_STEPS)

    zero = jnp.zeros((), jnp.int32)
    begin = tuple(jnp.asarray(x) + 0.0 * s1 for x in start)
    x1, x2, found, _ = lax.while_loop(goes_on, step, (*begin, ~ask, zero))

    def mode(x: jax.Array) -> jax.Array:
        return jnp.where(jnp.abs(x) <= 1.0, 0.0, jnp.sign(x))

    return mode(x1), mode(x2), found & jnp.isfinite(x1 + x2)
