r"""Lyapunov exponents: the mean rates at which small differences grow.

$$\lambda_i = \lim_{t\to\infty} \frac1t \ln \lVert v_i(t) \rVert$$

for tangents v that are kept orthonormal by Gram-Schmidt (Benettin et al., Meccanica 15
(1980) 9-20; Shimada & Nagashima 1979). The first is positive where neighbours part
exponentially: chaos. A motion that does not come to rest has one that is zero, along
itself; their sum is the mean divergence of the flow.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypedDict, cast

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..model.chain_of_rods import AbstractChain
from ..model.state import State
from ..motion.checks import check_scene
from ..motion.ending import ending, nan_where
from ..motion.method import tangent_method
from ..motion.not_finite import motion
from ..motion.options import Method, Spans, recorded, spans_for
from ..motion.spans import follow_spans
from ..numerics.no_number import refused
from ..numerics.numbers import Option, Scalar
from ..numerics.rules import whole_number
from ..results import CODE, AbstractMotionResult, Settings
from ..solvers import Explicit, Taylor
from ..steady.exponents import ERRORS, EXPONENTS, GrowthRates, standard_errors

NO_DERIVATIVE = (
    "`{}` has no derivatives: differences grow along a motion, and what is summed of "
    "them says nothing of its averages. Take it out of what is differentiated "
    "(`jax.lax.stop_gradient` of its arguments), or take differences of its results."
)


class Exponents(AbstractMotionResult[State]):
    """Lyapunov exponents of a motion, with standard errors.

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
    column: AbstractChain,
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

    The error assumes independent spans: their `length` should be many periods, and
    longer than correlations last. It does not include the contribution of the ends of
    the time T, of order $1/T$. Nor does it see that an exponent which is zero because
    growth is not exponential is still of the size $\ln T / T$.

    **Arguments:** (times in $\sqrt{m l^2/k}$)

    - `column`, `start`: the column or chain, and the state in which its motion starts.
    - `count`: the number of exponents, 1 to 2 a rod.
    - `spans`: as above, see `Spans`.
    - `method`: an explicit one, or Taylor's with set-valued friction; its tolerances
        are those of the motion's steps, which the tangents share.

    **Returns:** `Exponents`, in $\sqrt{k/(m l^2)}$; `outcome` is `complete`, or a
    failure with NaN.

    **Raises:** `ValueError` for arguments that break a rule, in a 32-bit session, and
    where a derivative is taken: averages over long motions have no reliable one.
    """
    check_scene(column, start)
    scene = column, start, spans, method
    column, start, spans, method = refused(
        NO_DERIVATIVE.format("lyapunov_exponents"), scene
    )
    count = whole_number("count", count)
    most = 2 * column.joints
    if count > most:
        raise ValueError(f"Argument `count` must be at most {most}, but is {count}.")
    method = tangent_method("lyapunov_exponents", method, column.system())
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
    """The options that folds over spans of growth share."""

    solver: Explicit | Taylor
    rtol: Scalar
    transient: Scalar
    span: Scalar
    most: int
    escape: Scalar


def growth_options(method: Method, spans: Spans) -> GrowthOptions:
    """The options that folds over spans of growth share."""
    return {
        "solver": method.variational,
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
