r"""Set-valued Coulomb friction: joints that truly stick, and what sets them free.

With the joint rates $u_1 = \omega_1$, $u_2 = \omega_2 - \omega_1$ each joint is in one
of three modes. It slips forwards or backwards (+1, -1) with the kinetic torque
$T_i = \pm\tau_{k,i}$ against its sliding, or it sticks (0): then $u_i = 0$ and $T_i$ is
the constraint torque $\lambda_i$ that keeps it so. With the mass matrix
[[a, h], [h, d]], $h = b \cos D$, and the right-hand sides $r_1, r_2$ of the equations
of motion without friction,

$$\lambda_1 = r_1 + T_2 - \frac{h}{d}(r_2 - T_2), \qquad
\lambda_2 = r_2 - \frac{h + d}{a + 2h + d}(r_1 + r_2 - T_1)$$

where the other joint slips, and $\lambda_1 = r_1 + r_2$, $\lambda_2 = r_2$ where both
stick. A joint can stick as long as $|\lambda_i| \le \tau_{s,i}$.
"""

from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax.numpy as jnp

from ._layer import layer_limit
from ._types import Pair, Scalar, both, number_or_pair
from .friction import (
    AbstractFriction,
    AbstractLoad,
    FollowerLoad,
    JointReaction,
    kinetic_at_most_static,
)

Release = Literal["stick-first", "stribeck-limit"]
RELEASES = ("stick-first", "stribeck-limit")


class Balance(NamedTuple):
    """The mass matrix [[a, h], [h, d]] and the forces r1, r2 without friction."""

    a: Scalar
    h: Scalar
    d: Scalar
    r1: Scalar
    r2: Scalar

    def held1(self, t2: Scalar) -> Scalar:
        """The torque that holds joint 1 while joint 2 slips under t2."""
        return self.r1 + t2 - self.h * (self.r2 - t2) / self.d

    def held2(self, t1: Scalar) -> Scalar:
        """The torque that holds joint 2 while joint 1 slips under t1."""
        whole = self.a + 2 * self.h + self.d
        return self.r2 - (self.h + self.d) * (self.r1 + self.r2 - t1) / whole

    def held(self) -> Pair:
        """The torques that hold both joints."""
        return self.r1 + self.r2, self.r2


class SetValuedCoulomb(AbstractFriction):
    r"""Static and kinetic Coulomb friction with exact stick and slip.

    $$T_i = \tau_{k,i}\,\mathrm{sign}(u_i) \text{ where } u_i \ne 0, \qquad
    |T_i| \le \tau_{s,i} \text{ where } u_i = 0, \qquad
    \tau_i = \mu_i \rho_i N_i$$

    With $\mu_s = \mu_k$ the law fixes every motion. With $\mu_s > \mu_k$ it does not:
    where one joint comes to rest or breaks loose while the other one rests too, more
    than one pair of modes can agree with it, and `release` names the rule that
    chooses:

    - `"stick-first"`: a joint at rest sticks if its constraint torque fits within
        $\tau_s$, taken for the modes that are chosen; a joint sticks rather than not.
    - `"stribeck-limit"`: the limit $v \to 0$ of the layer
        $\tau_s |u|/v$ for $|u| < v$, then
        $\tau_k + (\tau_s - \tau_k)\,e^{-(|u| - v)/v}$, integrated at each such event.
        While one joint passes through its layer, its torque rises to $\tau_s$ and may
        push the other over its own peak: so it may release what the first rule holds.

    The limit is not unique: another shape of the layer can choose other modes, and the
    layer above is part of the rule's name. At q = 5.5, $\tau_s$ = 0.2, $\tau_k$ = 0.05
    and a kick of 0.2 the two rules part at t = 5.80; the one ends stuck, the other
    flutters. For $\mu_s \le 1.25 \mu_k$ they agreed in every case tried.

    **Arguments:**

    - `mu_s`, `mu_k`: static and kinetic coefficient, one number or one a joint,
        $\mu_s \ge \mu_k \ge 0$; `mu_k` left out is `mu_s`.
    - `pin_radius`: $\rho = R_{pin}/l$, one number or one a joint.
    - `load`: the normal load, `FollowerLoad()` or `ConstantLoad(n)`. Not
        `JointReaction()`: its normal loads depend on the friction torques, so that
        each pair of modes has loads and thresholds of its own; to choose among them is
        not solved here.
    - `release`: the rule above.

    **Raises:** `ValueError` for concrete numbers that break a rule, and for
    `JointReaction()`. Traced numbers give the outcome `invalid`.
    """

    mu_s: Any
    mu_k: Any
    pin_radius: Any
    load: AbstractLoad
    release: Release = eqx.field(static=True)

    def __init__(
        self,
        mu_s: Any,
        mu_k: Any = None,
        *,
        pin_radius: Any,
        load: AbstractLoad | None = None,
        release: Release = "stick-first",
    ):
        """Check and keep the law's numbers."""
        self.mu_s = number_or_pair("mu_s", mu_s, "nonnegative")
        self.mu_k = (
            None if mu_k is None else number_or_pair("mu_k", mu_k, "nonnegative")
        )
        self.pin_radius = number_or_pair("pin_radius", pin_radius, "nonnegative")
        self.load = FollowerLoad() if load is None else load
        if not isinstance(self.load, AbstractLoad) or isinstance(load, JointReaction):
            raise ValueError(
                "Argument `load` must be `FollowerLoad()` or `ConstantLoad(n)` with "
                f"set-valued friction, but is {load!r}; a load that the reactions "
                "decide leaves the modes open."
            )
        if release not in RELEASES:
            raise ValueError(
                f"Argument `release` must be one of {', '.join(RELEASES)}, but is "
                f"{release!r}."
            )
        self.release = release
        kinetic_at_most_static(self.mu_s, self.mu_k)

    def levers(self, u1: Scalar, u2: Scalar) -> Pair:
        """Refuse: the torque at rest is not a function of the rates."""
        raise ValueError("Set-valued friction has no torque as a function of the rate.")

    def prepared(self, q: Scalar) -> "Torques":
        """The same law as torques."""
        lever = [
            n * r
            for n, r in zip(self.load.given(q), both(self.pin_radius), strict=True)
        ]
        static = tuple(x * mu for x, mu in zip(lever, both(self.mu_s), strict=True))
        if self.mu_k is None:
            return Torques(static, static, self.release, None)
        kinetic = tuple(x * mu for x, mu in zip(lever, both(self.mu_k), strict=True))
        return Torques(static, kinetic, self.release, None)

    def valid(self) -> Any:
        """0 <= mu_k <= mu_s, pin_radius >= 0."""
        good: Any = True
        for mu_s, rho in zip(both(self.mu_s), both(self.pin_radius), strict=True):
            good &= (jnp.asarray(mu_s) >= 0) & (jnp.asarray(rho) >= 0)
        if self.mu_k is not None:
            for mu_s, mu_k in zip(both(self.mu_s), both(self.mu_k), strict=True):
                good &= (jnp.asarray(mu_k) >= 0) & (jnp.asarray(mu_k) <= mu_s)
        return good

    def load_law(self) -> AbstractLoad:
        """The normal load."""
        return self.load

    def rate_cut(self) -> Scalar | None:
        """None: a joint sticks or it does not."""
        return None


