r"""The rule `stribeck-limit`: where two joints at rest go as their layer's v -> 0.

With $x_i = u_i / v$ the layer's torque is

$$T(x) = \tau_s |x| \text{ for } |x| < 1, \quad
\tau_k + (\tau_s - \tau_k)\,e^{-(|x| - 1)} \text{ beyond},$$

with the sign of x. In the time t / v the column does not move while x does,

$$x_1' = \dot\omega_1(T), \qquad x_2' = \dot\omega_2(T) - \dot\omega_1(T),$$

until each joint rests in its layer ($|x_i| \le 1$, it sticks) or has left it. Within
both layers the motion is linear, and with $e = x - x^*$ about its equilibrium
$V = \sum_i \tau_{s,i} e_i^2$ falls: once the ellipse V = const. lies within
$|x_i| \le 1$ the joints are caught there, and the passage is over.
"""

import jax
import jax.numpy as jnp
from jax import lax

from ..numerics.numbers import Flag, Pair, Scalar
from .stick_slip_modes import Dynamics

FAR = 12.0  # there e^-11 of the fall is left: 2e-5
MOST_STEPS = 1000
SHARE = 0.1  # of the way to the layer's edge, or of half its width, a step
GROWTH = 0.1  # what flies apart grows by so much a step
GAMMA = 1.0 - 0.5**0.5  # L-stable


class ReleaseLayer:
    """The layers of both joints under the forces of one state; x is an array of two."""

    def __init__(self, balance: Dynamics, static: Pair, kinetic: Pair):
        """Keep masses and forces (see `set_valued`) and the torques."""
        self.balance = balance
        self.static, self.kinetic = jnp.stack(static), jnp.stack(kinetic)
        a, h, d, r1, r2 = balance[:5]
        inverse = 1 / (a * d - h * h)
        one, two = (d * r1 - h * r2) * inverse, (a * r2 - h * r1) * inverse
        self.push = jnp.stack([one, two - one])
        w11, w12, w22 = d * inverse, -(d + h) * inverse, (a + 2 * h + d) * inverse
        self.columns = jnp.stack([w11, w12]), jnp.stack([w12, w22])  # of W

    def modes(self, start: Pair, ask: Flag) -> tuple[Scalar, Scalar, Flag]:
        """The modes that the passage from x = `start` ends in, if `ask`.

        **Returns:** two modes, -1., 0. or 1., and whether it came to its end.
        """

        def on(state):
            x = self.step(state[0])
            return x, self.ended(x) | ~jnp.all(jnp.isfinite(x)), state[2] + 1

        begin = jnp.stack(start) + 0.0 * self.push, ~ask, jnp.zeros((), jnp.int32)
        x, complete, _ = lax.while_loop(
            lambda s: ~s[1] & (s[2] < MOST_STEPS), on, begin
        )
        first, second = jnp.where(jnp.abs(x) <= 1.0, 0.0, jnp.sign(x))
        return first, second, complete & jnp.all(jnp.isfinite(x))

    def torque(self, x: jax.Array) -> tuple[jax.Array, jax.Array]:
        """T and its slope."""
        size = jnp.abs(x)
        tail = (self.static - self.kinetic) * jnp.exp(-jnp.maximum(size - 1, 0.0))
        outer = jnp.sign(x) * (self.kinetic + tail)
        inside = size < 1
        slope = jnp.where(inside, self.static, -tail)
        return jnp.where(inside, self.static * x, outer), slope

    def rates(self, x: jax.Array) -> jax.Array:
        """The rates x'."""
        t, _ = self.torque(x)
        return self.push - self.columns[0] * t[0] - self.columns[1] * t[1]

    def step(self, x: jax.Array) -> jax.Array:
        """By ROS2: what rests in its layer is stiff beside what is on its way to it."""
        v, slope, ds = self._linear(x)
        a = self._solve(v, slope, ds)
        b = self._solve(self.rates(x + ds * a) - 2 * a, slope, ds)
        return x + ds * (1.5 * a + 0.5 * b)

    def _linear(self, x: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        """The rates, the torques' slopes and the length of a step from here."""
        v, (_, slope) = self.rates(x), self.torque(x)
        tiny = jnp.finfo(x.dtype).tiny
        falls = jnp.maximum(-slope, 0.0)
        grows = self.columns[0][0] * falls[0] + self.columns[1][1] * falls[1]
        way = SHARE * jnp.maximum(0.5, jnp.abs(jnp.abs(x) - 1.0))
        ds = jnp.min(way / (jnp.abs(v) + tiny))
        return v, slope, jnp.minimum(ds, GROWTH / (grows + tiny))

    def _solve(self, v: jax.Array, slope: jax.Array, ds: jax.Array) -> jax.Array:
        """(I - gamma ds J)^-1 v with J = -W T'."""
        (m11, m21), (m12, m22) = (
            GAMMA * ds * column * slope[i] for i, column in enumerate(self.columns)
        )
        m11, m22 = 1 + m11, 1 + m22
        solved = [m22 * v[0] - m12 * v[1], m11 * v[1] - m21 * v[0]]
        return jnp.stack(solved) / (m11 * m22 - m12 * m21)

    def ended(self, x: jax.Array) -> jax.Array:
        """Whether each joint is caught in its layer, or left it, driven on."""
        inside, far = jnp.abs(x) <= 1.0, jnp.abs(x) > FAR
        holding = jnp.stack(self.balance.holding_torques())
        # where the layers' linear parts would come to rest, and the ellipse around it
        rest = holding / self.static
        room = jnp.min(self.static * (1.0 - jnp.abs(rest)) ** 2)
        caught = jnp.sum(self.static * (x - rest) ** 2) <= room
        both = jnp.all(inside & (jnp.abs(rest) <= 1.0)) & caught
        # one has left if it is driven on while the other rests
        t, _ = self.torque(x)
        beside = jnp.stack(
            [self.balance.holding_torque1(t[1]), self.balance.holding_torque2(t[0])]
        )
        fits = inside & (jnp.abs(beside) <= self.static)
        leaves = far & (holding * x > t * x)
        away = jnp.all(far & (x * self.rates(x) > 0))
        return both | jnp.any(fits & leaves[::-1]) | away
