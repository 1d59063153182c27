r"""Where a joint is about to stick, with derivatives: what decides a sequence of modes.

Where joint j comes to rest the torque that would hold it lies below the most by

$$\frac{\tau_s^2 - \lambda^2}{2 \tau_s^2},$$

positive where it sticks, negative where its rate passes zero; between them the number
goes through zero smoothly.

Of all in a motion the one nearest to zero counts.
"""

from typing import cast

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..model.column import Column, joint_balance
from ..model.set_valued import FrozenCoulomb, in_modes
from ..numerics.numbers import Pair, Scalar, Traced, Traced4
from ..solvers import Step
from .observers import joint_rates
from .saltation import leaves

NONE = 1e3  # of a motion without such an instant
# the number, and its derivatives along k directions
Nearest = tuple[Traced, Float[Array, " k"]]


class Contact(eqx.Module):
    """What is watched: where `joint`, 1 or 2, comes to rest."""

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

    def _mode(self, step: Step) -> Scalar:
        return cast(Pair, step.modes)[self.place]


def nearer(new: Nearest, old: Nearest, there: Array) -> Nearest:
    """The one of two that is nearer to zero; `there`: whether the new one is one."""
    closer = there & (jnp.abs(new[0]) < jnp.abs(old[0]))
    return jnp.where(closer, new[0], old[0]), jnp.where(closer, new[1], old[1])
