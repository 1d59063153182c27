r"""Poincare sections: where a motion passes a plane of its phase space.

A periodic motion leaves p points, a quasi-periodic one a closed curve, a chaotic one a
set that no curve holds.
"""

from typing import Any, Literal, NamedTuple, get_args

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ..model.column import Column, State
from ..motion.not_finite import motion
from ..motion.scene import check_scene
from ..motion.section import Passage, Plane, passage
from ..motion.windows import AbstractSpans, explicit_steps, follow_spans
from ..numerics.materialise import tree_where
from ..numerics.numbers import Scalar, Vector4, choice, keeps, number, whole_number
from ..results import OUTCOME
from ..solvers import Explicit

Coordinate = Literal["phi1", "phi2", "omega1", "omega2"]
COORDINATES = get_args(Coordinate)
LONGEST_PERIOD = 16  # passages


class CycleDetector(NamedTuple):
    """Brent's cycle detection on the passages of a section."""

    point: Vector4  # the reference
    time: Scalar
    count: Scalar  # passages since; -1 before the first
    most: Scalar  # after so many the reference is renewed
    passages: Scalar  # the period in passages, once there is one; else 0
    period: Scalar
    nearest: Scalar  # the least relative distance from a reference, in this block
    growth: Scalar  # logarithm of the tangent's growth up to the reference
    confirmed: Any


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
    count = returns.count + 1.0
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
    renew = (count == 0) | (again & ~repeats)
    renew |= ~first & (returns.passages == 0) & (count >= returns.most)
    doubled = jnp.where(
        returns.most >= LONGEST_PERIOD, 1.0 + 0.0 * count, 2 * returns.most
    )
    new = CycleDetector(
        point=tree_where(renew, here.y, returns.point),
        time=jnp.where(renew, here.time, returns.time),
        count=jnp.where(renew, 0.0, count),
        most=jnp.where(renew & (count > 0), doubled, returns.most),
        passages=jnp.where(renew, 0.0, jnp.where(first, count, returns.passages)),
        period=jnp.where(first, here.time - returns.time, returns.period),
        nearest=jnp.minimum(returns.nearest, jnp.where(count > 0, apart / size, 1.0)),
        growth=jnp.where(renew, growth, returns.growth),
        confirmed=returns.confirmed | repeats,
    )
    return tree_where(here.there, new, returns)


def no_cycle(t: Any, y: Vector4) -> CycleDetector:
    """Before the first passage."""
    zero, one = 0.0 * y[0], 0.0 * y[0] + 1
    no = jnp.zeros((), bool)
    return CycleDetector(y, t + zero, zero - 1, one, zero, zero, one, zero, no)


class Section(eqx.Module):
    """Points of a section: `times` (n,), `phi` and `omega` (n, 2), NaN where none is.

    `count`: how many there are; `outcome`: `complete`, or why there are no more.
    """

    times: Any
    phi: Any
    omega: Any
    count: Any
    steps: Any
    outcome: Any


@motion
def poincare(
    column: Column,
    start: State,
    *,
    points: int = 200,
    coordinate: Coordinate = "phi1",
    level: Any = 0.0,
    rising: bool = True,
    transient: Any = 200.0,
    span: Any = 5000.0,
    rtol: Any = 1e-9,
    atol: Any = 1e-9,
    solver: Explicit | None = None,
    escape: Any = np.pi,
    max_steps: int = 10_000_000,
) -> Section:
    r"""The motion's first passages through a plane after the transient.

    Each is found on the step's Hermite interpolants, quintics of the angles and cubics
    of the rates, $O(h^6)$ and $O(h^4)$ from the motion: with Tsit5 at 1e-9 angles are
    within 1e-9, rates 4e-7, times 7e-9 (q = 2.6, $\tau$ = 0.026, v_smooth = 0.1).

    **Arguments:** (times in $\sqrt{m l^2/k}$)

    - `column`, `start`: the scene.
    - `points`: how many passages.
    - `coordinate`, `level`, `rising`: the plane, e.g. $\phi_1 = 0$ rising.
    - `transient`: passages before it do not count.
    - `span`: after the transient; passages after it do not count.
    - `rtol`, `atol`, `solver`, `escape`, `max_steps`: as `lyapunov_exponents`.

    **Returns:** `Section`.

    **Raises:** `ValueError` for arguments that break a rule, and in a 32-bit
    session.
    """
    check_scene(column, start)
    choice("coordinate", coordinate, COORDINATES)
    level = number("level", level)
    first = number("transient", transient, "nonnegative")
    fold = SectionLog(
        transient=0.0,
        span=first + number("span", span, "positive"),
        most=1,
        escape=number("escape", escape, "positive"),
        size=whole_number("points", points),
        plane=Plane(COORDINATES.index(coordinate), level, bool(rising)),
        first=first,
    )
    method = explicit_steps(solver, rtol, atol, max_steps)
    run = follow_spans(column, start, fold, method)
    log = run.folded.watch
    return Section(
        times=log.times,
        phi=log.y[:, :2],
        omega=log.y[:, 2:],
        count=log.count,
        steps=run.steps,
        outcome=run.outcome.astype(jnp.int8),
    )


class SectionState(NamedTuple):
    """The points so far."""

    times: Any
    y: Any
    count: Any


class SectionLog(AbstractSpans):
    """Room for `size` passages in one span, none before the time `first`."""

    size: int
    plane: Plane
    first: Scalar

    def valid(self) -> Any:
        """Whether the options keep their rules; for those only known when traced."""
        good = keeps("nonnegative", self.first) & keeps("finite", self.plane.level)
        return super().valid() & good & keeps("positive", self.span - self.first)

    def begin(self, column, t0, y0):
        """No point yet."""
        del column, t0
        dtype = jnp.result_type(y0[0])
        return SectionState(
            jnp.full(self.size, jnp.nan, dtype),
            jnp.full((self.size, 4), jnp.nan, dtype),
            jnp.zeros((), jnp.int32),
        )

    def watch(self, column, state, step):
        """Log the step's passage, if any."""
        del column
        log, point = state.watch, passage(self.plane, step)
        there = point.there & (point.time >= self.first)
        row = jnp.where(there, log.count, self.size)  # beyond: dropped
        log = SectionState(
            log.times.at[row].set(point.time, mode="drop"),
            log.y.at[row].set(jnp.stack(point.y), mode="drop"),
            log.count + there.astype(jnp.int32),
        )
        return log, log.count >= self.size, None

    def judge(self, column, state, step, ended):
        """Done where there is no more room, or no more time."""
        del column, step
        full = state.watch.count >= self.size
        return state.watch, jnp.where(full | ended, OUTCOME.complete, state.outcome)
