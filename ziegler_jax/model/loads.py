"""The normal load of a joint's friction, and the forces that the joints transmit."""

from __future__ import annotations

import abc
from collections.abc import Sequence
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from ..numerics.materialise import materialise
from ..numerics.numbers import Joints, Numbers, OneOrEach, Pair, Scalar, each
from ..numerics.rules import AbstractRuled, checked, whole_number
from ..numerics.series import added


class AbstractNormalLoad(AbstractRuled):
    """The normal load of a joint.

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
    def at_rest(self, pulls: Numbers) -> Numbers:
        """The normal loads of all joints at rest.

        **Arguments:** `pulls`: of each joint the follower forces beyond it, q.
        """

    def split(self, pulls: Numbers) -> tuple[Numbers, Reaction | None]:
        """The loads known beforehand; 1 where the joints' reactions are to be found."""
        return self.at_rest(pulls), None


class FollowerLoad(AbstractNormalLoad):
    """$N_i = |q|$: the follower force, which all pins carry at rest.

    Of several follower forces a pin carries those beyond it.
    """

    def at_rest(self, pulls: Numbers) -> Numbers:
        """Return |q| for each joint."""
        return tuple(jnp.abs(q) for q in pulls)


class ConstantLoad(AbstractNormalLoad):
    """$N_i$ constant, e.g. a preload of the pins, in units of k/l."""

    rules: ClassVar = {"n": "nonnegative; each"}
    units: ClassVar = {"n": "k/l"}

    n: OneOrEach

    def __init__(self, n: Joints):
        """Set the load: one number, or one a joint, each nonnegative."""
        (self.n,) = checked(self.rules, n=n)

    def at_rest(self, pulls: Numbers) -> Numbers:
        """Return n for each joint."""
        return each(self.n, len(pulls))


class JointReaction(AbstractNormalLoad):
    r"""$N_i = |R_i|$: the magnitude of the reaction that the joint transmits.

    The reaction depends on the accelerations, and these on the friction torque. With
    fixed rates, accelerations are affine in the two normal loads,
    $R_i = R_i^0 + P_{i1} N_1 + P_{i2} N_2$, and $N_i = |R_i|$ is a system of two
    equations. `newton_steps` Newton steps with its exact 2 x 2 Jacobian solve it,
    starting from the frictionless reaction; each squares the error. The remainder,
    relative to $1 + N$, in the worst of 10 000 random states of uniform rods with
    $\mu\rho$ at both joints: 1e-14 at 0.05 after three steps, 8e-12 at 0.2 after four
    (the default). There is one solution as long as $\|P\| < 1$. Beyond there may be
    none (at 0.4 in one random state of seven, at 1 in seven of ten: Painleve's
    paradox of rigid bodies with friction); a residual above 1e-6 makes the
    accelerations NaN, and the motion ends as `not_finite` or `step_vanished`.
    """

    newton_steps: int = eqx.field(static=True, default=4)

    @property
    def of_motion(self) -> bool:
        """It is."""
        return True

    def __check_init__(self):
        """Refuse a loop that does not run."""
        whole_number("newton_steps", self.newton_steps)

    def at_rest(self, pulls: Numbers) -> Numbers:
        """Return |q| for each joint: the reactions balance the load alone."""
        return tuple(jnp.abs(q) for q in pulls)

    def split(self, pulls: Numbers) -> tuple[Numbers, Reaction]:
        """Reactions alone."""
        return (1.0,) * len(pulls), Reaction(self.newton_steps)


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

    def at_rest(self, pulls: Numbers) -> Numbers:
        """Return the sum of both for each joint."""
        return added(self.first.at_rest(pulls), self.second.at_rest(pulls))

    def split(self, pulls: Numbers) -> tuple[Numbers, Reaction | None]:
        """Reactions and what is known beside them."""
        first, reaction = self.first.split(pulls)
        second, other = self.second.split(pulls)
        if reaction is None and other is None:
            return self.at_rest(pulls), None
        if reaction is None:
            reaction, known = other, first
        else:
            known = second
        assert reaction is not None
        if reaction.preload is not None:
            known = added(reaction.preload, known)
        return (1.0,) * len(pulls), Reaction(reaction.steps, known)


class Reaction(eqx.Module):
    """A load that depends on the motion, in a `System`."""

    steps: int = eqx.field(static=True)  # of Newton's method
    preload: Numbers | None = None


def normal_load(load: AbstractNormalLoad | None) -> AbstractNormalLoad:
    """The load of a friction law; None is `FollowerLoad()`."""
    load = FollowerLoad() if load is None else load
    if not isinstance(load, AbstractNormalLoad):
        raise ValueError(
            "Argument `load` must be `FollowerLoad()`, `ConstantLoad(n)`, "
            f"`JointReaction()` or a sum of these, but is {load!r}."
        )
    return load


class Bodies(NamedTuple):
    """The inertia from which the reactions of two rods follow."""

    m2: Scalar  # rod 2's mass
    s1: Scalar  # rod 1's first moment about the base
    b: Scalar  # rod 2's first moment about the knee


