r"""How a settled motion's numbers move with the scene.

Nothing of the search for a cycle is differentiated. A certified cycle is a fixed point,
$R(z, p) = \sigma\,y(T) - y_0 = 0$ with $z = (x, T)$, and a number $g(z, p)$ of it has

$$dg = \partial_p g\,dp + \partial_z g\,dz, \qquad dz = -(\partial_z R)^{-1}\,
\partial_p R\,dp,$$

from one more turn, at the tolerance of the shot that verified it. A motion that is not
certified is followed once more, with one tangent. Forward mode only.
"""

from typing import NamedTuple, cast

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..model.column import Column
from ..motion.implicit import fixed, moving, solve
from ..motion.integrate import Motion
from ..motion.options import Method
from ..numerics.numbers import Count, Scalar, Traced4, Vector4
from ..results import Variable
from .certified import CertifiedMotion
from .observation import Observation, Record
from .rest import Rest
from .shots import FINE, FINEST
from .window_rule import SettleFold

Outputs = Float[Array, " m"]


class Place(NamedTuple):
    """What was followed at last: a cycle's turn, or the end of a motion."""

    closed: Bool[Array, ""]
    z: Float[Array, "4"]  # of the cycle: x, T
    sign: Scalar
    before: Scalar  # the end: when it begins, and for how long it was observed
    span: Scalar
    rest: Rest
    observation: Observation
    tolerances: tuple[Scalar, Scalar]  # of the motion


def carried(
    motion: CertifiedMotion, start: Traced4, place: Place, size: int
) -> Float[Array, " size"]:
    """Zeros that carry derivatives: of what observers saw, the span, the last state.

    **Arguments:** `motion`: of the scene as it is, derivatives included; `size`: of the
    observers' numbers, in the order of their names.
    """
    dtype, how = jnp.result_type(float), motion.method
    p, make = moving(motion.column, dtype)
    y0 = jnp.stack([jnp.asarray(x, dtype) for x in start])

    @jax.custom_jvp
    def zeros(p, y0, place):
        del p, y0, place
        return jnp.zeros(size + 5, dtype)

    @zeros.defjvp
    def rule(primals, tangents):
        p, y0, place = primals
        dp, dy0, _ = tangents

        def outputs(z, p, y0):
            return _outputs(make(p), y0, z, place, how)

        def along(dz, dp, dy0):
            return jax.jvp(outputs, (place.z, p, y0), (dz, dp, dy0))[1]

        unit = jnp.eye(5, 4, k=0, dtype=dtype)
        last = jnp.arange(5) == 4
        rows = jax.vmap(along)(
            unit,
            jnp.where(last[:, None], dp[None], 0.0),
            jnp.where(last[:, None], dy0[None], 0.0),
        )
        moved, by_scene = rows[:4].T, rows[4]  # of outputs, the last four the state
        jacobian = place.sign * moved[-4:] - jnp.eye(4, k=-1, dtype=dtype)
        dz = -solve(jacobian, place.sign * by_scene[-4:])
        cycle = by_scene[:-4] + moved[:-4] @ dz
        nothing = jnp.full(4, jnp.nan, dtype)
        closed = jnp.concatenate([cycle, dz[3:], nothing])
        motion_ = jnp.concatenate([by_scene[:-4], jnp.zeros(1, dtype), by_scene[-4:]])
        return zeros(*primals), jnp.where(place.closed, closed, motion_)

    return zeros(p, y0, fixed(place))


def _outputs(
    column: Column,
    y0: Float[Array, "4"],
    z: Float[Array, "4"],
    place: Place,
    how: Method,
) -> Outputs:
    """What observers see of a turn or an end, and the state behind it."""
    share = jnp.where(place.closed, FINE, 1.0)
    rtol, atol = (jnp.maximum(share * x, FINEST) for x in place.tolerances)
    method = Method(how.solver, rtol, atol).at_most(cast(Count, how.max_steps))
    span = jnp.where(place.closed, z[3], place.span)
    fold = SettleFold(
        transient=jnp.where(place.closed, 0.0, place.before),
        span=span,
        most=1,
        agreement=1.0,
        escape=jnp.inf,
        rest=place.rest,
        observation=place.observation,
    )
    start = jnp.where(place.closed, jnp.stack((0.0 * z[0], *z[:3])), y0)
    begin = Motion(
        column,
        cast(Traced4, tuple(start)),
        fold,
        method,
        first_stop=fold.first_stop(),
        end=fold.last_stop(),
    )
    run = begin.advance(begin.begin())
    record = Record(run.folded.watch.observed, span, run.y)
    named = place.observation.variables(column, record)
    return jnp.concatenate([floats(named), jnp.stack(cast(Vector4, run.y))])


def floats(named: dict[str, Variable]) -> Outputs:
    """The observers' real numbers in a row."""
    values = [jnp.asarray(v.value) for v in named.values() if v.codes is None]
    return jnp.concatenate([jnp.ravel(v) for v in values])


def with_zeros(named: dict[str, Variable], zeros: Outputs) -> dict[str, Variable]:
    """The observers' numbers, with what zeros in the same order carry."""
    after, used = {}, 0
    for name, variable in named.items():
        if variable.codes is not None:
            after[name] = variable
            continue
        value = jnp.asarray(variable.value)
        mine = zeros[used : used + value.size].reshape(value.shape)
        after[name] = variable._replace(value=value + mine)
        used += value.size
    return after
