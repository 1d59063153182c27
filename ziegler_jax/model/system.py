r"""The system that runs: a column's numbers, computed once, without rules and names.

A `System` is a `chain` of rods under follower forces, with its damping and friction,
and what else it stands under: forces of fixed direction, a foundation. A question makes
it of the column or chain in its first line, `column.system()`, and asks it everything.
"""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx

from ..numerics.elementary import sincos
from ..numerics.materialise import as_one_call, materialise
from ..numerics.numbers import Numbers, Pair, Scalar
from ..numerics.series import sum_of
from .chain import Follower, Rows, Turned, joint_angles, moved, on_rods, solved, turned
from .coulomb_torques import CoulombInModes, CoulombTorques, MassAndForces
from .damping import AbstractDamping, is_polynomial
from .forces import OwnForces
from .loads import Bodies, Reaction, Reactions, reactions_of, solve_loads
from .state import PhasePoint
from .torques import AbstractRateTorques, AbstractTorques


class Power(NamedTuple):
    r"""Rates of work in $k\sqrt{k/(m l^2)}$, each a scalar or None.

    `follower`: the work of the load, $Q \cdot \omega$ with its generalised forces, of
    a column $Q = (q\sin(\phi_1 - \eta\phi_2),\ q\,l_2\sin((1-\eta)\phi_2))$; `damping`:
    the loss by damping, $\omega \cdot C\omega$; `friction`: the loss by friction,
    $\sum_i T_i u_i$; `forces`: the work of your own forces beside their potential.
    Then $dE/dt$ = `follower` - `damping` - `friction` + `forces`, with E by `energy`.
    """

    follower: Scalar
    damping: Scalar | None
    friction: Scalar | None
    forces: Scalar | None = None


class EnergyRate(NamedTuple):
    """The energy, its time derivative, and the dissipation.

    The dissipation is by friction, by damping, and by the part of your own forces that
    depends on the rates.
    """

    energy: Scalar
    rate: Scalar
    loss: Scalar


