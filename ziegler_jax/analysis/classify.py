r"""A verdict on one motion: stuck, a cycle, quasi-periodic, chaotic, or none of them.

Two witnesses are heard while the motion runs. Its passages through the section
$\phi_1 = 0$, rising: a cycle of p passages a period returns to each, and its tangents
do not grow meanwhile, as they do beside an unstable one. And its two largest Lyapunov
exponents, which tell quasi-periodic motion (both zero) from chaos (one is positive).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..model.column import Column, State
from ..motion.checks import check_scene
from ..motion.ending import ending, nan_where
from ..motion.method import explicit_method, rate_cut_of
from ..motion.not_finite import motion
from ..motion.options import Method, Spans, spans_for
from ..motion.section import Passage, SectionPlane, passage
from ..motion.spans import AbstractSpans, SpanState, follow_spans
from ..motion.tangents import AbstractGrowth
from ..numerics.materialise import if_any_lane
from ..numerics.no_number import refused
from ..numerics.numbers import Flag, Numbers, Pair, Scalar
from ..numerics.rules import keeps, number
from ..results import CODE, TIME, VERDICTS, AbstractMotionResult, quantity
from ..solvers import Explicit
from ..steady.rest import Rest, Speeds
from .lyapunov import (
    ERRORS,
    EXPONENTS,
    NO_DERIVATIVE,
    GrowthSums,
    growth_options,
    growth_settings,
    no_growth,
    standard_errors,
    with_block,
)
from .poincare import CycleDetector, detect_cycle, no_cycle

SURE = 3.0  # standard errors
NEAR = 1e-3  # of a point: a passage this near one before it is on its way to a cycle
DRIFT = 0.1  # of the largest angle: what changes more has not settled
PLANE = SectionPlane()


class Verdict(AbstractMotionResult[State]):
    r"""What a motion is, and the witnesses.

    `verdict`: a `CODE`; `period_count`: passages of $\phi_1 = 0$, rising, a
    period, 0 where none was found; `period`: NaN likewise; `exponents`, `errors`: shape
    (2,), over the blocks that were measured, NaN where there was none; `outcome`: how
    the motion itself ended, a `CODE`. It is `unsettled` of tori and chaos, and
    of a cycle that was named by its passages before its windows agreed.
    """

    verdict: Int[Array, "*lanes"] = eqx.field(
        metadata=quantity("what the motion is", codes=VERDICTS)
    )
    period_count: Float[Array, "*lanes"] = eqx.field(
        metadata=quantity("passages a period")
    )
    period: Float[Array, "*lanes"] = eqx.field(
        metadata=quantity("period of the cycle", TIME)
    )
    exponents: Float[Array, "*lanes 2"] = eqx.field(metadata={"quantity": EXPONENTS})
    errors: Float[Array, "*lanes 2"] = eqx.field(metadata={"quantity": ERRORS})

    def coordinates(self) -> dict[str, Sequence[object]]:
        """The exponents' numbers."""
        return {"exponent": (1, 2)}


