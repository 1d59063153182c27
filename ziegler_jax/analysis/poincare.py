r"""Poincare sections: where a motion passes a plane of its phase space.

A periodic motion leaves p points, a quasi-periodic one a closed curve, a chaotic one a
set that no curve holds.
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..model.column import Column, State
from ..model.state import PhasePoint
from ..motion.checks import check_scene
from ..motion.implicit import forward_only
from ..motion.method import explicit_method
from ..motion.not_finite import motion
from ..motion.options import Method, recorded
from ..motion.section import Passage, SectionPlane, passage
from ..motion.spans import AbstractSpans, follow_spans
from ..numerics.materialise import tree_where
from ..numerics.numbers import Flag, Scalar
from ..numerics.rules import instance, keeps, number, whole_number
from ..results import CODE, OUTCOMES, RATE, TIME, AbstractResult, Settings, quantity

LONGEST_PERIOD = 16  # passages


class CycleDetector(NamedTuple):
    """Brent's cycle detection on the passages of a section."""

    point: PhasePoint  # the reference
    time: Scalar
    since: Scalar  # so many passages; -1 before the first
    most: Scalar  # after so many the reference is renewed
    passages: Scalar  # the period in passages, once there is one; else 0
    period: Scalar
    nearest: Scalar  # the least relative distance from a reference, in this block
    growth: Scalar  # logarithm of the tangent's growth up to the reference
    confirmed: Bool[Array, ""]


def detect_cycle(
    returns: CycleDetector,
    here: Passage,
    growth: Scalar,
    rtol: Scalar,
    zero_rate: Scalar,
) -> CycleDetector:
    """Hear one passage more, up to which the tangent has grown by e^`growth`.

    A motion that lingers by an unstable cycle comes back as well; its tangents grow.
    """
    count = returns.since + 1.0
    apart, size = 0.0 * count, 0.0 * count
    for x, x0 in zip(here.y, returns.point, strict=True):
        apart = jnp.maximum(apart, jnp.abs(x - x0))
        size = jnp.maximum(size, jnp.abs(x0))
    back = (count > 0) & (apart <= rtol * size)
    first = back & (returns.passages == 0)
    again = (returns.passages > 0) & (count == 2 * returns.passages)
    # growth is no number where the tangent was lost: nothing grows there
    lingers = growth - returns.growth > zero_rate * (here.time - returns.time)
    repeats = again & back & ~lingers
    # a period that was not confirmed was none
    renew = (count == 0) | (again & jnp.logical_not(repeats))
    renew |= ~first & (returns.passages == 0) & (count >= returns.most)
    doubled = jnp.where(
        returns.most >= LONGEST_PERIOD, 1.0 + 0.0 * count, 2 * returns.most
    )
    new = CycleDetector(
        point=tree_where(renew, here.y, returns.point),
        time=jnp.where(renew, here.time, returns.time),
        since=jnp.where(renew, 0.0, count),
        most=jnp.where(renew & (count > 0), doubled, returns.most),
        passages=jnp.where(renew, 0.0, jnp.where(first, count, returns.passages)),
        period=jnp.where(first, here.time - returns.time, returns.period),
        nearest=jnp.minimum(returns.nearest, jnp.where(count > 0, apart / size, 1.0)),
        growth=jnp.where(renew, growth, returns.growth),
        confirmed=returns.confirmed | repeats,
    )
    return tree_where(here.there, new, returns)


def no_cycle(t: Scalar, y: PhasePoint) -> CycleDetector:
    """Before the first passage."""
    zero, one = 0.0 * y[0], 0.0 * y[0] + 1
    no = jnp.zeros((), bool)
    return CycleDetector(y, t + zero, zero - 1, one, zero, zero, one, zero, no)


class PoincareSection(AbstractResult):
    """Points of a section: `times` (n,), `phi` and `omega` (n, 2), NaN where none is.

    `count`: how many there are; `outcome`: `complete`, or why there are no more.
    """

    times: Float[Array, "*lanes n"] = eqx.field(
        metadata=quantity("time of the passage", TIME, ("point",))
    )
    phi: Float[Array, "*lanes n 2"] = eqx.field(
        metadata=quantity("angle on the section", "rad", ("point", "rod"))
    )
    omega: Float[Array, "*lanes n 2"] = eqx.field(
        metadata=quantity("rate on the section", RATE, ("point", "rod"))
    )
    count: Int[Array, "*lanes"] = eqx.field(metadata=quantity("passages"))
    steps: Int[Array, "*lanes"] = eqx.field(metadata=quantity("attempted steps"))
    outcome: Int[Array, "*lanes"] = eqx.field(
        metadata=quantity("how the motion ended", codes=OUTCOMES)
    )
    settings: Settings = eqx.field(static=True)


