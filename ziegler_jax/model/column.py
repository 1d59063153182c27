r"""The Ziegler column as a value: inertia, springs, follower load, damping, friction.

Lengths in units of rod 1's length l, torques in k (the spring of joint 2), time in
$\sqrt{m l^2/k}$ with m the reference mass. The equations stand at `Column`. The
published ones that this project started from carry two misprints in the velocity terms;
these conserve energy at q = 0 and agree with a multibody code.
"""

import math
from functools import partial
from typing import ClassVar, NamedTuple, cast

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero

from ..numerics.elementary import sincos
from ..numerics.materialise import materialise
from ..numerics.numbers import (
    Pair,
    Scalar,
    Vector4,
    checked,
    equals,
    is_concrete,
    keeps_rules,
)
from ..runtime import refuse_forked
from .damping import AbstractDamping, lengths
from .friction import AbstractFriction, AbstractRateFriction
from .joint_reactions import joint_reactions
from .set_valued import Dynamics, FrozenCoulomb
from .state import State, scalars_of


class Column(eqx.Module):
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
    and `point_masses` work the inertia out of masses and lengths.

    **Arguments:**

    - `q`: the follower load $F l / k$.
    - `a`, `b`, `d`: inertia in $m l^2$, with $a, d > 0$ and $ad > b^2$.
    - `kappa`: $k_1 / k_2$, nonnegative.
    - `follower`: $\eta$, 1 for a load along rod 2. Known to be 1, its term in the
        second equation is not in the program.
    - `damping`: None, `Viscous(c1, c2)` or another damping law.
    - `friction`: None or a friction law.
    - `m2`, `s1`, optional: the mass of rod 2 and the first moment of rod 1 about the
        base (rod 2's about the knee is b), in m and m l. Only the joints' reactions
        need them; the constructors set them.
    - `l2`: the load's lever on rod 2, its length in l. Only a load that does not
        follow ($\eta \ne 1$) needs it, and `Air` must have the same.
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
    }

    q: Scalar
    a: Scalar
    b: Scalar
    d: Scalar
    kappa: Scalar
    follower: Scalar | None  # None: known to be 1, as in a prepared column
    damping: AbstractDamping | None
    friction: AbstractFriction | None
    m2: Scalar | None
    s1: Scalar | None
    l2: Scalar
    l1: Scalar | None  # None: the unit of length

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
    ):
        """Check and keep the column's numbers."""
        self.q, self.a, self.b, self.d = checked(self.rules, q=q, a=a, b=b, d=d)
        self.kappa, self.follower, self.m2, self.s1 = checked(
            self.rules, kappa=kappa, follower=follower, m2=m2, s1=s1
        )
        self.l2, self.l1 = checked(self.rules, l2=l2, l1=l1)
        inertia = (self.a, self.b, self.d)
        if all(map(is_concrete, inertia)) and not self.a * self.d > self.b**2:
            raise ValueError(
                "Arguments `a`, `b`, `d` must make a positive definite inertia, "
                f"a d > b^2, but are {self.a:g}, {self.b:g}, {self.d:g}."
            )
        for name, part, kind in (
            ("damping", damping, AbstractDamping),
            ("friction", friction, AbstractFriction),
        ):
            if part is not None and not isinstance(part, kind):
                raise ValueError(
                    f"Argument `{name}` must be None or a law, but is {part!r}."
                )
        for length in lengths(damping):
            known = is_concrete(length) and is_concrete(self.l2)
            if known and not math.isclose(length, self.l2, rel_tol=1e-12):
                raise ValueError(
                    "Argument `l2` of `Air` must be the column's, "
                    f"{self.l2:g}, but is {length:g}."
                )
        self.damping = damping
        self.friction = friction
        if friction is not None and friction.on_reactions:
            _needs_masses(self, "the load `JointReaction()`")

    @property
    def tangential(self) -> bool:
        """Whether the load is known to follow rod 2: then terms can be left out."""
        return self.follower is None or equals(self.follower, 1.0)

    @property
    def sticks(self) -> bool:
        """Whether friction is set-valued: joints truly stick, motions have events."""
        return self.friction is not None and self.friction.sticks

    def valid(self) -> jax.Array:
        """Whether the numbers keep their rules: for those only known when traced."""
        a, b, d = jnp.asarray(self.a), jnp.asarray(self.b), jnp.asarray(self.d)
        good = keeps_rules(self.rules, self) & (a * d > b * b)
        if self.damping is not None:
            good &= self.damping.valid()
        if self.friction is not None:
            good &= self.friction.valid()
        return good


