r"""Forces on a chain of rods: that follow them, fixed ones, and those of your own."""

from __future__ import annotations

import abc
import math
from functools import reduce
from typing import ClassVar, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from ..numerics.elementary import sincos
from ..numerics.jaxprs import reads_first
from ..numerics.numbers import (
    Joints,
    Numbers,
    OneOrEach,
    Scalar,
    Several,
    each,
    equals,
    is_concrete,
    is_real_scalar,
)
from ..numerics.rules import AbstractRuled, Invariants, checked, several
from ..numerics.series import added, sum_of
from ..results import TIME
from .chain import Follower

# ---- of your own


class AbstractForce(AbstractRuled):
    r"""A force of your own: torques $Q_i$ on the rods.

    They stand on the right-hand side of the equations of motion and are the generalised
    forces of the rods' absolute angles: virtual work $\sum_i Q_i\, \delta\phi_i$. A
    spring k from the tip of rod 2 to a wall, across the vertical:

    ```python
    class Wall(zj.AbstractForce):
        rules = {"k": "nonnegative"}
        units = {"k": "k/l^2"}
        k: float

        def torques(self, t, phi, omega):
            x = jnp.sin(phi[0]) + jnp.sin(phi[1])
            return tuple(-self.k * x * jnp.cos(angle) for angle in phi)

        def energy(self, phi):
            return self.k * (jnp.sin(phi[0]) + jnp.sin(phi[1])) ** 2 / 2

    column = zj.uniform_rods(2.6, forces=Wall(0.2))
    ```

    A force that depends on time says so: `autonomous: ClassVar[bool] = False` in its
    class. `trajectory` takes it, and `settle` by windows; functions for a column that
    is the same at all times (certificates, linear functions, orbits, exponents,
    thresholds, curves, sections) refuse it. A follower load that depends on time is an
    `AbstractLoadHistory`. With set-valued friction a force of your own needs an
    explicit method, since it has no Taylor series. `JointReaction()` and `reactions` do
    not take it.

    Linear functions and certificates use its derivatives in angles and rates, also
    where both are zero. Write it smoothly there: `-c * w * jnp.abs(w)`, not with
    `jnp.sign(w)` or a root, whose derivatives JAX takes as zero or NaN.

    Its numbers are leaves, scalars or arrays, to be swept and differentiated. Write
    them as its own fields, with `rules` and `units` as in `AbstractDamping`.
    """

    autonomous: ClassVar[bool] = True

    @abc.abstractmethod
    def torques(self, t: Scalar, phi: Numbers, omega: Numbers) -> Numbers:
        """The torques on the rods, one each, in k, from the base on.

        **Arguments:** `t`: the time; `phi`, `omega`: the rods' angles and rates, one
        number a rod.
        """

    def energy(self, phi: Numbers) -> Scalar | None:
        r"""Its potential E, in k, which enters `energy`; None: there is none.

        The power of the force is then what is left of it, $\sum_i (Q_i + \partial E /
        \partial\phi_i)\, \omega_i$: zero where E is the potential of all of it.
        """
        del phi
        return None


class AbstractLoadHistory(AbstractRuled):
    r"""A follower load that depends on time, added to the q of the column.

    $$q(t) = q + p(t)$$

    with p by `load`. Pulsation, $q(t) = q + p \cos \Omega t$:

    ```python
    class Pulsation(zj.AbstractLoadHistory):
        p: float
        rate: float

        def load(self, t):
            return self.p * jnp.cos(self.rate * t)

    column = zj.uniform_rods(1.5, forces=Pulsation(0.2, 3.0))
    motion = zj.trajectory(column, zj.State(omega=(0, 0.01)), np.linspace(0, 50, 501))
    ```

    All forces that q multiplies follow it. The normal load of friction must not depend
    on q, as `FollowerLoad()` does, since its torques are computed once: write
    `ConstantLoad(n)`. `trajectory` takes such a column, and `settle` by windows. Its
    numbers are as in `AbstractForce`.
    """

    @abc.abstractmethod
    def load(self, t: Scalar) -> Scalar:
        """The load that it adds to q at a time."""


