r"""The criterion by which a motion has come to rest.

Joints stick, or, where friction is smoothed, creep: no joint has been faster than the
cut for some time, and none speeds up. That is not sufficient: a motion beside a small
unstable cycle falls for long before it grows. So the remaining motion must decay. In
the joint angles, $\theta = (\phi_1, \phi_2 - \phi_1)$, the linear column about the
state,

$$\ddot\theta + C\,\dot\theta + K\,\theta = 0,$$

must be stable with every damping that a motion of this size or a smaller one may feel:
a mean of the law's slopes over the rates from rest to the largest. Stability is decided
by Hurwitz' conditions on $s^4 + p_1 s^3 + p_2 s^2 + p_3 s + p_4$, for more than two
rods by eigenvalues.

The law's slopes are computed at rest and at rates from the largest down, for each joint
and direction. The least, the greatest and some between are tried, each of one joint
with each of the other, as dampings that are stable at both ends need not be so between
them. The criterion does not see a damping of one joint that depends on the other's
rate, or on an angle that small. For more than two rods only some combinations are
tried: all dampings at one share of their ranges, and one at an end with the others at
the other.
"""

from collections.abc import Sequence
from functools import reduce
from operator import and_
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool

from ..model.chain import joint_angles
from ..model.state import PhasePoint
from ..model.system import System, field
from ..numerics.elementary import larger
from ..numerics.materialise import if_any_lane, tree_where
from ..numerics.numbers import Flag, Numbers, Scalar
from ..numerics.series import sum_of
from ..results import CODE
from ..solvers import Step

# Rates that steps leave of a motion that has decayed, in atol: of 104 viscous columns
# Tsit5 left 41, Dopri8 8, whatever the tolerance.
NOISE = 100.0
ROUNDING = 1e-12  # of Hurwitz' terms: a column on the boundary does not grow
# Of the largest rate: where the slope of friction or damping is asked. A motion of size
# A is slower than A / 1000 for less than a thousandth of its time.
LEVELS = (1.0, 0.5, 0.25, 0.1, 0.03, 0.01, 0.001)
BESIDE = 1e-6  # of it: at rest itself a law of |u| has no slope to JAX
MEANS = 8  # slopes from the least to the greatest that a motion may feel in the mean
DECADES = 1e-4  # of the greatest: below it they are not told apart
Damping = tuple[Array, ...]  # a column of C: against each joint


class Speeds(NamedTuple):
    """The largest joint rates; by modes 1 for a joint that slips."""

    now: Scalar  # in this span
    before: Scalar  # in the span before


class Rest(eqx.Module):
    """Whether a motion has come to rest: all joints stick, or are slow, and it decays.

    **Arguments:** `rate_cut`: what is slower creeps; None: set-valued friction, by
    modes; `at_once`: what sticks in all joints sticks for ever: no span is waited for;
    `atol`: of the steps, whose own error keeps a motion that has decayed at rates of up
    to some tens of it. What is slower than `NOISE` of them is slow, whatever the cut.
    """

    rate_cut: Scalar | None
    at_once: bool = eqx.field(static=True)
    atol: Scalar = 0.0

    @property
    def by_modes(self) -> bool:
        """Whether rest is a matter of modes."""
        return self.rate_cut is None

    @property
    def noise(self) -> Scalar:
        """The rate, or the swing, that steps leave of a motion that has decayed."""
        return NOISE * self.atol

    def slow(self, system: System, rate: Scalar) -> Flag:
        """Whether a joint rate is so low that what is left may be rest."""
        assert self.rate_cut is not None
        slow = rate < self.rate_cut
        return slow | (rate < self.noise) if system.polynomial else slow

    def begin(self, y: PhasePoint) -> Speeds:
        """At the start of a motion."""
        zero = 0.0 * y[0]
        return Speeds(zero if self.by_modes else fastest(y), zero)

    def watch(self, speeds: Speeds, step: Step) -> Speeds:
        """After a step."""
        if self.by_modes:
            assert step.modes
            still = reduce(and_, (m == 0 for m in step.modes))
            rate = jnp.where(still, 0.0, 1.0)
            rate = rate.astype(jnp.result_type(step.modes[0]))
        else:
            rate = fastest(step.y1)
        return speeds._replace(now=larger(speeds.now, rate))

    def sticks(self, step: Step) -> Flag:
        """Whether all joints stick from here on, where that is enough."""
        if not (self.by_modes and self.at_once):
            return False
        assert step.event
        return reduce(and_, (m == 0 for m in step.event[1]))

    def reached(self, system: System, speeds: Speeds, step: Step, ended: Flag) -> Flag:
        """Whether it rests at the end of a step, with which a span may have ended.

        Never where forces depend on time: what sticks, or decays now, may move again.
        """
        if not system.autonomous:
            return jnp.zeros_like(ended, bool)
        if self.by_modes:
            return self.sticks(step) | (ended & (speeds.now < 0.5))
        # slow is not at rest where it grows: the span before tells, and what decays
        slow = ended & self.slow(system, speeds.now) & (speeds.now <= speeds.before)

        def damped(slow: Bool[Array, ""]) -> Bool[Array, ""]:
            return slow & decays(system, step.y1, speeds.now)

        return if_any_lane(slow, damped, jnp.asarray(slow))

    def outcome(self, system: System) -> CODE:
        """The code of rest."""
        return CODE.rest if system.friction is None else CODE.stuck

    def setting(self) -> Scalar | str:
        """The cut, for the record."""
        return "by modes" if self.rate_cut is None else self.rate_cut

    def renewed(self, speeds: Speeds, step: Step, begins: Flag) -> Speeds:
        """Where a span begins after a step."""
        new = Speeds(self.begin(step.y1).now, speeds.now)
        return tree_where(begins, new, speeds)


