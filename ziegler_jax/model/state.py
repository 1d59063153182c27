"""The state of a column or chain: where a motion starts or ends."""

from __future__ import annotations

from collections.abc import Iterable
from typing import ClassVar

import equinox as eqx
import jax
import numpy as np

from ..numerics.numbers import Numbers, Scalar, Several
from ..numerics.rules import several
from ..results import RATE


class PhasePoint(tuple[Scalar, ...]):
    """A state as it runs, or its rate of change: n angles, and n rates behind them.

    It unpacks like a tuple of scalars, and is a pytree of its own to JAX: a plain tuple
    is refused in its place.
    """

    @classmethod
    def of(cls, phi: Iterable[Scalar], omega: Iterable[Scalar]) -> PhasePoint:
        """Of both halves."""
        return cls((*phi, *omega))

    @property
    def phi(self) -> Numbers:
        """The rods' angles; of a rate of change their rates."""
        return self[: len(self) // 2]

    @property
    def omega(self) -> Numbers:
        """The rods' rates; of a rate of change their accelerations."""
        return self[len(self) // 2 :]


jax.tree_util.register_pytree_node(
    PhasePoint, lambda y: (tuple(y), None), lambda _, numbers: PhasePoint(numbers)
)


class State(eqx.Module):
    r"""A start: the rods' angles $\phi_i$ (rad) and rates $\omega_i$.

    A turn winds up the springs: $\phi$ and $\phi + 2\pi$ are different states, and
    angles are never reduced. All rods turned by $2\pi n$ differ in spring 1's torque
    alone, and in rounding: an angle's last digit, $2^{-52} |\phi|$, is the finest that
    its sine, and the motion, can know.

    **Arguments:** `phi`, `omega`: one number a rod, finite where concrete; an argument
    that is left out is zero.

    **Raises:** `ValueError` for numbers that are not finite or not one a rod.
    """

    units: ClassVar = {"phi": "rad", "omega": RATE}

    phi: Numbers
    omega: Numbers

    def __init__(self, phi: Several | None = None, omega: Several | None = None):
        """Keep the numbers."""
        angles = None if phi is None else several("phi", phi)
        rates = None if omega is None else several("omega", omega)
        zeros = (np.float64(0.0),) * len(angles or rates or (0, 0))
        self.phi = zeros if angles is None else angles
        self.omega = zeros if rates is None else rates
        if len(self.phi) != len(self.omega):
            raise ValueError(
                "Arguments `phi` and `omega` must have one number a rod each, but have "
                f"{len(self.phi)} and {len(self.omega)}."
            )

    @property
    def y(self) -> PhasePoint:
        """The state as scalars, the angles first, as `vector_field` takes it."""
        return PhasePoint.of(self.phi, self.omega)


def phase_of(y: Numbers | State, rods: int) -> PhasePoint:
    """A state of so many rods as it runs, however it is given.

    **Raises:** `ValueError` for what is no such state and no such scalars.
    """
    y = y.y if isinstance(y, State) else y
    if not hasattr(y, "__len__") or len(y) != 2 * rods:
        raise ValueError(
            f"Argument `y` must be a `State` of {rods} rods or its {2 * rods} scalars, "
            f"but is {y!r}."
        )
    return PhasePoint(y)
