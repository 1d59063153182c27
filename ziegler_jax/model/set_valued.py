r"""Set-valued Coulomb friction: joints that truly stick, and what sets them free.

With the joint rates $u_1 = \omega_1$, $u_2 = \omega_2 - \omega_1$ each joint is in one
of three modes. It slips forwards or backwards (+1, -1) with the kinetic torque
$T_i = \pm\tau_{k,i}$ against its sliding, or it sticks (0): then $u_i = 0$ and $T_i$ is
the constraint torque $\lambda_i$ that keeps it so. With the mass matrix
[[a, h], [h, d]], $h = b \cos D$, and the right-hand sides $r_1, r_2$ of the equations
of motion without friction,

$$\lambda_1 = r_1 + T_2 - \frac{h}{d}(r_2 - T_2), \qquad
\lambda_2 = r_2 - \frac{h + d}{a + 2h + d}(r_1 + r_2 - T_1)$$

where the other slips, $\lambda_1 = r_1 + r_2$, $\lambda_2 = r_2$ where both stick. A
joint can stick as long as $|\lambda_i| \le \tau_{s,i}$.
"""

from typing import ClassVar, Literal, Protocol, TypeVar, cast, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from ..numerics.numbers import (
    Flag,
    Flags,
    Joints,
    OneOrTwo,
    Option,
    Pair,
    Scalar,
    both,
    checked,
    choice,
    is_concrete,
    keeps_rules,
)
from .friction import (
    AbstractFriction,
    SmoothCoulomb,
    falls_to_kinetic,
    kinetic_at_most_static,
)
from .joint_reactions import solve_loads
from .loads import AbstractLoad, JointReaction, normal_load
from .release_layer import ReleaseLayer
from .stick_slip_modes import ConstraintTorques, Dynamics, choose_modes, stick_first

Release = Literal["stick-first", "stribeck-limit"]
RELEASES = get_args(Release)
# both rest; one does beside the other that slips forwards, backwards
BESIDE = ((0.0, 0.0, 1.0, 0.0, -1.0), (0.0, 1.0, 0.0, -1.0, 0.0))


