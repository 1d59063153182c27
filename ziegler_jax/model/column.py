r"""The Ziegler column as a value: inertia, springs, follower load, damping, friction.

Lengths in units of rod 1's length l, torques in k (the spring of joint 2), time in
$\sqrt{m l^2/k}$ with m the reference mass. The equations stand at `Column`. The
published ones that this project started from carry two misprints in the velocity terms;
these conserve energy at q = 0 and agree with a multibody code.
"""

from __future__ import annotations

from typing import ClassVar

import jax
import jax.numpy as jnp

from ..numerics.elementary import sincos
from ..numerics.numbers import (
    Joints,
    Numbers,
    OneOrEach,
    Scalar,
    each,
    equals,
    is_concrete,
)
from ..numerics.rules import Invariants, checked, instance
from ..runtime import refuse_forked
from .chain import Follower, spread
from .chain_of_rods import AbstractChain
from .damping import AbstractDamping, lengths
from .forces import DeadLoad, Forces, Gravity, checked_own, fixed_forces, read
from .friction import AbstractFriction
from .loads import Bodies
from .state import PhasePoint, State, phase_of
from .system import Power, System


class Column(AbstractChain):
    r"""A double pendulum on springs under a follower load.

    With the rods' absolute angles $\phi_1, \phi_2$ from the vertical, their rates
    $\omega_1, \omega_2$ and $D = \phi_1 - \phi_2$, lengths in l, torques in $k = k_2$
    and times in $\sqrt{m l^2/k}$:

    $$a \dot\omega_1 + b\cos D\,\dot\omega_2 + b \sin D\,\omega_2^2
      + (\kappa+1)\phi_1 - \phi_2
      = q \sin(\phi_1 - \eta\phi_2) - T_1 + T_2 - (C\omega)_1$$
    $$b\cos D\,\dot\omega_1 + d \dot\omega_2 - b \sin D\,\omega_1^2 - \phi_1 + \phi_2
      = q\, l_2 \sin((1-\eta)\phi_2) - T_2 - (C\omega)_2$$

    $T_i$ is the friction torque in joint i, C the damping law's matrix. `uniform_rods`
    and `point_masses` compute the inertia from masses and lengths.

    **Arguments:**

    - `q`: the follower load $F l / k$.
    - `a`, `b`, `d`: inertia in $m l^2$, with $a, d > 0$ and $ad > b^2$.
    - `kappa`: $k_1 / k_2$, nonnegative.
    - `follower`: $\eta$, 1 for a load along rod 2. Where it is known to be 1, its term
        in the second equation is not in the program.
    - `damping`: None, `Viscous(c1, c2)` or another damping law.
    - `friction`: None or a friction law.
    - `m2`, `s1`, optional: the mass of rod 2 and the first moment of rod 1 about the
        base (rod 2's about the knee is b), in m and m l. Only the joints' reactions
        need them; the constructors set them.
    - `l2`: the load's lever on rod 2, its length in l. Only a load that does not
        follow ($\eta \ne 1$) needs it, and `Air` must have the same.
    - `rest_angles`, `dead_load`, `gravity`, `foundation`: as of `Chain`; gravity needs
        `m2` and `s1`.
    - `forces`: forces of your own (`AbstractForce`) and loads that depend on time
        (`LoadHistory`, `AbstractLoadHistory`), one or several in a tuple.
    - `l1`: the length of rod 1 in m, of a column in SI units alone (q in N, inertia in
        kg m^2, ...). Questions refuse it; `SI.scaled` gives it a rod 1 of length 1.

    All are leaves: any of them can be traced, mapped over and differentiated.

    **Raises:** `ValueError` where a concrete number breaks its rule.
    """

    rules: ClassVar = {
        "q": "finite",
        "a": "positive",
        "b": "finite",
        "d": "positive",
        "kappa": "nonnegative",
        "follower": "finite",
        "m2": "nonnegative; none",
        "s1": "finite; none",
        "l2": "positive",
        "l1": "positive; none",
        "rest_angles": "finite; each or none",
        "foundation": "nonnegative; each or none",
    }
    units: ClassVar = {
        "q": "k/l",
        "a": "m l^2",
        "b": "m l^2",
        "d": "m l^2",
        "kappa": "1",
        "follower": "1",
        "m2": "m",
        "s1": "m l",
        "l2": "l",
        "l1": "l",
        "rest_angles": "rad",
        "foundation": "k/l^3",
    }

    q: Scalar
    a: Scalar
    b: Scalar
    d: Scalar
    kappa: Scalar
    follower: Scalar
    damping: AbstractDamping | None
    friction: AbstractFriction | None
    m2: Scalar | None
    s1: Scalar | None
    l2: Scalar
    l1: Scalar | None  # None: the unit of length
    rest_angles: OneOrEach | None
    dead_load: DeadLoad | None
    gravity: Gravity | None
    foundation: OneOrEach | None
    forces: Forces | None

    def __init__(
        self,
        q: Scalar,
        a: Scalar,
        b: Scalar,
        d: Scalar,
        kappa: Scalar = 1.0,
        follower: Scalar = 1.0,
        damping: AbstractDamping | None = None,
        friction: AbstractFriction | None = None,
        *,
        m2: Scalar | None = None,
        s1: Scalar | None = None,
        l2: Scalar = 1.0,
        l1: Scalar | None = None,
        rest_angles: Joints | None = None,
        dead_load: DeadLoad | None = None,
        gravity: Gravity | None = None,
        foundation: Joints | None = None,
        forces: Forces | None = None,
    ):
        """Check and keep the column's numbers."""
        self.q, self.a, self.b, self.d = checked(self.rules, q=q, a=a, b=b, d=d)
        self.kappa, self.follower, self.m2, self.s1 = checked(
            self.rules, kappa=kappa, follower=follower, m2=m2, s1=s1
        )
        self.l2, self.l1 = checked(self.rules, l2=l2, l1=l1)
        self.rest_angles, self.foundation = checked(
            self.rules, rest_angles=rest_angles, foundation=foundation
        )
        self.damping, self.friction = damping, friction
        self.dead_load, self.gravity, self.forces = dead_load, gravity, read(forces)
        self.check_parts()
        self.refuse_broken()
        if gravity is not None:
            self.needs_bodies("`gravity`")

    @property
    def joints(self) -> int:
        """Two."""
        return 2

    @property
    def tangential(self) -> bool:
        """Whether the load is known to follow rod 2: then terms can be left out."""
        return equals(self.follower, 1.0)

    @property
    def pulls(self) -> Numbers:
        """Of both joints the load."""
        return self.q, self.q

    def needs_bodies(self, what: str) -> None:
        """Refuse what rests on the rods' masses where these are not known."""
        _needs_masses(self, what)

    def system(self) -> System:
        """The system that runs: all numbers computed that a motion does not change.

        **Raises:** `ValueError` for a column in SI units.
        """
        refuse_forked()
        refuse_si(self)
        bodies = None
        if self.m2 is not None and self.s1 is not None:
            bodies = Bodies(self.m2, self.s1, self.b)
        friction, bent, foundation = self.friction, self.rest_angles, self.foundation
        heavy = bodies and (bodies.s1 + bodies.m2, bodies.b)
        upright, across = fixed_forces(
            self.dead_load, self.gravity, (1.0, self.l2), heavy
        )
        force = Follower(1)
        if not self.tangential:
            force = Follower(1, eta=self.follower, lever=self.l2)
        return System(
            q=self.q,
            followers=(force,),
            moments=((self.a,), (self.b, self.d)),
            springs=(self.kappa, None),
            lengths=(None, self.l2),
            damping=self.damping,
            friction=None if friction is None else friction.torques(self.pulls),
            bodies=bodies,
            bent=None if bent is None else each(bent, 2),
            upright=upright,
            across=across,
            foundation=foundation
            if foundation is None
            else spread((1.0, self.l2), each(foundation, 2)),
            own=checked_own(self.own, 2),
        )

    def invariants(self) -> Invariants:
        """A positive definite inertia, and one length of rod 2."""
        yield (
            (self.a, self.b, self.d),
            lambda a, b, d: a * d > b * b,
            "Arguments `a`, `b`, `d` must make a positive definite inertia, a d > b^2, "
            "but are {:g}, {:g}, {:g}.",
        )
        for length in lengths(self.damping):
            yield (
                (self.l2, length),
                lambda own, other: abs(other - own) <= 1e-12 * abs(own),
                "Argument `l2` of `Air` must be the column's, {:g}, but is {:g}.",
            )


