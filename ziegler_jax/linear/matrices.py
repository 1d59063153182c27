r"""The matrices of the linear chain of any number of rods, and its equilibrium."""

from collections.abc import Iterable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from ..model.chain import Follower, Rows, straight, turned
from ..model.forces import AbstractForce
from ..model.system import System
from ..numerics.jaxprs import reads_first
from ..numerics.numbers import Flag, Numbers, Scalar

Matrix = Float[Array, "n n"]
Vector = Float[Array, " n"]

BALANCED = 1e-9  # what turns the rods at an equilibrium, of what may
# An equilibrium is followed by so many of Newton's steps on each of LEVELS of all that
# acts, from the springs' own shape on; a rod that turns by more on one has left it.
EQUILIBRIUM_STEPS, LEVELS, LEAP = 4, 64, 0.3


class Matrices(NamedTuple):
    """Of the chain at a load, about its equilibrium."""

    mass: Matrix
    damping: Matrix | None  # None: it has no damping law
    stiffness: Matrix
    angles: Vector  # of the equilibrium


def about(system: System, angles: Vector) -> Matrices:
    """The matrices at these angles, where the chain stands still."""
    n = system.joints
    apart = angles[:, None] - angles[None, :]
    mass = _dense(system.moments) * jnp.cos(apart)
    upper = jnp.eye(n) - jnp.eye(n, k=-1)  # the joints' angles of the rods'
    stiffness = upper.T @ (springs(system)[:, None] * upper)
    for force in system.followers:
        k, eta = force.rod, 1.0 if force.eta is None else force.eta
        pull = _pulls(system, force) * jnp.cos(angles - eta * angles[k])
        stiffness = stiffness - jnp.diag(pull)
        stiffness = stiffness.at[:, k].add(eta * pull)
    s, c = jnp.sin(angles), jnp.cos(angles)
    if system.upright is not None:
        stiffness = stiffness - jnp.diag(jnp.stack(floats(system.upright)) * c)
    if system.across is not None:
        stiffness = stiffness - jnp.diag(jnp.stack(floats(system.across)) * s)
    if system.foundation is not None:
        w = _dense(system.foundation)
        stiffness = stiffness + w * c[:, None] * c[None, :] - jnp.diag(s * (w @ s))
    damping = None
    if system.damping is not None:
        sines = turned(tuple(angles)) if system.displaced else straight(n)
        rows = system.damping.rows(sines, (jnp.zeros((), angles.dtype),) * n)
        damping = jnp.stack(
            [jnp.stack(floats(0.0 if x is None else x for x in row)) for row in rows]
        )
    if system.own.forces:
        by_angle, by_rate = _slopes(system, angles)
        stiffness = stiffness - by_angle
        if by_rate is not None:
            damping = -by_rate if damping is None else damping - by_rate
    return Matrices(mass, damping, stiffness, angles)


def _own(system: System, angles: Vector, rates: Vector) -> Vector:
    """The torques of forces of your own."""
    torques = system.own.torques(tuple(angles), tuple(rates))
    assert torques is not None
    return jnp.stack(floats(torques))


def _slopes(system: System, angles: Vector) -> tuple[Matrix, Matrix | None]:
    """Their derivatives by the angles and the rates; None: they read no rates."""
    still = jnp.zeros_like(angles)
    by_angle = jax.jacfwd(lambda x: _own(system, x, still))(angles)
    if not reads_first(lambda w: system.own.torques(tuple(angles), w), tuple(still)):
        return by_angle, None
    return by_angle, jax.jacfwd(lambda w: _own(system, angles, w))(still)


def torques(system: System, angles: Vector) -> Vector:
    """What turns the rods where the chain stands still at these angles."""
    n, s, c = system.joints, jnp.sin(angles), jnp.cos(angles)
    upper = jnp.eye(n) - jnp.eye(n, k=-1)
    wound = upper @ angles
    if system.bent is not None:
        wound = wound - jnp.stack(floats(system.bent))
    total = -upper.T @ (springs(system) * wound)
    for force in system.followers:
        eta = 1.0 if force.eta is None else force.eta
        turned_by = jnp.sin(angles - eta * angles[force.rod])
        total = total + _pulls(system, force) * turned_by
    if system.upright is not None:
        total = total + jnp.stack(floats(system.upright)) * s
    if system.across is not None:
        total = total - jnp.stack(floats(system.across)) * c
    if system.foundation is not None:
        total = total - c * (_dense(system.foundation) @ s)
    if system.own.forces:
        total = total + _own(system, angles, jnp.zeros_like(angles))
    return total


