r"""The step size of a lane whose steps must end on events.

The solver says where the step passes an event: the controller rejects such a step and
shortens it onto the event. The length that the error estimate allows is remembered
meanwhile, so that an event does not cost the steps that would grow from it.
"""

from typing import Any, NamedTuple

import diffrax as dfx
import equinox as eqx
import jax.numpy as jnp
import optimistix as optx

from .._materialise import materialise
from .._types import Scalar
from .control import NO_LIMIT, SMALLEST_STEP, judge, towards


class LandingSignals(eqx.Module):
    """What a stick-slip solver tells the controller beside the error.

    `stop` and `done` are those of `Signals`.
    """

    error: Any
    stop: Scalar
    done: Scalar
    land: Scalar  # before the step's end: reject, and end there; after it: end there


class LandingState(NamedTuple):
    """What the controller remembers between steps."""

    t: Any  # where the lane is
    stop: Any  # a time on which a step must end
    t_next: Any  # where the next step ends, if nothing clips it
    left: Any  # how many more steps may be attempted
    h: Any  # the length that the error estimate allows


class LandingControl(dfx.AbstractAdaptiveStepSizeController):
    """`StepControl` for steps that end on events.

    **Arguments:** `rtol`, `atol`: tolerances per step.
    """

    rtol: Scalar
    atol: Scalar

    @property
    def norm(self):  # pyright: ignore[reportIncompatibleMethodOverride]
        """The root mean square."""
        return optx.rms_norm

    def wrap(self, direction):
        """Nothing to know of the direction: lanes run forward."""
        del direction
        return self

    def init(self, terms, t0, t1, y0, dt0, args, func, error_order):
        """Start with `dt0`, which must be given."""
        del terms, t1, y0, args, func, error_order
        if dt0 is None:
            raise ValueError("Argument `dt0` must be given, but is None.")
        state = self.start(t0, dt0, jnp.inf)
        return state.t_next, state

    def start(self, t0: Any, dt0: Any, stop: Any) -> LandingState:
        """The state before the first step, with a first time to stop on."""
        dtype = jnp.result_type(t0)
        stop, t0 = jnp.asarray(stop, dtype), jnp.asarray(t0, dtype)
        h = jnp.asarray(dt0, dtype)
        left = jnp.asarray(NO_LIMIT, jnp.int32)
        return LandingState(t0, stop, towards(stop, t0, h), left, h)

    def adapt_step_size(
        self, t0, t1, y0, y1_candidate, args, y_error, error_order, controller_state
    ):
        """Accept or reject the step, and choose the next one."""
        del args
        assert isinstance(y_error, LandingSignals)
        signals = y_error
        left = controller_state.left - 1
        tols = self.rtol, self.atol

        def verdict():
            small, factor = judge(*tols, y0, y1_candidate, signals.error, error_order)
            return small, small & ~(signals.land < t1), factor

        small, keep, factor = materialise(t0, verdict)
        tried, allowed = t1 - t0, controller_state.h
        grown = tried * factor
        # a step that was cut short says little about how long one may be
        cut_short = small & (tried < 0.9 * allowed)
        h = jnp.where(cut_short, jnp.maximum(allowed, grown), grown)
        t = jnp.where(keep, t1, t0)
        stop = jnp.where(keep, signals.stop, controller_state.stop)
        t_next = towards(stop, t, h)
        t_next = jnp.where(small, jnp.minimum(t_next, signals.land), t_next)
        # an accepted step may be as small as the stop it was cut to
        vanished = ~(keep | (t_next - t > SMALLEST_STEP * jnp.abs(t)))
        pause = (left <= 0) | (keep & (signals.done > 0))
        result = dfx.RESULTS.where(
            pause, dfx.RESULTS.event_occurred, dfx.RESULTS.successful
        )
        result = dfx.RESULTS.where(vanished, dfx.RESULTS.dt_min_reached, result)
        state = LandingState(t, stop, t_next, left, h)
        return keep, t, t_next, False, state, result
