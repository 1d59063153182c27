r"""Chains of rods as values: what a user writes, and a `System` runs."""

import abc
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp

from ..numerics.jaxprs import reads_first
from ..numerics.numbers import (
    Joints,
    Numbers,
    OneOrEach,
    Scalar,
    Several,
    each,
)
from ..numerics.rules import (
    AbstractRuled,
    Invariants,
    checked,
    fit,
    several,
)
from ..runtime import refuse_forked
from .chain import Rows, is_definite, spread
from .damping import AbstractDamping, Drag, Sum
from .damping import lengths as lengths_of
from .forces import (
    AbstractForce,
    AbstractLoadHistory,
    DeadLoad,
    FollowerForces,
    Forces,
    Gravity,
    OwnForces,
    checked_own,
    fixed_forces,
    in_a_row,
    read,
)
from .friction import AbstractFriction
from .system import System

MOST_RODS = 16  # a motion's equations are written out rod by rod
MOST_STICKING = 4  # and where joints truly stick all 3^n modes: of five 13 s of tracing


class AbstractChain(AbstractRuled):
    """Rods in a row on spring hinges: a `Column` of two, or a `Chain` of more.

    Every question takes one, and asks its `system()`.
    """

    patterns: ClassVar[int] = 0  # of follower forces, how many it takes
    q: eqx.AbstractVar[Scalar]
    damping: eqx.AbstractVar[AbstractDamping | None]
    friction: eqx.AbstractVar[AbstractFriction | None]
    dead_load: eqx.AbstractVar[DeadLoad | None]
    gravity: eqx.AbstractVar[Gravity | None]
    rest_angles: eqx.AbstractVar[OneOrEach | None]
    foundation: eqx.AbstractVar[OneOrEach | None]
    forces: eqx.AbstractVar[Forces | None]

    @property
    @abc.abstractmethod
    def joints(self) -> int:
        """How many joints it has, and rods."""

    @abc.abstractmethod
    def system(self) -> System:
        """The system that runs: all numbers computed that a motion does not change."""

    @property
    @abc.abstractmethod
    def pulls(self) -> Numbers:
        """Of each joint the follower forces beyond it, at rest."""

    @property
    def sticks(self) -> bool:
        """Whether friction is set-valued: joints truly stick, motions have events."""
        return self.friction is not None and self.friction.sticks

    @property
    def follower_only(self) -> bool:
        """Whether follower forces alone act on it, and its springs rest at zero."""
        parts = self.dead_load, self.gravity, self.rest_angles, self.foundation
        alone = not self.own.forces and self.autonomous
        return alone and all(part is None for part in parts)

    @property
    def own(self) -> OwnForces:
        """Forces of your own, and what is added to q in time."""
        forces = in_a_row(self.forces)
        return OwnForces(
            tuple(f for f in forces if isinstance(f, AbstractForce)),
            tuple(f for f in forces if isinstance(f, AbstractLoadHistory)),
        )

    @property
    def autonomous(self) -> bool:
        """Whether it is the same at all times."""
        return self.own.autonomous

    def check_parts(self) -> None:
        """Refuse parts that are none, or are for another number of joints."""
        for name, kind in (
            ("damping", AbstractDamping),
            ("friction", AbstractFriction),
            ("dead_load", DeadLoad),
            ("gravity", Gravity),
        ):
            part = getattr(self, name)
            if part is not None and not isinstance(part, kind):
                what = "a law" if kind.__name__.startswith("Abs") else kind.__name__
                raise ValueError(
                    f"Argument `{name}` must be None or {what}, but is {part!r}."
                )
        self._check_forces()
        if self.friction is not None and self.friction.on_reactions:
            self.needs_bodies("the load `JointReaction()`")
            self.refuse_fixed_forces("the load `JointReaction()`")
        if self.sticks and self.joints > MOST_STICKING:
            raise ValueError(
                "Argument `friction` must not be set-valued in a chain of more than "
                f"{MOST_STICKING} rods, whose 3^n modes are written out, but there are "
                f"{self.joints}: write a smoothed law."
            )
        fit(self, self.joints)
        if self.damping is not None:
            self.damping.check(self.joints)

    def _check_forces(self) -> None:
        """Refuse a pattern too many, and friction that had to follow a history."""
        count = sum(isinstance(f, FollowerForces) for f in in_a_row(self.forces))
        if count > self.patterns:
            raise ValueError(
                f"Argument `forces` of a `{type(self).__name__}` must have at most "
                f"{self.patterns} patterns `FollowerForces`, but has {count}."
            )
        law = self.friction
        if not self.own.histories or law is None or law.on_reactions:
            return
        # worked out once, at one q
        if reads_first(lambda q: law.torques((q,) * self.joints), jnp.zeros(())):
            raise ValueError(
                "Argument `friction` must rest on a load that does not follow q, such "
                "as `ConstantLoad(n)`, where `forces` make q depend on time, but "
                f"{law!r} does."
            )

    def refuse_fixed_forces(self, what: str) -> None:
        """Refuse what rests on the joints' reactions where more than q loads them.

        **Raises:** `ValueError`.
        """
        for name in ("dead_load", "gravity", "foundation", "forces"):
            if getattr(self, name) is not None:
                raise ValueError(
                    f"Argument `{name}` must be None for {what}, as its part in the "
                    f"joints' reactions is not worked out, but is "
                    f"{getattr(self, name)!r}."
                )

    def needs_bodies(self, what: str) -> None:
        """Refuse what rests on the joints' reactions where these are not known."""
        raise ValueError(
            f"Argument `friction` must not rest on {what} in a `Chain`, whose joints' "
            "reactions are not worked out: write `FollowerLoad()` or `ConstantLoad(n)`."
        )


