r"""Lyapunov exponents: the mean rates at which small differences grow.

$$\lambda_i = \lim_{t\to\infty} \frac1t \ln \lVert v_i(t) \rVert$$

for tangents v that are kept orthonormal by Gram-Schmidt (Benettin et al., Meccanica 15
(1980) 9-20; Shimada & Nagashima 1979). The first is positive where neighbours part
exponentially: chaos. A motion that does not come to rest has one that is zero, along
itself; their sum is the mean divergence of the flow.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ..model.column import Column, State
from ..motion.integrate import Method, Motion, follow
from ..motion.not_finite import motion
from ..motion.observers import TIME
from ..motion.scene import (
    check_scene,
    explicit_method,
    float_state,
    nan_where,
    recorded,
    tolerances,
    valid_scene,
    whole_number,
)
from ..motion.tangents import AbstractGrowth, Growing, in_logs, unit_tangents
from ..motion.windows import first_stop, last_stop, told_apart
from ..numerics.materialise import if_any_lane
from ..numerics.numbers import Scalar, keeps, number
from ..results import OUTCOME, Variable
from ..solvers import Explicit

RATE = "sqrt(k/(m l^2))"


class Exponents(eqx.Module):
    """Lyapunov exponents of one lane, with standard errors.

    `exponents`, `errors`: shape (count,), from the largest on; in the order of
    Gram-Schmidt, so that equal ones may be exchanged within their errors. Minus
    infinity, without error, is a dimension that was lost where a joint sticks.
    """

    exponents: Any
    errors: Any
    final: State
    time: Any
    steps: Any
    outcome: Any
    settings: tuple[tuple[str, Any], ...] = eqx.field(static=True)

    def variables(self) -> dict[str, Variable]:
        """`exponent_1`, `exponent_1_error`, ..., for `sweep`."""
        named: dict[str, Variable] = {}
        for i in range(self.exponents.shape[-1]):
            name = f"exponent_{i + 1}"
            meaning = f"Lyapunov exponent {i + 1}"
            named[name] = Variable(self.exponents[..., i], meaning, RATE)
            named[f"{name}_error"] = Variable(
                self.errors[..., i], f"standard error of {meaning}", RATE
            )
        return named | {
            "time": Variable(self.time, "time at the end", TIME),
            "steps": Variable(self.steps, "attempted steps"),
            "outcome": Variable(self.outcome, "how the motion ended", codes=OUTCOME),
        }

    def attributes(self) -> dict[str, Any]:
        """How they were computed."""
        return dict(self.settings)


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
    rtol, atol = tolerances(rtol, atol)
    count = whole_number("count", count)
    if count > 4:
        raise ValueError(f"Argument `count` must be at most 4, but is {count}.")
    blocks = whole_number("blocks", blocks)
    if blocks < 2:
        raise ValueError(
            f"Argument `blocks` must be at least 2, for an error, but is {blocks}."
        )
    fold = Blocks(
        solver=explicit_method(solver, Explicit()),
        rtol=rtol,
        count=count,
        transient=number("transient", transient, "nonnegative"),
        block=number("block", block, "positive"),
        blocks=blocks,
        escape=number("escape", escape, "positive"),
    )
    y0 = float_state(start)
    good = valid_scene(column, y0) & fold.valid() & keeps("positive", rtol, atol)
    limit = whole_number("max_steps", max_steps)
    run = follow(
        Motion(
            column,
            y0,
            fold,
            Method(fold.solver, rtol, atol, limit),
            valid=good,
            first_stop=first_stop(fold.transient, fold.block),
            end=last_stop(fold.transient, fold.block, blocks),
        )
    )
    failed = run.outcome < OUTCOME.unsettled
    rates = run.folded.rates
    return Exponents(
        exponents=nan_where(failed, jnp.stack(rates.mean)),
        errors=nan_where(failed, jnp.stack(standard_errors(rates))),
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
            escape=fold.escape,
            max_steps=limit,
        ),
    )


class Rates(NamedTuple):
    """Running mean and sum of squared deviations of the blocks' growth rates."""

    blocks: Scalar  # completed; -1 in the transient
    mean: tuple[Scalar, ...]
    squares: tuple[Scalar, ...]


