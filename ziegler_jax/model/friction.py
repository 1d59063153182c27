r"""Dry friction in the joints: a law for the coefficient, and the load it rests on.

The torque of joint i opposes its rate $u_i$ ($u_1 = \omega_1$,
$u_2 = \omega_2 - \omega_1$):

$$T_i = \rho_i N_i \mu_i(u_i)$$

with the pin radius $\rho = R_{pin}/l$ and the joint's normal load $N_i$ in units of
$k/l$, so that $\tau_i = \mu_i \rho_i N_i$ comes in units of the spring constant k. A
published friction coefficient means nothing until all three are stated.
"""

import abc
import math
from collections.abc import Mapping
from typing import ClassVar, cast

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.core import Tracer

from ..numerics.elementary import LOG2_E
from ..numerics.numbers import (
    Flag,
    Joints,
    OneOrTwo,
    Option,
    Pair,
    Scalar,
    both,
    checked,
    equals,
    is_concrete,
    keeps_rules,
)
from ..results import RATE, Units
from .loads import AbstractLoad, FollowerLoad, normal_load
from .torque_curve import Curve, torque


class AbstractFriction(eqx.Module):
    """A joint friction law.

    Keep its numbers as its own fields: of an attribute of something else, or a global,
    that a law reads, JAX remembers as it was when first traced: within one point of a
    sweep, and outside of `sweep` for good.
    `rules` names for each of them the rule that it keeps: `finite`, `nonnegative`,
    `positive`; a lane in which one breaks its rule ends as `invalid`.
    `units` names for each of them its unit, for `SI.scaled` alone: `1`, `rad`, another
    one that it lists, or the powers of m, l and k.

    `sticks`: whether joints truly stick, so that motions have events: the library's own
    `SetValuedCoulomb` alone.
    """

    rules: ClassVar[Mapping[str, str]] = {}
    units: ClassVar[Units] = {}
    sticks: ClassVar[bool] = False

    def valid(self) -> Flag:
        """Whether the numbers keep the law's rules; traced where they are."""
        return keeps_rules(self.rules, self)

    @abc.abstractmethod
    def load_law(self) -> AbstractLoad | None:
        """The normal load that the law rests on; None if it is in the torques."""

    @property
    def on_reactions(self) -> bool:
        """Whether the motion decides its load: what the joints transmit."""
        load = self.load_law()
        return load is not None and load.of_motion

    def settings(self) -> dict[str, Option]:
        """What of it belongs into the record of a result."""
        return {}

    def prepared(self, q: Scalar) -> "AbstractFriction":
        """The same law for a motion under q, as cheap to evaluate as it can be.

        What it returns may be prepared again, and must not change by it.
        """
        del q
        return self

    @abc.abstractmethod
    def rate_cut(self) -> Scalar | None:
        """The joint rate below which a joint counts as sticking; None if by mode."""


class AbstractRateFriction(AbstractFriction):
    r"""A friction law whose torques are functions of the joints' rates.

    A law of one's own, $\mu u / \sqrt{u^2 + v^2}$ on pins of radius 0.1:

    ```python
    class Root(zj.AbstractRateFriction):
        rules = {"mu": "nonnegative", "v": "positive"}
        units = {"mu": "1", "v": "sqrt(k/(m l^2))"}
        mu: float
        v: float

        def levers(self, u1, u2):
            one, two = (u / jnp.sqrt(u * u + self.v**2) for u in (u1, u2))
            return 0.1 * self.mu * one, 0.1 * self.mu * two

        def rate_cut(self):
            return self.v

    def point(q, mu):
        column = zj.uniform_rods(q, friction=Root(mu, 0.01))
        return zj.settle(column, zj.State(omega=(0.0, 0.3)))

    ds = zj.sweep(point, q=[2.2, 2.6], mu=[0.05, 0.1, 0.3])
    ```

    Its normal load is the follower load unless it has a `load_law` of its own.

    Write torques as smooth odd functions of the rate: `sign(u) * f(abs(u))` has no
    slope at rest to JAX. Such a law is refused where it first meets numbers
    (`ValueError`). With a number that is traced, as an axis of a sweep is, it is not:
    then `tangent_column` is NaN, and so is what is asked of it.
    """

    def load_law(self) -> AbstractLoad | None:
        """The follower load."""
        return FollowerLoad()

    @abc.abstractmethod
    def levers(self, u1: Scalar, u2: Scalar) -> Pair:
        r"""Torque per unit of normal load, $\rho_i \mu_i(u_i)$, of both joints."""


