r"""Linear damping: a matrix C with torques $-C\,\omega$ on the two rods."""

import abc
from typing import Any

import equinox as eqx
import jax.numpy as jnp

from ._types import Pair, Scalar, number


class AbstractDamping(eqx.Module):
    """A damping law: what gives a 2 x 2 matrix."""

    @abc.abstractmethod
    def matrix(self, cos_d: Scalar) -> tuple[Pair, Pair]:
        """The rows of C at the given cosine of phi1 - phi2 (1 for linear maps)."""

    @abc.abstractmethod
    def valid(self) -> Any:
        """Whether the numbers keep the law's rules; traced where they are."""


class Viscous(AbstractDamping):
    r"""Viscous joints: $c_1 u_1$ and $c_2 u_2$ against the joints' rates.

    $$C = \begin{bmatrix} c_1 + c_2 & -c_2 \\ -c_2 & c_2 \end{bmatrix}$$

    **Arguments:** `c1`, `c2` in $\sqrt{k m l^2}$, nonnegative.
    """

    c1: Any
    c2: Any

    def __init__(self, c1: Any, c2: Any):
        """Check and keep both coefficients."""
        self.c1 = number("c1", c1, "nonnegative")
        self.c2 = number("c2", c2, "nonnegative")

    def matrix(self, cos_d: Scalar) -> tuple[Pair, Pair]:
        """The rows of C; they do not depend on the angle."""
        del cos_d
        return (self.c1 + self.c2, -self.c2), (-self.c2, self.c2)

    def valid(self) -> Any:
        """Both coefficients nonnegative."""
        return (jnp.asarray(self.c1) >= 0) & (jnp.asarray(self.c2) >= 0)