class LoadHistory(AbstractLoadHistory):
    r"""A follower load by its values at some times, with straight lines between them.

    It is added to the q of the column. A ramp up and down again is
    `LoadHistory((0, 500, 1000), (0, 3, 0))`, with q = 0; a measured history may have
    any number of values. Before the first time and after the last it is constant. A
    column at rest does not begin to swing on a ramp without a kick, and one that dry
    friction holds at no load: see `sweep_up_down` for the load from which it flutters.

    **Arguments:** `times`: increasing, in $\sqrt{m l^2/k}$; `loads`: in k/l, one a
    time.

    **Raises:** `ValueError` for numbers that are not finite, times that do not
    increase, and other than one load a time.
    """

    rules: ClassVar = {"times": "finite", "loads": "finite"}
    units: ClassVar = {"times": TIME, "loads": "k/l"}

    times: Float[ArrayLike, " n"]
    loads: Float[ArrayLike, " n"]

    def __init__(self, times: Several, loads: Several):
        """Check and keep both."""
        self.times, self.loads = _row("times", times), _row("loads", loads)
        if len(self.times) != len(self.loads):
            raise ValueError(
                "Arguments `times` and `loads` must be as many numbers each, but are "
                f"{len(self.times)} and {len(self.loads)}."
            )
        self.refuse_broken()

    def invariants(self) -> Invariants:
        """Times increase."""
        yield (
            (cast(Scalar, self.times),),
            lambda times: jnp.all(jnp.diff(jnp.asarray(times)) > 0),
            "Argument `times` must increase, but is {}.",
        )

    def load(self, t: Scalar) -> Scalar:
        """On the straight line between two times."""
        return jnp.interp(t, jnp.asarray(self.times), jnp.asarray(self.loads))


def _row(name: str, x: Several) -> Array | np.ndarray:
    """Numbers in a row, as an array; NumPy's where all are known now.

    **Raises:** `ValueError` for fewer than two, and for such as are not finite.
    """
    if isinstance(x, jax.Array) and x.ndim == 1 and x.size > 1:
        return x
    numbers = several(name, x)
    return (np if all(map(is_concrete, numbers)) else jnp).stack(numbers)


def _check(force: AbstractForce, rods: int) -> None:
    """Refuse torques of another count than rods, and time that is not named."""
    name, zero = type(force).__name__, jnp.zeros(())

    def asked(t, phi, omega):
        given = force.torques(t, phi, omega)
        several = isinstance(given, list | tuple) or jnp.ndim(given) > 0
        return tuple(given) if several else (given,), force.energy(phi)

    row = (zero,) * rods
    torques, potential = jax.eval_shape(asked, zero, row, row)
    given = (*torques, *(() if potential is None else (potential,)))
    if len(torques) != rods or not all(map(is_real_scalar, given)):
        raise ValueError(
            f"The force `{name}` must give one scalar torque for each of {rods} rods, "
            f"and one scalar energy or None, all real, but gives torques {torques} and "
            f"the energy {potential}."
        )
    if force.autonomous and reads_first(asked, zero, row, row):
        raise ValueError(
            f"The force `{name}` must say that it depends on time, but reads `t` and "
            "has `autonomous` = True: write `autonomous: ClassVar[bool] = False` in "
            "its class."
        )