def fastest(y: PhasePoint) -> Scalar:
    """The largest joint rate."""
    return reduce(larger, map(jnp.abs, joint_angles(y.omega)))


def decays(system: System, y: PhasePoint, rate: Scalar) -> Flag:
    """Whether motions about this state, no faster than `rate`, are damped.

    Without friction the terms of Hurwitz' conditions are those of the equilibrium but
    for the motion's own size; what lies within that of the boundary does not count as
    damped, nor does a column that dissipates nothing.

    **Arguments:** `rate`: the largest of a joint; 0 where the motion stands still.
    """
    y, zero = PhasePoint(y), 0.0 * y[0]
    sizes = (BESIDE,)
    if system.friction is not None or not system.polynomial or system.own.forces:
        sizes += tuple(way * level for level in LEVELS for way in (1.0, -1.0))
    # of each joint K's column, then C's for each size: one after the other, for each
    # place where the field is written out is ten thousand instructions
    n = system.joints
    none = (0.0,) * n
    rows = [
        (*turned, size, *moved, 1.0 if size == BESIDE else 0.0)
        for first in range(n)  # the rods from here on are what its angle turns
        for joint in [(0.0,) * first + (1.0,) * (n - first)]
        for turned, size, moved in [(joint, 0.0, none)]
        + [(none, size, joint) for size in sizes]
    ]

    def forces(*y):
        """Against the joints' own accelerations."""
        return tuple(-a for a in joint_angles(field(zero, PhasePoint(y), system).omega))

    def along(ends, row):
        """A column, and the least and the greatest of C's so far, by its own force."""
        turned, (size, *moved, begins) = row[:n], row[n:]
        state = *y.phi, *(size * rate * x for x in moved)
        direction = tuple(x + zero for x in (*turned, *moved))
        here = jax.jvp(forces, state, direction)[1]
        low, high = ends
        own, least, most = (_of_first(moved, x) for x in (here, low, high))
        low = tree_where((begins > 0) | (own < least), here, low)
        high = tree_where((begins > 0) | (own > most), here, high)
        return (low, high), (here, low, high)

    blank = (zero,) * n, (zero,) * n
    columns = tuple(map(jnp.asarray, zip(*rows, strict=True)))
    _, (every, *ends) = lax.scan(along, blank, columns)
    each = len(sizes) + 1  # rows of a joint
    stiff = [[force[each * j] for j in range(n)] for force in every]
    last = [each * (j + 1) - 1 for j in range(n)]
    one, dampings = len(sizes) == 1, []
    for j, row in enumerate(last):
        low, high = (tuple(force[row] for force in end) for end in ends)
        dampings.append(_between(low, high, j, one))
    unsure = 0.0
    if system.friction is None:
        unsure = rate * sum_of([rate, *map(jnp.abs, y.phi)])
    if n > 2:
        return _all_decay(unsure, stiff, dampings) | (rate == 0)
    # each damping of one joint with each of the other
    (k11, k12), (k21, k22) = stiff
    c11, c21 = (c[:, None] for c in dampings[0])
    c12, c22 = (c[None] for c in dampings[1])
    damped = _damped(
        unsure,
        c11 + c22,
        c11 * c22 - c12 * c21 + k11 + k22,
        c11 * k22 + c22 * k11 - c12 * k21 - c21 * k12,
        k11 * k22 - k12 * k21,
    )
    return jnp.all(damped) | (rate == 0)


