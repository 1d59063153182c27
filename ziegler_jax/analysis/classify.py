r"""A verdict on one motion: stuck, a cycle, quasi-periodic, chaotic, or none of them.

Two witnesses are heard while the motion runs. Its passages through the section
$\phi_1 = 0$, rising: a cycle of p passages a period returns to each, and its tangents
do not grow meanwhile, as they do beside an unstable one. And its two largest Lyapunov
exponents, which tell quasi-periodic motion (both zero) from chaos (one is positive).
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..model.column import Column, State, power
from ..motion.integrate import Method, Motion, follow
from ..motion.not_finite import motion
from ..motion.observers import TIME, joint_rates
from ..motion.scene import (
    check_scene,
    explicit_method,
    float_state,
    nan_where,
    rate_cut_of,
    recorded,
    tolerances,
    valid_scene,
    whole_number,
)
from ..motion.section import Plane, passage
from ..motion.tangents import AbstractGrowth, Growing, in_logs, unit_tangents
from ..motion.windows import first_stop, last_stop, told_apart
from ..numerics.materialise import if_any_lane
from ..numerics.numbers import Scalar, keeps, number
from ..results import OUTCOME, VERDICT, Variable
from ..solvers import Explicit, Step
from .lyapunov import RATE, Rates, no_rates, standard_errors, with_block
from .poincare import Returns, no_returns, returned

SURE = 3.0  # standard errors
NEAR = 1e-3  # of a point: a passage this near one before it is on its way to a cycle
DRIFT = 0.1  # of the largest angle: what changes more has not settled
PLANE = Plane()


class Verdict(eqx.Module):
    r"""What a motion is, and the witnesses.

    `verdict`: a code of VERDICT; `period_count`: passages of $\phi_1 = 0$, rising, a
    period, 0 where none was found; `period`: NaN likewise; `exponents`, `errors`: shape
    (2,), over the blocks that were measured, NaN where there was none; `outcome`: a
    code of OUTCOME.
    """

    verdict: Any
    period_count: Any
    period: Any
    exponents: Any
    errors: Any
    final: State
    time: Any
    steps: Any
    outcome: Any
    settings: tuple[tuple[str, Any], ...] = eqx.field(static=True)

    def variables(self) -> dict[str, Variable]:
        """All numbers with their names, for `sweep`."""
        named = {
            "verdict": Variable(self.verdict, "what the motion is", codes=VERDICT),
            "period_count": Variable(self.period_count, "passages a period"),
            "period": Variable(self.period, "period of the cycle", TIME),
        }
        for i in range(2):
            meaning = f"Lyapunov exponent {i + 1}"
            named[f"exponent_{i + 1}"] = Variable(self.exponents[i], meaning, RATE)
            named[f"exponent_{i + 1}_error"] = Variable(
                self.errors[i], f"standard error of {meaning}", RATE
            )
        return named | {
            "time": Variable(self.time, "time at the end", TIME),
            "steps": Variable(self.steps, "attempted steps"),
            "outcome": Variable(self.outcome, "how the motion ended", codes=OUTCOME),
        }

    def attributes(self) -> dict[str, Any]:
        """How it was found."""
        return dict(self.settings)


@motion
def verdict(
    column: Column,
    start: State,
    *,
    transient: Any = 200.0,
    block: Any = 50.0,
    blocks: int = 20,
    rtol_return: Any = 1e-5,
    zero_rate: Any = 0.01,
    rtol: Any = 1e-7,
    atol: Any = 1e-7,
    solver: Explicit | None = None,
    escape: Any = np.pi,
    rate_cut: Any = None,
    max_steps: int = 10_000_000,
) -> Verdict:
    r"""What kind of motion the column ends in from `start`.

    In this order, as soon as one holds:

    - `escaped`: a rod's angle passed `escape`.
    - `stuck`: both joints stick; with a smoothed law or without friction both joint
        rates stayed below `rate_cut` for a block and were no faster than in the block
        before.
    - `cycle`: after the transient a passage of the section comes back to within
        `rtol_return` (of its largest coordinate) after p passages and again after 2p,
        $p \le 16$, and over these the tangent, relative to the flow, grew by no more
        than `zero_rate` a unit of time: beside an unstable cycle a motion comes back as
        well. A `zero_rate` near the tangents' own errors finds no cycle. References are
        renewed after 1, 2, 4, 8, 16 passages (Brent's cycle detection): p is the number
        of passages a period.

    and where none did after all blocks, by the exponents $\lambda_1, \lambda_2$, if the
    largest angles of both halves of the blocks are within a tenth of each other (else
    it is a transient, and `undecided`):

    - `conservative`: neither friction nor damping took anything out at the end of any
        step after the transient: no motion attracts.
    - `chaotic`: $\lambda_1 >$ `zero_rate` and $\lambda_1 > 3$ standard errors.
    - `quasi_periodic`: both are zero: $|\lambda| \le$ `zero_rate`, and
        $|\lambda| \le 1/T + 3$ standard errors after blocks of T in all; and in the
        last block no passage came to within 1e-3 of a reference.
    - `cycle` with a period count of 0: $\lambda_1$ is zero and $\lambda_2$ is
        negative beyond that: its period is longer, or it is approached slowly.
    - `undecided` else.

    A motion that creeps past the ghost of a cycle can pass for one if it moves by less
    than `rtol_return` a period. With growth that is not exponential $\lambda$ is still
    about $\ln t / t$, 0.007 after the 1000 time units of the default; chaos weaker than
    `zero_rate` is not told from quasi-periodic motion.

    **Arguments:** (times in $\sqrt{m l^2/k}$)

    - `column`, `start`: the scene.
    - `transient`, `block`, `blocks`: as `lyapunov_exponents`; at least 2 blocks.
    - `rtol_return`, `zero_rate`: as above.
    - `rtol`, `atol`, `solver`, `escape`, `max_steps`: as `lyapunov_exponents`;
        `rtol_return` should be well above `rtol`.
    - `rate_cut`: as `settle`.

    **Returns:** `Verdict`.

    **Raises:** `ValueError` for arguments that break a rule, and in a 32-bit
    session.
    """
    check_scene(column, start)
    rtol, atol = tolerances(rtol, atol)
    blocks = whole_number("blocks", blocks)
    if blocks < 2:
        raise ValueError(
            f"Argument `blocks` must be at least 2, for an error, but is {blocks}."
        )
    fold = Witnesses(
        solver=explicit_method(solver, Explicit()),
        rtol=rtol,
        transient=number("transient", transient, "nonnegative"),
        block=number("block", block, "positive"),
        blocks=blocks,
        rtol_return=number("rtol_return", rtol_return, "positive"),
        zero_rate=number("zero_rate", zero_rate, "positive"),
        escape=number("escape", escape, "positive"),
        rate_cut=rate_cut_of(column, rate_cut),
    )
    y0 = float_state(start)
    good = valid_scene(column, y0) & fold.valid()
    limit = whole_number("max_steps", max_steps)
    run = follow(
        Motion(
            column,
            y0,
            fold,
            Method(fold.solver, rtol, atol, limit),
            valid=good & keeps("positive", rtol, atol),
            first_stop=first_stop(fold.transient, fold.block),
            end=last_stop(fold.transient, fold.block, blocks),
            at_end=OUTCOME.unsettled,
        )
    )
    rates, returns = run.folded.rates, run.folded.returns
    found = run.outcome == OUTCOME.cycle
    unmeasured = (rates.blocks < 1) | (run.outcome < OUTCOME.unsettled)
    return Verdict(
        verdict=_judged(run.outcome, run.folded, fold),
        period_count=jnp.where(found, returns.found, 0.0),
        period=jnp.where(found, returns.period, jnp.nan),
        exponents=nan_where(unmeasured, jnp.stack(rates.mean)),
        errors=nan_where(unmeasured, jnp.stack(standard_errors(rates))),
        final=State(run.y[:2], run.y[2:]),
        time=run.time,
        steps=run.steps,
        outcome=run.outcome.astype(jnp.int8),
        settings=recorded(
            solver=fold.solver.name,
            rtol=rtol,
            atol=atol,
            transient=fold.transient,
            block=fold.block,
            blocks=blocks,
            rtol_return=fold.rtol_return,
            zero_rate=fold.zero_rate,
            escape=fold.escape,
            rate_cut="by modes" if fold.rate_cut is None else fold.rate_cut,
            max_steps=limit,
        ),
    )


def _judged(outcome: Any, heard: "WitnessState", fold: "Witnesses") -> jax.Array:
    """The code of VERDICT."""
    zero_rate = fold.zero_rate
    rates, span = heard.rates, fold.blocks * fold.block
    (first, second), (error, other) = rates.mean, standard_errors(rates)

    def zero(rate, error):
        """Not to be told from zero: by one e-fold in all, and by its error."""
        within = jnp.abs(rate) <= 1 / span + SURE * error
        return within & (jnp.abs(rate) <= zero_rate)

    alone, both = zero(first, error), zero(first, error) & zero(second, other)
    by_rates = jnp.where(alone & ~both & (second < 0), VERDICT.cycle, 0)
    apart = heard.returns.nearest > NEAR
    by_rates = jnp.where(both & apart, VERDICT.quasi_periodic, by_rates)
    chaotic = (first > zero_rate) & (first > SURE * error)
    by_rates = jnp.where(chaotic, VERDICT.chaotic, by_rates)
    early, late = heard.angles
    transient = jnp.abs(late - early) > DRIFT * jnp.maximum(late, early)
    transient |= rates.blocks < fold.blocks
    by_rates = jnp.where((by_rates == 0) | transient, VERDICT.undecided, by_rates)
    by_rates = jnp.where(heard.dissipates, by_rates, VERDICT.conservative)
    code = jnp.where(outcome == OUTCOME.unsettled, by_rates, VERDICT.failed)
    at_rest = (outcome == OUTCOME.stuck) | (outcome == OUTCOME.rest)
    code = jnp.where(at_rest, VERDICT.stuck, code)
    code = jnp.where(outcome == OUTCOME.cycle, VERDICT.cycle, code)
    return jnp.where(outcome == OUTCOME.escaped, VERDICT.escaped, code).astype(jnp.int8)


class WitnessState(NamedTuple):
    """The running numbers of a lane."""

    growing: Growing
    grown: Scalar  # logarithm of the first tangent's growth in the blocks before
    rates: Rates
    returns: Returns
    fastest: Scalar  # the largest joint rate of this block
    faster: Scalar  # that of the block before
    angles: tuple[Scalar, Scalar]  # the largest in each half of the blocks
    dissipates: Any
    stop: Scalar
    outcome: Scalar


class Witnesses(AbstractGrowth):
    """Sections and exponents of one motion, until one of them decides."""

    solver: Explicit
    rtol: Scalar
    transient: Scalar
    block: Scalar
    blocks: int
    rtol_return: Scalar
    zero_rate: Scalar
    escape: Scalar
    rate_cut: Scalar | None  # None: set-valued friction, by modes

    def valid(self) -> Any:
        """Whether the options keep their rules; for those only known when traced."""
        good = keeps("nonnegative", self.transient)
        good &= keeps("positive", self.block, self.rtol_return, self.zero_rate)
        good &= keeps("positive", self.escape, self.rate_cut)
        return good & told_apart("block", self.transient, self.block, self.blocks)

    def init(self, column, t0, y0):
        """Nothing heard yet."""
        zero, no = 0.0 * y0[0], jnp.zeros((), bool)
        return WitnessState(
            growing=unit_tangents(column, y0, 2),
            grown=zero,
            rates=no_rates(self.transient, zero, 2),
            returns=no_returns(t0, y0),
            fastest=zero,
            faster=zero,
            angles=(zero, zero),
            dissipates=no,
            stop=first_stop(self.transient, self.block) + zero,
            outcome=jnp.asarray(OUTCOME.not_computed, jnp.int32),
        )

    def step(self, column, state, step):
        """Hear both witnesses; judge at a block's end or when one decides."""
        growing, longest = self.grow(column, state.growing, step)
        measuring = state.rates.blocks >= 0
        seen = passage(PLANE, step)
        seen = seen._replace(there=seen.there & measuring)

        def heard_again(returns):
            # at the step's start, relative to the field's own length there: what moves
            # along the flow has then not grown, wherever on the cycle the step begins
            before = state.growing
            length = before.factors[0] / jnp.sqrt(sum(f * f for f in step.f0))
            growth = state.grown + before.logs[0] + jnp.log(length)
            return returned(returns, seen, growth, self.rtol_return, self.zero_rate)

        returns = if_any_lane(seen.there, heard_again, state.returns)
        rates = joint_rates(step.y1)
        fastest = jnp.maximum(jnp.abs(rates[0]), jnp.abs(rates[1]))
        lost = [p for p in power(column, step.y1)[1:] if p is not None]
        dissipates = state.dissipates
        for loss in lost:
            dissipates |= measuring & (loss > 0)
        angle = jnp.maximum(jnp.abs(step.y1[0]), jnp.abs(step.y1[1]))
        early = measuring & (state.rates.blocks < self.blocks // 2)
        late = state.rates.blocks >= self.blocks // 2
        heard = state._replace(
            growing=growing,
            angles=tuple(
                jnp.where(when, jnp.maximum(peak, angle), peak)
                for when, peak in zip((early, late), state.angles, strict=True)
            ),
            returns=returns,
            fastest=jnp.maximum(state.fastest, fastest),
            dissipates=dissipates,
        )
        ended = step.t1 >= state.stop
        turned = angle > self.escape
        stuck = jnp.zeros_like(ended)
        if self.rate_cut is None:
            m1, m2 = step.event[1]
            stuck = (m1 == 0) & (m2 == 0)  # then nothing moves any more

        def judge(heard):
            return self._judge(column, heard, step, ended, turned, stuck)

        asked = ended | turned | stuck | returns.confirmed
        after = if_any_lane(asked, judge, heard)
        stop = jnp.minimum(after.stop, step.t1 + longest)
        return after, stop, after.outcome != OUTCOME.not_computed

    def _judge(
        self,
        column: Column,
        heard: WitnessState,
        step: Step,
        ended: Any,
        turned: Any,
        stuck: Any,
    ) -> WitnessState:
        """What is decided."""
        growing = in_logs(heard.growing, ended)
        rates = with_block(heard.rates, growing.logs, self.block, ended)
        if self.rate_cut is not None:
            slow = heard.fastest < self.rate_cut
            stuck = ended & slow & (heard.fastest <= heard.faster)
        resting = OUTCOME.rest if column.friction is None else OUTCOME.stuck
        over = rates.blocks >= self.blocks
        outcome = jnp.where(over, OUTCOME.unsettled, heard.outcome)
        repeats = heard.returns.confirmed & heard.dissipates
        outcome = jnp.where(repeats, OUTCOME.cycle, outcome)
        outcome = jnp.where(stuck, resting, outcome)
        outcome = jnp.where(turned, OUTCOME.escaped, outcome)
        return heard._replace(
            growing=growing._replace(
                logs=tuple(jnp.where(ended, 0.0, x) for x in growing.logs)
            ),
            grown=heard.grown + jnp.where(ended, growing.logs[0], 0.0),
            rates=rates,
            returns=heard.returns._replace(
                nearest=jnp.where(ended & ~over, 1.0, heard.returns.nearest)
            ),
            fastest=jnp.where(ended, 0.0, heard.fastest),
            faster=jnp.where(ended, heard.fastest, heard.faster),
            stop=jnp.where(ended, step.t1 + self.block, heard.stop),
            outcome=outcome.astype(jnp.int32),
        )