class OwnForces(eqx.Module):
    """Forces of your own and histories of q, as a `System` has them.

    `time`: at which they are asked, where they depend on it.
    """

    forces: tuple[AbstractForce, ...] = ()
    histories: tuple[AbstractLoadHistory, ...] = ()
    time: Scalar | None = None

    @property
    def autonomous(self) -> bool:
        """Whether they are the same at all times."""
        return not self.histories and all(force.autonomous for force in self.forces)

    @property
    def now(self) -> Scalar:
        """The time; any, where they do not depend on it."""
        if self.time is None and not self.autonomous:
            raise ValueError(
                "A column that depends on time must be asked at one, but is asked at "
                "none: give `t`, or write `system.at(t)`."
            )
        return 0.0 if self.time is None else self.time

    def load(self, q: Scalar, t: Scalar) -> Scalar:
        """The follower load at a time, of which q is the constant part."""
        return sum_of([q, *(history.load(t) for history in self.histories)])

    def torques(self, phi: Numbers, omega: Numbers | None) -> Numbers | None:
        """All torques; None: there are none. `omega`: None for no rates."""
        if not self.forces:
            return None
        omega = tuple(0.0 * x for x in phi) if omega is None else omega
        at = self.now, phi, omega
        return reduce(added, (tuple(force.torques(*at)) for force in self.forces))

    def energy(self, phi: Numbers) -> Scalar | None:
        """Their potential; None: there is none."""
        every = (force.energy(phi) for force in self.forces)
        given = [x for x in every if x is not None]
        return sum_of(given) if given else None

    def dissipated(self, phi: Numbers, omega: Numbers) -> Scalar | None:
        """The power lost by the part of the torques that depends on the rates."""
        standing, moving = self.torques(phi, None), self.torques(phi, omega)
        if standing is None or moving is None:
            return None
        rows = zip(standing, moving, omega, strict=True)
        return sum_of([(a - b) * w for a, b, w in rows])

    def stored(self, phi: Numbers, omega: Numbers) -> Scalar:
        """At which rate the potential grows."""

        def energy(phi: Numbers) -> Scalar:
            whole = self.energy(phi)
            return 0.0 * phi[0] if whole is None else whole

        kind = jnp.result_type(float, *phi, *omega)
        at, along = (tuple(jnp.asarray(x, kind) for x in row) for row in (phi, omega))
        return jax.jvp(energy, (at,), (along,))[1]


def checked_own(own: OwnForces, rods: int) -> OwnForces:
    """The same, if each gives what it must.

    **Raises:** `ValueError`.
    """
    for force in own.forces:
        _check(force, rods)
    for history in own.histories:
        load = jax.eval_shape(history.load, jnp.zeros(()))
        if not is_real_scalar(load):
            raise ValueError(
                f"The load history `{type(history).__name__}` must give one real "
                f"number, but gives {load}."
            )
    return own


# ---- the package's own


class AbstractFixedForce(AbstractRuled):
    """A force of fixed size and direction, whatever q is."""

    rules: ClassVar = {"size": "finite", "direction": "finite"}

    size: Scalar
    direction: Scalar

    def __init__(self, size: Scalar, direction: Scalar = 0.0):
        """Check and keep both."""
        self.size, self.direction = checked(self.rules, size=size, direction=direction)


class DeadLoad(AbstractFixedForce):
    r"""A force p at the tip, of fixed size and direction.

    Its moment on rod i is $p\, l_i \sin(\phi_i - \alpha)$.

    **Arguments:** `size`: p in k/l; `direction`: $\alpha$ in rad, the angle of a rod
    that it presses straight onto its base: 0 downwards on a column that stands, $\pi$
    upwards. Other directions than these bend the chain at rest.
    """

    units: ClassVar = {"size": "k/l", "direction": "rad"}


class Gravity(AbstractFixedForce):
    r"""The rods' weights, of one direction.

    Their moment on rod i is $g\, S_i \sin(\phi_i - \alpha)$. $S_i$ is the first moment
    of rod i about its joint, with the rods above it as a mass at its end.

    **Arguments:** `size`: g in k/(m l); `direction`: $\alpha$ in rad, as of
    `DeadLoad`.
    """

    units: ClassVar = {"size": "k/(m l)", "direction": "rad"}


