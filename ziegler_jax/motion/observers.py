r"""Observers of a motion: each folds over the accepted steps.

An observer keeps a few running numbers from the start of a window on and turns them
into a result at its end. One that is not asked for is not in the program.
"""

from __future__ import annotations

import abc
from typing import ClassVar, Generic, TypeVar, cast

import equinox as eqx
import jax
import jax.numpy as jnp

from ..model.chain import joint_angles
from ..model.state import PhasePoint
from ..model.system import System
from ..numerics.elementary import larger, smaller
from ..numerics.numbers import Flag, Joints, Numbers, OneOrEach, Scalar, each
from ..numerics.passages import share_within
from ..numerics.rules import keeps, number_or_each
from ..results import RATE, TIME, Units, Variable
from ..solvers import Step
from .section import SectionPlane, Swing, Turns, angles, passage, rod_angles

POWER = "k sqrt(k/(m l^2))"


Watched = TypeVar("Watched")  # an observer's running numbers


class AbstractObserver(eqx.Module, Generic[Watched]):
    """Running numbers over a window of the motion.

    An observer of your own, the largest rate of each joint:

    ```python
    class PeakRate(zj.AbstractObserver):
        name = "peak_rate"

        def init(self, system, t, y):
            return abs(y[2]), abs(y[3] - y[2])

        def step(self, system, state, step):
            w1, w2 = step.y1.omega
            return jnp.maximum(state[0], abs(w1)), jnp.maximum(state[1], abs(w2 - w1))

        def result(self, system, state, span, y):
            rates, unit = jnp.stack(state), "sqrt(k/(m l^2))"
            return {"peak_rate": zj.Variable(rates, "peak rate", unit, ("joint",))}

    def point(q):
        friction = zj.SmoothCoulomb(0.1, pin_radius=0.1, v_smooth=0.05)
        column, start = zj.uniform_rods(q, friction=friction), zj.State(omega=(0, 0.3))
        return zj.settle(column, start, observers=(PeakRate(),))

    ds = zj.sweep(point, q=[2.4, 2.6])
    ```

    It sees only the ends of the steps of the method: a peak that `step` computes is one
    at these ends, and the lower the longer the steps. (`Amplitude` finds the peaks of
    angles within steps.)

    A mean is an integral over the window by its `span`: `integrand` names the
    integrands, `step.integrals` are their integrals over a step, see `Step`. `system`
    has the column's numbers, computed once: `system.power(y)`, `system.energy(y)`,
    `system.friction_torques(y)` and `system.field(t, y)`. Where forces depend on time
    it is the system at the time of y.

    Write its numbers as its own fields. JAX remembers a global, or an attribute of
    another object, as it was when first traced: within one point of a sweep, and
    outside of `sweep` for good.
    """

    units: ClassVar[Units] = {}  # of its numbers, for `SI.scaled`
    name: ClassVar[str]  # no two of a motion have the same
    # whether half of a cycle that is its own mirror image tells as much as the whole
    mirrored: ClassVar[bool] = False

    def check(self, system: System) -> None:
        """Refuse a column that lacks what is to be observed (ValueError)."""
        del system

    def valid(self) -> Flag:
        """Whether the observer's numbers keep their rules; traced where they are."""
        return True

    def integrand(self, system: System, y: PhasePoint) -> Numbers:
        """A tuple of functions of the state, integrated over each step to its order."""
        del system, y
        return ()

    def init(self, system: System, t: Scalar, y: PhasePoint) -> Watched:
        """The running numbers at a window's start, any tree of numbers; else a zero.

        Each keeps its type and shape: write `0.0 * y[0]` for a zero.
        """
        del system, t
        return cast(Watched, 0.0 * y[0])

    @abc.abstractmethod
    def step(self, system: System, state: Watched, step: Step) -> Watched:
        """The running numbers after an accepted step, a `Step`."""

    @abc.abstractmethod
    def result(
        self, system: System, state: Watched, span: Scalar, y: PhasePoint
    ) -> dict[str, Variable]:
        """The variables, by name, of the window of length `span`, which ended at y."""


ROD_AMPLITUDE = Variable(None, "largest absolute angle of the rod", "rad", ("rod",))
JOINT_AMPLITUDE = Variable(
    None, "largest absolute angle of the joint", "rad", ("joint",)
)


