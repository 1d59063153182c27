r"""Poincare sections: where a motion passes a plane of its phase space.

A periodic motion leaves p points, a quasi-periodic one a closed curve, a chaotic one a
set that no curve holds.
"""

from typing import Any, Literal, NamedTuple, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..model.column import Column, State
from ..motion.integrate import Method, Motion, follow
from ..motion.not_finite import motion
from ..motion.scene import (
    check_scene,
    explicit_method,
    float_state,
    tolerances,
    valid_scene,
    whole_number,
)
from ..motion.section import Passage, Plane, passage
from ..numerics.numbers import Scalar, Vector4, keeps, number
from ..results import OUTCOME
from ..solvers import AbstractFold, Explicit

Coordinate = Literal["phi1", "phi2", "omega1", "omega2"]
COORDINATES = get_args(Coordinate)
LONGEST_PERIOD = 16  # passages


class Returns(NamedTuple):
    """Brent's cycle detection on the passages of a section."""

    point: Vector4  # the reference
    time: Scalar
    count: Scalar  # passages since; -1 before the first
    most: Scalar  # after so many the reference is renewed
    found: Scalar  # the period in passages, once seen; else 0
    period: Scalar
    nearest: Scalar  # the least relative distance from a reference, in this block
    growth: Scalar  # logarithm of the tangent's growth up to the reference
    confirmed: Any


def returned(
    returns: Returns, seen: Passage, growth: Scalar, rtol: Scalar, zero_rate: Scalar
) -> Returns:
    """Hear one passage more, up to which the tangent has grown by e^`growth`.

    A motion that lingers by an unstable cycle comes back as well; its tangents grow.
    """
    count = returns.count + 1.0
    apart, size = 0.0 * count, 0.0 * count
    for x, x0 in zip(seen.y, returns.point, strict=True):
        apart = jnp.maximum(apart, jnp.abs(x - x0))
        size = jnp.maximum(size, jnp.abs(x0))
    back = (count > 0) & (apart <= rtol * size)
    first = back & (returns.found == 0)
    again = (returns.found > 0) & (count == 2 * returns.found)
    # growth is no number where the tangent was lost: nothing grows there
    lingers = growth - returns.growth > zero_rate * (seen.time - returns.time)
    repeats = again & back & ~lingers
    # a period that was not confirmed was none
    renew = (count == 0) | (again & ~repeats)
    renew |= ~first & (returns.found == 0) & (count >= returns.most)
    doubled = jnp.where(
        returns.most >= LONGEST_PERIOD, 1.0 + 0.0 * count, 2 * returns.most
    )
    new = Returns(
        point=jax.tree.map(lambda a, b: jnp.where(renew, a, b), seen.y, returns.point),
        time=jnp.where(renew, seen.time, returns.time),
        count=jnp.where(renew, 0.0, count),
        most=jnp.where(renew & (count > 0), doubled, returns.most),
        found=jnp.where(renew, 0.0, jnp.where(first, count, returns.found)),
        period=jnp.where(first, seen.time - returns.time, returns.period),
        nearest=jnp.minimum(returns.nearest, jnp.where(count > 0, apart / size, 1.0)),
        growth=jnp.where(renew, growth, returns.growth),
        confirmed=returns.confirmed | repeats,
    )
    return jax.tree.map(lambda a, b: jnp.where(seen.there, a, b), new, returns)


def no_returns(t: Any, y: Vector4) -> Returns:
    """Before the first passage."""
    zero = 0.0 * y[0]
    no = jnp.zeros((), bool)
    return Returns(y, t + zero, zero - 1, zero + 1, zero, zero, zero + 1, zero, no)


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
    rtol, atol = tolerances(rtol, atol)
    if coordinate not in COORDINATES:
        raise ValueError(
            f"Argument `coordinate` must be one of {', '.join(COORDINATES)}, but is "
            f"{coordinate!r}."
        )
    level = number("level", level)
    fold = SectionLog(
        size=whole_number("points", points),
        plane=Plane(COORDINATES.index(coordinate), level, bool(rising)),
        transient=number("transient", transient, "nonnegative"),
        span=number("span", span, "positive"),
        escape=number("escape", escape, "positive"),
    )
    y0 = float_state(start)
    good = valid_scene(column, y0) & fold.valid() & keeps("positive", rtol, atol)
    end = fold.transient + fold.span
    limit = whole_number("max_steps", max_steps)
    run = follow(
        Motion(
            column,
            y0,
            fold,
            Method(explicit_method(solver, Explicit()), rtol, atol, limit),
            valid=good,
            first_stop=end,
            end=end + fold.span,
        )
    )
    seen = run.folded
    return Section(
        times=seen.times,
        phi=seen.y[:, :2],
        omega=seen.y[:, 2:],
        count=seen.count,
        steps=run.steps,
        outcome=run.outcome.astype(jnp.int8),
    )


class SectionState(NamedTuple):
    """The points so far."""

    times: Any
    y: Any
    count: Any
    outcome: Scalar


class SectionLog(AbstractFold):
    """Room for `size` passages."""

    size: int
    plane: Plane
    transient: Scalar
    span: Scalar
    escape: Scalar

    def valid(self) -> Any:
        """Whether the options keep their rules; for those only known when traced."""
        good = keeps("nonnegative", self.transient) & keeps("finite", self.plane.level)
        return good & keeps("positive", self.span, self.escape)

    def integrand(self, column):
        """Nothing."""
        del column
        return None

    def init(self, column, t0, y0):
        """No point yet."""
        del column, t0
        dtype = jnp.result_type(y0[0])
        return SectionState(
            jnp.full(self.size, jnp.nan, dtype),
            jnp.full((self.size, 4), jnp.nan, dtype),
            jnp.zeros((), jnp.int32),
            jnp.asarray(OUTCOME.not_computed, jnp.int32),
        )

    def step(self, column, state, step):
        """Keep the step's passage, if any."""
        del column
        found = passage(self.plane, step)
        end = self.transient + self.span
        there = found.there & (found.time >= self.transient)
        row = jnp.where(there, state.count, self.size)  # beyond: dropped
        times = state.times.at[row].set(found.time, mode="drop")
        y = state.y.at[row].set(jnp.stack(found.y), mode="drop")
        count = state.count + there.astype(jnp.int32)
        over = (count >= self.size) | (step.t1 >= end)
        outcome = jnp.where(over, OUTCOME.complete, state.outcome)
        turned = jnp.maximum(jnp.abs(step.y1[0]), jnp.abs(step.y1[1])) > self.escape
        outcome = jnp.where(turned, OUTCOME.escaped, outcome).astype(jnp.int32)
        after = SectionState(times, y, count, outcome)
        return after, end, outcome != OUTCOME.not_computed