class Torques(AbstractFriction):
    r"""Set-valued friction as torques, in given modes or those of the state itself.

    **Arguments:** `static`, `kinetic`: $\tau_{s,i}$, $\tau_{k,i}$; `release`: the rule;
    `modes`: -1., 0. or 1. for each joint, or None.
    """

    static: Pair
    kinetic: Pair
    release: Release = eqx.field(static=True)
    modes: Pair | None

    def levers(self, u1: Scalar, u2: Scalar) -> Pair:
        """Refuse: the torque at rest is not a function of the rates."""
        raise ValueError("Set-valued friction has no torque as a function of the rate.")

    def in_modes(self, modes: Pair) -> "Torques":
        """The same law with the modes frozen."""
        return Torques(self.static, self.kinetic, self.release, modes)

    def held_at(self, balance: Balance, u: Pair) -> "Torques":
        """The law in frozen modes: its own, or those that begin at these rates."""
        if self.modes is not None:
            return self
        return self.in_modes(self.begin(balance, u, (u[0] == 0, u[1] == 0)))

    def torques(self, balance: Balance) -> Pair:
        """T1, T2 in the frozen modes: what the accelerations leave of the forces."""
        assert self.modes is not None
        a, h, d, r1, r2 = balance
        a1, a2 = self.accelerations(balance)
        left2 = r2 - h * a1 - d * a2
        left1 = r1 - a * a1 - h * a2 + left2
        (m1, m2), (k1, k2) = self.modes, self.kinetic
        return (
            jnp.where(m1 == 0, left1, m1 * k1),
            jnp.where(m2 == 0, left2, m2 * k2),
        )

    def accelerations(self, balance: Balance) -> Pair:
        """The rods' accelerations in the frozen modes, with one division."""
        assert self.modes is not None
        a, h, d, r1, r2 = balance
        m1, m2 = self.modes
        t1, t2 = m1 * self.kinetic[0], m2 * self.kinetic[1]
        stuck1, stuck2 = m1 == 0, m2 == 0
        one, two, whole = r1 - t1 + t2, r2 - t2, r1 + r2 - t1
        inertia = jnp.where(stuck1, d, a * d - h * h)
        inverse = 1 / jnp.where(stuck2, a + 2 * h + d, inertia)
        first = jnp.where(stuck2, whole, d * one - h * two)
        second = jnp.where(stuck1, two, a * two - h * one)
        second = jnp.where(stuck2, whole, second)
        still = stuck1 & stuck2
        return (
            jnp.where(stuck1, 0.0, first * inverse),
            jnp.where(still, 0.0, second * inverse),
        )

    def hold(self, x1: Scalar, x2: Scalar) -> Pair:
        """Rates of the rods, with those of stuck joints exactly zero."""
        assert self.modes is not None
        m1, m2 = self.modes
        x1 = jnp.where(m1 == 0, 0.0, x1)
        return x1, jnp.where(m2 == 0, x1, x2)

    def begin(self, balance: Balance, u: Pair, rest: Pair) -> Pair:
        """The modes with which a motion starts: `rest` says which joints are at rest.

        The layers of joints that both start at rest start at rest too.
        """
        zero = 0.0 * u[0]
        given = jnp.sign(u[0]), jnp.sign(u[1])
        return self.chosen(balance, given, rest, (zero, zero), (zero, zero), True)

    def chosen(
        self,
        balance: Balance,
        given: Pair,
        rest: Pair,
        slack: Pair,
        layer: Pair,
        needed: Any,
    ) -> Pair:
        r"""The modes after an event, by the rule.

        **Arguments:**

        - `balance`: the state's.
        - `given`: the modes of the joints that are not at rest.
        - `rest`: which joints are.
        - `slack`: by how much less than $\tau_s$ sets a joint free: the tolerance for
            one whose torque has just reached it.
        - `layer`: where each joint stands in its layer, $u_i / v$.
        - `needed`: whether the answer is used, so that no layer is passed in vain.
        """
        thresholds = tuple(s - x for s, x in zip(self.static, slack, strict=True))
        modes = stick_first(balance, self.kinetic, thresholds, given, rest)
        if self.release == "stick-first" or self.static is self.kinetic:
            return modes
        # with equal coefficients the law alone decides, and the layer has no slope
        falls = (self.static[0] > self.kinetic[0]) | (self.static[1] > self.kinetic[1])
        ask = rest[0] & rest[1] & falls & needed
        first, second, found = layer_limit(
            balance, self.static, self.kinetic, layer, ask
        )
        # a passage that does not end, on the border between two ends, decides nothing
        ask &= found
        return jnp.where(ask, first, modes[0]), jnp.where(ask, second, modes[1])

    def valid(self) -> Any:
        """What it was made from has been checked."""
        return True

    def load_law(self) -> None:
        """The load is in the torques."""
        return None

    def rate_cut(self) -> Scalar | None:
        """None: a joint sticks or it does not."""
        return None


