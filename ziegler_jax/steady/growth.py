r"""The growth of a small difference in the kick until the motion settles.

The tangent v of the kick follows the variational equations along the motion from $v_0 =
y_0 / |y_0|$. Steps of tolerance rtol leave differences of about rtol, which grow as it
does: where

$$\max_t |v(t)|\; rtol > 10^{-3},$$

the motion may end otherwise with other steps.
"""

from __future__ import annotations

from typing import ClassVar, NamedTuple

import jax.numpy as jnp

from ..model.state import PhasePoint
from ..model.system import System
from ..motion.observers import AbstractObserver
from ..motion.tangents import past, push
from ..numerics.materialise import tree_where
from ..numerics.numbers import Flag, Numbers, Scalar
from ..results import Variable
from ..solvers import Explicit, Step, Taylor

# Of the state, for a difference as large as the tolerance to grow to. Of 2000 cells
# beside thresholds of each law all 11 that end elsewhere at a tolerance of 1e-10 were
# above it. It is no bound: beside another end of a map some ends change below it.
ALLOWED = 1e-3
MOST = 1e100  # where the tangent is followed no further


class Growth(AbstractObserver):
    r"""The largest growth $\max_t |v(t)|$ of the kick's tangent on the way.

    $$\dot v = \frac{\partial f}{\partial y}\, v, \qquad v(0) = \frac{y(0)}{|y(0)|},
    \qquad |v|^2 = \varphi_1^2 + \varphi_2^2 + \omega_1^2 + \omega_2^2$$

    It follows the motion from its start to its end, while other observers follow the
    cycle; so it requires certificates (`certify` of `settle`). Each step carries a
    tangent.

    **Results:** `growth`, at most about 1e100, NaN for a start at rest; and
    `sensitive`, whether `growth * rtol` exceeds 0.001, 1e3 at the usual tolerance:
    steps of another length may then lead to another end. Some ends change at a smaller
    growth: `follow_again` asks a map directly, at a finer tolerance.
    """

    name: ClassVar[str] = "growth"
    mirrored: ClassVar[bool] = True

    def init(self, system, t, y):
        """Nothing: the tangent goes along with the motion itself."""
        del system, t, y
        return ()

    def step(self, system, state, step):
        """Return the state unchanged."""
        del system, step
        return state

    def result(self, system, state, span, y):
        """`settle` has it."""
        del system, state, span, y
        return {}


class Grown(NamedTuple):
    """The kick's tangent, and its largest length so far."""

    tangent: PhasePoint
    largest: Scalar


def kick_tangent(y0: PhasePoint) -> Grown:
    """At the start: of length one in the kick's direction; none of a start at rest."""
    size = _length(y0)
    none = jnp.where(size > 0, size, jnp.nan)
    return Grown(PhasePoint(x / none for x in y0), 1.0 + 0.0 * none)


def grown(
    system: System, solver: Explicit | Taylor, before: Grown, step: Step
) -> Grown:
    """After a step, whose `integrals` are the tangent's image, and past its event."""
    images = step.integrals
    if step.moved:
        images = tuple(each.y1 for each in step.moved)
    elif step.modes:  # it may have been cut
        assert isinstance(solver, Explicit)
        ends = step.t0, step.t1, step.y0
        _, (_, images), *_ = push(solver, system, *ends, (before.tangent,))
    (tangent,) = past(system, step, images)
    length = _length(tangent)
    goes_on = before.largest < MOST
    after = Grown(tangent, jnp.maximum(before.largest, length))
    return tree_where(goes_on, after, before)


def growth_variables(
    largest: Scalar, failed: Flag, rtol: Scalar
) -> dict[str, Variable]:
    """The variables of `Growth`."""
    growth = jnp.where(failed, jnp.nan, largest)
    sensitive = growth * rtol > ALLOWED
    return {
        "growth": Variable(growth, "largest growth of a difference in the kick"),
        "sensitive": Variable(sensitive, "whether other steps may lead to another end"),
    }


def _length(v: Numbers) -> Scalar:
    return jnp.sqrt(sum(x * x for x in v))