class SetValuedCoulomb(AbstractFriction):
    r"""Static and kinetic Coulomb friction with exact stick and slip.

    $$T_i = \tau_{k,i}\,\mathrm{sign}(u_i) \text{ where } u_i \ne 0, \qquad
    |T_i| \le \tau_{s,i} \text{ where } u_i = 0, \qquad \tau_i = \mu_i \rho_i N_i$$

    With $\mu_s = \mu_k$ the law fixes every motion. With $\mu_s > \mu_k$, where one
    joint comes to rest or breaks loose while the other rests, more than one pair of
    modes can agree with it, and `release` names the rule that chooses:

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
    - `load`: the normal load, `FollowerLoad()`, `ConstantLoad(n)`, `JointReaction()`.
    - `release`: the rule above; `"stick-first"` alone with `JointReaction()`, as a
        passage through the layer would change the loads all along it.

    **With `JointReaction()`** each pair of modes has loads, torques and thresholds of
    its own. In given modes the accelerations, and so the reactions, are affine in
    the loads of the joints that slip, $N_i = |R_i^0 + P_{i1} N_1 + P_{i2} N_2|$,
    solved by Newton's method as in `JointReaction`, which says what is left; while
    both joints stick nothing is to be solved. New modes are chosen by the same rule,
    a joint's torque against the threshold of the modes in which that torque holds it.
    The loads have one solution where the right-hand side is a contraction, that is
    where the matrix of the lengths $|P_{ij}|$ has its eigenvalues below 1. Where it is
    none (Painleve's paradox of rigid bodies with friction) the accelerations are NaN
    and the lane ends as `not_finite` or `step_vanished`.

    **Raises:** `ValueError` for concrete numbers that break a rule; traced: `invalid`.
    """

    rules: ClassVar = {
        "mu_s": "nonnegative; two",
        "mu_k": "nonnegative; two or none",
        "pin_radius": "nonnegative; two",
    }
    units: ClassVar = {"mu_s": "1", "mu_k": "1", "pin_radius": "l"}
    sticks: ClassVar[bool] = True

    mu_s: OneOrTwo
    mu_k: OneOrTwo | None
    pin_radius: OneOrTwo
    load: AbstractLoad
    release: Release = eqx.field(static=True)

    def __init__(
        self,
        mu_s: Joints,
        mu_k: Joints | None = None,
        *,
        pin_radius: Joints,
        load: AbstractLoad | None = None,
        release: Release = "stick-first",
    ):
        """Check and keep the law's numbers."""
        self.mu_s, self.mu_k, self.pin_radius = checked(
            self.rules, mu_s=mu_s, mu_k=mu_k, pin_radius=pin_radius
        )
        self.load = normal_load(load)
        choice("release", release, RELEASES)
        if self.load.of_motion and release != "stick-first":
            raise ValueError(
                'Argument `release` must be "stick-first" with the load '
                f"`JointReaction()`, but is {release!r}."
            )
        self.release = release
        kinetic_at_most_static(self.mu_s, self.mu_k)

    def prepared(self, q: Scalar) -> "FrozenCoulomb":
        """The same law as torques."""
        load = cast(JointReaction, self.load) if self.load.of_motion else None
        normal = self.load.at_rest(q) if load is None else (1.0, 1.0)
        lever = [n * r for n, r in zip(normal, both(self.pin_radius), strict=True)]
        kinetic = static = tuple(
            x * mu for x, mu in zip(lever, both(self.mu_s), strict=True)
        )
        if self.mu_k is not None:
            pairs = zip(lever, both(self.mu_k), strict=True)
            kinetic = tuple(x * mu for x, mu in pairs)
        return FrozenCoulomb(
            cast(Pair, static), cast(Pair, kinetic), self.release, None, load
        )

    def valid(self) -> Flag:
        """Each number's rule, the load's, and mu_k <= mu_s."""
        good = keeps_rules(self.rules, self) & self.load.valid()
        return good & falls_to_kinetic(self.mu_s, self.mu_k)

    def smoothed(
        self, v_smooth: Scalar, v_stribeck: Joints | None = None
    ) -> SmoothCoulomb:
        """The smoothed law with the same coefficients, pin radius and load."""
        mu_k = self.mu_k
        known = all(map(is_concrete, jax.tree.leaves((mu_k, self.mu_s))))
        if mu_k is not None and v_stribeck is None and known:
            mu_k = None if mu_k == self.mu_s else mu_k
        return SmoothCoulomb(
            self.mu_s,
            mu_k,
            pin_radius=self.pin_radius,
            v_smooth=v_smooth,
            v_stribeck=v_stribeck,
            load=self.load,
        )

    def settings(self) -> dict[str, Option]:
        """The rule that chooses modes."""
        return {"release": self.release}

    def load_law(self) -> AbstractLoad:
        """The normal load."""
        return self.load

    def rate_cut(self) -> Scalar | None:
        """None: a joint sticks or it does not."""
        return None


class Rubbed(Protocol):
    """What has friction: a `Column`."""

    @property
    def friction(self) -> AbstractFriction | None: ...  # noqa: D102


Prepared = TypeVar("Prepared", bound=Rubbed)


def in_modes(column: Prepared, modes: Pair | None) -> Prepared:
    """A prepared column with its joints' modes frozen, or free (None)."""
    law = cast(FrozenCoulomb, column.friction)
    return eqx.tree_at(lambda c: c.friction, column, law.in_modes(modes))


