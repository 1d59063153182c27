r"""The step size: one lane's, from its error estimate.

$$h \leftarrow h\,\min\bigl(10, \max(0.2,\; 0.8\, E^{-1/p})\bigr), \qquad
E^2 = \tfrac14 \sum_i \Bigl(\frac{e_i}{atol + rtol \max(|y_{0,i}|, |y_{1,i}|)}
\Bigr)^2$$
"""

from typing import NamedTuple, cast

import diffrax as dfx
import equinox as eqx
import jax.numpy as jnp
import optimistix as optx
from jax import lax

from ..model.column import Column
from ..numerics.elementary import larger, short_power, smaller
from ..numerics.materialise import materialise
from ..numerics.numbers import Count, Flag, Numbers, Pair, Scalar, Vector4

# On motions with smoothed friction (q = 2..4, Tsit5) 0.8 needs 4 to 6 % fewer steps
# than 0.9 at tolerances from 1e-4 to 1e-6, and errs by about a third less: fewer steps
# are rejected. A proportional-integral controller does no better.
SAFETY = 0.8
SMALLEST_FACTOR, LARGEST_FACTOR = 0.2, 10.0
NO_LIMIT = 2**31 - 1
LAYER_SHARE = 0.02  # of a joint's rate in the layer: what a step may err by
# A step far beyond its tolerance has no interpolant on which an event could be found.
WORST_CUT = 100.0
SMALLEST_STEP = 1e-13  # against max(|t|, 1): below, t + h hardly moves


class Verdict(NamedTuple):
    """Of a step that was tried."""

    accepts: Scalar  # 1 for a lane that moves and whose step is accepted; else 0
    factor: Scalar  # how long the next one may be, over this one


class Signals(eqx.Module):
    """What an observing solver tells the controller beside the error.

    It travels in place of the error estimate, over which diffrax, where it runs the
    solver itself, only maps, looking for NaN: hence numbers, not flags.
    """

    error: Numbers
    stop: Scalar  # a time on which a step must end; infinity for none
    done: Scalar  # 1 to end the lane after this step, if it is accepted; else 0
    reached: Scalar | None = (
        None  # the time of y1 where the step was cut; None: not to be cut
    )
    verdict: Verdict | None = None  # where the solver has asked for it already


class ControlState(NamedTuple):
    """What the controller remembers between steps."""

    t: Scalar  # where the lane is
    stop: Scalar  # a time on which a step must end
    t_next: Scalar  # where the next step ends, if nothing clips it
    left: Count  # how many more steps may be attempted
    h: Scalar  # the length that the error estimate allows


