r"""When a motion has come to rest.

Joints stick, or, where friction is smoothed, creep: no joint has been faster than the
cut for some time, and none speeds up. That alone is no rest: a motion beside a small
unstable cycle falls for long before it grows. What is left must decay. In the joints'
own angles, $\theta = (\phi_1, \phi_2 - \phi_1)$, the linear column about the state,

$$\ddot\theta + C\,\dot\theta + K\,\theta = 0,$$

must be stable by Hurwitz' conditions on $s^4 + p_1 s^3 + p_2 s^2 + p_3 s + p_4$, with
the slopes of friction at rest, those at the motion's largest rate, in either joint and
direction, and those between: there lies the damping that a smaller motion feels, and
dampings that are stable at both ends need not be so between them.
"""

from typing import NamedTuple, cast

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool

from ..model.column import Column
from ..motion.observers import joint_rates
from ..motion.scene import field, prepared
from ..numerics.elementary import larger
from ..numerics.materialise import if_any_lane, tree_where
from ..numerics.numbers import Flag, Scalar, Vector4
from ..results import OUTCOME
from ..solvers import Step

# Rates that steps leave of a motion that has decayed, in atol: of 104 viscous columns
# Tsit5 left 41, Dopri8 8, whatever the tolerance.
NOISE = 100.0
ROUNDING = 1e-12  # of Hurwitz' terms: a column on the boundary does not grow
SHARES = (0.25, 0.5, 0.75, 1.0)  # of the way from the slope at rest to another
BESIDE = 1e-6  # of the largest rate: what counts as at rest
JOINTS = ((1.0, 1.0), (0.0, 1.0))  # the rods that the angle of one joint turns


class Speeds(NamedTuple):
    """The largest joint rates; by modes 1 for a joint that slips."""

    now: Scalar  # in this span
    before: Scalar  # in the span before


class Rest(eqx.Module):
    """Whether a motion has come to rest: all joints stick, or are slow, and it decays.

    **Arguments:** `rate_cut`: what is slower creeps; None: set-valued friction, by
    modes; `at_once`: what sticks in both joints sticks for ever: no span is waited for;
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

    def slow(self, rate: Scalar) -> Flag:
        """Whether a joint rate is so low that what is left may be rest."""
        return (rate < cast(Scalar, self.rate_cut)) | (rate < self.noise)

    def begin(self, y: Vector4) -> Speeds:
        """At the start of a motion."""
        zero = 0.0 * y[0]
        return Speeds(zero if self.by_modes else fastest(y), zero)

    def watch(self, speeds: Speeds, step: Step) -> Speeds:
        """After a step."""
        if self.by_modes:
            assert step.modes
            m1, m2 = step.modes
            rate = jnp.where((m1 == 0) & (m2 == 0), 0.0, 1.0)
            rate = rate.astype(cast(jax.Array, m1).dtype)
        else:
            rate = fastest(step.y1)
        return speeds._replace(now=larger(speeds.now, rate))

    def sticks(self, step: Step) -> Flag:
        """Whether both joints stick from here on, where that is enough."""
        if not (self.by_modes and self.at_once):
            return False
        assert step.event
        m1, m2 = step.event[1]
        return (m1 == 0) & (m2 == 0)

    def reached(self, column: Column, speeds: Speeds, step: Step, ended: Flag) -> Flag:
        """Whether it rests at the end of a step, with which a span may have ended."""
        if self.by_modes:
            return self.sticks(step) | (ended & (speeds.now < 0.5))
        # slow is not at rest where it grows: the span before tells, and what decays
        slow = ended & self.slow(speeds.now) & (speeds.now <= speeds.before)

        def damped(slow: Bool[Array, ""]) -> Bool[Array, ""]:
            return slow & decays(column, step.y1, speeds.now)

        return if_any_lane(slow, damped, jnp.asarray(slow))

    def outcome(self, column: Column) -> OUTCOME:
        """What rest is called."""
        return OUTCOME.rest if column.friction is None else OUTCOME.stuck

    def setting(self) -> Scalar | str:
        """The cut, for the record."""
        return "by modes" if self.rate_cut is None else self.rate_cut

    def renewed(self, speeds: Speeds, step: Step, begins: Flag) -> Speeds:
        """Where a span begins after a step."""
        new = Speeds(self.begin(step.y1).now, speeds.now)
        return tree_where(begins, new, speeds)


def fastest(y: Vector4) -> Scalar:
    """The larger joint rate."""
    u1, u2 = joint_rates(y)
    return larger(jnp.abs(u1), jnp.abs(u2))


def decays(column: Column, y: Vector4, rate: Scalar) -> Flag:
    """Whether motions about this state, no faster than `rate`, are damped.

    Without friction the terms of Hurwitz' conditions are those of the equilibrium but
    for the motion's own size; what lies within that of the boundary does not count as
    damped, nor does a column that dissipates nothing.

    **Arguments:** `rate`: the largest of a joint; 0 where the motion stands still.
    """
    column, zero = prepared(column), 0.0 * y[0]
    free = column.friction is None and column.damping is None
    # beside rest, not at it: there a law of |u| has no slope to JAX
    sizes = (0,) if free else (BESIDE, 1, -1)
    # K's two columns, then C's two for each size, one after the other: a program of one
    rows = [(0.0, 0.0, 0.0, *joint) for joint in JOINTS]
    rows += [(size, *joint, 0.0, 0.0) for size in sizes for joint in JOINTS]

    def forces(*y):
        """Against the joints' own accelerations."""
        _, _, a1, a2 = field(zero, y, column)
        return -a1, a1 - a2

    def slopes(_, row):
        size, moved1, moved2, turned1, turned2 = row
        state = (y[0], y[1], size * rate * moved1, size * rate * moved2)
        direction = (turned1, turned2, moved1, moved2)
        return None, jax.jvp(forces, state, tuple(x + zero for x in direction))[1]

    rows = tuple(map(jnp.asarray, zip(*rows, strict=True)))
    _, forces_along = lax.scan(slopes, None, rows)
    along = jnp.stack(forces_along)  # by force, and by row
    (k11, k12), (k21, k22) = along[:, :2]
    # by force, size and joint: the slope at rest, those at the largest rates, and some
    # from one to the other
    rates = along[:, 2:].reshape(2, len(sizes), 2)
    shares = jnp.reshape(jnp.asarray(SHARES), (1, -1, 1, 1))
    between = rates[:, None, :1] + shares * (rates - rates[:, :1])[:, None]
    damping = between.reshape(2, -1, 2)  # by force, and by joint
    # each damping of one joint with each of the other
    (c11, c21), (c12, c22) = damping[:, :, None, 0], damping[:, None, :, 1]
    unsure = 0.0
    if column.friction is None:
        unsure = rate * (rate + jnp.abs(y[0]) + jnp.abs(y[1]))
    damped = _damped(
        unsure,
        c11 + c22,
        c11 * c22 - c12 * c21 + k11 + k22,
        c11 * k22 + c22 * k11 - c12 * k21 - c21 * k12,
        k11 * k22 - k12 * k21,
    )
    return jnp.all(damped) | (rate == 0)


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
