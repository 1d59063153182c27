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

    Two may be added: `ConstantLoad(0.2) + JointReaction()` is a pin that is preloaded
    and transmits the joint's force.
    """

    @property
    def of_motion(self) -> bool:
        """Whether the accelerations decide it, as `JointReaction`'s; or q alone."""
        return False

    def __add__(self, other: AbstractNormalLoad) -> LoadSum:
        """Both at once."""
        return LoadSum(self, other)

    @abc.abstractmethod
    def at_rest(self, q: Scalar) -> Pair:
        """The normal loads of joints 1 and 2 at rest."""

    def split(self, q: Scalar) -> tuple[Pair, Reaction | None]:
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

    newton_steps: int = eqx.field(static=True, default=4)

    @property
    def of_motion(self) -> bool:
        """It is."""
        return True

    def __check_init__(self):
        """Refuse a loop that does not run."""
        whole_number("newton_steps", self.newton_steps)

    def at_rest(self, q: Scalar) -> Pair:
        """Return |q| for both joints: the reactions balance the load alone."""
        return jnp.abs(q), jnp.abs(q)

    def split(self, q: Scalar) -> tuple[Pair, Reaction]:
        """Reactions alone."""
        del q
        return (1.0, 1.0), Reaction(self.newton_steps)


class LoadSum(AbstractNormalLoad):
    """$N_i = N_i^{(1)} + N_i^{(2)}$, e.g. a preload and the joint's reaction.

    **Arguments:** `first`, `second`: normal loads, of which one at most is, or holds,
    `JointReaction()`: a joint transmits its force once. `first + second` is the same.

    **Raises:** `ValueError` for anything else.
    """

    first: AbstractNormalLoad
    second: AbstractNormalLoad

    def __init__(self, first: AbstractNormalLoad, second: AbstractNormalLoad):
        """Keep both loads."""
        for name, load in (("first", first), ("second", second)):
            if not isinstance(load, AbstractNormalLoad):
                raise ValueError(
                    f"Argument `{name}` must be a normal load, but is {load!r}."
                )
        if first.of_motion and second.of_motion:
            raise ValueError(
                "Argument `second` must hold no `JointReaction()` where `first` does, "
                f"as a joint transmits its force once, but is {second!r}."
            )
        self.first, self.second = first, second

    @property
    def of_motion(self) -> bool:
        """Whether one of them is."""
        return self.first.of_motion or self.second.of_motion

    def at_rest(self, q: Scalar) -> Pair:
        """Return the sum of both for each joint."""
        (a1, a2), (b1, b2) = self.first.at_rest(q), self.second.at_rest(q)
        return a1 + b1, a2 + b2

    def split(self, q: Scalar) -> tuple[Pair, Reaction | None]:
        """Reactions and what is known beside them."""
        (first, reaction), (second, other) = self.first.split(q), self.second.split(q)
        if reaction is None and other is None:
            return self.at_rest(q), None
        if reaction is None:
            reaction, known = other, first
        else:
            known = second
        assert reaction is not None
        if reaction.preload is not None:
            (a1, a2), (b1, b2) = reaction.preload, known
            known = a1 + b1, a2 + b2
        return (1.0, 1.0), Reaction(reaction.steps, known)


class Reaction(eqx.Module):
    """What a `System` has of a load that the motion decides."""

    steps: int = eqx.field(static=True)  # of Newton's method
    preload: Pair | None = None


def normal_load(load: AbstractNormalLoad | None) -> AbstractNormalLoad:
    """The load of a friction law; None is `FollowerLoad()`."""
    load = FollowerLoad() if load is None else load
    if not isinstance(load, AbstractNormalLoad):
        raise ValueError(
            "Argument `load` must be `FollowerLoad()`, `ConstantLoad(n)`, "
            f"`JointReaction()` or a sum of these, but is {load!r}."
        )
    return load