def floats(numbers: Iterable[Scalar]) -> list[jax.Array]:
    """Each as an array of its own."""
    return [jnp.asarray(x, float) for x in numbers]


def springs(system: System) -> Vector:
    """The joints' springs."""
    return jnp.stack(floats(1.0 if k is None else k for k in system.springs))


def _pulls(system: System, force: Follower) -> Vector:
    """A follower force's levers on all rods, times the force."""
    pull = system.q if force.weight is None else system.q * force.weight
    before = [1.0 if x is None else x for x in system.lengths[: force.rod]]
    own = 1.0 if force.lever is None else force.lever
    beyond = [0.0] * (system.joints - force.rod - 1)
    return pull * jnp.stack(floats([*before, own, *beyond]))


def _dense(rows: Rows) -> Matrix:
    n = range(len(rows))
    return jnp.stack(
        [jnp.stack(floats(rows[max(i, j)][min(i, j)] for j in n)) for i in n]
    )


def under(system: System, q: Scalar) -> System:
    """The same under another load."""
    return eqx.tree_at(lambda s: s.q, system, q)


def nearer(system: System, angles: Vector, steps: int) -> Vector:
    """An equilibrium near these angles, by so many of Newton's steps."""

    def step(_, angles):
        stiffness = about(system, angles).stiffness
        return angles + jnp.linalg.solve(stiffness, torques(system, angles))

    if steps == 1:
        return step(0, angles)
    return lax.fori_loop(0, steps, step, angles)


def equilibrium(system: System) -> tuple[Vector, Flag]:
    """The equilibrium that the springs' own shape goes over to, and whether it does.

    All that acts is raised from nothing on. Its derivative is Newton's last step's.
    """
    zero = jnp.zeros(system.joints, jnp.result_type(float))
    if not system.displaced:
        return zero, True
    still = lax.stop_gradient(system)
    natural = zero if still.bent is None else jnp.cumsum(jnp.stack(floats(still.bent)))

    def rise(k, state):
        angles, there = state
        new = nearer(_share(still, (k + 1) / LEVELS), angles, EQUILIBRIUM_STEPS)
        return new, there & ~(jnp.max(jnp.abs(new - angles)) > LEAP)

    begin = natural, jnp.asarray(True)
    angles, there = lax.fori_loop(0, LEVELS, rise, begin)
    angles = nearer(system, nearer(system, angles, 1), 1)
    left = torques(still, lax.stop_gradient(angles))
    there &= jnp.max(jnp.abs(left)) < BALANCED * (1 + jnp.max(jnp.abs(angles)))
    return jnp.where(there, angles, jnp.nan), there


class ShareOf(AbstractForce):
    """A share of a force of your own, as an equilibrium is followed from none on."""

    force: AbstractForce
    share: Scalar

    def torques(self, t: Scalar, phi: Numbers, omega: Numbers) -> Numbers:
        """So much of each."""
        return tuple(self.share * x for x in self.force.torques(t, phi, omega))


def _share(system: System, share: Scalar) -> System:
    """The same under a share of all that acts on it."""

    def acts(s: System) -> list:
        return jax.tree.leaves((s.q, s.upright, s.across, s.foundation))

    less = eqx.tree_at(acts, system, [share * x for x in acts(system)])
    forces = tuple(ShareOf(force, jnp.asarray(share)) for force in system.own.forces)
    return eqx.tree_at(lambda s: s.own.forces, less, forces) if forces else less


def eigenvalues_of(matrices: Matrices) -> Array:
    """All 2 n of them."""
    return jnp.linalg.eigvals(of_first_order(matrices))


def of_first_order(matrices: Matrices) -> Float[Array, "m m"]:
    """The matrix of the same equations of first order."""
    m, c, k, _ = matrices
    zero, one = jnp.zeros_like(m), jnp.eye(len(m), dtype=m.dtype)
    rates = zero if c is None else -jnp.linalg.solve(m, c)
    return jnp.block([[zero, one], [-jnp.linalg.solve(m, k), rates]])