# Of the rate cut: where a law's slope at rest is looked at. The nearer place is as far
# as rounding lets differences see; by what they change on the way they tell a slope
# from one that differences do not reach, as that of |u|^1.5 or of a steeper layer.
PLACES = (1e-5, 1e-11)
ALIKE = 0.1  # how far that may be from the derivative
FLAT = 1e-5  # of the slope of the whole layer: as good as none


def slopes_at_rest(law: AbstractRateFriction) -> Pair:
    r"""How steep both levers are at rest, $\partial(\rho_i \mu_i)/\partial u_i$ at 0.

    JAX's derivative of `sign(u) * f(abs(u))` there is 0, whatever f does. So a law that
    is not of this package is compared with differences on both sides.

    **Raises:** `ValueError` where both do not agree, NaN where numbers are traced.
    """
    if isinstance(law, SmoothCoulomb):
        return jax.jvp(lambda u: law.levers(u, u), (0.0,), (1.0,))[1]
    if _is_traced(law):
        return _checked_slopes(law)
    with jax.ensure_compile_time_eval():
        return _checked_slopes(law)


def check_slopes(law: AbstractFriction | None) -> None:
    """Refuse a law of one's own whose slope at rest JAX does not see.

    Nothing of it is in the program: traced numbers are not looked at. (Where they are,
    `slopes_at_rest` is NaN, and rest is judged by slopes beside it.)

    **Raises:** `ValueError`.
    """
    if not isinstance(law, AbstractRateFriction) or isinstance(law, SmoothCoulomb):
        return
    if not _is_traced(law):
        slopes_at_rest(law)


def _is_traced(law: AbstractRateFriction) -> bool:
    return any(isinstance(x, Tracer) for x in jax.tree.leaves(law))


def _checked_slopes(law: AbstractRateFriction) -> Pair:
    _, slopes = jax.jvp(lambda u: law.levers(u, u), (0.0,), (1.0,))
    cut = law.rate_cut()
    cuts = jnp.broadcast_to(jnp.asarray(1.0 if cut is None else cut, float), (2,))

    def rises(share: float) -> Pair:
        u1, u2 = share * cuts
        (a1, a2), (b1, b2) = law.levers(u1, u2), law.levers(-u1, -u2)
        return (a1 - b1) / (2 * u1), (a2 - b2) / (2 * u2)

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
    return checked_ones[0], checked_ones[1]