class Reactions(NamedTuple):
    """Both joints' reactions in rod 2's frame: (along, across), affine in a1 and a2."""

    still: tuple[Pair, Pair]  # without accelerations
    turned: Pair  # sine and cosine of D: across rod 1 is where a1 acts
    moments: Pair  # of rod 1 and what hangs on its end, about the joint: by a1
    b: Scalar  # and of rod 2 about the knee: by a2

    def slope(self, a1: Scalar, a2: Scalar) -> tuple[Pair, Pair]:
        """The part of the reactions that is linear in the accelerations."""
        s, c = self.turned
        pulls = [m * a1 for m in self.moments]
        first, second = ((-x * s, x * c + self.b * a2) for x in pulls)
        return first, second

    def at(self, a1: Scalar, a2: Scalar) -> tuple[Pair, Pair]:
        """The reactions under these accelerations."""
        pairs = zip(self.still, self.slope(a1, a2), strict=True)
        first, second = ((x + dx, y + dy) for (x, y), (dx, dy) in pairs)
        return first, second


def reactions_of(
    bodies: Bodies,
    rates: Sequence[Scalar],
    turned: Pair,
    pull: tuple[Scalar, Scalar | None],
    drag: tuple[Scalar, Scalar, Scalar] | None,
) -> Reactions:
    """The reactions of one state, still to be told its accelerations.

    **Arguments:** `turned`: sine and cosine of D; `pull`: the load along rod 2 and
    across it; `drag`: of the damping law.
    """
    (m2, s1, b), (w1, w2), (s, c) = bodies, rates, turned
    # towards the centres of the rods' circles; rod 1 lies at D, rod 2 at 0
    along1, across1 = -w1 * w1 * c, -w1 * w1 * s
    along, across = m2 * along1 - b * w2 * w2 + pull[0], m2 * across1
    if pull[1] is not None:
        across = across + pull[1]
    joint1 = along + s1 * along1, across + s1 * across1
    if drag is not None:  # the joints hold the rods against it
        f1, f2, f3 = drag[0] * w1, drag[1] * w1, drag[2] * w2
        joint1 = joint1[0] - s * (f1 + f2), joint1[1] + c * (f1 + f2) + f3
        along, across = along - s * f2, across + c * f2 + f3
    return Reactions((joint1, (along, across)), (s, c), (m2 + s1, m2), b)


def solve_loads(
    base: tuple[Pair, Pair],
    slopes: Sequence[tuple[Pair, Pair]],
    load: Reaction,
    unique: bool = False,
) -> Pair:
    """Solve N_i = |base_i + p1_i N_1 + p2_i N_2| + n_i by Newton; NaN if that fails.

    **Arguments:** `load`: the number of Newton's steps and the preload n, if any.

    With `unique` also where the right-hand side is no contraction, so that there may
    be more solutions: where the matrix of the lengths |pj_i| has an eigenvalue of one
    and more.
    """
    p1, p2 = slopes
    tiny = 1e-30  # a reaction of exactly zero has no direction: let its slope be zero

    def magnitude(i, n1, n2):
        along, across = (base[i][k] + p1[i][k] * n1 + p2[i][k] * n2 for k in (0, 1))
        size = jnp.sqrt(along * along + across * across + tiny)
        normal = size if load.preload is None else size + load.preload[i]
        d1 = (along * p1[i][0] + across * p1[i][1]) / size
        d2 = (along * p2[i][0] + across * p2[i][1]) / size
        return normal, d1, d2

    def newton(n1, n2):
        f1, d11, d12 = magnitude(0, n1, n2)
        f2, d21, d22 = magnitude(1, n1, n2)
        e1, e2 = f1 - n1, f2 - n2
        det = (1 - d11) * (1 - d22) - d12 * d21
        return (
            n1 + ((1 - d22) * e1 + d12 * e2) / det,
            n2 + (d21 * e1 + (1 - d11) * e2) / det,
        )

    at = base[0][0]  # a step fused into the next would be computed for each of its uses
    n1, n2 = materialise(
        at, lambda: (magnitude(0, 0.0, 0.0)[0], magnitude(1, 0.0, 0.0)[0])
    )
    n1, n2 = jax.lax.fori_loop(0, load.steps, lambda i, n: newton(*n), (n1, n2))
    left = jnp.abs(magnitude(0, n1, n2)[0] - n1) + jnp.abs(magnitude(1, n1, n2)[0] - n2)
    solved = left <= 1e-6 * (1 + jnp.abs(n1) + jnp.abs(n2))
    if unique:
        (s11, s21), (s12, s22) = (
            [along * along + across * across for along, across in p] for p in (p1, p2)
        )
        room = (1 - jnp.sqrt(s11)) * (1 - jnp.sqrt(s22))
        solved &= (s11 < 1) & (s22 < 1) & (room * room > s12 * s21)
    return jnp.where(solved, n1, jnp.nan), jnp.where(solved, n2, jnp.nan)
