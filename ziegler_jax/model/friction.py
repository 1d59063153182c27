r"""Dry friction in the joints: a law for the coefficient, and a normal load.

The torque of joint i opposes its rate $u_i$ ($u_1 = \omega_1$,
$u_i = \omega_i - \omega_{i-1}$):

$$T_i = \rho_i N_i \mu_i(u_i)$$

with the pin radius $\rho = R_{pin}/l$ and the joint's normal load $N_i$ in units of
$k/l$, so that $\tau_i = \mu_i \rho_i N_i$ has the unit of the spring constant k. A
published coefficient gives a torque only with the pin radius and the normal load.
"""

from __future__ import annotations

import abc
import math
from collections.abc import Sequence
from typing import ClassVar, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from ..numerics.elementary import LOG2_E
from ..numerics.numbers import (
    Joints,
    Numbers,
    OneOrEach,
    Scalar,
    each,
    equals,
    is_concrete,
)
from ..numerics.rules import AbstractRuled, Invariants, checked
from ..results import RATE
from .loads import AbstractNormalLoad, FollowerLoad, Reaction, normal_load
from .torques import AbstractRateTorques, AbstractTorques, Curve, SmoothTorques


class AbstractFriction(AbstractRuled):
    """A joint friction law.

    Write its numbers as its own fields. JAX remembers a global, or an attribute of
    another object, as it was when first traced: within one point of a sweep, and
    outside of `sweep` for good.
    `rules` names a rule for each of them: `finite`, `nonnegative`, `positive`; a motion
    with a number that breaks its rule ends as `invalid`. `units` names their units, for
    `SI.scaled` only: `1`, `rad`, another one that it lists, or the powers of m, l, k.

    A law of your own derives from `AbstractRateFriction`.

    `sticks`: whether joints truly stick, so that motions have events. Only
    `SetValuedCoulomb` does.
    """

    sticks: ClassVar[bool] = False

    @abc.abstractmethod
    def load_law(self) -> AbstractNormalLoad | None:
        """The normal load that the law rests on; None: its levers are torques."""

    @property
    def on_reactions(self) -> bool:
        """Whether the motion decides its load: what the joints transmit."""
        load = self.load_law()
        return load is not None and load.of_motion

    @abc.abstractmethod
    def torques(self, pulls: Numbers) -> AbstractTorques:
        """The law for a motion: all worked out that this does not change.

        **Arguments:** `pulls`: of each joint the follower forces beyond it, q.
        """

    @abc.abstractmethod
    def rate_cut(self) -> Scalar | None:
        """The joint rate below which a joint counts as sticking; None if by mode."""


class AbstractRateFriction(AbstractFriction):
    r"""A friction law whose torques are functions of the joints' rates.

    A law of your own, $\mu u / \sqrt{u^2 + v^2}$ on pins of radius 0.1:

    ```python
    class Root(zj.AbstractRateFriction):
        rules = {"mu": "nonnegative", "v": "positive"}
        units = {"mu": "1", "v": "sqrt(k/(m l^2))"}
        mu: float
        v: float

        def levers(self, *rates):
            return [0.1 * self.mu * u / jnp.sqrt(u * u + self.v**2) for u in rates]

        def rate_cut(self):
            return self.v

    def point(q, mu):
        column = zj.uniform_rods(q, friction=Root(mu, 0.01))
        return zj.settle(column, zj.State(omega=(0.0, 0.3)))

    ds = zj.sweep(point, q=[2.2, 2.6], mu=[0.05, 0.1, 0.3])
    ```

    Its normal load is the follower load unless it has its own `load_law`.

    Write torques as smooth odd functions of the rate: for `sign(u) * f(abs(u))` JAX has
    no slope at rest. Such a law is refused when it first meets numbers (`ValueError`).
    With a traced number, as of an axis of a sweep, it cannot be refused: then
    `tangent_column` and all results from it are NaN.
    """

    def load_law(self) -> AbstractNormalLoad | None:
        """The follower load."""
        return FollowerLoad()

    def torques(self, pulls: Numbers) -> AbstractRateTorques:
        """The levers under the load at rest, or the joints' reactions."""
        rests = self.load_law()
        ones = (1.0,) * len(pulls)
        normal, load = (ones, None) if rests is None else rests.split(pulls)
        return LawTorques(law=self, normal=normal, load=load)

    @abc.abstractmethod
    def levers(self, *rates: Scalar) -> Sequence[Scalar]:
        r"""Torque per unit of normal load, $\rho_i \mu_i(u_i)$, of all joints.

        A law of your own that is for two joints alone may name them, `u1, u2`.
        """