def refuse_si(column: Column) -> None:
    """Refuse a column in SI units, in which the equations of motion do not hold."""
    if column.l1 is not None:
        length = f"{column.l1:g}" if is_concrete(column.l1) else "a traced number"
        raise ValueError(
            "Argument `column` must be in its own units, in which rod 1 has the length "
            f"1, but has `l1` = {length}: write `si.scaled(column)`, with `si` of "
            "`zj.SI`."
        )


def vector_field(t: Scalar, y: Vector4, column: Column) -> Vector4:
    """The equations of motion, in diffrax's signature.

    **Arguments:** `t`: unused, the column is autonomous; `y`: phi1, phi2, omega1,
    omega2 as four scalars; `column`.

    **Returns:** their time derivatives, four scalars.
    """
    del t
    _, _, w1, w2 = y
    forces = _Forces(column, y)
    if column.sticks:
        law = _set_valued(column, forces)
        return w1, w2, *law.accelerations(forces.balance())
    return w1, w2, *forces.accelerations(_friction_torques(column, forces, y))


def energy(column: Column, y: Vector4 | State) -> jax.Array:
    r"""Kinetic energy and that of the springs, in units of k.

    $$E = \tfrac12 a\omega_1^2 + b \cos D\,\omega_1\omega_2 + \tfrac12 d\omega_2^2
    + \tfrac12\kappa\phi_1^2 + \tfrac12(\phi_2-\phi_1)^2$$

    The follower load has no potential: its work is in `power`.

    **Arguments:** `column`; `y`: a `State`, or its four scalars.
    """
    refuse_forked()
    refuse_si(column)
    y = scalars_of(y)
    return jnp.asarray(_energy(column, y, sincos(y[0] - y[1])[1]))


def _energy(column: Column, y: Vector4, cos_d: Scalar) -> Scalar:
    phi1, phi2, w1, w2 = y
    kinetic = column.a * w1 * w1 / 2 + column.d * w2 * w2 / 2
    kinetic += column.b * cos_d * w1 * w2
    return kinetic + (column.kappa * phi1**2 + (phi2 - phi1) ** 2) / 2


class Power(NamedTuple):
    r"""Rates of work in $k\sqrt{k/(m l^2)}$, each a scalar or None.

    `follower`: what the load feeds in, $Q \cdot \omega$ with its generalised forces
    $Q = (q\sin(\phi_1 - \eta\phi_2),\ q\,l_2\sin((1-\eta)\phi_2))$; `damping`: what
    damping takes out, $\omega \cdot C\omega$; `friction`: what friction takes out,
    $T_1 u_1 + T_2 u_2$. Then $dE/dt$ = `follower` - `damping` - `friction`, with E by
    `energy`.
    """

    follower: Scalar
    damping: Scalar | None
    friction: Scalar | None


def power(column: Column, y: Vector4 | State) -> Power:
    r"""What the load feeds in, and what damping and friction take out.

    $$\frac{dE}{dt} = P_{follower} - P_{damping} - P_{friction}$$

    **Arguments:** `column`; `y`: a `State`, or its four scalars $\phi_1, \phi_2,
    \omega_1, \omega_2$.

    **Returns:** a `Power`: scalars in $k\sqrt{k/(m l^2)}$; a part that the column does
    not have is None, not zero.
    """
    y = scalars_of(y)
    _, _, w1, w2 = y
    forces = _Forces(column, y)
    load1, load2 = forces.load
    follower = load1 * w1 + (0.0 if load2 is None else load2 * w2)
    damping = friction = None
    if forces.damping is not None:
        damping = forces.damping[0] * w1 + forces.damping[1] * w2
    torques = _friction_torques(column, forces, y)
    if torques is not None:
        friction = torques[0] * w1 + torques[1] * (w2 - w1)
    return Power(follower, damping, friction)


