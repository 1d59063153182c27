"""The rule of windows: a motion has settled when two consecutive ones agree."""

from collections.abc import Sequence
from typing import NamedTuple, cast

import jax.numpy as jnp

from ..model.chain_of_rods import AbstractChain
from ..model.state import State
from ..model.system import System
from ..motion.checks import float_state, valid_scene, with_amplitude
from ..motion.integrate import Motion
from ..motion.method import method_of, rate_cut_of, usual_method
from ..motion.observation import Observation
from ..motion.observers import AbstractObserver, Amplitude
from ..motion.options import Method, Windows, windows_for
from ..motion.spans import AbstractSpans, SpanState
from ..numerics.materialise import if_any_lane, tree_where
from ..numerics.numbers import Flag, Option, Scalar, equals
from ..numerics.rules import keeps
from ..results import CODE
from ..solvers.explicit import Integrand
from .growth import Growth
from .repeats import Before, Noise, Window, at_end, at_start, begun, compared, watched
from .rest import Rest, Speeds


class WindowState(NamedTuple):
    """The quantities that are watched in a window."""

    observed: tuple  # one state per observer, the amplitude's first
    window: Window | tuple[()]  # empty where there is but one
    before: Before | tuple[()]
    drift: Scalar
    speeds: Speeds


class SettleFold(AbstractSpans[WindowState]):
    """A transient, then windows until two agree (see `settle`)."""

    agreement: Scalar
    rest: Rest
    observation: Observation
    rtol: Scalar = 0.0  # of the steps

    def valid(self) -> Flag:
        """Whether the options keep their rules; for those only known when traced."""
        good = super().valid() & keeps("positive", self.agreement, self.rest.rate_cut)
        return good & self.observation.valid()

    def integrand(self, system: System) -> Integrand | None:
        """The integrands of all observers, one after the other."""
        return self.observation.integrand(system)

    def begin(self, system, t0, y0):
        """Observers that saw nothing yet."""
        zero = 0.0 * y0[0]
        none, several = (zero,) * system.joints, self.most > 1
        return WindowState(
            observed=self.observation.init(system, t0, y0),
            window=begun(at_start(system, y0), system.joints) if several else (),
            before=Before(none, none, none, zero) if several else (),
            drift=zero + jnp.inf,
            speeds=self.rest.begin(y0),
        )

    def watch(self, system, state, step):
        """Let all observers see the step.

        In the transient they need not: where it ends `judge` has them begin anew. A
        lane that is still in it may be shown to them for a batch mate's sake; those
        numbers are thrown away.
        """

        def observe(before):
            observed, window = before
            observed = self.observation.step(system, observed, step)
            if window:
                window = watched(system, window, step)
            return observed, window

        now = state.watch.observed, state.watch.window
        if equals(self.transient, 0.0):
            observed, window = observe(now)
        else:
            observed, window = if_any_lane(state.spans >= 0, observe, now)
        speeds = self.rest.watch(state.watch.speeds, step)
        watch = state.watch._replace(observed=observed, window=window, speeds=speeds)
        return watch, self.rest.sticks(step), None

    def judge(self, system, state, step, ended):
        """Compare the window that ended with the one before."""
        watch, speeds = state.watch, state.watch.speeds
        ended_window = ended & (state.spans > 0)
        two = self.rest.by_modes | (state.spans >= min(2, self.most))
        at_rest = self.rest.reached(system, speeds, step, ended_window & two)
        last = ended_window & (state.spans >= self.most)
        outcome = jnp.where(last, CODE.unsettled, state.outcome)
        window, before, drift = watch.window, watch.before, watch.drift
        swings = Amplitude.swings(watch.observed[0])
        if window and before:
            noise = Noise(self.rest.noise, self.rtol, self.rest.atol)
            options = self.agreement, 2 * self.span, noise
            drawn = compared(before, window, swings, *options)
            second = ended_window & (state.spans > 1)
            drift = jnp.where(second, drawn.drift, drift)
            agreed = second & (drawn.outcome != CODE.not_computed)
            if not self.rest.by_modes:
                agreed &= ~self.rest.slow(system, speeds.now)  # what is left is noise
            outcome = jnp.where(agreed, drawn.outcome, outcome)
        outcome = jnp.where(at_rest, self.rest.outcome(system), outcome)
        begins = ended & (outcome == CODE.not_computed)

        fresh = self.observation.init(system, step.t1, step.y1)
        if window and before:
            last_one = Before(swings, window.low, window.high, window.lost)
            before = tree_where(begins, last_one, before)
            anew = begun(at_end(system, step), system.joints)
            window = tree_where(begins, anew, window)
        watch = WindowState(
            observed=tree_where(begins, fresh, watch.observed),
            window=window,
            before=before,
            drift=drift,
            speeds=self.rest.renewed(speeds, step, begins),
        )
        return watch, outcome


class SettleProblem(Motion[SpanState[WindowState]]):
    """A motion that ends when it has settled.

    **Arguments:** those of `settle`, a scene that has been checked; `question`: whose
    defaults hold.
    """

    def __init__(
        self,
        column: AbstractChain,
        start: State,
        question: str,
        windows: Windows,
        observers: Sequence[AbstractObserver],
        method: Method,
    ):
        """Set up the watch."""
        self.column, system = column, column.system()
        watched = with_amplitude(observers, system)
        if any(isinstance(observer, Growth) for observer in watched):
            raise ValueError(
                f"Argument `observers` must not contain `Growth()` in `{question}` "
                "where windows judge, but does: see `certify` of `settle`."
            )
        y0 = float_state(start)
        method = method_of(question, method, system, usual_method(system))
        self.windows = windows = windows_for(question, windows, rate_cut_of(system))
        transient, length, most = windows.spans
        self.watch = watch = SettleFold(
            transient=transient,
            span=length,
            most=most,
            agreement=cast(Scalar, windows.agreement),
            escape=windows.bound,
            rest=Rest(windows.rate_cut, at_once=False, atol=method.tolerances[1]),
            observation=Observation(watched),
            rtol=method.tolerances[0],
        )
        valid = valid_scene(column, y0) & watch.valid()
        super().__init__(
            system,
            y0,
            watch,
            method,
            valid=valid & keeps("positive", method.rtol, method.atol),
            first_stop=watch.first_stop(),
            end=watch.last_stop(),
            at_end=CODE.unsettled,
        )

    def settings(self) -> dict[str, Option]:
        """The options, for the record."""
        return {
            **self.method.settings(),
            **self.windows.settings(),
            "rate_cut": self.watch.rest.setting(),
        }
