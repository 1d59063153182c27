r"""Where a joint is about to stick, with derivatives: what decides a sequence of modes.

Two numbers of a motion vanish where its sequence of stick and slip changes:

- where joint j comes to rest, how far the torque that would hold it lies below the
  most, $(\tau_s^2 - \lambda^2) / 2 \tau_s^2$: positive where it sticks, negative where
  its rate passes zero. It goes through zero smoothly.
- the least rate $|u_j|$ that slip comes down to before it grows again: zero where the
  motion grazes. There is no such least rate beyond.

Of all in a motion the one nearest to zero counts.
"""

from typing import Literal, cast

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..model.column import Column, joint_balance
from ..model.set_valued import FrozenCoulomb, in_modes
from ..numerics.hermite import HermiteQuartic
from ..numerics.numbers import Pair, Scalar, Traced, Traced4
from ..solvers import Step
from .observers import joint_rates
from .saltation import leaves

NONE = 1e3  # of a motion without such an instant
# the number, and its derivatives along k directions
Nearest = tuple[Traced, Float[Array, " k"]]


class Contact(eqx.Module):
    """What is watched: `what` happens, in `joint` 1 or 2."""

    what: Literal["sticking", "grazing"] = eqx.field(static=True)
    joint: int = eqx.field(static=True)

    @property
    def place(self) -> int:
        """The joint's, of two."""
        return self.joint - 1

    def begin(self, zero: Traced, k: int) -> Nearest:
        """None yet."""
        return zero + NONE, jnp.zeros(k, zero.dtype)

    def landing(
        self, column: Column, step: Step, dy: Traced4, dp: Column | None
    ) -> tuple[Traced, Traced]:
        """How far the joint's torque is below the most at the step's end; its change.

        **Arguments:** `column`: in the modes of the step; `dy`: a difference at its
        end, before the event; `dp`: how the column's numbers differ.
        """
        numbers, column_of = leaves(column, dp)
        modes = list(cast(FrozenCoulomb, column.friction).modes or ())
        modes[self.place] = 0.0 * modes[self.place]

        def rate(y: Traced4) -> Traced:
            return cast(Traced, joint_rates(y)[self.place])

        def left(y: Traced4, numbers: Column) -> Traced:
            here = in_modes(column_of(numbers), (modes[0], modes[1]))
            law = cast(FrozenCoulomb, here.friction)
            balance = joint_balance(here, y)
            most = law.loaded(balance).static[self.place]
            return cast(Traced, law.guard(balance)[self.place] / most)

        # the joint comes to rest earlier or later
        _, towards = jax.linearize(rate, step.y1)
        speed = towards(step.f1)
        late = -towards(dy) / jnp.where(speed == 0, jnp.inf, speed)
        pairs = zip(dy, step.f1, strict=True)
        dy = cast(Traced4, tuple(d + late * f for d, f in pairs))
        still = jax.tree.map(jnp.zeros_like, numbers) if dp is None else dp
        return jax.jvp(left, (step.y1, numbers), (dy, still))

    def lands(self, step: Step) -> Array:
        """Whether the joint comes to rest at the step's end."""
        assert step.event
        mine = (step.event[0] == self.joint) | (step.event[0] == 3)
        return jnp.asarray(mine & (self._mode(step) != 0))

    def slips(self, step: Step) -> Array:
        """Whether the joint slips all along the step."""
        return jnp.asarray(self._mode(step) != 0)

    def _mode(self, step: Step) -> Scalar:
        return cast(Pair, step.modes)[self.place]

    def dip(
        self, h: Traced, y0: Traced4, f0: Traced4, y1: Traced4, f1: Traced4
    ) -> Traced:
        """The joint's rate where it is least in size within a step, else far from zero.

        On the cubic through both ends, whose error falls with the step's fourth power.
        """
        ends = (joint_rates(cast(Traced4, y))[self.place] for y in (y0, f0, y1, f1))
        u0, a0, u1, a1 = ends
        side = jnp.sign(u0 + u1)
        v0, v1, rise = side * h * a0, side * h * a1, side * (u1 - u0)
        turns = (v0 < 0) & (v1 > 0)
        # the slope v0 + 2 c2 x + 3 c3 x^2 of the cubic
        c2, c3 = 3 * rise - 2 * v0 - v1, v0 + v1 - 2 * rise
        root = jnp.sqrt(jnp.where(turns, c2 * c2 - 3 * c3 * v0, 1.0))
        x = -v0 / jnp.where(turns, c2 + root, 1.0)
        zero = jnp.zeros_like(u0)
        least = HermiteQuartic(side * u0, side * u1, v0, v1, zero)(x)
        return jnp.where(turns, least, NONE)


def nearer(new: Nearest, old: Nearest, there: Array) -> Nearest:
    """The one of two that is nearer to zero; `there`: whether the new one is one."""
    closer = there & (jnp.abs(new[0]) < jnp.abs(old[0]))
    return jnp.where(closer, new[0], old[0]), jnp.where(closer, new[1], old[1])
