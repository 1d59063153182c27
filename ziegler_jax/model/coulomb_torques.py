r"""Set-valued friction as torques: the torques that hold joints, and their modes.

`chain` computes the torque that holds a joint, and the motion of a chain with held
joints; `stick_slip_modes` decides which joints stick.
"""

from collections.abc import Sequence
from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp

from ..numerics.numbers import Flag, Numbers, Scalar
from .chain import (
    Factored,
    Rows,
    accelerated,
    factored,
    holding_torques,
    on_rods,
    welded,
)
from .loads import Reaction, Reactions, solve_loads
from .stick_slip_modes import Holding, agreeing, modes_of, with_one_held
from .torques import AbstractTorques


class MassAndForces(NamedTuple):
    """At one state: the mass matrix, and the forces without friction."""

    mass: Rows
    right: Numbers
    reactions: Reactions | None = None  # where they load the joints


class CoulombTorques(AbstractTorques):
    r"""Set-valued friction, in modes that are yet to be chosen.

    **Arguments:** `static`, `kinetic`: $\tau_{s,i}$, $\tau_{k,i}$; `load`: the joints'
    reactions, then the torques are per unit of them; None: there is none left.
    """

    sticks: ClassVar[bool] = True

    static: Numbers
    kinetic: Numbers
    load: Reaction | None = None

    def rate_cut(self) -> Scalar | None:
        """None: a joint sticks or it does not."""
        return None

    def in_modes(self, modes: Numbers) -> "CoulombInModes":
        """The same torques in given modes."""
        return CoulombInModes(
            static=self.static, kinetic=self.kinetic, load=self.load, modes=modes
        )

    def at_state(
        self, balance: MassAndForces, u: Numbers, rest: Sequence[Flag] | None = None
    ) -> "CoulombInModes":
        """The torques in the modes with which a motion starts.

        **Arguments:** `u`: the joints' rates; `rest`: which joints are at rest; None:
        those whose rate is 0.
        """
        rest, n = [x == 0 for x in u] if rest is None else rest, len(u)
        number = self.chosen(balance, [jnp.sign(x) for x in u], rest, [0.0] * n)
        return self.in_modes(modes_of(number, n))

    def chosen(
        self,
        balance: MassAndForces,
        given: Sequence[Scalar],
        rest: Sequence[Flag],
        slack: Sequence[Scalar],
    ) -> Scalar:
        r"""The number of the modes after an event, by the rule.

        **Arguments:** `balance`: the state's; `given`: the modes of the joints that are
        not at rest; `rest`: which joints are; `slack`: by how much less than $\tau_s$
        sets a joint free: the tolerance for one whose torque has just reached it.
        """
        several = with_one_held(len(given))
        if self.load is None:
            each = [self.in_modes(m).holding(balance) for m in several]
        else:
            each = self._loaded_holding(balance, several)
        holding = {
            modes: Holding(
                here.torques,
                tuple(s - x for s, x in zip(here.static, slack, strict=True)),
                here.kinetic,
            )
            for modes, here in zip(several, each, strict=True)
        }
        return agreeing(holding, given, rest, 0.0 if self.load is None else jnp.nan)

    def _loaded_holding(
        self, balance: MassAndForces, several: Sequence[tuple[int, ...]]
    ) -> list[Holding]:
        """In each of the modes, with its own loads: written once into the program."""
        rows = jnp.asarray(several, jnp.result_type(balance.right[0]))
        every = jax.vmap(lambda m: self.in_modes((*m,)).holding(balance))(rows)
        return [jax.tree.map(lambda x, i=i: x[i], every) for i in range(len(several))]


class CoulombInModes(CoulombTorques):
    """Set-valued friction in given modes: 1 or -1 slips, 0 sticks."""

    modes: Numbers = ()

    @property
    def stuck(self) -> list[Flag]:
        """Which joints stick."""
        return [m == 0 for m in self.modes]

    def loaded(self, balance: MassAndForces) -> "CoulombInModes":
        """The law in its modes under the loads of this state."""
        if self.load is None:
            return self
        assert balance.reactions is not None
        zero = 0.0 * balance.right[0]
        zeros = (zero,) * len(self.modes)
        rubbed, parts = balance._replace(right=zeros), self.factored(balance.mass)
        free = self.accelerations_under(balance, zeros, parts)
        slopes = []
        for i, (m, k) in enumerate(zip(self.modes, self.kinetic, strict=True)):
            one = (*zeros[:i], m * k, *zeros[i + 1 :])
            moved = self.accelerations_under(rubbed, one, parts)
            slopes.append(balance.reactions.slope(*moved))
        base = balance.reactions.at(*free)
        loads = solve_loads(base, slopes, self.load, unique=True)
        static, kinetic = (
            tuple(x * n for x, n in zip(each, loads, strict=True))
            for each in (self.static, self.kinetic)
        )
        return CoulombInModes(static=static, kinetic=kinetic, modes=self.modes)

    def holding(self, balance: MassAndForces) -> Holding:
        """The torques that hold the joints which stick, and the most, as loaded."""
        law = self.loaded(balance)
        x = law.accelerations(balance)
        torques = holding_torques(balance.mass, balance.right, x)
        return Holding(torques, law.static, law.kinetic)

    def torques(self, balance: MassAndForces) -> Numbers:
        """T_i: what holds a joint that sticks, the kinetic torque of one in slip."""
        law = self.loaded(balance)
        holding = law.holding(balance).torques
        each = zip(law.stuck, holding, law.slipping, strict=True)
        return tuple(jnp.where(stuck, t, slip) for stuck, t, slip in each)

    @property
    def slipping(self) -> Numbers:
        """The torques of joints that slip; 0 where they stick."""
        return tuple(m * k for m, k in zip(self.modes, self.kinetic, strict=True))

    def guard(self, balance: MassAndForces, least: Scalar = 1e-30) -> Numbers:
        r"""How far the torques are below the most: $(\tau_s^2 - T^2) / 2\tau_s$.

        Where the most is below `least`, to which torques are told apart, over that.
        """
        law = self.loaded(balance)
        pairs = zip(law.static, law.torques(balance), strict=True)
        return tuple((s * s - t * t) / (2 * jnp.maximum(s, least)) for s, t in pairs)

    def accelerations(self, balance: MassAndForces) -> Numbers:
        """The rods' accelerations in these modes."""
        slipping = self.loaded(balance).slipping
        return self.accelerations_under(balance, slipping, self.factored(balance.mass))

    def factored(self, mass: Rows) -> Factored:
        """The mass matrix of what slips, ready to be divided by."""
        return factored(mass, self.stuck)

    def accelerations_under(
        self, balance: MassAndForces, torques: Numbers, parts: Factored
    ) -> Numbers:
        """The rods' accelerations under these torques of what slips."""
        pairs = zip(balance.right, on_rods(torques), strict=True)
        return accelerated(parts, [r - t for r, t in pairs], self.stuck)

    def hold(self, x: Sequence[Scalar]) -> Numbers:
        """Rates of the rods, with those of joints that stick exactly zero."""
        return welded(self.stuck, x)