# Of the rate cut: where a law's slope at rest is looked at. The nearer place is as far
# as rounding lets differences see; by what they change on the way they tell a slope
# from one that differences do not reach, as that of |u|^1.5 or of a steeper layer.
PLACES = (1e-5, 1e-11)
ALIKE = 0.1  # how far that may be from the derivative
FLAT = 1e-5  # of the slope of the whole layer: as good as none


def slopes_at_rest(law: AbstractRateFriction, joints: int) -> Numbers:
    r"""How steep all levers are at rest, $\partial(\rho_i \mu_i)/\partial u_i$ at 0.

    JAX's derivative of `sign(u) * f(abs(u))` there is 0, whatever f does. So a law that
    is not of this package is compared with differences on both sides.

    **Raises:** `ValueError` where both do not agree, NaN where numbers are traced.
    """
    if isinstance(law, SmoothCoulomb):
        return _slopes(law, joints)
    if _is_traced(law):
        return _checked_slopes(law, joints)
    with jax.ensure_compile_time_eval():
        return _checked_slopes(law, joints)


def check_slopes(law: AbstractFriction | None, joints: int) -> None:
    """Refuse a law of your own whose slope at rest JAX does not see.

    Nothing of it is in the program: traced numbers are not looked at. (Where they are,
    `slopes_at_rest` is NaN, and rest is judged by slopes beside it.)

    **Raises:** `ValueError`.
    """
    if not isinstance(law, AbstractRateFriction) or isinstance(law, SmoothCoulomb):
        return
    if not _is_traced(law):
        slopes_at_rest(law, joints)


def _is_traced(law: AbstractRateFriction) -> bool:
    return any(isinstance(x, Tracer) for x in jax.tree.leaves(law))


def _slopes(law: AbstractRateFriction, joints: int) -> Numbers:
    return jax.jvp(lambda u: (*law.levers(*[u] * joints),), (0.0,), (1.0,))[1]


def _checked_slopes(law: AbstractRateFriction, joints: int) -> Numbers:
    slopes = _slopes(law, joints)
    cut = law.rate_cut()
    cuts = jnp.broadcast_to(jnp.asarray(1.0 if cut is None else cut, float), (joints,))

    def rises(share: float) -> Numbers:
        rates = share * cuts
        pairs = zip(law.levers(*rates), law.levers(*-rates), rates, strict=True)
        return tuple((a - b) / (2 * u) for a, b, u in pairs)

    checked_ones = []
    rows = zip(slopes, *map(rises, (*PLACES, 1.0)), strict=True)
    for joint, (slope, far, near, whole) in enumerate(rows, 1):
        off = slope - near
        within = ALIKE * jnp.abs(near) + FLAT * jnp.abs(whole)
        # or it lies where differences still go as they draw near
        goes_on = (jnp.abs(near - far) > within) & (off * (near - far) > 0)
        agrees = (jnp.abs(off) <= within) | goes_on
        if not isinstance(agrees, Tracer) and not agrees:
            raise ValueError(
                f"Argument `friction` must have the slope at rest that JAX sees, but "
                f"`{type(law).__name__}` rises by {float(near):.3g} a unit of rate in "
                f"joint {joint}, and its derivative there is {float(slope):.3g}: write "
                "it as a smooth odd function of the rate, without `sign` and `abs`."
            )
        checked_ones.append(jnp.where(agrees, slope, jnp.nan))
    return tuple(checked_ones)