@motion
def verdict(
    column: Column,
    start: State,
    *,
    spans: Spans = Spans(),
    rtol_return: Scalar = 1e-5,
    zero_rate: Scalar = 0.01,
    rate_cut: Scalar | None = None,
    method: Method = Method(),
) -> Verdict:
    r"""What kind of motion the column ends in from `start`.

    In this order, as soon as one holds:

    - `escaped`: a rod's angle passed `escape`.
    - `stuck`, without friction `rest`: both joints stick; with a smoothed law or
        without friction both joint rates stayed below `rate_cut` for a block, were no
        faster than in the block before, and what is left decays (see `settle`).
    - `periodic`: after the transient a passage of the section comes back to within
        `rtol_return` (of its largest coordinate) after p passages and again after 2p,
        $p \le 16$, and over these the tangent, relative to the flow, grew by no more
        than `zero_rate` a unit of time: beside an unstable cycle a motion comes back as
        well. A `zero_rate` near the tangents' own errors finds no cycle. References are
        renewed after 1, 2, 4, 8, 16 passages (Brent's cycle detection): p is the number
        of passages a period.

    and where none did after all blocks, by the exponents $\lambda_1, \lambda_2$, if the
    largest angles of both halves of the blocks are within a tenth of each other (else
    it is a transient, and `unclassified`):

    - `conservative`: neither friction nor damping took anything out at the end of any
        step after the transient: no motion attracts.
    - `chaotic`: $\lambda_1 >$ `zero_rate`, $\lambda_1 > 1/T$ after blocks of T in all,
        and $\lambda_1 > 3$ standard errors.
    - `quasi_periodic`: both are zero: $|\lambda| \le$ `zero_rate`, and
        $|\lambda| \le 1/T + 3$ standard errors after blocks of T in all; in the last
        block no passage came to within 1e-3 of a reference; and the rates $\omega_1$ of
        the passages fill the same band in both halves of the blocks, to a tenth of its
        width: a slow approach to a cycle or to rest looks alike but for that.
    - `periodic` with a period count of 0: $\lambda_1$ is zero and $\lambda_2$ is
        negative beyond that: its period is longer, or it is approached slowly.
    - `unclassified` else.

    A motion that creeps past the ghost of a cycle can pass for one if it moves by less
    than `rtol_return` a period. With growth that is not exponential $\lambda$ is still
    about $\ln t / t$, 0.007 after the 1000 time units of the default; chaos weaker than
    `zero_rate` is not told from quasi-periodic motion.

    **Arguments:** (times in $\sqrt{m l^2/k}$)

    - `column`, `start`: the scene.
    - `spans`: as `lyapunov_exponents`; the blocks of the above.
    - `rtol_return`, `zero_rate`: as above; `rtol_return` should be well above the
        method's `rtol`.
    - `rate_cut`: as in `Windows`.
    - `method`: an explicit one.

    **Returns:** `Verdict`.

    **Raises:** `ValueError` for arguments that break a rule, in a 32-bit session, and
    where a derivative is taken: averages over long motions have none to rely on.
    """
    check_scene(column, start)
    scene = column, start, spans, rtol_return, zero_rate, rate_cut, method
    column, start, spans, rtol_return, zero_rate, rate_cut, method = refused(
        NO_DERIVATIVE.format("verdict"), scene
    )
    method = explicit_method("verdict", method)
    spans = spans_for("verdict", spans)
    if rate_cut is None:
        rate_cut = rate_cut_of(column.system())
    else:
        rate_cut = number("rate_cut", rate_cut, "positive")
    fold = Classifier(
        rtol_return=number("rtol_return", rtol_return, "positive"),
        zero_rate=number("zero_rate", zero_rate, "positive"),
        rest=Rest(rate_cut, at_once=True, atol=method.tolerances[1]),
        **growth_options(method, spans),
    )
    run = follow_spans(column, start, fold, method, CODE.unsettled)
    evidence, blocks = run.folded.watch, run.folded.spans
    growth, returns = evidence.growth, evidence.returns
    cycle = run.outcome == CODE.cycle
    unmeasured = (blocks < 1) | (run.outcome < CODE.unsettled)
    return Verdict(
        verdict=_judged(run.outcome, evidence, blocks, fold),
        period_count=jnp.where(cycle, returns.passages, 0.0),
        period=jnp.where(cycle, returns.period, jnp.nan),
        exponents=nan_where(unmeasured, jnp.stack(growth.mean)),
        errors=nan_where(unmeasured, jnp.stack(standard_errors(growth, blocks))),
        settings=growth_settings(
            method,
            spans,
            rtol_return=fold.rtol_return,
            zero_rate=fold.zero_rate,
            rate_cut=fold.rest.setting(),
        ),
        **ending(run),
    )


def _judged(
    outcome: Int[Array, ""],
    evidence: Evidence,
    blocks: Int[Array, ""],
    fold: Classifier,
) -> jax.Array:
    """The verdict, a `CODE`."""
    zero_rate, growth, span = fold.zero_rate, evidence.growth, fold.most * fold.span
    (first, second), (error, other) = growth.mean, standard_errors(growth, blocks)

    def zero(rate, error):
        """Not to be told from zero: by one e-fold in all, and by its error."""
        within = jnp.abs(rate) <= 1 / span + SURE * error
        return within & (jnp.abs(rate) <= zero_rate)

    alone, both = zero(first, error), zero(first, error) & zero(second, other)
    by_rates = jnp.where(alone & ~both & (second < 0), CODE.periodic, 0)
    apart = (evidence.returns.nearest > NEAR) & _stays(evidence.bands)
    by_rates = jnp.where(both & apart, CODE.quasi_periodic, by_rates)
    # by more than one e-fold in all: of a span within rounding no rate is known
    chaotic = (first > jnp.maximum(zero_rate, 1 / span)) & (first > SURE * error)
    by_rates = jnp.where(chaotic, CODE.chaotic, by_rates)
    early, late = evidence.angles
    transient = jnp.abs(late - early) > DRIFT * jnp.maximum(late, early)
    transient |= blocks < fold.most
    by_rates = jnp.where((by_rates == 0) | transient, CODE.unclassified, by_rates)
    by_rates = jnp.where(evidence.dissipates, by_rates, CODE.conservative)
    code = jnp.where(outcome == CODE.unsettled, by_rates, CODE.failed)
    at_rest = (outcome == CODE.stuck) | (outcome == CODE.rest)
    code = jnp.where(at_rest, outcome, code)
    code = jnp.where(outcome == CODE.cycle, CODE.periodic, code)
    return jnp.where(outcome == CODE.escaped, CODE.escaped, code).astype(jnp.int8)


