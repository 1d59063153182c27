"""The state of a column: where a motion starts or ends."""

from typing import ClassVar

import equinox as eqx

from ..numerics.numbers import Pair, Two, Vector4, pair
from ..results import RATE


class State(eqx.Module):
    r"""A start: angles $\phi_1, \phi_2$ (rad) and rates $\omega_1, \omega_2$.

    Springs are wound up by a turn: $\phi$ and $\phi + 2\pi$ are different states, and
    angles are never reduced. Both rods turned by $2\pi n$ differ in spring 1's torque
    alone, and in rounding: an angle's last digit, $2^{-52} |\phi|$, is the finest that
    its sine, and the motion, can know.

    **Arguments:** `phi`, `omega`: two numbers each, finite where concrete.
    """

    units: ClassVar = {"phi": "rad", "omega": RATE}

    phi: Pair
    omega: Pair

    def __init__(self, phi: Two = (0.0, 0.0), omega: Two = (0.0, 0.0)):
        """Keep the four numbers."""
        self.phi = pair("phi", phi)
        self.omega = pair("omega", omega)

    @property
    def y(self) -> Vector4:
        """The state as four scalars, as `vector_field` takes it."""
        return (*self.phi, *self.omega)


def scalars_of(y: Vector4 | State) -> Vector4:
    """The four scalars of a state, however it is given."""
    return y.y if isinstance(y, State) else y