def _of_first(moved: Sequence[Scalar], forces: Numbers) -> Scalar:
    """That of the first joint whose rods move."""
    chosen = forces[-1]
    for x, force in reversed(list(zip(moved[:-1], forces[:-1], strict=True))):
        chosen = jnp.where(x > 0, force, chosen)
    return chosen


def _all_decay(
    unsure: Scalar, stiff: list[list[Scalar]], dampings: list[Damping]
) -> Flag:
    """Whether all eigenvalues lie to the left, with each damping that is tried.

    **Arguments:** `unsure`: by which share of the largest they may be off.
    """
    n, count = len(stiff), dampings[0][0].shape[0]
    shares = [[k] * n for k in range(count)]
    if count > 1:
        ends = (0, count - 1), (count - 1, 0)
        shares += [
            [one if j == i else others for j in range(n)]
            for one, others in ends
            for i in range(n)
        ]
    tried = np.asarray(shares)
    c = jnp.stack(  # by trial, force, joint
        [
            jnp.stack([dampings[j][i][tried[:, j]] for j in range(n)], axis=-1)
            for i in range(n)
        ],
        axis=-2,
    )
    k = jnp.stack([jnp.stack(row) for row in stiff])
    k = jnp.broadcast_to(k, c.shape)
    one = jnp.broadcast_to(jnp.eye(n), c.shape)
    rates = jnp.concatenate([jnp.zeros_like(c), one], -1)
    matrix = jnp.concatenate([rates, jnp.concatenate([-k, -c], -1)], -2)
    values = jnp.linalg.eigvals(lax.stop_gradient(matrix))
    size = jnp.max(jnp.abs(values), -1)
    return jnp.all(jnp.max(values.real, -1) < -(unsure + ROUNDING) * size)


def _between(low: Damping, high: Damping, joint: int, one: bool) -> Damping:
    """Columns of C from one to another, each by the same ratio greater than the last.

    **Arguments:** `joint`: by whose force; `one`: whether there is one alone.
    """
    if one:
        return tuple(x[None] for x in low)
    least, most = low[joint], high[joint]
    begin = larger(least, DECADES * jnp.abs(most))
    ratio = jnp.log(jnp.where(most > begin, most / begin, 1.0))
    slopes = begin * jnp.exp(jnp.linspace(0.0, 1.0, MEANS) * ratio)
    rise = jnp.where(most > least, most - least, jnp.inf)
    shares = ((slopes - least) / rise).at[0].set(0.0)
    return tuple(a + shares * (b - a) for a, b in zip(low, high, strict=True))


def _damped(unsure: Scalar, p1: Scalar, p2: Scalar, p3: Scalar, p4: Scalar) -> Flag:
    """Whether no root of s^4 + p1 s^3 + p2 s^2 + p3 s + p4 has a positive real part.

    **Arguments:** `unsure`: by which share its terms may be off.
    """
    terms = p1 * p2 * p3, -p3 * p3, -p1 * p1 * p4
    size = jnp.abs(terms[0]) + jnp.abs(terms[1]) + jnp.abs(terms[2])
    negative = terms[0] + terms[1] + terms[2] < (unsure - ROUNDING) * size
    grows = (p1 < 0) | (p2 < 0) | (p3 < 0) | (p4 < 0) | negative
    undamped = (p1 == 0) & (p3 == 0)
    return ~(grows | undamped)