class Amplitude(AbstractObserver):
    r"""The largest $|\phi_i|$ (rods) and $|\phi_i - \phi_{i-1}|$ (joints).

    Each step contributes the extremum of its quintic Hermite interpolant, a step of
    Taylor's that of its series, so that an amplitude does not depend on where the steps
    happen to end. Joint 1's angle is rod 1's.
    """

    name: ClassVar[str] = "amplitude"
    mirrored: ClassVar[bool] = True

    def init(self, system, t, y):
        """The start itself: of each angle the smallest and the largest value."""
        del system, t
        return tuple((x, x) for x in (*y.phi, *joint_angles(y.phi)[1:]))

    def step(self, system, state, step):
        """The wider of what was and the step's extrema."""
        del system
        after = []
        for (low, high), path in zip(state, angles(step), strict=True):
            least, most = path.extent()
            after.append((smaller(least, low), larger(most, high)))
        return tuple(after)

    @staticmethod
    def swings(state) -> Numbers:
        """By how much each joint's angle has varied."""
        n = (len(state) + 1) // 2
        return tuple(high - low for low, high in (state[0], *state[n:]))

    def result(self, system, state, span, y):
        """`rod_amplitude(rod)` and `joint_amplitude(joint)`."""
        del system, span
        peaks, n = [larger(-low, high) for low, high in state], len(y.phi)
        rod, joint = jnp.stack(peaks[:n]), jnp.stack([peaks[0], *peaks[n:]])
        return {
            "rod_amplitude": ROD_AMPLITUDE._replace(value=rod),
            "joint_amplitude": JOINT_AMPLITUDE._replace(value=joint),
        }


class Mean(AbstractObserver):
    r"""The mean angles $\bar\phi_i$, of a stuck motion its place of rest.

    The result has one number a rod, in rad.
    """

    name: ClassVar[str] = "mean"

    def init(self, system, t, y):
        """Zero area."""
        del system, t
        return tuple(0.0 * x for x in y.phi)

    def step(self, system, state, step):
        """Add the integral of the step's course."""
        del system
        h = step.t1 - step.t0
        pairs = zip(state, rod_angles(step), strict=True)
        return tuple(total + h * path.mean() for total, path in pairs)

    def result(self, system, state, span, y):
        """`mean_angle(rod)`: area over time."""
        del system, y
        mean = jnp.stack(state) / span
        return {"mean_angle": Variable(mean, "mean angle of the rod", "rad", ("rod",))}


class Period(AbstractObserver):
    r"""The mean time between upward passages of $\phi_1$ through zero.

    Where the chain is bent or pushed aside, or may be, by forces of your own, they are
    counted through the middle of what $\phi_1$ has swung over in the window, from where
    it has turned both ways: through a level that moves while the motion grows.

    That is the period of a cycle that passes once; of one that passes n times a period
    it is the n-th part. Fewer than two passages in the window: NaN, as of a rod 1 that
    sticks, or of an upright chain that has buckled and swings on one side of zero.
    Where a cycle is certified, `period` is that of the orbit, whether asked for or not.
    """

    name: ClassVar[str] = "period"

    def init(self, system, t, y):
        """Before the first passage: their number, the first and the last; no turn."""
        zero = 0.0 * y[0]
        turns = Turns(Swing(y[0], y[0]), zero, zero) if system.displaced else ()
        return zero, t + zero, t + zero, turns

    def step(self, system, state, step):
        """Count the step's passage."""
        del system
        count, first, last, turns = state
        plane = SectionPlane(level=turns.swing.level) if turns else SectionPlane()
        there, time, _ = passage(plane, step)
        if turns:
            there &= turns.both
        return (
            count + jnp.where(there, 1.0, 0.0),
            jnp.where(there & (count == 0), time, first),
            jnp.where(there, time, last),
            turns.after(step) if turns else (),
        )

    def result(self, system, state, span, y):
        """`period`: time between first and last, by the number of returns."""
        del span, y
        count, first, last, _ = state
        returns = jnp.where(count >= 2, count - 1, 1.0)
        period = jnp.where(count >= 2, (last - first) / returns, jnp.nan)
        where = "the middle of its swing" if system.displaced else "zero"
        meaning = (
            f"mean time between upward passages of phi1 through {where}, "
            "NaN of fewer than two"
        )
        return {"period": Variable(period, meaning, TIME)}