class SmoothCoulomb(AbstractRateFriction):
    r"""Static and kinetic Coulomb friction, smoothed by a hyperbolic tangent.

    $$\mu(u) = \Bigl[\mu_k + (\mu_s - \mu_k)\, e^{-(u/v_{stribeck})^2}\Bigr]
    \tanh(u / v_{smooth})$$

    $v_{smooth}$ should lie well below $v_{stribeck}$, or the product's peak stays
    below $\mu_s$ (for $\mu_s = 1.2 \mu_k$: 1.140 $\mu_k$ at a ratio of 5, 1.177 at 10,
    1.198 at 50). At rest the law is viscous damping $\tau_s / v_{smooth}$: it never
    truly sticks, it creeps at a rate of $v_{smooth} / \tau$, and its linearisation is
    set by $v_{smooth}$. With $\mu_s = \mu_k$ it tends to set-valued friction as
    $v_{smooth} \to 0$; with $\mu_s > \mu_k$ at fixed $v_{stribeck}$ it tends to a
    Stribeck law.

    Without a static part (`mu_k` left out, or `v_stribeck` left out and
    `mu_k` equal to `mu_s`) the exponential is not in the program.

    **A multibody program's joint friction** (coefficients, pin radius R in m,
    transition velocity v of the pin's surface in m/s) is this law with $\rho = R/l$,

    $$v_{stribeck} = \frac{1.25}{\sqrt{\ln 2}}\,\frac{v}{R}\sqrt{\frac{m l^2}{k}},
    \qquad \frac{1.25}{\sqrt{\ln 2}} \approx 1.50,$$

    so that both have done half of their fall at the rate 1.25 v / R (rad/s), the middle
    of the program's passage from v to 1.5 v; and `JointReaction()`, whose N is the
    pin's force in k/l. $v_{smooth}$ has no counterpart there. `SI.joint_friction` makes
    the law in SI units, and `SI.transition_rate` the rate that separates its regimes.

    **Arguments:**

    - `mu_s`, `mu_k`: static and kinetic coefficient, one number or one a joint,
        $\mu_s \ge \mu_k \ge 0$.
    - `pin_radius`: $\rho = R_{pin}/l$, one number or one a joint.
    - `v_stribeck`, `v_smooth`: angular rates in $\sqrt{k/(m l^2)}$, positive;
        `v_stribeck` one number or one a joint.
    - `load`: the normal load, in k/l: `FollowerLoad()`, `ConstantLoad(n)`,
        `JointReaction()`.

    **Raises:** `ValueError` for concrete numbers that break a rule. Traced ones give
    the outcome `invalid`.
    """

    rules: ClassVar = {
        "mu_s": "nonnegative; each",
        "mu_k": "nonnegative; each or none",
        "pin_radius": "nonnegative; each",
        "v_stribeck": "positive; each or none",
        "v_smooth": "positive",
    }
    units: ClassVar = {
        "mu_s": "1",
        "mu_k": "1",
        "pin_radius": "l",
        "v_stribeck": RATE,
        "v_smooth": RATE,
    }

    mu_s: OneOrEach
    mu_k: OneOrEach | None
    pin_radius: OneOrEach
    v_stribeck: OneOrEach | None
    v_smooth: Scalar
    load: AbstractNormalLoad

    def __init__(
        self,
        mu_s: Joints,
        mu_k: Joints | None = None,
        *,
        pin_radius: Joints,
        v_smooth: Scalar,
        v_stribeck: Joints | None = None,
        load: AbstractNormalLoad | None = None,
    ):
        """Check and keep the law's numbers."""
        if v_stribeck is None and mu_k is not None:
            if mu_k is not mu_s and not _same(mu_s, mu_k):
                raise ValueError(
                    "Argument `v_stribeck` must be given where `mu_k` may differ from "
                    "`mu_s`; for one coefficient leave out `mu_k`."
                )
            mu_k = None
        if mu_k is None and v_stribeck is not None:
            raise ValueError(
                "Argument `mu_k` must be given where `v_stribeck` is: the Stribeck "
                "rate says how fast friction falls from `mu_s` to `mu_k`."
            )
        self.mu_s, self.mu_k, self.pin_radius, self.v_smooth, self.v_stribeck = checked(
            self.rules,
            mu_s=mu_s,
            mu_k=mu_k,
            pin_radius=pin_radius,
            v_smooth=v_smooth,
            v_stribeck=v_stribeck,
        )
        self.load = normal_load(load)
        self.refuse_broken()

    def levers(self, *rates: Scalar) -> Numbers:
        """Torque per unit of normal load, all joints."""
        return self._torques((1.0,) * len(rates)).at(rates)

    def torques(self, pulls: Numbers) -> SmoothTorques:
        """The curves of all joints."""
        return self._torques(*self.load.split(pulls))

    def _torques(self, normal: Numbers, load: Reaction | None = None) -> SmoothTorques:
        n = len(normal)
        lever = [x * r for x, r in zip(normal, each(self.pin_radius, n), strict=True)]
        rises, root = 2.0 * LOG2_E / self.v_smooth, math.sqrt(LOG2_E)
        curves = []
        for i, (x, mu_s) in enumerate(zip(lever, each(self.mu_s, n), strict=True)):
            drop = falls = None
            mu_k = mu_s if self.mu_k is None else each(self.mu_k, n)[i]
            if self.v_stribeck is not None:
                drop = x * (mu_s - mu_k)
                falls = root / each(self.v_stribeck, n)[i]
            curves.append(Curve(x * mu_k, drop, falls, rises))
        return SmoothTorques(curves=tuple(curves), cut=self.v_smooth, load=load)

    def invariants(self) -> Invariants:
        """That mu_k <= mu_s."""
        return falls_to_kinetic(self.mu_s, self.mu_k)

    def load_law(self) -> AbstractNormalLoad:
        """The normal load."""
        return self.load

    def rate_cut(self) -> Scalar:
        """Below v_smooth the law is still rising: a joint this slow creeps."""
        return self.v_smooth


