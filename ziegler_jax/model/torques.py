r"""Friction in a motion: torques in the joints, all numbers computed.

The smoothed law in powers of two, of which a processor does the whole ones by itself:

$$T = \bigl[T_k + (T_s - T_k)\, 2^{-(f u)^2}\bigr]\,
\frac{2^{g u} - 1}{2^{g u} + 1}, \qquad
f = \frac{\sqrt{\log_2 e}}{v_{stribeck}}, \quad
g = \frac{2 \log_2 e}{v_{smooth}}$$
"""

import abc
from functools import partial
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero

from ..numerics.elementary import LOG2_E, half_to_the, tanh2
from ..numerics.numbers import Numbers, Scalar
from .loads import Reaction


class Curve(NamedTuple):
    """The numbers of one joint."""

    kinetic: Scalar
    drop: Scalar | None  # from static to kinetic
    falls: Scalar | None  # f
    rises: Scalar  # g


@jax.custom_jvp
def torque(u: Scalar, curve: Curve) -> Scalar:
    """The torque at a rate u."""
    return _factors(u, curve).torque


@partial(torque.defjvp, symbolic_zeros=True)
def _torque_jvp(primals, tangents):
    """By one slope, worked out with the torque: many tangents are multiplied by it."""
    (u, curve), (du, dcurve) = primals, tangents
    at = _factors(u, curve)
    rise, ln_2 = at.rise, 1 / LOG2_E
    slope = at.peak * at.steepness * (0.5 * ln_2 * curve.rises)
    if curve.falls is not None:
        fallen = u * curve.falls
        # where 2^-x is no longer followed, f^2 would make much of what is left of it
        fall = (2.0 * ln_2 * fallen) * (curve.falls * at.more) * rise
        slope = slope - jnp.where(fallen * fallen > 1000.0, 0.0, fall)
    moved = jnp.zeros_like(u) if isinstance(du, SymbolicZero) else slope * du
    if not all(isinstance(x, SymbolicZero) for x in jax.tree.leaves(dcurve)):
        still = [
            jnp.zeros_like(x) if isinstance(dx, SymbolicZero) else dx
            for x, dx in zip(curve, dcurve, strict=True)
        ]
        along = jax.jvp(lambda c: _factors(u, c).torque, (curve,), (Curve(*still),))
        moved += along[1]
    return at.torque, moved


class _Factors(NamedTuple):
    """The factors of a torque, with one division for all of it."""

    torque: Scalar
    peak: Scalar  # beyond the layer
    more: Scalar  # by how much that exceeds the kinetic torque
    rise: Scalar  # in the layer
    steepness: Scalar  # one less its square


def _factors(u: Scalar, curve: Curve) -> _Factors:
    top, bottom, product = tanh2(u * curve.rises)
    if curve.drop is None or curve.falls is None:
        share = 1.0 / bottom
        rise, steepness = top * share, product * share * share
        return _Factors(curve.kinetic * rise, curve.kinetic, 0.0, rise, steepness)
    part, whole = half_to_the((u * curve.falls) ** 2)
    peak, inverse = curve.kinetic * whole + curve.drop * part, 1.0 / (whole * bottom)
    share, beyond = whole * inverse, bottom * inverse
    return _Factors(
        torque=(peak * top) * inverse,
        peak=peak * beyond,
        more=curve.drop * part * beyond,
        rise=top * share,
        steepness=product * share * share,
    )


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