class System(eqx.Module):
    r"""A column as it runs: numbers alone, `column.system()`.

    Its methods take a state y, a `PhasePoint` as observers get it and as `State.y` is:
    `field`, `energy`, `power`, `friction_torques`.

    - `q`, `followers`: the load and the forces that it multiplies.
    - `moments`: $J_{ij}$, row by row of the lower triangle.
    - `springs`: $k_i$ of the joints; None: 1.
    - `lengths`: $l_i$ of the rods, the forces' levers; None: 1.
    - `damping`, `friction`: None without.
    - `bodies`: the inertia for the joints' reactions, where it is known.
    - `bent`: the joints' angles at which the springs are at rest; None: 0.
    - `upright`, `across`: moments $V_i$, $H_i$ of the forces of fixed direction, along
        the vertical and across it: torques $V_i \sin\phi_i - H_i \cos\phi_i$.
    - `foundation`: moments $W_{ij}$ of springs across the vertical: torques
        $-\cos\phi_i \sum_j W_{ij} \sin\phi_j$.
    - `own`: your own forces, and histories of q; see `at`.
    """

    q: Scalar
    followers: tuple[Follower, ...]
    moments: Rows
    springs: tuple[Scalar | None, ...]
    lengths: tuple[Scalar | None, ...]
    damping: AbstractDamping | None
    friction: AbstractTorques | None
    bodies: Bodies | None = None
    bent: Numbers | None = None
    upright: Numbers | None = None
    across: Numbers | None = None
    foundation: Rows | None = None
    own: OwnForces = OwnForces()

    # ---- what it is

    @property
    def joints(self) -> int:
        """How many there are, and rods."""
        return len(self.moments)

    @property
    def displaced(self) -> bool:
        """Whether it may have no equilibrium at angles of zero."""
        parts = self.bent, self.across, self.own.forces or None
        return any(part is not None for part in parts)

    @property
    def autonomous(self) -> bool:
        """Whether it is the same at all times."""
        return self.own.autonomous

    @property
    def sticks(self) -> bool:
        """Whether friction is set-valued: joints truly stick, motions have events."""
        return self.friction is not None and self.friction.sticks

    @property
    def rate_cut(self) -> Scalar | None:
        """The rate below which friction counts a joint as sticking; None: by mode."""
        return None if self.friction is None else self.friction.rate_cut()

    @property
    def polynomial(self) -> bool:
        """Whether the damping is a polynomial of the state's sines and cosines."""
        return is_polynomial(self.damping)

    @property
    def on_reactions(self) -> bool:
        """Whether the motion decides the load that friction rests on."""
        return self.friction is not None and self.friction.load is not None

    @property
    def has_series(self) -> bool:
        """Whether `Taylor` can follow it."""
        written = self.polynomial and self.autonomous and not self.own.forces
        return self.sticks and written and not self.on_reactions

    # ---- set-valued friction

    @property
    def coulomb(self) -> CoulombTorques:
        """Its friction, which is set-valued."""
        assert isinstance(self.friction, CoulombTorques)
        return self.friction

    @property
    def law(self) -> CoulombInModes:
        """Its friction in the modes in which it runs."""
        assert isinstance(self.friction, CoulombInModes)
        return self.friction

    def in_modes(self, modes: Numbers) -> "System":
        """The same in given modes: 1 or -1 where a joint slips, 0 where it sticks."""
        law = self.coulomb.in_modes(modes)
        return eqx.tree_at(lambda s: s.friction, self, law)

    # ---- at a time

    def at(self, t: Scalar | None) -> "System":
        """The system as it is at a time; itself, where it is the same at all times.

        One that is at a time already stays there: ask the column's own for another.
        What depends on time has to be asked so for everything but its `field`.
        """
        if self.autonomous or self.own.time is not None or t is None:
            return self
        new = (
            self.own.load(self.q, t),
            eqx.tree_at(lambda own: own.time, self.own, t, is_leaf=lambda x: x is None),
        )
        return eqx.tree_at(lambda s: (s.q, s.own), self, new)

    # ---- at a state

    def field(self, t: Scalar, y: PhasePoint) -> PhasePoint:
        """The right-hand side, in the modes of the motion, or those of the state."""
        self = self.at(t)
        rates, forces = y.omega, _Forces(self, y)
        if self.sticks:
            balance = forces.balance()
            law = self._in_its_modes(balance, rates)
            return PhasePoint.of(rates, law.accelerations(balance))
        torques, right = self._torques(forces), forces.right
        if torques is not None:
            pairs = zip(right, on_rods(torques), strict=True)
            right = tuple(r - t for r, t in pairs)
        return PhasePoint.of(rates, forces.accelerations(right))

    def right_hand_side(self, t: Scalar, y: PhasePoint) -> PhasePoint:
        """The same as a call of a program that is traced once."""
        return field(t, y, self)

    def balance(self, y: PhasePoint) -> MassAndForces:
        """The mass matrix and the forces without friction."""
        return _Forces(self, y).balance()

    def friction_torques(self, y: PhasePoint) -> Numbers | None:
        """T_i in the joints; None without friction."""
        return self._torques(_Forces(self, y))

    def reactions(self, y: PhasePoint) -> tuple[Pair, ...]:
        """The forces that the joints transmit: along and across the last rod."""
        return _Forces(self, y).reactions().at(*self.field(0.0, y).omega)

    def energy(self, y: PhasePoint) -> Scalar:
        """Kinetic energy and that of springs and fixed forces (see `energy`)."""
        return self._energy(y, turned(y.phi))

    def power(self, y: PhasePoint) -> Power:
        """The power of the load, and the losses by damping and friction."""
        rates, forces = y.omega, _Forces(self, y)
        torques, damping = self._rubbing(forces), forces.damping
        own = self.own.torques(y.phi, rates)
        return Power(
            _work(forces.load, rates),
            None if damping is None else _work(damping, rates),
            None if torques is None else _work(torques, joint_angles(rates)),
            None if own is None else _work(own, rates) + self.own.stored(y.phi, rates),
        )

    def energy_rate(self, y: PhasePoint, accelerations: Sequence[Scalar]) -> EnergyRate:
        r"""The energy and its balance, from the state and its accelerations alone.

        $$\frac{dE}{dt} = \sum_{i \ge j} J_{ij} \bigl(\cos D_{ij}\,(\dot\omega_i\omega_j
        + \omega_i\dot\omega_j) - \sin D_{ij}\,(\omega_i - \omega_j)\,\omega_i\omega_j
        \bigr) + \sum_i k_i \theta_i u_i, \qquad D_{ij} = \phi_i - \phi_j$$

        (half of it for i = j), less the work of fixed forces and foundation. The loss
        is $Q\cdot\omega - dE/dt$, the sum of the last two parts of `power`, whatever
        the laws are: none is evaluated.
        """
        phi, rates = y.phi, y.omega
        sines = turned(phi)
        terms = []
        for i, row in enumerate(self.moments):
            wi, ai = rates[i], accelerations[i]
            for j, moment in enumerate(row):
                wj, aj = rates[j], accelerations[j]
                if i == j:
                    terms.append(moment * wi * ai)
                    continue
                s, c = sines[j, i]
                bent = c * (ai * wj + wi * aj) - s * (wj - wi) * wi * wj
                terms.append(moment * bent)
        turns = joint_angles(rates)
        terms += [x * u for x, u in zip(self._spring_torques(phi), turns, strict=True)]
        still = self._fixed_forces(phi)
        if still is not None:
            terms += [-f * w for f, w in zip(still, rates, strict=True)]
        rate = sum_of(terms)
        fed = _work(self._load(phi, sines), rates)
        now = EnergyRate(self._energy(y, sines), rate, fed - rate)
        standing = self.own.torques(phi, None)
        if standing is None:
            return now
        energy, rate, loss = now
        rate = rate + self.own.stored(phi, rates)
        return EnergyRate(energy, rate, loss + _work(standing, rates))

    # ---- of which these are made

    def _in_its_modes(self, balance: MassAndForces, rates: Numbers) -> CoulombInModes:
        """Set-valued friction in the modes of the motion or of the state."""
        if isinstance(self.friction, CoulombInModes):
            return self.friction
        return self.coulomb.at_state(balance, joint_angles(rates))

    def _rubbing(self, forces: "_Forces") -> Numbers | None:
        """Friction torques that do work: what holds a joint at rest does none."""
        if not self.sticks:
            return self._torques(forces)
        balance = forces.balance()
        law = self._in_its_modes(balance, forces.y.omega).loaded(balance)
        return law.slipping

    def _torques(self, forces: "_Forces") -> Numbers | None:
        if self.friction is None:
            return None
        rates = forces.y.omega
        if self.sticks:
            balance = forces.balance()
            return self._in_its_modes(balance, rates).torques(balance)
        assert isinstance(self.friction, AbstractRateTorques)
        u, load = joint_angles(rates), self.friction.load
        # all accelerations need them: not to be computed for each
        torques = materialise(rates[0], self.friction.at, u)
        if load is None:
            return torques
        normal = forces.loads(torques, load)
        return tuple(g * n for g, n in zip(torques, normal, strict=True))

    def _energy(self, y: PhasePoint, sines: Turned) -> Scalar:
        phi, rates = y.phi, y.omega
        potential = self.own.energy(phi)
        terms = [] if potential is None else [potential]
        for i, row in enumerate(self.moments):
            for j, moment in enumerate(row):
                own = moment * rates[i] * rates[j]
                terms.append(own / 2 if i == j else own * sines[j, i][1])
        for k, x in zip(self.springs, self._wound(phi), strict=True):
            terms.append((x * x if k is None else k * x * x) / 2)
        if self.upright is None and self.foundation is None:
            return sum_of(terms)
        angles = [sincos(x) for x in phi]
        if self.upright is not None:
            # as far as it has sunk: not cos - 1, which cancels
            halves = [sincos(x / 2)[0] for x in phi]
            pairs = zip(self.upright, halves, strict=True)
            terms += [-2 * v * s * s for v, s in pairs]
        if self.across is not None:
            pairs = zip(self.across, angles, strict=True)
            terms += [h * s for h, (s, _) in pairs]
        if self.foundation is not None:
            aside = [s for s, _ in angles]
            pairs = zip(moved(self.foundation, aside), aside, strict=True)
            terms += [f * s / 2 for f, s in pairs]
        return sum_of(terms)

    def _wound(self, phi: Sequence[Scalar]) -> Numbers:
        """By how much each spring is wound."""
        angles = joint_angles(phi)
        if self.bent is None:
            return angles
        return tuple(x - rest for x, rest in zip(angles, self.bent, strict=True))

    def _spring_torques(self, phi: Sequence[Scalar]) -> Numbers:
        pairs = zip(self.springs, self._wound(phi), strict=True)
        return tuple(x if k is None else k * x for k, x in pairs)

    def _load(self, phi: Sequence[Scalar], sines: Turned) -> tuple[Scalar | None, ...]:
        """The load's generalised forces; None where one is known to be zero."""
        _ = self.own.now  # q is that of a time
        load: list[Scalar | None] = [None] * len(phi)
        for force in self.followers:
            pull = self.q if force.weight is None else self.q * force.weight
            k, eta = force.rod, force.eta
            for i, length in enumerate((*self.lengths[:k], force.lever)):
                if eta is None and i == k:  # along its own rod
                    continue
                if eta is None:
                    own = pull * sines[i, k][0]
                elif i == k:
                    own = pull * sincos((1 - eta) * phi[i])[0]
                else:
                    own = pull * sincos(phi[i] - eta * phi[k])[0]
                if length is not None:
                    own = own * length
                before = load[i]
                load[i] = own if before is None else before + own
        return tuple(load)

    def _fixed_forces(self, phi: Sequence[Scalar]) -> Numbers | None:
        """The torques of fixed forces and of the foundation; None: there are none."""
        if self.upright is None and self.foundation is None:
            return None
        angles = [sincos(x) for x in phi]
        forces: Numbers = (0.0,) * len(phi)
        if self.upright is not None:
            rows = zip(self.upright, angles, strict=True)
            forces = tuple(v * s for v, (s, _) in rows)
        if self.across is not None:
            rows = zip(forces, self.across, angles, strict=True)
            forces = tuple(f - h * c for f, h, (_, c) in rows)
        if self.foundation is not None:
            borne = moved(self.foundation, [s for s, _ in angles])
            rows = zip(forces, borne, angles, strict=True)
            forces = tuple(f - b * c for f, b, (_, c) in rows)
        return forces


