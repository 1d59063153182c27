"""What friction is to a motion: torques in the joints, all numbers worked out."""

import abc
from typing import ClassVar

import equinox as eqx

from ..numerics.numbers import Numbers, Scalar
from .loads import Reaction
from .torque_curve import Curve, torque


class AbstractTorques(eqx.Module):
    """Friction of a `System`.

    `sticks`: whether joints truly stick, so that motions have events.
    """

    sticks: ClassVar[bool] = False
    load: eqx.AbstractVar[Reaction | None]  # then torques are per unit of it

    @abc.abstractmethod
    def rate_cut(self) -> Scalar | None:
        """The joint rate below which a joint counts as sticking; None if by mode."""


class AbstractRateTorques(AbstractTorques):
    """Friction whose torques are functions of the joints' rates."""

    @abc.abstractmethod
    def at(self, u: Numbers) -> Numbers:
        """The torques; per unit of load where the motion decides that."""


class SmoothTorques(AbstractRateTorques):
    """A smoothed law's torques, each by its `Curve`."""

    curves: tuple[Curve, ...]
    cut: Scalar
    load: Reaction | None = None

    def at(self, u: Numbers) -> Numbers:
        """Joint by joint."""
        return tuple(torque(x, c) for x, c in zip(u, self.curves, strict=True))

    def rate_cut(self) -> Scalar:
        """That of the law."""
        return self.cut