class FrozenCoulomb(AbstractFriction):
    r"""Set-valued friction as torques, in given modes or those of the state itself.

    **Arguments:** `static`, `kinetic`: $\tau_{s,i}$, $\tau_{k,i}$; `release`: the rule;
    `modes`: -1., 0. or 1. for each joint, or None; `load`: the joints' reactions, then
    the torques are per unit of them; None: there is none left.
    """

    sticks: ClassVar[bool] = True

    static: Pair
    kinetic: Pair
    release: Release = eqx.field(static=True)
    modes: Pair | None
    load: JointReaction | None = None

    def in_modes(self, modes: Pair | None) -> "FrozenCoulomb":
        """The same law with the modes frozen."""
        return FrozenCoulomb(self.static, self.kinetic, self.release, modes, self.load)

    def in_modes_at(self, balance: Dynamics, u: Pair) -> "FrozenCoulomb":
        """The law in frozen modes: its own, or those that begin at these rates."""
        if self.modes is not None:
            return self
        return self.in_modes(self.begin(balance, u, (u[0] == 0, u[1] == 0)))

    def loaded(self, balance: Dynamics) -> "FrozenCoulomb":
        """The law in its modes under the loads of this state."""
        if self.load is None:
            return self
        assert self.modes is not None and balance.reactions is not None
        zero = 0.0 * balance.r1
        t1, t2 = (m * k for m, k in zip(self.modes, self.kinetic, strict=True))
        rubbed = balance._replace(r1=zero, r2=zero)
        free = self._accelerations_under(balance, zero, zero)
        by1, by2 = (
            self._accelerations_under(rubbed, t1, zero),
            self._accelerations_under(rubbed, zero, t2),
        )
        at, slope = balance.reactions.at, balance.reactions.slope
        loads = solve_loads(
            at(*free), slope(*by1), slope(*by2), self.load.newton_steps, unique=True
        )
        static, kinetic = (
            tuple(x * n for x, n in zip(pair, loads, strict=True))
            for pair in (self.static, self.kinetic)
        )
        return FrozenCoulomb(
            cast(Pair, static), cast(Pair, kinetic), self.release, self.modes
        )

    def torques(self, balance: Dynamics) -> Pair:
        """T1, T2 in the frozen modes: what the accelerations leave of the forces."""
        return self.loaded(balance)._torques(balance)

    def guard(self, balance: Dynamics, least: Scalar = 1e-30) -> Pair:
        r"""How far the torques are below the most: $(\tau_s^2 - T^2) / 2\tau_s$.

        Where the most is below `least`, to which torques are told apart, over that.
        """
        law = self.loaded(balance)
        pairs = zip(law.static, law._torques(balance), strict=True)
        guards = ((s * s - t * t) / (2 * jnp.maximum(s, least)) for s, t in pairs)
        return cast(Pair, tuple(guards))

    def accelerations(self, balance: Dynamics) -> Pair:
        """The rods' accelerations in the frozen modes."""
        assert self.modes is not None
        kinetic = self.loaded(balance).kinetic
        m1, m2 = self.modes
        return self._accelerations_under(balance, m1 * kinetic[0], m2 * kinetic[1])

    def _torques(self, balance: Dynamics) -> Pair:
        assert self.modes is not None
        (m1, m2), (k1, k2) = self.modes, self.kinetic
        left1, left2 = self.constraint_torques(balance, *self.accelerations(balance))
        return (
            jnp.where(m1 == 0, left1, m1 * k1),
            jnp.where(m2 == 0, left2, m2 * k2),
        )

    def constraint_torques(self, balance: Dynamics, a1: Scalar, a2: Scalar) -> Pair:
        """The torques that hold the joints that stick, under these accelerations."""
        a, h, d, r1, r2 = balance[:5]
        left2 = r2 - h * a1 - d * a2
        return r1 - a * a1 - h * a2 + left2, left2

    def inverse_inertia(self, balance: Dynamics) -> Scalar:
        """One over the determinant of the inertia of what slips."""
        assert self.modes is not None
        a, h, d = balance[:3]
        m1, m2 = self.modes
        inertia = jnp.where(m1 == 0, d, a * d - h * h)
        return 1 / jnp.where(m2 == 0, a + 2 * h + d, inertia)

    def accelerations_under(
        self, balance: Dynamics, t1: Scalar, t2: Scalar, inverse_inertia: Scalar
    ) -> Pair:
        """The accelerations under these torques of what slips."""
        assert self.modes is not None
        a, h, d, r1, r2 = balance[:5]
        m1, m2 = self.modes
        stuck1, stuck2 = m1 == 0, m2 == 0
        one, two, whole = r1 - t1 + t2, r2 - t2, r1 + r2 - t1
        first = jnp.where(stuck2, whole, d * one - h * two)
        second = jnp.where(stuck1, two, a * two - h * one)
        second = jnp.where(stuck2, whole, second)
        still = stuck1 & stuck2
        return (
            jnp.where(stuck1, 0.0, first * inverse_inertia),
            jnp.where(still, 0.0, second * inverse_inertia),
        )

    def _accelerations_under(self, balance: Dynamics, t1: Scalar, t2: Scalar) -> Pair:
        return self.accelerations_under(balance, t1, t2, self.inverse_inertia(balance))

    def hold(self, x1: Scalar, x2: Scalar) -> Pair:
        """Rates of the rods, with those of stuck joints exactly zero."""
        assert self.modes is not None
        m1, m2 = self.modes
        x1 = jnp.where(m1 == 0, 0.0, x1)
        return x1, jnp.where(m2 == 0, x1, x2)

    def begin(self, balance: Dynamics, u: Pair, rest: Flags) -> Pair:
        """The modes with which a motion starts: `rest` says which joints are at rest.

        The layers of joints that both start at rest start at rest too.
        """
        zero = 0.0 * u[0]
        given = jnp.sign(u[0]), jnp.sign(u[1])
        return self.chosen(balance, given, rest, (zero, zero), (zero, zero), True)

    def chosen(
        self,
        balance: Dynamics,
        given: Pair,
        rest: Flags,
        slack: Pair,
        layer: Pair,
        needed: Flag,
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
        if self.load is not None:
            return choose_modes(self._holding(balance, slack), given, rest, jnp.nan)
        thresholds = tuple(s - x for s, x in zip(self.static, slack, strict=True))
        modes = stick_first(balance, self.kinetic, cast(Pair, thresholds), given, rest)
        if self.release == "stick-first" or self.static is self.kinetic:
            return modes
        # with equal coefficients the law alone decides, and the layer has no slope
        falls = (self.static[0] > self.kinetic[0]) | (self.static[1] > self.kinetic[1])
        ask = rest[0] & rest[1] & falls & needed
        passage = ReleaseLayer(balance, self.static, self.kinetic)
        first, second, complete = passage.modes(layer, ask)
        # a passage that does not end, on the border between two ends, decides nothing
        ask &= complete
        return jnp.where(ask, first, modes[0]), jnp.where(ask, second, modes[1])

    def _holding(
        self, balance: Dynamics, slack: Pair
    ) -> tuple[ConstraintTorques, ConstraintTorques, ConstraintTorques]:
        """What holds a joint beside one that rests, slips forwards and backwards.

        Each has loads of its own.
        """
        pairs = jnp.asarray(BESIDE, jnp.result_type(balance.r1))

        @jax.vmap  # written once into the program
        def beside(m1, m2):
            law = self.in_modes((m1, m2)).loaded(balance)
            return law._torques(balance), law.static, law.kinetic

        torque, static, kinetic = beside(*pairs)
        static = tuple(s - x for s, x in zip(static, slack, strict=True))
        rows = cast("tuple[tuple[Array, Array], ...]", (torque, static, kinetic))
        still, up, down = (
            ConstraintTorques(*((x[0][one], x[1][two]) for x in rows))
            for one, two in ((0, 0), (1, 2), (3, 4))
        )
        return still, up, down

    def load_law(self) -> AbstractLoad | None:
        """None: the load is in the torques; or the joints' reactions."""
        return self.load

    def rate_cut(self) -> Scalar | None:
        """None: a joint sticks or it does not."""
        return None
