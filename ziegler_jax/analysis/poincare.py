r"""Poincare sections: where a motion passes a plane of its phase space.

A periodic motion leaves p points, a quasi-periodic one a closed curve, a chaotic one a
set that no curve holds.
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..model.chain_of_rods import AbstractChain
from ..model.column import check_autonomous
from ..model.state import State
from ..motion.checks import check_scene
from ..motion.implicit import forward_only
from ..motion.method import explicit_method
from ..motion.not_finite import motion
from ..motion.options import Method, recorded
from ..motion.section import SectionPlane, passage
from ..motion.spans import AbstractSpans, follow_spans
from ..numerics.numbers import Flag, Scalar
from ..numerics.rules import instance, keeps, number, whole_number
from ..results import CODE, OUTCOMES, RATE, TIME, AbstractResult, Settings, quantity


class PoincareSection(AbstractResult):
    """Points of a section: `times` (n,), `phi` and `omega` (n, rods).

    Where there is none they are NaN. `count`: how many there are; `outcome`:
    `complete`, or why there are no more.
    """

    times: Float[Array, "*lanes n"] = eqx.field(
        metadata=quantity("time of the passage", TIME, ("point",))
    )
    phi: Float[Array, "*lanes n rods"] = eqx.field(
        metadata=quantity("angle on the section", "rad", ("point", "rod"))
    )
    omega: Float[Array, "*lanes n rods"] = eqx.field(
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
    column: AbstractChain,
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
    v_smooth = 0.1). Passages are as good as the steps: at 1e-4 a step that spans the
    layer of smoothed friction has an error of some 3 % in a rate.

    **Arguments:** (times in $\sqrt{m l^2/k}$)

    - `column`, `start`: the column or chain, and the state in which its motion starts.
    - `section`: the plane, e.g. $\phi_1 = 0$ rising.
    - `points`: the number of passages.
    - `transient`: passages before it do not count.
    - `max_time`: after the transient; passages after it do not count.
    - `escape`: a rod's angle in rad beyond which the motion ends as `escaped`.
    - `method`: an explicit one.

    **Returns:** `PoincareSection`.

    **Derivatives:** forward, of the steps and of their passage through the plane.
    Second ones are refused (`ValueError`) with set-valued friction.

    **Raises:** `ValueError` for arguments that break a rule, and in a 32-bit
    session.
    """
    check_scene(column, start)
    check_autonomous("poincare", column)
    instance("section", section, SectionPlane)
    section.place(column.joints)  # else it is refused
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
        phi=log.y[:, : column.joints],
        omega=log.y[:, column.joints :],
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
    y: Float[Array, "n numbers"]
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
        """The section before its first point."""
        del system, t0
        dtype = jnp.result_type(y0[0])
        return SectionState(
            jnp.full(self.size, jnp.nan, dtype),
            jnp.full((self.size, len(y0)), jnp.nan, dtype),
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