# a system's field, traced once for such arguments: a scene asks for it ten times
field = as_one_call(lambda t, y, system: system.field(t, y), inline=True)


class _Forces:
    """Everything but friction, at one state: what field, power and reactions share."""

    def __init__(self, system: System, y: PhasePoint):
        phi, rates = y.phi, y.omega
        self.system, self.y = system, y
        self.turned = turned(phi)
        self.load = system._load(phi, self.turned)
        self.damping: Numbers | None = None
        if system.damping is not None:
            rows = system.damping.rows(self.turned, rates)
            each = (zip(row, rates, strict=True) for row in rows)
            self.damping = tuple(
                sum_of([c * w for c, w in pairs if c is not None]) for pairs in each
            )
        still = system._fixed_forces(phi)
        own = system.own.torques(phi, rates)
        pull = on_rods(system._spring_torques(phi))
        squares = [w * w for w in rates]
        right = []
        for i, force in enumerate(self.load):
            r = -pull[i] if force is None else force - pull[i]
            if still is not None:
                r = r + still[i]
            if own is not None:
                r = r + own[i]
            for j, square in enumerate(squares):
                if j != i:
                    moment = system.moments[max(i, j)][min(i, j)]
                    thrown = moment * self.turned[min(i, j), max(i, j)][0] * square
                    r = r - thrown if i < j else r + thrown
            right.append(r if self.damping is None else r - self.damping[i])
        self.right = tuple(right)

    @property
    def mass(self) -> Rows:
        """The mass matrix."""
        return tuple(
            tuple(
                moment if i == j else moment * self.turned[j, i][1]
                for j, moment in enumerate(row)
            )
            for i, row in enumerate(self.system.moments)
        )

    def accelerations(self, right: Numbers) -> Numbers:
        """The accelerations of a chain whose joints all move, under these forces."""
        return solved(self.mass, right)

    def balance(self) -> MassAndForces:
        """Mass and forces, by which set-valued friction holds a joint."""
        reactions = self.reactions() if self.system.on_reactions else None
        return MassAndForces(self.mass, self.right, reactions)

    def reactions(self) -> Reactions:
        """The joints' reactions, as a function of the accelerations."""
        system, bodies = self.system, self.system.bodies
        assert bodies is not None  # `Column` saw to it
        (force,), drag = system.followers, system.damping and system.damping.drag()
        eta = force.eta
        pull = (system.q, None)
        if eta is not None:
            sin_f, cos_f = sincos((1 - eta) * self.y.phi[-1])
            pull = (system.q * cos_f, -system.q * sin_f)
        return reactions_of(bodies, self.y.omega, self.turned[0, 1], pull, drag)

    def loads(self, torques: Numbers, load: Reaction) -> Numbers:
        """N_i = |R_i(N)| + n_i under friction torques g_i N_i (see `JointReaction`)."""
        reactions, zero = self.reactions(), 0.0 * torques[0]
        # accelerations without friction, and per unit of each load
        free, slopes = self.accelerations(self.right), []
        for i, g in enumerate(torques):
            one = [zero] * i + [g] + [zero] * (len(torques) - i - 1)
            pushed = self.accelerations(tuple(-x for x in on_rods(one)))
            slopes.append(reactions.slope(*pushed))
        return solve_loads(reactions.at(*free), slopes, load)


def _work(forces: Sequence[Scalar | None], rates: Sequence[Scalar]) -> Scalar:
    pairs = zip(forces, rates, strict=True)
    terms = [f * w for f, w in pairs if f is not None]
    return sum_of(terms) if terms else 0.0 * rates[0]
