r"""Lyapunov exponents: the mean rates at which small differences grow.

$$\lambda_i = \lim_{t\to\infty} \frac1t \ln \lVert v_i(t) \rVert$$

for tangents v that are kept orthonormal by Gram-Schmidt (Benettin et al., Meccanica 15
(1980) 9-20; Shimada & Nagashima 1979). The first is positive where neighbours part
exponentially: chaos. A motion that does not come to rest has one that is zero, along
itself; their sum is the mean divergence of the flow.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from ..model.column import Column, State
from ..motion.integrate import Method
from ..motion.not_finite import motion
from ..motion.scene import check_scene, ending, nan_where, recorded
from ..motion.tangents import AbstractGrowth, Growing, in_logs, unit_tangents
from ..motion.windows import AbstractSpans, explicit_steps, follow_spans
from ..numerics.numbers import Scalar, Vector4, number, whole_number
from ..results import OUTCOME, RATE, AbstractMotionResult, Variable
from ..solvers import Explicit


class Exponents(AbstractMotionResult):
    """Lyapunov exponents of one lane, with standard errors.

    `exponents`, `errors`: shape (count,), from the largest on; in the order of
    Gram-Schmidt, so that equal ones may be exchanged within their errors. Minus
    infinity, without error, is a dimension that was lost where a joint sticks.
    """

    exponents: Any
    errors: Any

    def variables(self) -> dict[str, Variable]:
        """`exponent_1`, `exponent_1_error`, ..., for `sweep`."""
        return exponent_variables(self) | super().variables()


def exponent_variables(result: Any) -> dict[str, Variable]:
    """The exponents of a result."""
    named: dict[str, Variable] = {}
    for i in range(result.exponents.shape[-1]):
        name = f"exponent_{i + 1}"
        meaning = f"Lyapunov exponent {i + 1}"
        named[name] = Variable(result.exponents[..., i], meaning, RATE)
        named[f"{name}_error"] = Variable(
            result.errors[..., i], f"standard error of {meaning}", RATE
        )
    return named


@motion
def lyapunov_exponents(
    column: Column,
    start: State,
    *,
    count: int = 4,
    transient: Any = 200.0,
    block: Any = 50.0,
    blocks: int = 20,
    rtol: Any = 1e-8,
    atol: Any = 1e-8,
    solver: Explicit | None = None,
    escape: Any = np.pi,
    max_steps: int = 10_000_000,
) -> Exponents:
    r"""The first `count` Lyapunov exponents of the motion from `start`.

    The tangents are those of the computed motion (see `tangents`), orthonormal after
    every step, and pass through stick and slip by saltation. After the transient, in
    which they turn into their directions, `blocks` mean growth rates $r_b$ are taken,
    each over a time `block`:

    $$\lambda = \bar r, \qquad
    \mathrm{error} = \sqrt{\frac{\sum_b (r_b - \bar r)^2}{B(B-1)}}.$$

    The error is that of blocks that know little of each other: `block` should be many
    periods, and longer than the motion remembers. It does not see what the ends of the
    whole time T contribute, of order $1/T$, nor that an exponent which is zero because
    growth is not exponential is still of the size $\ln T / T$.

    **Arguments:** (times in $\sqrt{m l^2/k}$)

    - `column`, `start`: the scene.
    - `count`: how many exponents, 1 to 4. Each costs.
    - `transient`, `block`, `blocks`: as above.
    - `rtol`, `atol`: tolerances of the motion's steps, which the tangents share.
    - `solver`: `Explicit(tableau)`; None is Tsit5.
    - `escape`: a rod's angle beyond which the lane ends as `escaped`.
    - `max_steps`: the step budget.

    **Returns:** `Exponents`, in $\sqrt{k/(m l^2)}$; `outcome` is `complete`, or a
    failure with NaN.

    **Raises:** `ValueError` for arguments that break a rule, and in a 32-bit
    session.
    """
    check_scene(column, start)
    count = whole_number("count", count)
    if count > 4:
        raise ValueError(f"Argument `count` must be at most 4, but is {count}.")
    method = explicit_steps(solver, rtol, atol, max_steps)
    fold = GrowthRates(
        count=count, **growth_options(method, transient, block, blocks, escape)
    )
    run = follow_spans(column, start, fold, method)
    failed = run.outcome < OUTCOME.unsettled
    growth, n = run.folded.watch, run.folded.spans
    return Exponents(
        exponents=nan_where(failed, jnp.stack(growth.mean)),
        errors=nan_where(failed, jnp.stack(standard_errors(growth, n))),
        settings=growth_settings(fold, method),
        **ending(run),
    )


def growth_options(
    method: Method, transient: Any, block: Any, blocks: Any, escape: Any
) -> dict[str, Any]:
    """What folds over blocks of growth have in common, validated."""
    blocks = whole_number("blocks", blocks)
    if blocks < 2:
        raise ValueError(
            f"Argument `blocks` must be at least 2, for an error, but is {blocks}."
        )
    return {
        "solver": method.solver,
        "rtol": method.rtol,
        "transient": number("transient", transient, "nonnegative"),
        "span": number("block", block, "positive"),
        "most": blocks,
        "escape": number("escape", escape, "positive"),
    }


def growth_settings(fold: AbstractSpans, method: Method, **more: Any) -> Any:
    """Their options, for the record."""
    return recorded(
        solver=method.solver.name,
        rtol=method.rtol,
        atol=method.atol,
        transient=fold.transient,
        block=fold.span,
        blocks=fold.most,
        escape=fold.escape,
        max_steps=method.max_steps,
        **more,
    )


class Growth(NamedTuple):
    """Tangents, and the rates at which they grow, from block to block."""

    tangents: Growing
    mean: tuple[Scalar, ...]  # of the blocks so far
    squares: tuple[Scalar, ...]  # of the deviations from it, their sums


def no_growth(column: Column, y: Vector4, count: int) -> Growth:
    """Unit tangents that have not grown."""
    zero = (0.0 * y[0],) * count
    return Growth(unit_tangents(column, y, count), zero, zero)


def with_block(
    growth: Growth, blocks: Scalar, block: Scalar, ended: Any
) -> tuple[Growth, tuple[Scalar, ...]]:
    """One block more where it has ended (Welford's update); the transient's is lost.

    **Arguments:** `blocks`: how many there are with it; `block`: its length.

    **Returns:** the growth, and the logarithms of what the block has added to it.
    """
    tangents = in_logs(growth.tangents, ended)
    counted = ended & (blocks > 0)
    count = blocks.astype(tangents.logs[0].dtype)
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
    growth = Growth(tangents._replace(logs=logs), tuple(means), tuple(squares))
    return growth, added


def standard_errors(growth: Growth, blocks: Scalar) -> tuple[Scalar, ...]:
    """Those of the means; none (NaN) of fewer than two blocks, 0 of infinity."""
    n = blocks.astype(growth.mean[0].dtype)
    pairs = jnp.where(n > 1, n * (n - 1), jnp.nan)
    return tuple(
        jnp.where(jnp.isinf(mean), 0.0, jnp.sqrt(square / pairs))
        for mean, square in zip(growth.mean, growth.squares, strict=True)
    )


class GrowthRates(AbstractSpans, AbstractGrowth):
    """A transient, then blocks of growth."""

    solver: Explicit
    rtol: Scalar
    count: int

    def begin(self, column, t0, y0):
        """Unit tangents that have not grown."""
        del t0
        return no_growth(column, y0, self.count)

    def tangents(self, state):
        """Those of the blocks."""
        return state.watch.tangents

    def watch(self, column, state, step):
        """Let the tangents grow."""
        tangents, longest = self.grow(column, state, step)
        return state.watch._replace(tangents=tangents), False, longest

    def judge(self, column, state, step, ended):
        """Take the block's rates."""
        del column, step
        growth, _ = with_block(state.watch, state.spans, self.span, ended)
        last = state.spans >= self.most
        return growth, jnp.where(last, OUTCOME.complete, state.outcome)
