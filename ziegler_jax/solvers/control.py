r"""The step size: one lane's, from its error estimate.

$$h \leftarrow h\,\min\bigl(10, \max(0.2,\; 0.8\, E^{-1/p})\bigr), \qquad
E^2 = \tfrac14 \sum_i \Bigl(\frac{e_i}{atol + rtol \max(|y_{0,i}|, |y_{1,i}|)}
\Bigr)^2$$
"""

from typing import NamedTuple

import diffrax as dfx
import jax.numpy as jnp
from jax import lax

from ..model.chain import joint_angles
from ..model.state import PhasePoint
from ..numerics.elementary import larger, short_power, smaller
from ..numerics.materialise import materialise
from ..numerics.numbers import Count, Flag, Numbers, Pair, Scalar

# On motions with smoothed friction (q = 2..4, Tsit5) 0.8 needs 4 to 6 % fewer steps
# than 0.9 at tolerances from 1e-4 to 1e-6, and errs by about a third less: fewer steps
# are rejected. A proportional-integral controller does no better.
SAFETY = 0.8
SMALLEST_FACTOR, LARGEST_FACTOR = 0.2, 10.0
NO_LIMIT = 2**31 - 1
LAYER_SHARE = 0.02  # of a joint's rate in the layer: what a step may err by
# A step far beyond its tolerance has no interpolant on which an event could be found.
WORST_CUT = 100.0
MOVES, HALTED, VANISHED = 0.0, 1.0, 2.0  # what a lane does; paused is halted
NOT_HERE = (
    "Lane solvers and their controllers must be run by `LaneLoop`, the `adjoint` of "
    "`diffeqsolve`, from a given `solver_state` and `controller_state` and without an "
    "`event`, but diffrax has asked for a step of its own."
)
SMALLEST_STEP = 1e-13  # against max(|t|, 1): below, t + h hardly moves


class Verdict(NamedTuple):
    """Of a step that was tried."""

    accepts: Scalar  # 1 for a lane that moves and whose step is accepted; else 0
    factor: Scalar  # how long the next one may be, over this one


ACCEPTED = Verdict(1.0, 1.0)


class Signals(NamedTuple):
    """What a lane solver tells the controller of a step."""

    verdict: Verdict
    stop: Scalar  # a time on which a step must end; infinity for none
    done: Scalar  # 1 to end the lane after this step, if it is accepted; else 0
    reached: Scalar | None = None  # the time of y1 where steps may be cut


class ControlState(NamedTuple):
    """What the controller remembers between steps."""

    t: Scalar  # where the lane is
    stop: Scalar  # a time on which a step must end
    t_next: Scalar  # where the next step ends, if nothing clips it
    left: Count  # how many more steps may be attempted
    h: Scalar  # the length that the error estimate allows


class StepControl(dfx.AbstractStepSizeController):
    """An integral controller without `pow`, which XLA calls lane by lane on a CPU.

    It ends a lane, as `VANISHED`, whose step vanishes or is NaN: such a lane
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

    rtol: Scalar
    atol: Scalar
    layer: Scalar | None = None
    end: Scalar = jnp.inf

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

    def halt(self, t: Scalar, pause: Flag, vanished: Flag) -> Scalar:
        """What the loop is told: to go on, to pause, or that there is no next step."""
        halts = jnp.where(pause | (t >= self.end), HALTED, MOVES)
        return jnp.where(vanished, VANISHED, halts)

    def verdict(
        self,
        t0: Scalar,
        t1: Scalar,
        y0: PhasePoint,
        y1: PhasePoint,
        error: Numbers,
        error_order: Scalar,
        reached: Scalar | None = None,
        moves: Flag = True,
    ) -> Verdict:
        """Whether a step from t0 on is accepted, and how long the next one may be.

        **Arguments:** `error`: the estimate of that of `y1`; `error_order`: the power
        of the step that it falls with; `reached`: as of `Signals`; `moves`: whether the
        lane does.
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

    def after(
        self, t0: Scalar, t1: Scalar, signals: Signals, state: ControlState
    ) -> tuple[ControlState, Scalar]:
        """Where a lane is after a step that was tried, and whether it halts there."""
        left, tried, allowed = state.left - 1, t1 - t0, state.h
        keep = signals.verdict.accepts > 0
        # one that was shortened to a stop moves with it, those behind it do not
        h = lax.stop_gradient(tried) * signals.verdict.factor
        reached = t1 if signals.reached is None else signals.reached
        if signals.reached is not None:
            # one that was shortened to a stop says little about how long one may be
            shortened = keep & (tried < 0.9 * allowed)
            allowed = h = jnp.where(shortened, jnp.maximum(allowed, h), h)
        t = jnp.where(keep, reached, t0)
        # an accepted step may be as small as the stop it was cut to
        vanished = jnp.logical_not(keep | (h > SMALLEST_STEP * larger(jnp.abs(t), 1.0)))
        stop = jnp.where(keep, signals.stop, state.stop)
        pause = (left <= 0) | (keep & (signals.done > 0))
        following = ControlState(t, stop, self.towards(stop, t, h), left, allowed)
        return following, self.halt(t, pause, vanished)

    # ---- what diffrax does not ask for where `LaneLoop` runs

    def wrap(self, direction):
        """Lanes run forward."""
        del direction
        return self

    def init(self, terms, t0, t1, y0, dt0, args, func, error_order):
        """See `start`."""
        raise NotImplementedError(NOT_HERE)

    def adapt_step_size(
        self, t0, t1, y0, y1_candidate, args, y_error, error_order, controller_state
    ):
        """See `after`."""
        raise NotImplementedError(NOT_HERE)


def judge(
    rtol: Scalar,
    atol: Scalar,
    y0: PhasePoint,
    y1: PhasePoint,
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
        each = (joint_angles(x.omega) for x in (PhasePoint(error), y0, y1))
        for e, u0, u1 in zip(*each, strict=True):
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
