r"""Lyapunov exponents: the mean rates at which small differences grow.

$$\lambda_i = \lim_{t\to\infty} \frac1t \ln \lVert v_i(t) \rVert$$

for tangents v that are kept orthonormal by Gram-Schmidt (Benettin et al., Meccanica 15
(1980) 9-20; Shimada & Nagashima 1979). The first is positive where neighbours part
exponentially: chaos. A motion that does not come to rest has one that is zero, along
itself; their sum is the mean divergence of the flow.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, TypedDict, cast

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..model.column import Column, State
from ..model.state import PhasePoint
from ..model.system import System
from ..motion.checks import check_scene
from ..motion.ending import ending, nan_where
from ..motion.method import explicit_method
from ..motion.not_finite import motion
from ..motion.options import Method, Spans, recorded, spans_for
from ..motion.spans import AbstractSpans, SpanState, follow_spans
from ..motion.tangents import AbstractGrowth, TangentFrame, in_logs, unit_tangents
from ..numerics.no_number import refused
from ..numerics.numbers import Flag, Option, Scalar
from ..numerics.rules import whole_number
from ..results import CODE, RATE, AbstractMotionResult, Settings, Variable
from ..solvers import Explicit

NO_DERIVATIVE = (
    "`{}` has no derivatives: differences grow along a motion, and what is summed of "
    "them says nothing of its averages. Take it out of what is differentiated "
    "(`jax.lax.stop_gradient` of its arguments), or take differences of its results."
)
EXPONENTS = Variable(None, "Lyapunov exponent", RATE, ("exponent",))
ERRORS = Variable(None, "standard error of the exponent", RATE, ("exponent",))


class Exponents(AbstractMotionResult[State]):
    """Lyapunov exponents of one lane, with standard errors.

    `exponents`, `errors`: shape (count,), from the largest on; in the order of
    Gram-Schmidt, so that equal ones may be exchanged within their errors. Minus
    infinity, without error, is a dimension that was lost where a joint sticks.
    """

    exponents: Float[Array, "*lanes exponent"] = eqx.field(
        metadata={"quantity": EXPONENTS}
    )
    errors: Float[Array, "*lanes exponent"] = eqx.field(metadata={"quantity": ERRORS})

    def coordinates(self) -> dict[str, Sequence[object]]:
        """Their numbers, from 1."""
        return {"exponent": tuple(range(1, self.exponents.shape[-1] + 1))}


@motion
def lyapunov_exponents(
    column: Column,
    start: State,
    *,
    count: int = 4,
    spans: Spans = Spans(),
    method: Method = Method(),
) -> Exponents:
    r"""The first `count` Lyapunov exponents of the motion from `start`.

    The tangents are those of the computed motion (see `tangents`), orthonormal after
    every step, and pass through stick and slip by saltation. After the transient, in
    which they turn into their directions, mean growth rates $r_b$ are taken, each over
    one of B spans:

    $$\lambda = \bar r, \qquad
    \mathrm{error} = \sqrt{\frac{\sum_b (r_b - \bar r)^2}{B(B-1)}}.$$

    The error is that of spans that know little of each other: their `length` should be
    many periods, and longer than the motion remembers. It does not see what the ends of
    the whole time T contribute, of order $1/T$, nor that an exponent which is zero
    because growth is not exponential is still of the size $\ln T / T$.

    **Arguments:** (times in $\sqrt{m l^2/k}$)

    - `column`, `start`: the scene.
    - `count`: how many exponents, 1 to 4. Each costs.
    - `spans`: as above, see `Spans`.
    - `method`: an explicit one; its tolerances are those of the motion's steps, which
        the tangents share.

    **Returns:** `Exponents`, in $\sqrt{k/(m l^2)}$; `outcome` is `complete`, or a
    failure with NaN.

    **Raises:** `ValueError` for arguments that break a rule, in a 32-bit session, and
    where a derivative is taken: averages over long motions have none to rely on.
    """
    check_scene(column, start)
    scene = column, start, spans, method
    column, start, spans, method = refused(
        NO_DERIVATIVE.format("lyapunov_exponents"), scene
    )
    count = whole_number("count", count)
    if count > 4:
        raise ValueError(f"Argument `count` must be at most 4, but is {count}.")
    method = explicit_method("lyapunov_exponents", method)
    spans = spans_for("lyapunov_exponents", spans)
    fold = GrowthRates(count=count, **growth_options(method, spans))
    run = follow_spans(column, start, fold, method)
    failed = run.outcome < CODE.unsettled
    growth, n = run.folded.watch, run.folded.spans
    return Exponents(
        exponents=nan_where(failed, jnp.stack(growth.mean)),
        errors=nan_where(failed, jnp.stack(standard_errors(growth, n))),
        settings=growth_settings(method, spans),
        **ending(run),
    )


class GrowthOptions(TypedDict):
    """What folds over spans of growth have in common."""

    solver: Explicit
    rtol: Scalar
    transient: Scalar
    span: Scalar
    most: int
    escape: Scalar


def growth_options(method: Method, spans: Spans) -> GrowthOptions:
    """What folds over spans of growth have in common."""
    return {
        "solver": method.explicit,
        "rtol": method.tolerances[0],
        "transient": cast(Scalar, spans.transient),
        "span": cast(Scalar, spans.length),
        "most": cast(int, spans.count),
        "escape": cast(Scalar, spans.escape),
    }


def growth_settings(method: Method, spans: Spans, **more: Option) -> Settings:
    """Their options, for the record."""
    return recorded(
        **method.settings(),
        transient=spans.transient,
        span_length=spans.length,
        span_count=spans.count,
        escape=spans.escape,
        **more,
    )


class GrowthSums(NamedTuple):
    """Tangents, and the rates at which they grow, from block to block."""

    tangents: TangentFrame
    mean: tuple[Scalar, ...]  # of the blocks so far
    squares: tuple[Scalar, ...]  # of the deviations from it, their sums


def no_growth(system: System, y: PhasePoint, count: int) -> GrowthSums:
    """Unit tangents that have not grown."""
    zero = (0.0 * y[0],) * count
    return GrowthSums(unit_tangents(system, y, count), zero, zero)


def with_block(
    growth: GrowthSums, blocks: Int[Array, ""], block: Scalar, ended: Flag
) -> tuple[GrowthSums, tuple[Scalar, ...]]:
    """One block more where it has ended (Welford's update); the transient's is lost.

    **Arguments:** `blocks`: how many there are with it; `block`: its length.

    **Returns:** the growth, and the logarithms of what the block has added to it.
    """
    tangents = in_logs(growth.tangents, ended)
    counted = ended & (blocks > 0)
    count = blocks.astype(jnp.result_type(tangents.logs[0]))
    means, squares = [], []
    rows = zip(tangents.logs, growth.mean, growth.squares, strict=True)
    for log, mean, square in rows:
        rate = log / block
        # two infinities that agree do not differ
        off = jnp.where(rate == mean, 0.0, rate - mean)
        new = mean + off / jnp.where(counted, count, 1.0)
        still = jnp.where(rate == new, 0.0, rate - new)
        means.append(jnp.where(counted, new, mean))
        squares.append(jnp.where(counted, square + off * still, square))
    added = tuple(jnp.where(ended, x, 0.0) for x in tangents.logs)
    logs = tuple(jnp.where(ended, 0.0, x) for x in tangents.logs)
    growth = GrowthSums(tangents._replace(logs=logs), tuple(means), tuple(squares))
    return growth, added


def standard_errors(growth: GrowthSums, blocks: Int[Array, ""]) -> tuple[Scalar, ...]:
    """Those of the means; none (NaN) of fewer than two blocks, 0 of infinity."""
    n = blocks.astype(jnp.result_type(growth.mean[0]))
    pairs = jnp.where(n > 1, n * (n - 1), jnp.nan)
    return tuple(
        jnp.where(jnp.isinf(mean), 0.0, jnp.sqrt(square / pairs))
        for mean, square in zip(growth.mean, growth.squares, strict=True)
    )


class GrowthRates(AbstractSpans[GrowthSums], AbstractGrowth[SpanState[GrowthSums]]):
    """A transient, then blocks of growth."""

    solver: Explicit
    rtol: Scalar
    count: int

    def begin(self, system, t0, y0):
        """Unit tangents that have not grown."""
        del t0
        return no_growth(system, y0, self.count)

    def tangents(self, state):
        """Those of the blocks."""
        return state.watch.tangents

    def watch(self, system, state, step):
        """Let the tangents grow."""
        tangents, longest = self.advance_frame(system, state, step)
        return state.watch._replace(tangents=tangents), False, longest

    def judge(self, system, state, step, ended):
        """Take the block's rates."""
        del system, step
        growth, _ = with_block(state.watch, state.spans, self.span, ended)
        last = state.spans >= self.most
        return growth, jnp.where(last, CODE.complete, state.outcome)