def no_rates(transient: Any, zero: Scalar, count: int) -> Rates:
    """Before the first block."""
    blocks = jnp.where(jnp.asarray(transient) > 0, -1.0, 0.0).astype(zero.dtype)
    return Rates(blocks + zero, (zero,) * count, (zero,) * count)


def with_block(rates: Rates, logs: tuple, block: Scalar, ended: Any) -> Rates:
    """One block more where it has ended (Welford's update); the transient's is lost."""
    blocks = rates.blocks + jnp.where(ended, 1.0, 0.0)
    counted = ended & (blocks > 0)
    means, squares = [], []
    for growth, mean, square in zip(logs, rates.mean, rates.squares, strict=True):
        rate = growth / block
        # two infinities that agree do not differ
        off = jnp.where(rate == mean, 0.0, rate - mean)
        new = mean + off / jnp.where(counted, blocks, 1.0)
        still = jnp.where(rate == new, 0.0, rate - new)
        means.append(jnp.where(counted, new, mean))
        squares.append(jnp.where(counted, square + off * still, square))
    return Rates(blocks, tuple(means), tuple(squares))


def standard_errors(rates: Rates) -> tuple[Scalar, ...]:
    """Those of the means; none (NaN) of fewer than two blocks, 0 of infinity."""
    n = rates.blocks
    pairs = jnp.where(n > 1, n * (n - 1), jnp.nan)
    return tuple(
        jnp.where(jnp.isinf(mean), 0.0, jnp.sqrt(square / pairs))
        for mean, square in zip(rates.mean, rates.squares, strict=True)
    )


class BlocksState(NamedTuple):
    """The running numbers of a lane."""

    growing: Growing
    rates: Rates
    stop: Scalar
    outcome: Scalar


class Blocks(AbstractGrowth):
    """A transient, then blocks of growth."""

    solver: Explicit
    rtol: Scalar
    count: int
    transient: Scalar
    block: Scalar
    blocks: int
    escape: Scalar

    def valid(self) -> Any:
        """Whether the options keep their rules; for those only known when traced."""
        good = keeps("nonnegative", self.transient)
        good &= keeps("positive", self.block, self.escape)
        return good & told_apart("block", self.transient, self.block, self.blocks)

    def init(self, column, t0, y0):
        """Unit tangents that have not grown."""
        zero = 0.0 * y0[0]
        return BlocksState(
            unit_tangents(column, y0, self.count),
            no_rates(self.transient, zero, self.count),
            first_stop(self.transient, self.block) + zero,
            jnp.asarray(OUTCOME.not_computed, jnp.int32),
        )

    def step(self, column, state, step):
        """Let the tangents grow; at a block's end keep its rates."""
        growing, longest = self.grow(column, state.growing, step)
        seen = state._replace(growing=growing)
        ended = step.t1 >= state.stop
        turned = jnp.maximum(jnp.abs(step.y1[0]), jnp.abs(step.y1[1])) > self.escape

        def judge(seen):
            growing = in_logs(seen.growing, ended)
            rates = with_block(seen.rates, growing.logs, self.block, ended)
            over = rates.blocks >= self.blocks
            outcome = jnp.where(over, OUTCOME.complete, seen.outcome)
            outcome = jnp.where(turned, OUTCOME.escaped, outcome)
            logs = tuple(jnp.where(ended, 0.0, x) for x in growing.logs)
            return BlocksState(
                growing._replace(logs=logs),
                rates,
                jnp.where(ended, step.t1 + self.block, seen.stop),
                outcome.astype(jnp.int32),
            )

        after = if_any_lane(ended | turned, judge, seen)
        stop = jnp.minimum(after.stop, step.t1 + longest)
        return after, stop, after.outcome != OUTCOME.not_computed