def stick_first(
    f: Balance, kinetic: Pair, thresholds: Pair, given: Pair, rest: Pair
) -> Pair:
    r"""Modes in which every joint at rest sticks exactly if its torque fits.

    A joint at rest slips in the direction of its constraint torque, taken for the
    other joint's final mode, if that passes the threshold. Where no pair of modes does
    so (possible only with $\mu_s > \mu_k$), one is taken in which what slips is
    accelerated in its direction: one torque above $\tau_k$ is enough. There always is
    one, as for any positive definite inertia.
    """
    (k1, k2), (most1, most2) = kinetic, thresholds
    hold1, hold2 = f.held()
    # the torque that holds one joint, for each direction of the other
    up1, down1 = f.held1(k2), f.held1(-k2)
    up2, down2 = f.held2(k1), f.held2(-k1)

    def alone(torque, most):
        return jnp.where(jnp.abs(torque) <= most, 0.0, jnp.sign(torque))

    alone1 = alone(jnp.where(given[1] > 0, up1, down1), most1)
    alone2 = alone(jnp.where(given[0] > 0, up2, down2), most2)

    first, second = jnp.sign(hold1), jnp.sign(hold2)
    one = jnp.ones_like(first)
    zero = 0.0 * one
    fits1 = jnp.abs(jnp.where(second > 0, up1, down1)) <= most1
    fits2 = jnp.abs(jnp.where(first > 0, up2, down2)) <= most2
    # where either joint could be the one that gives way, the more loaded one does
    over = jnp.abs(hold1) - most1 >= jnp.abs(hold2) - most2
    choices = [((jnp.abs(hold1) <= most1) & (jnp.abs(hold2) <= most2), zero, zero)]
    for least1, least2 in ((most1, most2), (k1, k2)):
        slips1 = (jnp.abs(hold1) > least1) & fits2
        slips2 = (jnp.abs(hold2) > least2) & fits1
        choices += [
            (slips1 & (over | ~slips2), first, zero),
            (slips2, zero, second),
            ((up1 > least1) & (up2 > least2), one, one),
            ((down1 > least1) & (-up2 > least2), one, -one),
            ((-up1 > least1) & (down2 > least2), -one, one),
            ((-down1 > least1) & (-down2 > least2), -one, -one),
        ]
    m1, m2 = zero, zero
    for agrees, one1, one2 in reversed(choices):
        m1, m2 = jnp.where(agrees, one1, m1), jnp.where(agrees, one2, m2)
    m1 = jnp.where(rest[0], jnp.where(rest[1], m1, alone1), given[0])
    m2 = jnp.where(rest[1], jnp.where(rest[0], m2, alone2), given[1])
    return m1, m2
