"""The state of a column: where a motion starts or ends."""

from __future__ import annotations

from collections.abc import Iterable
from typing import ClassVar

import equinox as eqx
import jax

from ..numerics.numbers import Numbers, Pair, Scalar, Two
from ..numerics.rules import pair
from ..results import RATE


class PhasePoint(tuple[Scalar, ...]):
    """A state as it runs, or its rate of change: n angles, and n rates behind them.

    A tuple of scalars to whoever takes it apart, and a tree of its own to JAX: a tuple
    that is none is not taken for one.
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
    def y(self) -> PhasePoint:
        """The state as four scalars, as `vector_field` takes it."""
        return PhasePoint.of(self.phi, self.omega)


def phase_of(y: Numbers | State) -> PhasePoint:
    """A state as it runs, however it is given.

    **Raises:** `ValueError` for what is no state and no four scalars.
    """
    if isinstance(y, State):
        return y.y
    if not hasattr(y, "__len__") or len(y) != 4:
        raise ValueError(
            f"Argument `y` must be a `State` or its four scalars, but is {y!r}."
        )
    return PhasePoint(y)