class StickFraction(AbstractObserver):
    r"""The share of time in which a joint sticks: $|u_i| <$ `rate_cut`.

    Under a smoothed law a joint never sticks, it creeps: the cut defines sticking. With
    set-valued friction the modes define it, unless a cut is named.
    The time below the cut lies between the passages of the rate through $\pm$`rate_cut`
    on each step's quintic of the angle, $O(h^5)$ from the rate's course, or on its
    series, and moves with them: the fraction has a derivative as exact as the motion.
    The passages are looked for in halves of a step, so not exactly on the long steps of
    `Taylor(order)` above 8, with a cut: those of order 20 leave 5e-4. At the edge of
    sticking, where the rate's extremum just reaches the cut, the fraction has a
    vertical tangent.
    The result has one number a joint.

    **Arguments:** `rate_cut`: in $\sqrt{k/(m l^2)}$, one number or one a joint; None is
    the friction law's own (`v_smooth` of the smoothed law, below which its torque has
    not risen to its peak).
    """

    units: ClassVar = {"rate_cut": RATE}

    rate_cut: OneOrEach | None = None
    name: ClassVar[str] = "stick_fraction"
    mirrored: ClassVar[bool] = True

    def __init__(self, rate_cut: Joints | None = None):
        """Keep the cut."""
        self.rate_cut = (
            None
            if rate_cut is None
            else number_or_each("rate_cut", rate_cut, "positive")
        )

    def valid(self):
        """Positive cuts."""
        if self.rate_cut is None:
            return True
        return keeps("positive", *each(self.rate_cut, 1))

    def check(self, system):
        """Without friction nothing sticks, unless the cut is named."""
        if system.friction is None and self.rate_cut is None:
            raise ValueError(
                "Argument `rate_cut` of `StickFraction` must be given for a column "
                "without friction, but is None."
            )
        cut, n = self.rate_cut, system.joints
        if isinstance(cut, tuple) and len(cut) != n:
            raise ValueError(
                "Argument `rate_cut` of `StickFraction` must be one number, or one for "
                f"each of {n} joints, but is {len(cut)} numbers."
            )

    def init(self, system, t, y):
        """Zero time."""
        del system, t
        return (0.0 * y[0],) * len(y.phi)

    def step(self, system, state, step):
        """Add the step's time below the cut."""
        cut = self.rate_cut
        if cut is None:
            cut = system.rate_cut
        h = step.t1 - step.t0
        if cut is None:
            return tuple(
                time + jnp.where(m == 0, h, 0.0)
                for time, m in zip(state, step.modes, strict=True)
            )
        n = len(state)
        paths = angles(step)
        joints = (paths[0], *paths[n:])  # joint 1's angle is rod 1's
        return tuple(
            time + h * share_within(path, h * c)
            for time, path, c in zip(state, joints, each(cut, n), strict=True)
        )

    def result(self, system, state, span, y):
        """`stick_fraction(joint)`: time over time."""
        del system, y
        meaning = "share of time in which the joint sticks"
        share = Variable(jnp.stack(state) / span, meaning, "1", ("joint",))
        return {"stick_fraction": share}


class EnergyBalance(AbstractObserver):
    r"""Power of the load, losses by damping and friction, each per unit time.

    The powers are integrated with the stages of the method, to its order.
    `energy_imbalance` is the remainder of $\Delta E = W_{load} - W_{damping} -
    W_{friction} + W_{forces}$ per unit time: the energy error of the integration.
    """

    name: ClassVar[str] = "power"
    mirrored: ClassVar[bool] = True

    def integrand(self, system, y):
        """The powers that the column has."""
        return tuple(p for p in system.power(y) if p is not None)

    def init(self, system, t, y):
        """The energy at the start, and no work yet."""
        del t
        works = jax.eval_shape(lambda: self.integrand(system, y))
        return system.energy(y), tuple(0.0 * y[0] for _ in works)

    def step(self, system, state, step):
        """Add the step's work."""
        del system
        start, works = state
        return start, tuple(w + dw for w, dw in zip(works, step.integrals, strict=True))

    def result(self, system, state, span, y):
        """`follower_power`, `damping_power`, `friction_power`, `force_power`.

        Of these what there is, and `energy_imbalance`.
        """
        start, works = state
        means = iter(w / span for w in works)
        gain, gained = next(means), "mean power of the follower load"
        powers = {"follower_power": (gain, gained)}
        if system.damping is not None:
            powers["damping_power"] = next(means), "mean power lost in damping"
        if system.friction is not None:
            powers["friction_power"] = next(means), "mean power lost in joint friction"
        _, *losses = (power for power, _ in powers.values())
        if system.own.forces:
            fed = next(means)
            powers["force_power"] = fed, "mean power of forces of one's own"
            gain = gain + fed
        change = (system.energy(y) - start) / span
        error = change - gain + sum(losses)
        powers["energy_imbalance"] = error, "energy error per unit time"
        return {
            name: Variable(value, meaning, POWER)
            for name, (value, meaning) in powers.items()
        }