class StepControl(dfx.AbstractAdaptiveStepSizeController):
    """An integral controller without `pow`, which XLA calls lane by lane on a CPU.

    It ends a lane, with `dt_min_reached`, whose step vanishes or is NaN: such a lane
    would otherwise run for ever and its batch with it.

    **Arguments:**

    - `rtol`, `atol`: tolerances per step.
    - `layer`: the width $v_{smooth}$ of a friction layer that is to be resolved
        whatever the tolerances: a step that begins or ends in it may err by 2 % of it
        in a joint's rate. Else a creeping joint leaves and reenters a layer narrower
        than `atol`: with v_smooth = 1e-6 and tolerances of 1e-6 some lanes of a
        friction map take 100 times the steps; at 10 % of 1e-7 they still do, at 3 % of
        1e-8 they no longer do. And one that breaks loose, from 3 to 4 v_smooth, does
        so unseen: the layer's slope at the step's start, with which the method damps
        its error estimate, is far from that at its end (one such step erred by 3000
        tolerances, by its estimate less than one). None: there is none.
    - `end`: a time on which a step must end, and the lane with it.
    """

    rtol: Scalar  # pyright: ignore[reportIncompatibleVariableOverride]
    atol: Scalar  # pyright: ignore[reportIncompatibleVariableOverride]
    layer: Scalar | None = None
    end: Scalar = jnp.inf

    @property
    def norm(self):  # pyright: ignore[reportIncompatibleMethodOverride]
        """The root mean square; `adapt_step_size` has its square written out."""
        return optx.rms_norm

    def wrap(self, direction):
        """Nothing to know of the direction: lanes run forward."""
        del direction
        return self

    def init(  # pyright: ignore[reportIncompatibleMethodOverride]
        self, terms, t0: Scalar, t1, y0, dt0: Scalar | None, args, func, error_order
    ):
        """Start with `dt0`, which must be given."""
        del terms, t1, y0, args, func, error_order
        if dt0 is None:
            raise ValueError("Argument `dt0` must be given, but is None.")
        state = self.start(t0, dt0, jnp.inf)
        return state.t_next, state

    def start(self, t0: Scalar, dt0: Scalar, stop: Scalar) -> ControlState:
        """The state before the first step, with a first time to stop on."""
        dtype = jnp.result_type(t0)
        stop, t0 = jnp.asarray(stop, dtype), jnp.asarray(t0, dtype)
        h = jnp.asarray(dt0, dtype)
        left = jnp.asarray(NO_LIMIT, jnp.int32)
        return ControlState(t0, stop, self.towards(stop, t0, h), left, h)

    def towards(self, stop: Scalar, t: Scalar, h: Scalar) -> Scalar:
        """The end of a step of about h, on the stop or the end if these are near."""
        return towards(smaller(stop, self.end), t, h)

    def ending(self, t: Scalar, pause: Flag, vanished: Flag) -> dfx.RESULTS:
        """What the loop is told: to go on, to pause, or that there is no next step."""
        okay, paused = dfx.RESULTS.successful, dfx.RESULTS.event_occurred
        result = dfx.RESULTS.where(pause | (t >= self.end), paused, okay)
        return dfx.RESULTS.where(vanished, dfx.RESULTS.dt_min_reached, result)

    def verdict(
        self,
        t0: Scalar,
        t1: Scalar,
        y0: Vector4,
        y1: Vector4,
        error: Numbers,
        error_order: Scalar,
        reached: Scalar | None = None,
        moves: Flag = True,
    ) -> Verdict:
        """Whether a step from t0 on is accepted, and how long the next one may be.

        **Arguments:** as `adapt_step_size`; `reached`: as of `Signals`; `moves`:
        whether the lane does.
        """

        def judged():
            square, factor = judge(
                self.rtol, self.atol, y0, y1, error, error_order, self.layer
            )
            keep = square <= 1
            if reached is not None:
                # along its step an interpolant leaves the start with the error's square
                share = ((reached - t0) / (t1 - t0)) ** 2
                keep = (square * share**2 <= 1) & (square <= WORST_CUT**2)
                # behind an event the field is another: no reason to grow
                factor = jnp.where(reached < t1, jnp.minimum(factor, 1.0), factor)
            # a number: a vector of flags is unpacked wherever it is used
            return jnp.where(moves & keep, 1.0, 0.0), factor

        return Verdict(*materialise(t0, judged))

    def adapt_step_size(  # pyright: ignore[reportIncompatibleMethodOverride]
        self,
        t0: Scalar,
        t1: Scalar,
        y0: Vector4,
        y1_candidate: Vector4,
        args: Column,
        y_error: Signals | Numbers,
        error_order: Scalar,
        controller_state: ControlState,
    ):
        """Accept or reject the step, and choose the next one."""
        del args
        signals = y_error if isinstance(y_error, Signals) else None
        error = cast(Numbers, y_error) if signals is None else signals.error
        stop, left = controller_state.stop, controller_state.left - 1

        cut = None if signals is None else signals.reached
        whole = cut is None  # steps are never cut
        reached = t1 if whole else cut
        tried, allowed = t1 - t0, controller_state.h
        verdict = None if signals is None else signals.verdict
        if verdict is None:
            verdict = self.verdict(t0, t1, y0, y1_candidate, error, error_order, cut)
        # one that was shortened to a stop moves with it, those behind it do not
        keep, h = verdict.accepts > 0, lax.stop_gradient(tried) * verdict.factor
        if not whole:
            # one that was shortened to a stop says little about how long one may be
            shortened = keep & (tried < 0.9 * allowed)
            allowed = h = jnp.where(shortened, jnp.maximum(allowed, h), h)
        t = jnp.where(keep, reached, t0)
        # an accepted step may be as small as the stop it was cut to
        vanished = ~(keep | (h > SMALLEST_STEP * larger(jnp.abs(t), 1.0)))
        pause = left <= 0
        if signals is not None:
            stop = jnp.where(keep, signals.stop, stop)
            pause |= keep & (signals.done > 0)
        result = self.ending(t, pause, vanished)
        t_next = self.towards(stop, t, h)
        state = ControlState(t, stop, t_next, left, allowed)
        return keep, t, t_next, False, state, result


def judge(
    rtol: Scalar,
    atol: Scalar,
    y0: Numbers,
    y1: Numbers,
    error: Numbers,
    error_order: Scalar,
    layer: Scalar | None = None,
) -> Pair:
    """The error's square, within tolerance up to 1, and the next step over this one."""
    square = jnp.zeros_like(y0[0])
    for e, a, b in zip(error, y0, y1, strict=True):
        scale = atol + rtol * larger(jnp.abs(a), jnp.abs(b))
        square += (e / scale) ** 2
    if layer is not None:
        joints = [(error[2], y0[2], y1[2])]
        joints += [(error[3] - error[2], y0[3] - y0[2], y1[3] - y1[2])]
        for e, u0, u1 in joints:
            inside = larger(smaller(jnp.abs(u0), jnp.abs(u1)), layer)
            square += (e / (LAYER_SHARE * inside)) ** 2
    square = square / len(error)
    # a NaN error counts as a large one; a derivative is that of the same steps
    measure = larger(smaller(lax.stop_gradient(square), 1e30), 1e-30)
    factor = SAFETY * short_power(measure, -0.5 / error_order)
    factor = larger(smaller(factor, LARGEST_FACTOR), SMALLEST_FACTOR)
    return square, factor


def towards(stop: Scalar, t: Scalar, h: Scalar) -> Scalar:
    """The end of a step of about h: on `stop` if it is near, and no crumb before it."""
    left = stop - t
    shorter = jnp.where(left < 2 * h, 0.5 * left, h)
    return jnp.where(left <= 1.001 * h, stop, t + shorter)