class EnergyBalance(NamedTuple):
    """The energy, its time derivative, and what friction and damping take out."""

    energy: Scalar
    rate: Scalar
    loss: Scalar


def energy_balance(column: Column, y: Vector4, accelerations: Pair) -> EnergyBalance:
    r"""The energy and its balance, from the state and its accelerations alone.

    $$\frac{dE}{dt} = a\omega_1\dot\omega_1 + b\cos D\,(\dot\omega_1\omega_2 +
    \omega_1\dot\omega_2) - b\sin D\,(\omega_1 - \omega_2)\,\omega_1\omega_2 +
    d\omega_2\dot\omega_2 + \kappa\phi_1\omega_1 + (\phi_2 - \phi_1)(\omega_2 -
    \omega_1)$$

    The loss is $Q\cdot\omega - dE/dt$, the sum of the last two parts of `power`,
    whatever the laws are: none is evaluated.
    """
    phi1, phi2, w1, w2 = y
    a1, a2 = accelerations
    sin_d, cos_d = sincos(phi1 - phi2)
    rate = column.a * w1 * a1 + column.d * w2 * a2
    rate += column.b * (cos_d * (a1 * w2 + w1 * a2) - sin_d * (w1 - w2) * w1 * w2)
    rate += column.kappa * phi1 * w1 + (phi2 - phi1) * (w2 - w1)
    load1, load2 = _load(column, y, sin_d)
    fed = load1 * w1 + (0.0 if load2 is None else load2 * w2)
    return EnergyBalance(_energy(column, y, cos_d), rate, fed - rate)


def joint_balance(column: Column, y: Vector4) -> Dynamics:
    """The mass matrix and the forces without friction, for set-valued friction."""
    return _Forces(column, y).balance()


def reactions(column: Column, y: Vector4 | State) -> jax.Array:
    r"""The forces that the joints transmit, in units of k/l.

    $R_2 = m_2 \ddot r_{c2} - F$ on rod 2 at the knee, $R_1 = m_1 \ddot r_{c1} + R_2$
    at the base; at rest both balance the load, $|R_i| = |q|$.

    **Arguments:** `column`, with `m2` and `s1`; `y`: a `State`, or its four scalars.

    **Returns:** an array of shape (2, 2): joint 1 and 2, components along the
    horizontal x and the vertical z.

    **Raises:** `ValueError` if the column was built without `m2` and `s1`.
    """
    _needs_masses(column, "`reactions`")
    y = scalars_of(y)
    _, _, a1, a2 = vector_field(0.0, y, column)
    forces = joint_reactions(column, _Forces(column, y))
    (along1, across1), (along2, across2) = forces.at(a1, a2)
    s, c = sincos(y[1])  # from rod 2's frame to the fixed one
    return jnp.stack(
        [
            jnp.stack([across1 * c + along1 * s, along1 * c - across1 * s]),
            jnp.stack([across2 * c + along2 * s, along2 * c - across2 * s]),
        ]
    )


def _load(column: Column, y: Vector4, sin_d: Scalar) -> tuple[Scalar, Scalar | None]:
    """The load's generalised forces Q; the second is None where it is known to be 0."""
    phi1, phi2, *_ = y
    q, eta = column.q, column.follower
    if column.tangential:
        return q * sin_d, None
    assert eta is not None
    return (
        q * sincos(phi1 - eta * phi2)[0],
        q * column.l2 * sincos((1 - eta) * phi2)[0],
    )


