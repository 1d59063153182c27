"""Which joints stick, and which slip where: the modes that agree with the forces."""

from typing import NamedTuple

import jax.numpy as jnp

from ..numerics.numbers import Flags, Pair, Scalar
from .joint_reactions import Reactions


class Dynamics(NamedTuple):
    """The mass matrix [[a, h], [h, d]] and the forces r1, r2 without friction."""

    a: Scalar
    h: Scalar
    d: Scalar
    r1: Scalar
    r2: Scalar
    reactions: Reactions | None = None  # where they load the joints

    def holding_torque1(self, t2: Scalar) -> Scalar:
        """The torque that holds joint 1 while joint 2 slips under t2."""
        return self.r1 + t2 - self.h * (self.r2 - t2) / self.d

    def holding_torque2(self, t1: Scalar) -> Scalar:
        """The torque that holds joint 2 while joint 1 slips under t1."""
        whole = self.a + 2 * self.h + self.d
        return self.r2 - (self.h + self.d) * (self.r1 + self.r2 - t1) / whole

    def holding_torques(self) -> Pair:
        """The torques that hold both joints."""
        return self.r1 + self.r2, self.r2


class ConstraintTorques(NamedTuple):
    """The torques that hold each joint, and the most that hold it at rest, in slip."""

    torque: Pair
    static: Pair
    kinetic: Pair


def stick_first(
    f: Dynamics, kinetic: Pair, thresholds: Pair, given: Pair, rest: Flags
) -> Pair:
    """`choose_modes` for torques that the modes do not change."""
    k1, k2 = kinetic
    torques = (
        f.holding_torques(),
        (f.holding_torque1(k2), f.holding_torque2(k1)),
        (f.holding_torque1(-k2), f.holding_torque2(-k1)),
    )
    still, up, down = (
        ConstraintTorques(torque, thresholds, kinetic) for torque in torques
    )
    return choose_modes((still, up, down), given, rest)


def choose_modes(
    holding: tuple[ConstraintTorques, ConstraintTorques, ConstraintTorques],
    given: Pair,
    rest: Flags,
    otherwise: float = 0.0,
) -> Pair:
    r"""Modes in which every joint at rest sticks exactly if its torque fits.

    A joint at rest slips in the direction of its constraint torque, taken for the
    other joint's final mode, if that passes the threshold. Where no pair of modes does
    so (possible only with $\mu_s > \mu_k$), one is taken in which what slips is
    accelerated in its direction: one torque above $\tau_k$ is enough. There always is
    one, as for any positive definite inertia; with loads that the modes decide, as long
    as the loads' equations have one solution each.

    **Arguments:** `holding`: what holds a joint while the other one rests, slips
    forwards, slips backwards; `given`, `rest`: see `FrozenCoulomb.chosen`;
    `otherwise`: the modes where there are none.
    """
    still, up, down = holding
    (hold1, hold2), (up1, up2), (down1, down2) = (x.torque for x in holding)
    first, second = _direction(hold1), _direction(hold2)

    def fits(i, forwards):
        """Whether joint i sticks while the other one slips, and its direction."""
        torque = jnp.where(forwards, up.torque[i], down.torque[i])
        most = up.static[i]
        if most is not down.static[i]:
            most = jnp.where(forwards, most, down.static[i])
        return jnp.abs(torque) <= most, _direction(torque)

    def alone(i, forwards):
        sticks, direction = fits(i, forwards)
        return jnp.where(sticks, 0.0, direction)

    alone1, alone2 = alone(0, given[1] > 0), alone(1, given[0] > 0)
    one = jnp.ones_like(first)
    zero = 0.0 * one
    fits1, fits2 = fits(0, second > 0)[0], fits(1, first > 0)[0]
    most1, most2 = still.static
    # where either joint could be the one that gives way, the more loaded one does
    over = jnp.abs(hold1) - most1 >= jnp.abs(hold2) - most2
    choices = [((jnp.abs(hold1) <= most1) & (jnp.abs(hold2) <= most2), zero, zero)]
    for least in ("static", "kinetic"):
        (rest1, rest2), (a1, a2), (b1, b2) = (getattr(x, least) for x in holding)
        slips1 = (jnp.abs(hold1) > rest1) & fits2
        slips2 = (jnp.abs(hold2) > rest2) & fits1
        choices += [
            (slips1 & (over | ~slips2), first, zero),
            (slips2, zero, second),
            ((up1 > a1) & (up2 > a2), one, one),
            ((down1 > b1) & (-up2 > a2), one, -one),
            ((-up1 > a1) & (down2 > b2), -one, one),
            ((-down1 > b1) & (-down2 > b2), -one, -one),
        ]
    m1, m2 = zero + otherwise, zero + otherwise
    for agrees, one1, one2 in reversed(choices):
        m1, m2 = jnp.where(agrees, one1, m1), jnp.where(agrees, one2, m2)
    m1 = jnp.where(rest[0], jnp.where(rest[1], m1, alone1), given[0])
    m2 = jnp.where(rest[1], jnp.where(rest[0], m2, alone2), given[1])
    return m1, m2


def _direction(torque: Scalar) -> Scalar:
    """Where a torque that nothing holds turns: even one of zero must have a side."""
    return jnp.where(torque == 0, 1.0, jnp.sign(torque))  # NaN stays NaN
