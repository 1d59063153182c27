r"""Forces on a chain of rods: patterns that follow the rods, and fixed ones."""

from __future__ import annotations

import math
from typing import ClassVar

import jax.numpy as jnp

from ..numerics.elementary import sincos
from ..numerics.numbers import Joints, Numbers, OneOrEach, Scalar, Several, each, equals
from ..numerics.rules import AbstractRuled, checked, several
from ..numerics.series import added
from .system import Follower


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
    of rod i about its joint, with what hangs on its end as a mass there.

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