class FollowerForces(AbstractRuled):
    r"""A pattern of forces that one factor q multiplies, each following its rod.

    On rod k acts $w_k q$, at an angle $\eta_k \phi_k$ to the vertical, at the share
    $a_k$ of its length:

    $$Q_i = q \sum_{k \ge i} w_k r_{ki} \sin(\phi_i - \eta_k \phi_k), \qquad
    r_{ki} = l_i \ (i < k),\quad a_k l_k \ (i = k)$$

    A follower force along the rods, so much a unit of length, is
    `FollowerForces(lengths, at=0.5)`; on the tip alone, which is the default of a
    `Chain`, `FollowerForces((0, ..., 0, 1))`.

    **Arguments:** `weights`: $w_k$, one a rod; a known zero is left out of the
    program. `follower`: $\eta_k$, and `at`: $a_k$, one number or one a rod; 1 each.
    Where a force follows its rod wholly, it does not matter where on the rod it acts.

    **Raises:** `ValueError` for numbers that are not finite.
    """

    rules: ClassVar = {
        "weights": "finite; each",
        "follower": "finite; each",
        "at": "finite; each",
    }
    units: ClassVar = {"weights": "1", "follower": "1", "at": "1"}

    weights: Numbers
    follower: OneOrEach
    at: OneOrEach

    def __init__(self, weights: Several, follower: Joints = 1.0, at: Joints = 1.0):
        """Check and keep the pattern."""
        self.weights = several("weights", weights)
        self.follower, self.at = checked(self.rules, follower=follower, at=at)

    def pulls(self, q: Scalar) -> Numbers:
        """Of each joint the forces beyond it, at rest."""
        sums, whole = [], None
        for weight in reversed(self.weights):
            if not equals(weight, 0.0):
                own = q if equals(weight, 1.0) else q * weight
                whole = own if whole is None else whole + own
            sums.append(0.0 * q if whole is None else whole)
        return tuple(reversed(sums))

    def followers(self, lengths: Numbers) -> tuple[Follower, ...]:
        """The forces that there are."""
        n, forces = len(lengths), []
        rows = zip(self.weights, each(self.follower, n), each(self.at, n), strict=True)
        for k, (weight, eta, at) in enumerate(rows):
            if equals(weight, 0.0):
                continue
            wholly = equals(eta, 1.0)
            forces.append(
                Follower(
                    k,
                    None if equals(weight, 1.0) else weight,
                    None if wholly else eta,
                    None if wholly else at * lengths[k],
                )
            )
        return tuple(forces)


# one of your own, a history of q, a pattern of those that q multiplies; or several
Force = AbstractForce | AbstractLoadHistory | FollowerForces
Forces = Force | tuple[Force, ...]


def in_a_row(forces: Forces | None) -> tuple[Force, ...]:
    """The forces that exist, in a tuple."""
    if forces is None:
        return ()
    return forces if isinstance(forces, tuple) else (forces,)


def read(forces: Forces | None) -> Forces | None:
    """Forces as a column keeps them.

    **Raises:** `ValueError` for what is none.
    """
    for force in in_a_row(forces):
        if not isinstance(force, Force):
            raise ValueError(
                "Argument `forces` must be None, or one or a tuple of `AbstractForce`, "
                "`AbstractLoadHistory` and, in a `Chain`, `FollowerForces`, but has "
                f"{force!r}."
            )
    return forces if in_a_row(forces) else None


def fixed_forces(
    dead_load: DeadLoad | None,
    gravity: Gravity | None,
    lengths: Numbers,
    heavy: Numbers | None,
) -> tuple[Numbers | None, Numbers | None]:
    """Moments of forces of fixed direction, along the vertical and across it.

    **Arguments:** `heavy`: the rods' first moments, each with what hangs on its end.
    """
    upright: Numbers | None = None
    across: Numbers | None = None
    for force, arms in ((dead_load, lengths), (gravity, heavy)):
        if force is None:
            continue
        assert arms is not None
        upwards = any(equals(force.direction, way * math.pi) for way in (1, -1))
        if equals(force.direction, 0.0) or upwards:  # nothing of it bends
            size = -force.size if upwards else force.size
            along, aside = tuple(size * arm for arm in arms), None
        else:
            s, c = sincos(jnp.asarray(force.direction, float))
            along = tuple(force.size * c * arm for arm in arms)
            aside = tuple(force.size * s * arm for arm in arms)
        upright = along if upright is None else added(upright, along)
        if aside is not None:
            across = aside if across is None else added(across, aside)
    return upright, across