def _wider(
    bands: tuple[Pair, Pair], point: Passage, late: Bool[Array, ""]
) -> tuple[Pair, Pair]:
    """The bands with a passage in that of its half."""
    rate, after = point.y[2], []
    for (low, high), mine in zip(bands, (~late, late), strict=True):
        here = point.there & mine
        low = jnp.where(here, jnp.minimum(low, rate), low)
        after.append((low, jnp.where(here, jnp.maximum(high, rate), high)))
    return after[0], after[1]


def _stays(bands: tuple[Pair, Pair]) -> Bool[Array, ""]:
    """Whether passages of the late half fill the band of the early one.

    Those of a torus do. A motion that falls to rest, or nears a cycle slowly, has
    passages that differ as well, but its band moves, or shrinks.
    """
    (low, high), (low_late, high_late) = bands
    moved = jnp.maximum(jnp.abs(low - low_late), jnp.abs(high - high_late))
    return moved <= DRIFT * (high - low)


class Evidence(NamedTuple):
    """What is watched for a verdict."""

    growth: GrowthSums
    grown: Scalar  # logarithm of the first tangent's growth in the blocks before
    returns: CycleDetector
    speeds: Speeds
    angles: Numbers  # the largest in each half of the blocks
    dissipates: Bool[Array, ""]
    bands: tuple[Pair, Pair]  # in each half the least and largest omega1 of a passage


class Classifier(AbstractSpans[Evidence], AbstractGrowth[SpanState[Evidence]]):
    """Sections and exponents of one motion, until one of them decides."""

    solver: Explicit
    rtol: Scalar
    rtol_return: Scalar
    zero_rate: Scalar
    rest: Rest

    def valid(self) -> Flag:
        """Whether the options keep their rules; for those only known when traced."""
        more = self.rtol_return, self.zero_rate, self.rest.rate_cut
        return super().valid() & keeps("positive", *more)

    def begin(self, system, t0, y0):
        """No evidence yet."""
        zero, no = 0.0 * y0[0], jnp.zeros((), bool)
        no_band = zero + jnp.inf, zero - jnp.inf
        return Evidence(
            growth=no_growth(system, y0, 2),
            grown=zero,
            returns=no_cycle(t0, y0),
            speeds=self.rest.begin(y0),
            angles=(zero, zero),
            dissipates=no,
            bands=(no_band, no_band),
        )

    def tangents(self, state):
        """Those of the two largest exponents."""
        return state.watch.growth.tangents

    def watch(self, system, state, step):
        """Take the step into both witnesses."""
        before = state.watch
        tangents, longest = self.advance_frame(system, state, step)
        measuring = state.spans >= 0
        point = passage(PLANE, step)
        point = point._replace(there=point.there & measuring)

        def with_passage(returns):
            # at the step's start, relative to the field's own length there: what moves
            # along the flow has then not grown, wherever on the cycle the step begins
            tangents = before.growth.tangents
            length = tangents.factors[0] / jnp.sqrt(sum(f * f for f in step.f0))
            growth = before.grown + tangents.logs[0] + jnp.log(length)
            return detect_cycle(
                returns, point, growth, self.rtol_return, self.zero_rate
            )

        returns = if_any_lane(point.there, with_passage, before.returns)
        dissipates = before.dissipates
        for loss in system.power(step.y1)[1:]:
            if loss is not None:
                dissipates |= measuring & (loss > 0)
        angle = jnp.maximum(jnp.abs(step.y1[0]), jnp.abs(step.y1[1]))
        late = state.spans >= self.most // 2
        halves = zip((measuring & ~late, late), before.angles, strict=True)
        larger = (
            jnp.where(when, jnp.maximum(peak, angle), peak) for when, peak in halves
        )
        evidence = Evidence(
            growth=before.growth._replace(tangents=tangents),
            grown=before.grown,
            returns=returns,
            speeds=self.rest.watch(before.speeds, step),
            angles=tuple(larger),
            dissipates=dissipates,
            bands=_wider(before.bands, point, late),
        )
        return evidence, self.rest.sticks(step) | returns.confirmed, longest

    def judge(self, system, state, step, ended):
        """What is decided."""
        evidence = state.watch
        growth, added = with_block(evidence.growth, state.spans, self.span, ended)
        last = state.spans >= self.most
        outcome = jnp.where(last, CODE.unsettled, state.outcome)
        repeats = evidence.returns.confirmed & evidence.dissipates
        outcome = jnp.where(repeats, CODE.cycle, outcome)
        at_rest = self.rest.reached(system, evidence.speeds, step, ended)
        outcome = jnp.where(at_rest, self.rest.outcome(system), outcome)
        nearest = evidence.returns.nearest
        nearest = jnp.where(ended & ~last, 1.0, nearest)
        evidence = evidence._replace(
            growth=growth,
            grown=evidence.grown + added[0],
            returns=evidence.returns._replace(nearest=nearest),
            speeds=self.rest.renewed(evidence.speeds, step, ended),
        )
        return evidence, outcome
