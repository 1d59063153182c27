"""The normal load that a joint's friction rests on."""

from __future__ import annotations

import abc
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp

from ..numerics.numbers import Joints, OneOrTwo, Pair, Scalar, both
from ..numerics.rules import AbstractRuled, checked, whole_number


class AbstractNormalLoad(AbstractRuled):
    """Where a joint's normal load comes from.

    `of_motion`: whether the accelerations decide it, as of `JointReaction` alone; else
    it is that at rest.
    """

    of_motion: ClassVar[bool] = False

    @abc.abstractmethod
    def at_rest(self, q: Scalar) -> Pair:
        """The normal loads of joints 1 and 2 at rest."""

    def split(self, q: Scalar) -> tuple[Pair, JointReaction | None]:
        """The loads known beforehand; 1 where the joints' reactions are to be found."""
        return self.at_rest(q), None


class FollowerLoad(AbstractNormalLoad):
    """$N_1 = N_2 = |q|$: the follower force, which both pins carry at rest."""

    def at_rest(self, q: Scalar) -> Pair:
        """Return |q| for both joints."""
        return jnp.abs(q), jnp.abs(q)


class ConstantLoad(AbstractNormalLoad):
    """$N_1, N_2$ constant, e.g. a preload of the pins, in units of k/l."""

    rules: ClassVar = {"n": "nonnegative; two"}
    units: ClassVar = {"n": "k/l"}

    n: OneOrTwo

    def __init__(self, n: Joints):
        """Set the load: one number, or one a joint, each nonnegative."""
        (self.n,) = checked(self.rules, n=n)

    def at_rest(self, q: Scalar) -> Pair:
        """Return n for each joint."""
        del q
        return both(self.n)


class JointReaction(AbstractNormalLoad):
    r"""$N_i = |R_i|$: the magnitude of the reaction that the joint transmits.

    The reaction depends on the accelerations, and these on the friction torque. With
    the rates given, accelerations are affine in the two normal loads,
    $R_i = R_i^0 + P_{i1} N_1 + P_{i2} N_2$, and $N_i = |R_i|$ is a system of two
    equations. `newton_steps` Newton steps with its exact 2 x 2 Jacobian solve it,
    starting from the frictionless reaction; each squares the error. What is left,
    relative to $1 + N$, in the worst of 10 000 random states of uniform rods with
    $\mu\rho$ at both joints: 1e-14 at 0.05 after three steps, 8e-12 at 0.2 after four
    (the default). There is one solution as long as $\|P\| < 1$. Beyond there may be
    none (at 0.4 in one random state of seven, at 1 in seven of ten: Painleve's
    paradox of rigid bodies with friction); a residual above 1e-6 makes the
    accelerations NaN, and the lane ends as `not_finite` or `step_vanished`.
    """

    of_motion: ClassVar[bool] = True

    newton_steps: int = eqx.field(static=True, default=4)

    def __check_init__(self):
        """Refuse a loop that does not run."""
        whole_number("newton_steps", self.newton_steps)

    def at_rest(self, q: Scalar) -> Pair:
        """Return |q| for both joints: the reactions balance the load alone."""
        return jnp.abs(q), jnp.abs(q)

    def split(self, q: Scalar) -> tuple[Pair, JointReaction | None]:
        """Itself."""
        del q
        return (1.0, 1.0), self


def normal_load(load: AbstractNormalLoad | None) -> AbstractNormalLoad:
    """The load of a friction law; None is `FollowerLoad()`."""
    load = FollowerLoad() if load is None else load
    if not isinstance(load, AbstractNormalLoad):
        raise ValueError(
            "Argument `load` must be `FollowerLoad()`, `ConstantLoad(n)` or "
            f"`JointReaction()`, but is {load!r}."
        )
    return load