def refuse_si(column: AbstractChain) -> None:
    """Refuse a column in SI units, in which the equations of motion do not hold."""
    if isinstance(column, Column) and column.l1 is not None:
        length = f"{column.l1:g}" if is_concrete(column.l1) else "a traced number"
        raise ValueError(
            "Argument `column` must be in its own units, in which rod 1 has the length "
            f"1, but has `l1` = {length}: write `si.scaled(column)`, with `si` of "
            "`zj.SI`."
        )


# what follows a motion as it comes, and asks nothing that holds at all times
IN_TIME = "trajectory", "settle"


def check_autonomous(question: str, column: AbstractChain | System) -> None:
    """Refuse forces that depend on time, where a question asks what holds at all times.

    **Raises:** `ValueError`.
    """
    if question not in IN_TIME and not column.autonomous:
        raise ValueError(
            "Argument `forces` of the column must not depend on time for "
            f"`{question}`, which asks for what holds at all times, but does: "
            "`trajectory` and `settle(certify=False)` take it."
        )


def vector_field(t: Scalar, y: Numbers, column: AbstractChain) -> Numbers:
    """The equations of motion, in diffrax's signature.

    **Arguments:** `t`: the time, on which only your own forces depend; `y`: phi1,
    phi2, omega1, omega2 as four scalars, of n rods as 2 n; `column`.

    **Returns:** their time derivatives, as many scalars.
    """
    slope = column.system().field(t, phase_of(y, column.joints))
    return slope if isinstance(y, PhasePoint) else tuple(slope)


