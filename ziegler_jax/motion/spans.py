"""Motions judged span by span: a transient, then equal spans until one decides.

`AbstractSpans` is the machine of all questions of this kind.
"""

import abc
from functools import reduce
from typing import Generic, NamedTuple, TypeVar

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from ..model.chain_of_rods import AbstractChain
from ..model.state import PhasePoint, State
from ..model.system import System
from ..numerics.elementary import larger
from ..numerics.materialise import if_any_lane, replaced, tree_where
from ..numerics.numbers import Flag, Scalar, any_of, is_concrete
from ..numerics.rules import keeps
from ..results import CODE
from ..solvers import ACCEPTED, AbstractFold, Step, Verdict
from .checks import float_state, valid_scene
from .integrate import Motion, Run, follow
from .options import Method
from .section import rod_angles

APART = 16  # units of rounding at the end: a shorter span is none


Watch = TypeVar("Watch")  # a question's own running numbers


class SpanState(NamedTuple, Generic[Watch]):
    """Where a lane is among its spans."""

    watch: Watch
    end: Scalar  # of this span
    spans: Int[Array, ""]  # completed ones; -1 in the transient
    outcome: Int[Array, ""]  # `not_computed` while it runs


class AbstractSpans(AbstractFold[SpanState[Watch]]):
    """A transient, then equal spans until one decides.

    A question says what it watches (`begin`, `watch`) and, where a span has ended or it
    asked for a judgement, how the motion ended, if it did (`judge`). A rod that turns
    over ends it at once.
    """

    transient: Scalar
    span: Scalar
    most: int  # spans
    escape: Scalar

    @abc.abstractmethod
    def begin(self, system: System, t0: Scalar, y0: PhasePoint) -> Watch:
        """The watch before the first step."""

    @abc.abstractmethod
    def watch(
        self, system: System, state: SpanState[Watch], step: Step
    ) -> tuple[Watch, Flag, Scalar | None]:
        """The watch after a step, whether to judge, how long the next step may be.

        The last is None where that is no matter.
        """

    @abc.abstractmethod
    def judge(
        self,
        system: System,
        state: SpanState[Watch],
        step: Step,
        ended: Bool[Array, ""],
    ) -> tuple[Watch, Int[Array, ""]]:
        """The watch from this step on, and the outcome; `ended`: whether the span has.

        It is asked for a whole batch; what it says of a lane that did not ask is lost.
        """

    def valid(self) -> Flag:
        """Whether the options keep their rules; for those only known when traced.

        **Raises:** `ValueError` for a span that cannot be told from rounding.
        """
        good = keeps("nonnegative", self.transient)
        good &= keeps("positive", self.span, self.escape)
        eps = float(jnp.finfo(jnp.result_type(float)).eps)
        least = APART * eps * self.last_stop()
        if is_concrete(least) and not self.span >= least:
            raise ValueError(
                f"Argument `length` must be at least {APART} units of "
                f"rounding at the motion's end, {float(least):.3g}, but is "
                f"{float(self.span):g}; take longer or fewer of them, or a shorter "
                "`transient`."
            )
        return good & (self.span >= least)

    def first_stop(self) -> Scalar:
        """The end of the transient, or of the first span where there is none."""
        if is_concrete(self.transient):
            return self.transient if self.transient > 0 else self.span
        return jnp.where(self.transient > 0, self.transient, self.span)

    def last_stop(self) -> Scalar:
        """A time before which all spans are over, but for their rounding."""
        return self.transient + self.span * (self.most + 1)

    def init(self, system: System, t0: Scalar, y0: PhasePoint) -> SpanState[Watch]:
        """Before the first step."""
        before = jnp.asarray(self.transient) > 0
        return SpanState(
            self.begin(system, t0, y0),
            self.first_stop() + 0.0 * y0[0],
            jnp.where(before, -1, 0).astype(jnp.int32),
            jnp.asarray(CODE.not_computed, jnp.int32),
        )

    def step(
        self, system: System, state: SpanState[Watch], step: Step
    ) -> tuple[SpanState[Watch], Scalar, Flag]:
        """Watch a step; where a span ends, or is asked to, judge and begin the next."""
        return self.accepted(system, state, step, ACCEPTED)

    def accepted(
        self,
        system: System,
        state: SpanState[Watch],
        step: Step,
        verdict: Verdict,
    ) -> tuple[SpanState[Watch], Scalar, Flag]:
        """The same where the step is accepted.

        Numbers that only `judge` changes are masked there, which is rare.
        """
        watch, asked, longest = self.watch(system, state, step)
        watch = tree_where(verdict.accepts > 0, watch, state.watch)
        ended = jnp.asarray(step.t1 >= state.end)
        near = may_turn_over(step, self.escape)

        def judge(before):
            over = turns_over(step, self.escape)
            state = before._replace(spans=before.spans + ended.astype(jnp.int32))
            watch, outcome = self.judge(system, state, step, ended)
            outcome = jnp.where(over, CODE.escaped, outcome).astype(jnp.int32)
            end = jnp.where(ended, step.t1 + self.span, state.end)
            return replaced(asked, SpanState(watch, end, state.spans, outcome), before)

        asked = ended | near | asked
        asked &= verdict.accepts > 0
        after = if_any_lane(asked, judge, state._replace(watch=watch))
        stop = after.end
        if longest is not None:
            stop = jnp.minimum(stop, step.t1 + longest)
        return after, stop, after.outcome != CODE.not_computed


def follow_spans(
    column: AbstractChain,
    start: State,
    fold: AbstractSpans[Watch],
    method: Method,
    at_end: CODE = CODE.complete,
) -> Run[SpanState[Watch]]:
    """The motion from `start` to its end."""
    y0 = float_state(start)
    good = keeps("positive", method.rtol, method.atol)
    motion = Motion(
        column.system(),
        y0,
        fold,
        method,
        valid=good & valid_scene(column, y0) & fold.valid(),
        first_stop=fold.first_stop(),
        end=fold.last_stop(),
        at_end=at_end,
    )
    return follow(motion)


def turns_over(step: Step, escape: Scalar) -> Flag:
    """Whether a rod has turned so far that its motion is over, in a step or at its end.

    About where the angle peaks: ends of long steps may lie far below.
    """
    over = any_of(path.largest() > escape for path in rod_angles(step))
    return may_turn_over(step, escape) & over  # whoever is looked at for a mate's sake


def may_turn_over(step: Step, escape: Scalar) -> Flag:
    """Whether it is worth a look, by rates up to twice those at the step's ends."""
    farthest = reduce(larger, map(jnp.abs, step.y1.phi))
    rates = (jnp.abs(w) for y in (step.y0, step.y1) for w in y.omega)
    return farthest + 2 * (step.t1 - step.t0) * reduce(larger, rates) > escape
