r"""The criterion by which two windows agree: the motion repeats, or is conservative.

For each joint's angle $\theta_j$ a window has the swing
$S_j = \max\theta_j - \min\theta_j$, without the offset. Two windows agree if each
moving joint, with $S_j$ above the noise of the steps, has turned back at least twice in
the same direction, so that the window contains one return, and

$$|S_j - S_j'| \le \epsilon\, S_j + \mathrm{atol}.$$

That is not sufficient: where little dissipates a motion decays by less. Let $W$ be the
loss by friction and damping over both windows. In a motion that repeats, the work of
the load covers this loss. A period may have several turns of a joint, each with its
energy. The least energies of the two windows must agree within $W / 8$, and so must the
greatest; without load they fall by half of W. All of them must lie within $10\,W$: else
they might agree by chance, as the load's work comes and goes. A motion that drifts by
less, on its way past an unstable cycle or where the equilibrium begins to flutter,
repeats as far as two windows can tell.

W must also exceed the steps' own error of the energy, some $(\mathrm{rtol} +
\mathrm{atol} / S)\,E$ a unit of time, which could hide a loss that is not covered. With
W = 0 no motion attracts: another start swings otherwise.
"""

from collections.abc import Callable, Sequence
from functools import reduce
from typing import NamedTuple

import jax.numpy as jnp

from ..model.chain import joint_angles
from ..model.state import PhasePoint
from ..model.system import EnergyRate, System
from ..numerics.elementary import larger, smaller
from ..numerics.hermite import HermiteQuartic, cubic
from ..numerics.numbers import Flag, Numbers, Scalar
from ..results import CODE
from ..solvers import Step

TURNS = 2.0  # downward turns of a joint, between which one return lies
NOTHING = 1e-10  # of the energy: what rounding leaves of the losses of a window
# Of the losses: by what the least and the greatest energy at turns may change from one
# window to the next, and how far they may be apart. Of 6000 columns of weak dry
# friction that decay (eta 0, 0.5) none repeats; with the first alone 3.
PAID, APART = 1 / 8, 10.0
# Of (rtol + atol / S) E a unit of time: by so much the losses must exceed it. Of 128
# columns without load, at 1e-5 to 1e-8, steps changed the energy by up to 23 (Taylor),
# 21 (Tsit5), 4 (Dopri8) and 3 (Rodas5P), in the median by 1.
DOUBT = 100.0


class Window(NamedTuple):
    """The numbers of a window beside those of the observers."""

    turns: Numbers  # how often each joint's angle has turned down
    low: Numbers  # the least energy where it did
    high: Numbers  # the greatest
    lost: Scalar  # what friction and damping have taken out
    now: EnergyRate  # at the last step's end


class Before(NamedTuple):
    """The numbers of the previous window."""

    swings: Numbers
    low: Numbers
    high: Numbers
    lost: Scalar


class Noise(NamedTuple):
    """The effect of the steps' own error."""

    floor: Scalar  # the swing that it leaves at rest
    rtol: Scalar
    atol: Scalar


class Agreement(NamedTuple):
    """How two windows compare."""

    drift: Scalar  # the largest change of a swing, relative
    outcome: Scalar  # `not_computed` where they do not agree


def begun(now: EnergyRate, joints: int) -> Window:
    """At a window's start."""
    zero = 0.0 * now.energy
    none, least, most = ((x,) * joints for x in (zero, zero + jnp.inf, zero - jnp.inf))
    return Window(none, least, most, zero, now)


def at_start(system: System, y: PhasePoint) -> EnergyRate:
    """Where no step has told how the energy changes."""
    zero = 0.0 * y[0]
    return EnergyRate(system.energy(y), zero, zero)


def at_end(system: System, step: Step) -> EnergyRate:
    """Where a step ends."""
    system = system.at(step.t1)
    if not step.modes:
        return system.energy_rate(step.y1, step.f1.omega)
    # the last accelerations are not quite those at its end
    there = system.energy(step.y1)
    fed, *losses, own = system.power(step.y1)
    loss = sum((x for x in losses if x is not None), 0.0 * there)
    rate, more = fed - loss, system.own.dissipated(step.y1.phi, step.y1.omega)
    if own is not None and more is not None:
        rate, loss = rate + own, loss + more
    return EnergyRate(there, rate, loss)


