r"""When two windows of a motion agree: it repeats, or nothing in it dissipates.

Of each joint's angle $\theta_j$ a window keeps the swing $S_j = \max\theta_j -
\min\theta_j$: offsets are not in it. Two windows agree if each joint that moves at all,
$S_j$ above the noise of the steps, has turned back at least twice in the same
direction, so that the window holds a whole return, and

$$|S_j - S_j'| \le \epsilon\, S_j + \mathrm{atol}.$$

That alone is no repetition: where little dissipates a motion decays by less. With $W$
what friction and damping took out over both windows, and $\Delta E$ the change of the
energy from the start of the first to the end of the second, a motion that repeats has
$|\Delta E| \le W / 2$, as the load pays for the losses. Without load $\Delta E = -W$.
Nor may W be so small that the steps' own error of the energy, some $(\mathrm{rtol} +
\mathrm{atol} / S)\,E$ a unit of time, hides what is not paid. Where W = 0 no motion
attracts: another start swings otherwise.
"""

from typing import NamedTuple

import jax.numpy as jnp

from ..model.column import Column, dissipated, energy, power
from ..motion.observers import joint_rates
from ..numerics.numbers import Pair, Scalar, Traced, Traced4, Vector4
from ..results import OUTCOME
from ..solvers import Step

TURNS = 2.0  # downward turns of a joint, between which one return lies
NOTHING = 1e-10  # of the energy: what rounding leaves of the losses of a window
PAID = 0.5  # of the losses
# Of (rtol + atol / S) E a unit of time: by so much the losses must exceed it. Of 128
# columns without load, at 1e-5 to 1e-8, steps changed the energy by up to 23 (Taylor),
# 21 (Tsit5), 4 (Dopri8) and 3 (Rodas5P), in the median by 1.
DOUBT = 100.0


class Window(NamedTuple):
    """What a window has seen beside the observers."""

    turns: Pair  # how often each joint's angle has turned down
    lost: Traced  # what friction and damping have taken out
    loss: Traced  # and take out a unit of time at the last step's end
    energy: Traced  # at the window's start


class Before(NamedTuple):
    """What is kept of the window before."""

    swings: Pair
    lost: Traced
    energy: Traced


class Noise(NamedTuple):
    """What the steps' own error does."""

    floor: Scalar  # the swing that it leaves at rest
    rtol: Scalar
    atol: Scalar


class Agreement(NamedTuple):
    """How two windows compare."""

    drift: Scalar  # the largest change of a swing, relative
    outcome: Scalar  # `not_computed` where they do not agree


def begun(column: Column, y: Traced4, loss: Traced) -> Window:
    """At a window's start."""
    zero = 0.0 * y[0]
    return Window((zero, zero), zero, loss, energy(column, y))


def watched(column: Column, window: Window, step: Step) -> Window:
    """After a step."""
    pairs = zip(window.turns, joint_rates(step.y0), joint_rates(step.y1), strict=True)
    turns = tuple(n + jnp.where((a > 0) & (b <= 0), 1.0, 0.0) for n, a, b in pairs)
    loss = loss_at_end(column, step)
    lost = window.lost + (step.t1 - step.t0) * (window.loss + loss) / 2
    return window._replace(turns=turns, lost=lost, loss=loss)


def loss_at_end(column: Column, step: Step) -> Traced:
    """What friction and damping take out a unit of time, where a step ends."""
    if not step.modes:  # the accelerations there are those of the laws, to rounding
        return jnp.asarray(dissipated(column, step.y1, (step.f1[2], step.f1[3])))
    _, *losses = power(column, step.y1)
    there = [loss for loss in losses if loss is not None]
    return jnp.asarray(sum(there, 0.0 * step.y1[0]))


def compared(
    column: Column,
    before: Before,
    window: Window,
    swings: Pair,
    y: Vector4,
    agreement: Scalar,
    time: Scalar,
    noise: Noise,
) -> Agreement:
    """How a window compares with the one before.

    **Arguments:** `swings`: the window's, which ends at y; `time`: of both windows.
    """
    floor, rtol, atol = noise
    agrees, moves = jnp.asarray(True), jnp.asarray(False)
    drift = 0.0 * y[0]
    for swing, other, turns in zip(swings, before.swings, window.turns, strict=True):
        change, still = jnp.abs(swing - other), (swing <= floor) & (other <= floor)
        same = (turns >= TURNS) & (change <= agreement * swing + atol)
        agrees &= still | same
        moves |= jnp.logical_not(still)
        relative = change / jnp.where(still, 1.0, jnp.maximum(swing, other))
        drift = jnp.maximum(drift, jnp.where(still, 0.0, relative))
    lost, now = before.lost + window.lost, energy(column, y)
    size = jnp.maximum(now, before.energy)
    conserves = jnp.abs(lost) <= NOTHING * size
    paid = jnp.abs(now - before.energy) <= PAID * lost
    share = rtol + atol / jnp.maximum(jnp.maximum(*swings), atol)
    paid &= lost > DOUBT * share * time * size
    kind = jnp.where(paid, OUTCOME.repeats, OUTCOME.not_computed)
    kind = jnp.where(conserves, OUTCOME.conservative, kind)
    outcome = jnp.where(agrees & moves, kind, OUTCOME.not_computed)
    return Agreement(drift, outcome)
