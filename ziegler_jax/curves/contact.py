r"""Where a joint is about to stick, with derivatives: what decides a sequence of modes.

`Landing`: where joint j comes to rest the torque that would hold it lies below the most
by

$$\frac{\tau_s^2 - \lambda^2}{2 \tau_s^2},$$

positive where it sticks, negative where its rate passes zero; between them the number
goes through zero smoothly.

`Dip`: the least rate $m u_j$ that slip in the direction m comes down to before it grows
again, positive where it does not come to rest. Where it does, at the slope
$m \dot u_j < 0$, it would have come down to

$$-\frac{\dot u_j^2}{2 m \ddot u_j}$$

had slip gone on: the number goes through zero smoothly, too, where the motion grazes.

Of all in a motion the one nearest to zero counts.
"""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from ..model.chain import joint_angles
from ..model.state import PhasePoint
from ..model.system import System
from ..motion.section import joint_rates
from ..motion.variational import NONE, AbstractContact
from ..numerics.hermite import cubic, turning
from ..numerics.numbers import Scalar
from ..solvers import Step
from ..solvers.along import leaves


class AtRest(AbstractContact):
    """What is watched where `joint`, 1 or 2, comes to rest."""

    joint: int = eqx.field(static=True)

    @property
    def place(self) -> int:
        """The joint's, of two."""
        return self.joint - 1

    @abc.abstractmethod
    def number(self, system: System, step: Step, y: PhasePoint) -> Scalar:
        """Of the state at the step's end, in which the joint is at rest."""

    def landing(
        self, system: System, step: Step, dy: PhasePoint, dp: System | None
    ) -> tuple[Scalar, Scalar]:
        """The number where the joint comes to rest, earlier or later."""
        numbers, dp, system_of = leaves(system, dp)
        _, towards = jax.linearize(self.rate, step.y1)
        speed = towards(step.f1)
        late = -towards(dy) / jnp.where(speed == 0, jnp.inf, speed)
        pairs = zip(dy, step.f1, strict=True)
        dy = PhasePoint(d + late * f for d, f in pairs)
        still = jax.tree.map(jnp.zeros_like, numbers) if dp is None else dp

        def value(y: PhasePoint, numbers: System) -> Scalar:
            return self.number(system_of(numbers), step, y)

        return jax.jvp(value, (step.y1, numbers), (dy, still))

    def lands(self, step: Step) -> Array:
        """Whether the joint comes to rest at the step's end."""
        assert step.event
        mine = (step.event[0] == self.joint) | (step.event[0] == 3)
        return jnp.asarray(mine & (self._mode(step) != 0))

    def rate(self, y: PhasePoint) -> Scalar:
        """The joint's."""
        return joint_angles(y.omega)[self.place]

    def _mode(self, step: Step) -> Scalar:
        return step.modes[self.place]


class Landing(AtRest):
    """How far the torque that would hold the joint lies below the most."""

    def number(self, system, step, y):
        """With the joint held, whatever the other does."""
        modes = list(step.modes)
        modes[self.place] = 0.0 * modes[self.place]
        law, balance = system.in_modes(tuple(modes)).law, system.balance(y)
        most = law.loaded(balance).static[self.place]
        return law.guard(balance)[self.place] / most


class Dip(AtRest):
    """How far slip is from coming to rest: the rate at which it turns."""

    def number(self, system, step, y):
        """How far below zero slip would have turned; `NONE` if it would not."""

        def slope(y: PhasePoint) -> PhasePoint:
            return system.field(step.t1, y)

        towards, bends = jax.jvp(slope, (y,), (slope(y),))
        mode = self._mode(step)
        speed, bend = (mode * self.rate(x) for x in (towards, bends))
        turns = (speed < 0) & (bend > 0)
        depth = speed * speed / (2 * jnp.where(turns, bend, 1.0))
        return jnp.where(turns, -depth, NONE)

    def turn(self, step: Step) -> tuple[Scalar, Array]:
        """Where in the step slip is least, as a share of it; whether it is at all.

        By the rate's series, or the cubic through both ends: where it turns the rate
        stands still.
        """
        mode, h = self._mode(step), step.t1 - step.t0
        if step.series:
            rate = joint_rates(step)[self.place]
            turns, x = rate.turning()
        else:
            u0, u1, a0, a1 = map(self.rate, (step.y0, step.y1, step.f0, step.f1))
            rate = cubic(u0, u1, h * a0, h * a1)
            turns, x = turning(rate)
        # slip that begins does not turn
        turns &= (mode * rate.g0 > 0) & (mode * rate.v0 < 0)
        return jnp.where(turns, x, 1.0), jnp.asarray(turns)

    def least(self, step: Step, y: PhasePoint) -> Scalar:
        """The rate in the direction of slip, or its difference."""
        return self._mode(step) * self.rate(y)
