"""The rule of windows: a motion has settled when two consecutive ones agree."""

from collections.abc import Sequence
from typing import NamedTuple, cast

import jax.numpy as jnp

from ..model.column import Column, State
from ..motion.integrate import Motion
from ..motion.observers import AbstractObserver
from ..motion.options import Method, Windows, windows_for
from ..motion.scene import (
    check_scene,
    float_state,
    method_of,
    rate_cut_of,
    usual_method,
    valid_scene,
    with_amplitude,
)
from ..motion.spans import AbstractSpans, SpanState
from ..numerics.materialise import if_any_lane, tree_where
from ..numerics.numbers import (
    Flag,
    Numbers,
    Option,
    Scalar,
    Traced,
    equals,
    keeps,
)
from ..results import OUTCOME
from ..solvers.explicit import Integrand
from .growth import Growth
from .observation import Observation
from .rest import Rest, Speeds


class WindowState(NamedTuple):
    """What is watched in a window."""

    observed: tuple  # one state per observer, the amplitude's first
    previous: Numbers  # the amplitudes of the window before
    drift: Traced
    speeds: Speeds


class SettleFold(AbstractSpans[WindowState]):
    """A transient, then windows until two agree (see `settle`)."""

    agreement: Scalar
    rest: Rest
    observation: Observation

    def valid(self) -> Flag:
        """Whether the options keep their rules; for those only known when traced."""
        good = super().valid() & keeps("positive", self.agreement, self.rest.rate_cut)
        return good & self.observation.valid()

    def integrand(self, column: Column) -> Integrand | None:
        """The integrands of all observers, one after the other."""
        return self.observation.integrand(column)

    def begin(self, column, t0, y0):
        """Observers that saw nothing yet."""
        zero = 0.0 * y0[0]
        return WindowState(
            observed=self.observation.init(column, t0, y0),
            previous=(zero, zero, zero) if self.most > 1 else (),
            drift=zero + jnp.inf,
            speeds=self.rest.begin(y0),
        )

    def watch(self, column, state, step):
        """Let all observers see the step.

        In the transient they need not: where it ends `judge` has them begin anew. A
        lane that is still in it may be shown to them for a batch mate's sake; those
        numbers are thrown away.
        """

        def observe(before):
            return self.observation.step(column, before, step)

        observed = state.watch.observed
        if equals(self.transient, 0.0):
            observed = observe(observed)
        else:
            observed = if_any_lane(state.spans >= 0, observe, observed)
        speeds = self.rest.watch(state.watch.speeds, step)
        watch = state.watch._replace(observed=observed, speeds=speeds)
        return watch, self.rest.sticks(step), None

    def judge(self, column, state, step, ended):
        """Compare the window that ended with the one before."""
        watch, speeds = state.watch, state.watch.speeds
        ended_window = ended & (state.spans > 0)
        two = self.rest.by_modes | (state.spans >= min(2, self.most))
        at_rest = self.rest.reached(speeds, step, ended_window & two)
        amplitudes, drift, agreed = watch.observed[0], watch.drift, False
        if self.most > 1:
            relative = _relative_change(amplitudes, watch.previous)
            drift = jnp.where(ended_window & (state.spans > 1), relative, drift)
            agreed = ended_window & (drift <= self.agreement)
        if not self.rest.by_modes:
            # at rest steps leave noise, and two windows of it may agree: no cycle
            agreed &= speeds.now >= cast(Scalar, self.rest.rate_cut)
        last = ended_window & (state.spans >= self.most)
        outcome = jnp.where(last, OUTCOME.unsettled, state.outcome)
        outcome = jnp.where(agreed, OUTCOME.cycle, outcome)
        outcome = jnp.where(at_rest, self.rest.outcome(column), outcome)
        begins = ended & (outcome == OUTCOME.not_computed)

        fresh = self.observation.init(column, step.t1, step.y1)
        previous = watch.previous
        watch = WindowState(
            observed=tree_where(begins, fresh, watch.observed),
            previous=tree_where(begins, amplitudes, previous) if previous else (),
            drift=drift,
            speeds=self.rest.renewed(speeds, step, begins),
        )
        return watch, outcome


def _relative_change(new: Numbers, old: Numbers) -> Scalar:
    """The largest change of the amplitudes against the largest amplitude."""
    change = [jnp.abs(a - b) for a, b in zip(new, old, strict=True)]
    largest = jnp.maximum(jnp.maximum(new[0], new[1]), new[2])
    # a motion of no amplitude at all has not changed
    largest = jnp.maximum(largest, jnp.finfo(largest.dtype).tiny)
    return jnp.maximum(jnp.maximum(change[0], change[1]), change[2]) / largest


class SettleProblem(Motion[SpanState[WindowState]]):
    """A motion that ends when it has settled.

    **Arguments:** those of `settle`; `question`: whose defaults hold.
    """

    def __init__(
        self,
        column: Column,
        start: State,
        question: str,
        windows: Windows,
        observers: Sequence[AbstractObserver],
        method: Method,
    ):
        """Check the scene and set up the watch."""
        check_scene(column, start)
        watched = with_amplitude(observers, column)
        if any(isinstance(observer, Growth) for observer in watched):
            raise ValueError(
                f"Argument `observers` must not contain `Growth()` in `{question}` "
                "where windows judge, but does: see `certify` of `settle`."
            )
        y0 = float_state(start)
        method = method_of(question, method, column, usual_method(column))
        self.windows = windows = windows_for(question, windows, rate_cut_of(column))
        self.watch = watch = SettleFold(
            transient=cast(Scalar, windows.transient),
            span=cast(Scalar, windows.length),
            most=cast(int, windows.max_windows),
            agreement=cast(Scalar, windows.agreement),
            escape=cast(Scalar, windows.escape),
            rest=Rest(windows.rate_cut, at_once=False),
            observation=Observation(watched),
        )
        valid = valid_scene(column, y0) & watch.valid()
        super().__init__(
            column,
            y0,
            watch,
            method,
            valid=valid & keeps("positive", method.rtol, method.atol),
            first_stop=watch.first_stop(),
            end=watch.last_stop(),
            at_end=OUTCOME.unsettled,
        )

    def settings(self) -> dict[str, Option]:
        """The options, for the record."""
        return {
            **self.method.settings(),
            **self.windows.settings(),
            "rate_cut": self.watch.rest.setting(),
            **(self.column.friction.settings() if self.column.friction else {}),
        }
