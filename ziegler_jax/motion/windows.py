"""The watch that `settle` keeps over a lane: windows, their agreement, the verdict."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from ..model.column import Column
from ..numerics.materialise import if_any_lane
from ..numerics.numbers import Scalar, Vector4, is_concrete, keeps
from ..results import OUTCOME
from ..solvers import AbstractFold, Step
from .observers import AbstractObserver, joint_rates

APART = 16  # units of rounding at the end: a shorter window is none


def first_stop(transient: Scalar, window: Scalar) -> Scalar:
    """The end of the transient, or of the first window where there is none."""
    if is_concrete(transient):
        return transient if transient > 0 else window
    return jnp.where(transient > 0, transient, window)


def last_stop(transient: Scalar, window: Scalar, count: int) -> Scalar:
    """A time before which `count` windows are over, but for their rounding."""
    return transient + window * (count + 1)


def told_apart(name: str, transient: Scalar, window: Scalar, count: int) -> Any:
    """Whether a window can be told from rounding to the last; `name`: what it is.

    **Raises:** `ValueError` if it cannot, and both numbers are concrete.
    """
    eps = float(jnp.finfo(jnp.result_type(float)).eps)
    least = APART * eps * last_stop(transient, window, count)
    if is_concrete(least) and not window >= least:
        raise ValueError(
            f"Argument `{name}` must be at least {APART} units of rounding at the "
            f"motion's end, {float(least):.3g}, but is {float(window):g}; take longer "
            "or fewer of them, or a shorter `transient`."
        )
    return window >= least


class Watched(NamedTuple):
    """The running numbers of a lane."""

    observed: tuple  # one state per observer, the amplitude's first
    window_end: Scalar
    windows: Scalar  # completed windows; -1 in the transient
    previous: tuple  # the amplitudes of the window before
    drift: Scalar
    fastest: Scalar  # the largest joint rate of this window; 1 if any, by modes
    faster: Scalar  # that of the window before
    outcome: Scalar  # `not_computed` while it runs


class Windows(AbstractFold):
    """A transient, then windows until two agree (see `settle`)."""

    transient: Scalar
    window: Scalar
    rtol_settle: Scalar
    escape: Scalar
    rate_cut: Scalar | None  # None: set-valued friction, by modes
    max_windows: int
    observers: tuple[AbstractObserver, ...]
    # For a verdict alone: what sticks in both joints sticks for ever and need not be
    # watched, and windows agree only if they draw nearer, as at a stable cycle.
    strict: bool = eqx.field(static=True, default=False)

    def valid(self) -> Any:
        """Whether the options keep their rules; for those only known when traced."""
        options = self.window, self.rtol_settle, self.escape, self.rate_cut
        good = keeps("nonnegative", self.transient) & keeps("positive", *options)
        good &= told_apart("window", self.transient, self.window, self.max_windows)
        for observer in self.observers:
            good &= observer.valid()
        return good

    def integrand(self, column: Column) -> Any:
        """The integrands of all observers, one after the other."""

        def joint(y: Vector4) -> tuple:
            return sum((o.integrand(column, y) for o in self.observers), ())

        zero = jax.ShapeDtypeStruct((), jnp.result_type(float))
        return joint if jax.eval_shape(joint, (zero,) * 4) else None

    def init(self, column, t0, y0):
        """Nothing seen yet."""
        zero = 0.0 * y0[0]
        compares = self.max_windows > 1
        return Watched(
            observed=self._fresh(column, t0, y0),
            window_end=first_stop(self.transient, self.window) + zero,
            windows=jnp.where(jnp.asarray(self.transient) > 0, -1, 0).astype(jnp.int32),
            previous=(zero, zero, zero) if compares else (),
            drift=zero + jnp.inf,
            fastest=zero if self.by_modes else _fastest(y0),
            faster=zero,
            outcome=jnp.asarray(OUTCOME.not_computed, jnp.int32),
        )

    def step(self, column, state, step):
        """See a step; at a window's end compare, judge, and begin the next."""
        observed, used = [], 0
        for observer, part in zip(self.observers, state.observed, strict=True):
            count = len(observer.integrand(column, step.y1))
            mine = step._replace(integrals=step.integrals[used : used + count])
            observed.append(observer.step(column, part, mine))
            used += count
        fastest = jnp.maximum(state.fastest, self._motion(step))
        seen = state._replace(observed=tuple(observed), fastest=fastest)
        ended = step.t1 >= state.window_end
        turned = jnp.maximum(jnp.abs(step.y1[0]), jnp.abs(step.y1[1])) > self.escape

        held: Any = False
        if self.strict and self.by_modes:
            m1, m2 = step.event[1]
            held = (m1 == 0) & (m2 == 0)

        def judge(seen: Watched) -> Watched:
            return self._judge(column, seen, step, ended, turned, held)

        after = if_any_lane(ended | turned | held, judge, seen)
        return after, after.window_end, after.outcome != OUTCOME.not_computed

    def _judge(
        self,
        column: Column,
        seen: Watched,
        step: Step,
        ended: Any,
        turned: Any,
        held: Any,
    ) -> Watched:
        """The verdict on a lane whose window ended, or that turned over or is held."""
        windows = seen.windows + ended.astype(jnp.int32)
        judged = ended & (windows > 0)
        if self.by_modes:
            at_rest = held | (judged & (seen.fastest < 0.5))
        else:  # slow is not at rest where it grows: the window before tells
            at_rest = judged & (seen.fastest < self.rate_cut)
            at_rest &= seen.fastest <= seen.faster
            at_rest &= windows >= min(2, self.max_windows)
        over = judged & (windows >= self.max_windows)
        amplitudes, drift, agreed = seen.observed[0], seen.drift, False
        if self.max_windows > 1:
            relative = _relative_change(amplitudes, seen.previous)
            drift = jnp.where(judged & (windows > 1), relative, drift)
            agreed = judged & (drift <= self.rtol_settle)
            if self.strict:
                agreed &= (windows > 2) & (drift <= seen.drift)

        if not self.by_modes:
            # at rest steps leave noise, and two windows of it may agree: no cycle
            agreed &= seen.fastest >= self.rate_cut
        resting = OUTCOME.rest if column.friction is None else OUTCOME.stuck
        outcome = jnp.where(over, OUTCOME.unsettled, seen.outcome)
        outcome = jnp.where(agreed, OUTCOME.cycle, outcome)
        outcome = jnp.where(at_rest, resting, outcome)
        outcome = jnp.where(turned, OUTCOME.escaped, outcome)
        begins = ended & (outcome == OUTCOME.not_computed)

        def where(new: Any, old: Any) -> Any:
            return jax.tree.map(lambda a, b: jnp.where(begins, a, b), new, old)

        return Watched(
            observed=where(self._fresh(column, step.t1, step.y1), seen.observed),
            window_end=where(step.t1 + self.window, seen.window_end),
            windows=windows,
            previous=where(amplitudes, seen.previous) if seen.previous else (),
            drift=drift,
            fastest=where(
                0.0 * step.t1 if self.by_modes else _fastest(step.y1), seen.fastest
            ),
            faster=where(seen.fastest, seen.faster),
            outcome=outcome.astype(jnp.int32),
        )

    @property
    def by_modes(self) -> bool:
        """Whether rest is a matter of modes."""
        return self.rate_cut is None

    def _motion(self, step: Step) -> Any:
        """The step's largest joint rate at its end; by modes 1 if a joint slips."""
        if not self.by_modes:
            return _fastest(step.y1)
        m1, m2 = step.modes
        return jnp.where((m1 == 0) & (m2 == 0), 0.0, 1.0).astype(m1.dtype)

    def _fresh(self, column: Column, t: Scalar, y: Vector4) -> tuple:
        return tuple(observer.init(column, t, y) for observer in self.observers)


def _fastest(y: Vector4) -> Any:
    u1, u2 = joint_rates(y)
    return jnp.maximum(jnp.abs(u1), jnp.abs(u2))


def _relative_change(new: tuple, old: tuple) -> Any:
    """The largest change of the amplitudes against the largest amplitude."""
    change = [jnp.abs(a - b) for a, b in zip(new, old, strict=True)]
    largest = jnp.maximum(jnp.maximum(new[0], new[1]), new[2])
    # a motion of no amplitude at all has not changed
    largest = jnp.maximum(largest, jnp.finfo(largest.dtype).tiny)
    return jnp.maximum(jnp.maximum(change[0], change[1]), change[2]) / largest