class _Forces:
    """Everything but friction, at one state: what field, power and reactions share."""

    def __init__(self, column: Column, y: Vector4):
        phi1, phi2, w1, w2 = y
        refuse_forked()  # what needs the forces asks here
        refuse_si(column)
        self.column, self.y = column, y
        self.sin_d, self.cos_d = sincos(phi1 - phi2)
        self.load = _load(column, y, self.sin_d)
        self.damping = None
        if column.damping is not None:
            (c11, c12), (c21, c22) = column.damping.matrix(self.cos_d, (w1, w2))
            self.damping = (c11 * w1 + c12 * w2, c21 * w1 + c22 * w2)
        gyro = column.b * self.sin_d
        spring = phi1 - phi2
        self.r1 = self.load[0] - column.kappa * phi1 - spring - gyro * (w2 * w2)
        self.r2 = spring + gyro * (w1 * w1)
        if self.load[1] is not None:
            self.r2 = self.r2 + self.load[1]
        if self.damping is not None:
            self.r1 = self.r1 - self.damping[0]
            self.r2 = self.r2 - self.damping[1]

    def balance(self) -> Dynamics:
        """What set-valued friction needs to hold a joint."""
        column, law = self.column, self.column.friction
        h, reactions = column.b * self.cos_d, None
        if law is not None and law.on_reactions:
            reactions = joint_reactions(column, self)
        return Dynamics(column.a, h, column.d, self.r1, self.r2, reactions)

    def solve(self, r1: Scalar, r2: Scalar) -> Pair:
        """Divide by the mass matrix."""
        return _solved(self.column.a, self.column.b * self.cos_d, self.column.d, r1, r2)

    def accelerations(self, torques: Pair | None) -> Pair:
        """The angular accelerations under the joints' friction torques."""
        if torques is None:
            return self.solve(self.r1, self.r2)
        t1, t2 = torques
        return self.solve(self.r1 - t1 + t2, self.r2 - t2)


@jax.custom_jvp
def _solved(a: Scalar, h: Scalar, d: Scalar, r1: Scalar, r2: Scalar) -> Pair:
    """The accelerations of a mass matrix with the rows (a, h) and (h, d)."""
    inverse = 1 / (a * d - h * h)
    w1 = materialise(r1, lambda: (d * r1 - h * r2) * inverse)  # the second needs it
    return w1, (r2 - h * w1) * (1 / d)


@partial(_solved.defjvp, symbolic_zeros=True)
def _solved_jvp(primals, tangents):
    """M dw = dr - dM w: with the accelerations w, not with a quotient's derivative."""
    a, h, d, *_ = primals
    da, dh, dd, dr1, dr2 = tangents
    w1, w2 = _solved(*primals)
    inverse = 1 / (a * d - h * h)
    s1 = _added(w1, (dr1, 1.0), (dh, -w2), (da, -w1))
    s2 = _added(w2, (dr2, 1.0), (dh, -w1), (dd, -w2))
    across, first, second = h * inverse, d * inverse, a * inverse
    return (w1, w2), (first * s1 - across * s2, second * s2 - across * s1)


def _added(like: Scalar, *products: tuple[Scalar, Scalar]) -> Scalar:
    """The sum of products whose first factors are not known to be zero."""
    known = [(x, f) for x, f in products if not isinstance(x, SymbolicZero)]
    return sum((x * f for x, f in known), jnp.zeros_like(like))


def _friction_torques(column: Column, forces: _Forces, y: Vector4) -> Pair | None:
    law = column.friction
    if law is None:
        return None
    _, _, w1, w2 = y
    if column.sticks:
        return _set_valued(column, forces).torques(forces.balance())
    # both accelerations need both: not to be computed for each
    law = cast(AbstractRateFriction, law)
    g1, g2 = materialise(w1, law.levers, w1, w2 - w1)
    load = law.load_law()
    if load is None:
        return g1, g2
    n1, n2 = load.normal(column, forces, g1, g2)
    return g1 * n1, g2 * n2


def _set_valued(column: Column, forces: _Forces) -> FrozenCoulomb:
    """Set-valued friction in the modes of the motion or of the state."""
    _, _, w1, w2 = forces.y
    law = cast(AbstractFriction, column.friction)
    law = cast(FrozenCoulomb, law.prepared(column.q))
    return law.in_modes_at(forces.balance(), (w1, w2 - w1))


def _needs_masses(column: Column, what: str) -> None:
    if column.m2 is None or column.s1 is None:
        raise ValueError(
            f"Arguments `m2` and `s1` of the column must be given for {what}, but are "
            f"{column.m2!r} and {column.s1!r}; `uniform_rods` and `point_masses` set "
            "them."
        )