def energy(column: AbstractChain, y: Numbers | State) -> jax.Array:
    r"""Kinetic energy and that of the springs, in units of k.

    Of two rods

    $$E = \tfrac12 a\omega_1^2 + b \cos D\,\omega_1\omega_2 + \tfrac12 d\omega_2^2
    + \tfrac12\kappa\phi_1^2 + \tfrac12(\phi_2-\phi_1)^2$$

    plus the energy of dead load, gravity and foundation, zero where the chain stands
    upright, and the potential of your own forces. A follower load
    has no potential: its work is in `power`.

    **Arguments:** `column`; `y`: a `State`, or its scalars.
    """
    return jnp.asarray(column.system().energy(phase_of(y, column.joints)))


def power(column: AbstractChain, y: Numbers | State, t: Scalar | None = None) -> Power:
    r"""The power of the load, and the losses by damping and friction.

    $$\frac{dE}{dt} = P_{follower} - P_{damping} - P_{friction} + P_{forces}$$

    **Arguments:** `column`; `y`: a `State`, or its scalars $\phi_1, \phi_2,
    \omega_1, \omega_2$; `t`: the time, required where forces depend on it.

    **Returns:** a `Power`: scalars in $k\sqrt{k/(m l^2)}$; a part that the column does
    not have is None, not zero.
    """
    return column.system().at(t).power(phase_of(y, column.joints))


def reactions(column: Column, y: Numbers | State) -> jax.Array:
    r"""The forces that the joints transmit, in units of k/l.

    $R_2 = m_2 \ddot r_{c2} - F$ on rod 2 at the knee, $R_1 = m_1 \ddot r_{c1} + R_2$
    at the base; at rest both balance the load, $|R_i| = |q|$.

    **Arguments:** `column`, with `m2` and `s1`; `y`: a `State`, or its four scalars.

    **Returns:** an array of shape (2, 2): joint 1 and 2, components along the
    horizontal x and the vertical z.

    **Raises:** `ValueError` if the column was built without `m2` and `s1`, and under a
    dead load, gravity or a foundation, which are not implemented for it.
    """
    instance("column", column, Column)
    _needs_masses(column, "`reactions`")
    column.refuse_fixed_forces("`reactions`")
    y = phase_of(y, 2)
    (along1, across1), (along2, across2) = column.system().reactions(y)
    s, c = sincos(y[1])  # from rod 2's frame to the fixed one
    return jnp.stack(
        [
            jnp.stack([across1 * c + along1 * s, along1 * c - across1 * s]),
            jnp.stack([across2 * c + along2 * s, along2 * c - across2 * s]),
        ]
    )


def _needs_masses(column: Column, what: str) -> None:
    if column.m2 is None or column.s1 is None:
        raise ValueError(
            f"Arguments `m2` and `s1` of the column must be given for {what}, but are "
            f"{column.m2!r} and {column.s1!r}; `uniform_rods` and `point_masses` set "
            "them."
        )