def watched(system: System, window: Window, step: Step) -> Window:
    """After a step."""
    h, before, after = step.t1 - step.t0, window.now, at_end(system, step)
    course = cubic(before.energy, after.energy, h * before.rate, h * after.rate)
    ends = step.y0.omega, step.y1.omega, step.f0.omega, step.f1.omega
    rates = zip(*map(joint_angles, ends), strict=True)
    turned = [turn(cubic(u0, u1, h * v0, h * v1), course) for u0, u1, v0, v1 in rates]
    turns, low, high = window.turns, window.low, window.high
    turns = of_each(lambda by, n: n + jnp.where(by[0], 1.0, 0.0), turned, turns)
    low = of_each(lambda by, x: smaller(x, jnp.where(by[0], by[1], x)), turned, low)
    high = of_each(lambda by, x: larger(x, jnp.where(by[0], by[1], x)), turned, high)
    lost = window.lost + h * (before.loss + after.loss) / 2
    return Window(turns, low, high, lost, now=after)


def of_each(function: Callable[..., Scalar], one: Sequence, other: Sequence) -> Numbers:
    """A function of one joint's numbers, for each joint."""
    return tuple(map(function, one, other))


def turn(rate: HermiteQuartic, energy: HermiteQuartic) -> tuple[Flag, Scalar]:
    """Whether a joint's rate falls through zero in a step, and the energy there.

    The place is the chord's and one step of Newton's method.
    """
    down = (rate.g0 > 0) & (rate.g1 <= 0)
    x = rate.g0 / jnp.where(down, rate.g0 - rate.g1, 1.0)
    slope = rate.slope(x)
    x = x - rate(x) / jnp.where(slope < 0, slope, -jnp.inf)
    return down, energy(jnp.clip(x, 0.0, 1.0))


def compared(
    before: Before,
    window: Window,
    swings: Numbers,
    agreement: Scalar,
    time: Scalar,
    noise: Noise,
) -> Agreement:
    """How a window compares with the one before.

    **Arguments:** `swings`: the window's; `time`: of both windows.
    """
    floor, rtol, atol = noise
    agrees, moves, paid = jnp.asarray(True), jnp.asarray(False), jnp.asarray(False)
    drift, lost = 0.0 * window.lost, before.lost + window.lost
    energies = before.low, window.low, before.high, window.high
    joints = swings, before.swings, window.turns, *energies
    for swing, other, turns, low0, low1, high0, high1 in zip(*joints, strict=True):
        change, still = jnp.abs(swing - other), (swing <= floor) & (other <= floor)
        same = (turns >= TURNS) & (change <= agreement * swing + atol)
        agrees &= still | same
        moves |= jnp.logical_not(still)
        moved = larger(jnp.abs(low1 - low0), jnp.abs(high1 - high0))
        apart = larger(high0, high1) - smaller(low0, low1)
        pays = (moved <= PAID * lost) & (apart <= APART * lost)
        paid |= jnp.logical_not(still) & pays
        relative = change / jnp.where(still, 1.0, jnp.maximum(swing, other))
        drift = jnp.maximum(drift, jnp.where(still, 0.0, relative))
    highest = reduce(larger, window.high)
    size = larger(window.now.energy, jnp.where(moves, highest, 0.0))
    conserves = jnp.abs(lost) <= NOTHING * size
    share = rtol + atol / jnp.maximum(reduce(jnp.maximum, swings), atol)
    paid &= lost > DOUBT * share * time * size
    kind = jnp.where(paid, CODE.repeats, CODE.not_computed)
    kind = jnp.where(conserves, CODE.conservative, kind)
    outcome = jnp.where(agrees & moves, kind, CODE.not_computed)
    return Agreement(drift, outcome)