@motion
def poincare(
    column: Column,
    start: State,
    *,
    section: SectionPlane = SectionPlane(),
    points: int = 200,
    transient: Scalar = 200.0,
    max_time: Scalar = 5000.0,
    escape: Scalar = np.pi,
    method: Method = Method(),
) -> PoincareSection:
    r"""The motion's first passages through a plane after the transient.

    Each is found on the step's Hermite interpolants, quintics of the angles and their
    slopes, quartics, of the rates, $O(h^6)$ and $O(h^5)$ from the motion: with Tsit5 at
    1e-9 angles are within 1e-9, rates 4e-7, times 7e-9 (q = 2.6, $\tau$ = 0.026,
    v_smooth = 0.1). No better than the steps: at 1e-4 one that spans the layer of
    smoothed friction is off by some 3 % in a rate, and so are its passages.

    **Arguments:** (times in $\sqrt{m l^2/k}$)

    - `column`, `start`: the scene.
    - `section`: the plane, e.g. $\phi_1 = 0$ rising.
    - `points`: how many passages.
    - `transient`: passages before it do not count.
    - `max_time`: after the transient; passages after it do not count.
    - `escape`: a rod's angle in rad beyond which the motion ends as `escaped`.
    - `method`: an explicit one.

    **Returns:** `PoincareSection`.

    **Derivatives:** forward, those of the steps and of where they pass the plane.
    Second ones are refused (`ValueError`) with set-valued friction.

    **Raises:** `ValueError` for arguments that break a rule, and in a 32-bit
    session.
    """
    check_scene(column, start)
    instance("section", section, SectionPlane)
    first = number("transient", transient, "nonnegative")
    fold = SectionLog(
        transient=0.0,
        span=first + number("max_time", max_time, "positive"),
        most=1,
        escape=number("escape", escape, "positive"),
        size=whole_number("points", points),
        plane=section,
        first=first,
    )
    method = explicit_method("poincare", method)
    run = follow_spans(column, start, fold, method)
    log = run.folded.watch
    section_ = PoincareSection(
        times=log.times,
        phi=log.y[:, :2],
        omega=log.y[:, 2:],
        count=log.filled,
        steps=run.steps,
        outcome=run.outcome.astype(jnp.int8),
        settings=recorded(
            **method.settings(),
            **section.settings(),
            transient=first,
            max_time=number("max_time", max_time),
            points=fold.size,
            escape=fold.escape,
        ),
    )
    return forward_only("poincare", section_, once=column.sticks)


class SectionState(NamedTuple):
    """The points so far."""

    times: Float[Array, " n"]
    y: Float[Array, "n 4"]
    filled: Int[Array, ""]


class SectionLog(AbstractSpans[SectionState]):
    """Room for `size` passages in one span, none before the time `first`."""

    size: int
    plane: SectionPlane
    first: Scalar

    def valid(self) -> Flag:
        """Whether the options keep their rules; for those only known when traced."""
        good = keeps("nonnegative", self.first) & keeps("finite", self.plane.level)
        return super().valid() & good & keeps("positive", self.span - self.first)

    def begin(self, system, t0, y0):
        """No point yet."""
        del system, t0
        dtype = jnp.result_type(y0[0])
        return SectionState(
            jnp.full(self.size, jnp.nan, dtype),
            jnp.full((self.size, 4), jnp.nan, dtype),
            jnp.zeros((), jnp.int32),
        )

    def watch(self, system, state, step):
        """Log the step's passage, if any."""
        del system
        log, point = state.watch, passage(self.plane, step)
        there = point.there & (point.time >= self.first)
        row = jnp.where(there, log.filled, self.size)  # beyond: dropped
        log = SectionState(
            log.times.at[row].set(point.time, mode="drop"),
            log.y.at[row].set(jnp.stack(point.y), mode="drop"),
            log.filled + there.astype(jnp.int32),
        )
        return log, log.filled >= self.size, None

    def judge(self, system, state, step, ended):
        """Done where there is no more room, or no more time."""
        del system, step
        full = state.watch.filled >= self.size
        return state.watch, jnp.where(full | ended, CODE.complete, state.outcome)