class LawTorques(AbstractRateTorques):
    """A law of your own under the load at rest."""

    law: AbstractRateFriction
    normal: Numbers
    load: Reaction | None = None

    def at(self, u: Numbers) -> Numbers:
        """Its levers, times that load."""
        levers = self.law.levers(*u)
        return tuple(g * n for g, n in zip(levers, self.normal, strict=True))

    def rate_cut(self) -> Scalar | None:
        """The law's."""
        return self.law.rate_cut()


def falls_to_kinetic(mu_s: OneOrEach, mu_k: OneOrEach | None) -> Invariants:
    """That mu_k <= mu_s in all joints; None for mu_k is mu_s."""
    sentence = (
        "Argument `mu_k` must be at most `mu_s`, but is {1:g} with `mu_s` = {0:g}."
    )
    if mu_k is not None:
        n = _count(mu_s, mu_k)
        for pair in zip(each(mu_s, n), each(mu_k, n), strict=True):
            yield pair, lambda s, k: k <= s, sentence


def _count(*numbers: OneOrEach) -> int:
    """Of how many joints they are: 1, where each is one number.

    **Raises:** `ValueError` where they are of different numbers of joints.
    """
    counts = {len(x) for x in numbers if isinstance(x, tuple)}
    if len(counts) > 1:
        raise ValueError(
            "Arguments `mu_s` and `mu_k` must be of the same number of joints, but are "
            f"of {' and '.join(map(str, sorted(counts)))}."
        )
    return counts.pop() if counts else 1


def _same(mu_s: Joints, mu_k: Joints) -> bool:
    """Whether two coefficients are known to be equal."""
    try:
        one, other = (
            tuple(cast(Numbers, x)) if np.ndim(cast(float, x)) else cast(Scalar, x)
            for x in (mu_s, mu_k)
        )
        n = _count(one, other)
        return all(
            s is k or (is_concrete(k) and equals(s, float(k)))
            for s, k in zip(each(one, n), each(other, n), strict=True)
        )
    except (TypeError, ValueError):
        return False