class SmoothCoulomb(AbstractRateFriction):
    r"""Static and kinetic Coulomb friction, smoothed by a hyperbolic tangent.

    $$\mu(u) = \Bigl[\mu_k + (\mu_s - \mu_k)\, e^{-(u/v_{stribeck})^2}\Bigr]
    \tanh(u / v_{smooth})$$

    $v_{smooth}$ should lie well below $v_{stribeck}$, or the product's peak stays
    below $\mu_s$ (for $\mu_s = 1.2 \mu_k$: 1.140 $\mu_k$ at a ratio of 5, 1.177 at 10,
    1.198 at 50). At rest the law is viscous damping $\tau_s / v_{smooth}$: it never
    truly sticks, it creeps at a rate of $v_{smooth} / \tau$, and its linear map is a
    map of $v_{smooth}$. With $\mu_s = \mu_k$ it tends to set-valued friction as
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
    pin's force in k/l. $v_{smooth}$ has no counterpart there. `SI.joint_friction`
    makes the law, in SI units, and `SI.transition_rate` gives the rate by which to tell
    the regimes that a run enters.

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
        "mu_s": "nonnegative; two",
        "mu_k": "nonnegative; two or none",
        "pin_radius": "nonnegative; two",
        "v_stribeck": "positive; two or none",
        "v_smooth": "positive",
    }
    units: ClassVar = {
        "mu_s": "1",
        "mu_k": "1",
        "pin_radius": "l",
        "v_stribeck": RATE,
        "v_smooth": RATE,
    }

    mu_s: OneOrTwo
    mu_k: OneOrTwo | None
    pin_radius: OneOrTwo
    v_stribeck: OneOrTwo | None
    v_smooth: Scalar
    load: AbstractLoad

    def __init__(
        self,
        mu_s: Joints,
        mu_k: Joints | None = None,
        *,
        pin_radius: Joints,
        v_smooth: Scalar,
        v_stribeck: Joints | None = None,
        load: AbstractLoad | None = None,
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
        kinetic_at_most_static(self.mu_s, self.mu_k)

    def levers(self, u1: Scalar, u2: Scalar) -> Pair:
        """Torque per unit of normal load, both joints."""
        return self._worked_out((1.0, 1.0)).levers(u1, u2)

    def prepared(self, q: Scalar) -> AbstractFriction:
        """The same law with everything worked out that the motion does not change."""
        if self.load.of_motion:
            return self._worked_out((1.0, 1.0), self.load)
        return self._worked_out(self.load.at_rest(q))

    def _worked_out(
        self, normal: Pair, load: AbstractLoad | None = None
    ) -> "PreparedCoulomb":
        lever = [n * r for n, r in zip(normal, both(self.pin_radius), strict=True)]
        least = self.mu_s if self.mu_k is None else self.mu_k
        kinetic = tuple(x * mu for x, mu in zip(lever, both(least), strict=True))
        drop = falls = None
        if self.mu_k is not None:
            assert self.v_stribeck is not None
            pairs = zip(lever, both(self.mu_s), both(self.mu_k), strict=True)
            drop = tuple(x * (s - k) for x, s, k in pairs)
            root = math.sqrt(LOG2_E)
            falls = (
                tuple(root / v for v in self.v_stribeck)
                if isinstance(self.v_stribeck, tuple)
                else root / self.v_stribeck
            )
        return PreparedCoulomb(
            cast(Pair, kinetic),
            cast(Pair | None, drop),
            cast(OneOrTwo | None, falls),
            2.0 * LOG2_E / self.v_smooth,
            self.v_smooth,
            load,
        )

    def valid(self) -> Flag:
        """Each number's rule, the load's, and mu_k <= mu_s."""
        good = keeps_rules(self.rules, self) & self.load.valid()
        return good & falls_to_kinetic(self.mu_s, self.mu_k)

    def load_law(self) -> AbstractLoad:
        """The normal load."""
        return self.load

    def rate_cut(self) -> Scalar:
        """Below v_smooth the law is still rising: a joint this slow creeps."""
        return self.v_smooth


class PreparedCoulomb(AbstractRateFriction):
    """A smoothed law with its constants worked out: see `torque_curve`."""

    kinetic: Pair
    drop: Pair | None  # from static to kinetic
    falls: OneOrTwo | None  # f: one number, or one a joint
    rises: Scalar  # g
    v_smooth: Scalar
    load: AbstractLoad | None

    def levers(self, u1: Scalar, u2: Scalar) -> Pair:
        """The torques; per unit of load where the motion decides that."""

        def lever(u, i):
            drop = falls = None
            if self.drop is not None:
                drop, falls = self.drop[i], both(cast(OneOrTwo, self.falls))[i]
            return torque(u, Curve(self.kinetic[i], drop, falls, self.rises))

        return lever(u1, 0), lever(u2, 1)

    def load_law(self) -> AbstractLoad | None:
        """None: the load is in the levers; or the joints' reactions."""
        return self.load

    def rate_cut(self) -> Scalar:
        """As the law it was made from."""
        return self.v_smooth


def falls_to_kinetic(mu_s: OneOrTwo, mu_k: OneOrTwo | None) -> Flag:
    """Whether mu_k <= mu_s in both joints; None for mu_k is mu_s."""
    if mu_k is None:
        return True
    good: Flag = True
    for s, k in zip(both(mu_s), both(mu_k), strict=True):
        good &= jnp.asarray(k) <= s
    return good


def kinetic_at_most_static(mu_s: OneOrTwo, mu_k: OneOrTwo | None) -> None:
    """Refuse mu_k > mu_s where both are known; None for mu_k is mu_s."""
    for s, k in zip(both(mu_s), both(mu_s if mu_k is None else mu_k), strict=True):
        if is_concrete(s) and is_concrete(k) and k > s:
            raise ValueError(
                f"Argument `mu_k` must be at most `mu_s`, but is {k:g} with "
                f"`mu_s` = {s:g}."
            )


def _same(mu_s: Joints, mu_k: Joints) -> bool:
    """Whether two coefficients are known to be equal."""
    try:
        return all(
            s is k or (is_concrete(k) and equals(s, float(k)))
            for s, k in zip(
                both(cast(OneOrTwo, mu_s)), both(cast(OneOrTwo, mu_k)), strict=True
            )
        )
    except (TypeError, ValueError):
        return False