def check_column(column: object) -> None:
    """Refuse what is neither a `Column` nor a `Chain`.

    **Raises:** `ValueError`.
    """
    if not isinstance(column, AbstractChain):
        raise ValueError(
            f"Argument `column` must be a `Column` or a `Chain`, but is {column!r}."
        )


class Chain(AbstractChain):
    r"""n rods in a plane on spring hinges, from a fixed base, under follower forces.

    With the rods' absolute angles $\phi_i$ from the vertical, $D_{ij} = \phi_i -
    \phi_j$, joint angles $\theta_i = \phi_i - \phi_{i-1}$ and rates $u_i$,

    $$\sum_j J_{ij} (\cos D_{ij}\, \dot\omega_j + \sin D_{ij}\, \omega_j^2) = Q_i(q)
    - M_i + M_{i+1} - A_{ij} \cos D_{ij}\, \omega_j + V_i \sin\phi_i - H_i \cos\phi_i
    - \cos\phi_i \sum_j W_{ij} \sin\phi_j$$

    with the joints' torques $M_i = k_i (\theta_i - \theta_i^0) + c_i u_i + T_i$ of
    springs, damping and friction, the forces Q of the pattern that q multiplies
    (`FollowerForces`), and the moments

    $$J_{ij} = \sum_k m_k r_{ki} r_{kj} + I_i \delta_{ij} + m_t l_i l_j + I_t
    \delta_{in} \delta_{jn}, \qquad r_{ki} = l_i \ (i < k),\ s_k \ (i = k),\ 0$$

    and so, of loads in place of masses, V and H (`DeadLoad`, `Gravity`), and of what is
    spread along the rods A (air) and W (foundation). A part that is not named is not in
    the program. Units are any that agree, SI among them: with a mass m, a length l and
    a spring k as units, loads are in k/l and times in $\sqrt{m l^2/k}$.

    **Arguments:**

    - `q`: what multiplies the follower forces, with the default pattern the force on
        the tip.
    - `lengths`: $l_i$, one a rod, from the base on: 2 to 16 of them.
    - `masses`, `springs`: $m_i$, $k_i$, one number or one a rod or joint; positive.
        None is 1, the unit; a chain in SI units names both (`SI.scaled`).
    - `centres`: $s_i$, each rod's centre of mass from its joint; None: its middle.
    - `inertias`: $I_i$ about that, nonnegative; None: $m_i l_i^2/12$, uniform rods.
    - `tip_mass`, `tip_inertia`: $m_t$, $I_t$ at the tip.
    - `rest_angles`: $\theta_i^0$ at which the springs are at rest, an imperfection.
    - `damping`: None, `Viscous(c1, ..., cn)` or a law of your own.
    - `air`: drag on the rods' points, $-e_i v$ a unit of length; one number or one a
        rod, nonnegative.
    - `friction`: None or a friction law; not on `JointReaction()`, and set-valued up to
        four rods.
    - `forces`: the pattern that q multiplies, `FollowerForces`; without one $q$ acts
        along the last rod, on its end. Forces of your own (`AbstractForce`) and loads
        that depend on time (`LoadHistory`, `AbstractLoadHistory`) stand here, too, one
        or several in a tuple.
    - `dead_load`, `gravity`: `DeadLoad(p, direction)`, `Gravity(g, direction)`.
    - `foundation`: $w_i$ of springs across the vertical, so much a unit of length
        (Winkler's); one number or one a rod, nonnegative.

    All are leaves: any of them can be traced, mapped over and differentiated.

    **Raises:** `ValueError` where a concrete number breaks its rule.
    """

    rules: ClassVar = {
        "q": "finite",
        "lengths": "positive; each",
        "masses": "positive; each or none",
        "springs": "positive; each or none",
        "centres": "finite; each or none",
        "inertias": "nonnegative; each or none",
        "tip_mass": "nonnegative; none",
        "tip_inertia": "nonnegative; none",
        "rest_angles": "finite; each or none",
        "air": "nonnegative; each or none",
        "foundation": "nonnegative; each or none",
    }
    units: ClassVar = {
        "q": "k/l",
        "lengths": "l",
        "masses": "m",
        "springs": "k",
        "centres": "l",
        "inertias": "m l^2",
        "tip_mass": "m",
        "tip_inertia": "m l^2",
        "rest_angles": "rad",
        "air": "sqrt(k m)/l^2",
        "foundation": "k/l^3",
    }

    patterns: ClassVar[int] = 1
    q: Scalar
    lengths: Numbers
    masses: OneOrEach | None
    springs: OneOrEach | None
    centres: OneOrEach | None
    inertias: OneOrEach | None
    tip_mass: Scalar | None
    tip_inertia: Scalar | None
    rest_angles: OneOrEach | None
    damping: AbstractDamping | None
    air: OneOrEach | None
    friction: AbstractFriction | None
    forces: Forces | None
    dead_load: DeadLoad | None
    gravity: Gravity | None
    foundation: OneOrEach | None

    def __init__(
        self,
        q: Scalar = 0.0,
        *,
        lengths: Several,
        masses: Joints | None = None,
        springs: Joints | None = None,
        centres: Joints | None = None,
        inertias: Joints | None = None,
        tip_mass: Scalar | None = None,
        tip_inertia: Scalar | None = None,
        rest_angles: Joints | None = None,
        damping: AbstractDamping | None = None,
        air: Joints | None = None,
        friction: AbstractFriction | None = None,
        forces: Forces | None = None,
        dead_load: DeadLoad | None = None,
        gravity: Gravity | None = None,
        foundation: Joints | None = None,
    ):
        """Check and keep the chain's numbers."""
        self.q, self.masses, self.springs, self.tip_mass, self.tip_inertia = checked(
            self.rules,
            q=q,
            masses=masses,
            springs=springs,
            tip_mass=tip_mass,
            tip_inertia=tip_inertia,
        )
        self.lengths = several("lengths", lengths, "positive")
        self.centres, self.inertias, self.air, self.rest_angles, self.foundation = (
            checked(
                self.rules,
                centres=centres,
                inertias=inertias,
                air=air,
                rest_angles=rest_angles,
                foundation=foundation,
            )
        )
        if len(self.lengths) > MOST_RODS:
            raise ValueError(
                f"Argument `lengths` must be of at most {MOST_RODS} rods, as equations "
                f"are written out rod by rod, but is of {len(self.lengths)}."
            )
        self.damping, self.friction, self.forces = damping, friction, read(forces)
        self.dead_load, self.gravity = dead_load, gravity
        self.check_parts()
        if lengths_of(damping):
            raise ValueError(
                "Argument `damping` must not hold `Air` in a `Chain`, which knows its "
                f"own lengths: write `air=(e1, ...)`, but is {damping!r}."
            )
        self.refuse_broken()

    @property
    def joints(self) -> int:
        """As many as rods."""
        return len(self.lengths)

    @property
    def pattern(self) -> FollowerForces:
        """The forces that q multiplies."""
        for force in in_a_row(self.forces):
            if isinstance(force, FollowerForces):
                return force
        return FollowerForces((0.0,) * (self.joints - 1) + (1.0,))

    @property
    def pulls(self) -> Numbers:
        """Of each joint the follower forces beyond it, at rest."""
        return self.pattern.pulls(self.q)

    def invariants(self) -> Invariants:
        """A positive definite inertia."""
        rows, _ = self._moments()
        yield (
            tuple(x for row in rows for x in row),
            lambda *moments: is_definite(moments, self.joints),
            "Arguments `masses`, `centres`, `inertias`, `tip_mass` and `tip_inertia` "
            "must make a positive definite inertia, in which each rod has a moment "
            "about its joint, but do not.",
        )

    def _rods(self) -> list[tuple[Scalar, Scalar, Scalar]]:
        """Mass, centre and moment of inertia about it of each rod."""
        n = self.joints
        masses = each(1.0 if self.masses is None else self.masses, n)
        centres = each(self.centres, n) if self.centres is not None else None
        rods = []
        for i, (m, l) in enumerate(zip(masses, self.lengths, strict=True)):  # noqa: E741
            centre = l / 2 if centres is None else centres[i]
            if self.inertias is None:
                own = m * l * l / 12
            else:
                own = each(self.inertias, n)[i]
            rods.append((m, centre, own))
        return rods

    def _moments(self) -> tuple[Rows, Numbers]:
        """J, and the first moments of the rods with what hangs on their ends."""
        n, lengths, rods = self.joints, self.lengths, self._rods()
        beyond: list[Scalar] = (
            [0.0] * n if self.tip_mass is None else [self.tip_mass] * n
        )
        for i in reversed(range(n - 1)):
            beyond[i] = beyond[i + 1] + rods[i + 1][0]
        firsts = [
            m * s + hung * l
            for (m, s, _), hung, l in zip(rods, beyond, lengths, strict=True)  # noqa: E741
        ]
        rows = []
        every = zip(rods, beyond, lengths, strict=True)
        for i, ((m, s, own), hung, span) in enumerate(every):
            diagonal = own + m * s * s + hung * span * span
            if i == n - 1 and self.tip_inertia is not None:
                diagonal = diagonal + self.tip_inertia
            rows.append((*(lengths[j] * firsts[i] for j in range(i)), diagonal))
        return tuple(rows), tuple(firsts)

    def system(self) -> System:
        """The system that runs: all numbers computed that a motion does not change."""
        refuse_forked()
        n, lengths = self.joints, self.lengths
        moments, firsts = self._moments()
        upright, across = fixed_forces(self.dead_load, self.gravity, lengths, firsts)
        damping, bent, foundation = self.damping, self.rest_angles, self.foundation
        if self.air is not None:
            drag = Drag(spread(lengths, each(self.air, n)))
            damping = drag if damping is None else Sum(damping, drag)
        friction = None
        if self.friction is not None:
            friction = self.friction.torques(self.pulls)
        return System(
            q=self.q,
            followers=self.pattern.followers(lengths),
            moments=moments,
            springs=(None,) * n if self.springs is None else each(self.springs, n),
            lengths=lengths,
            damping=damping,
            friction=friction,
            bent=None if bent is None else each(bent, n),
            upright=upright,
            across=across,
            foundation=foundation
            if foundation is None
            else spread(lengths, each(foundation, n)),
            own=checked_own(self.own, n),
        )
