r"""The derivatives of a settled motion's numbers in the column and the start.

The search for a cycle is not differentiated. A certified cycle is a fixed point,
$R(z, p) = \sigma\,y(T) - y_0 = 0$ with $z = (x, T)$, and a number $g(z, p)$ of it has

$$dg = \partial_p g\,dp + \partial_z g\,dz, \qquad dz = -(\partial_z R)^{-1}\,
\partial_p R\,dp,$$

from one more shot, a repetition of the one that verified the cycle. The multipliers
belong to the derivative that the shot carries, so their derivatives are second ones of
the motion. A motion that neither is certified nor came to rest ends at a fixed time,
and so does one whose joints stick: it is followed once more, with one tangent. Under a
smoothed law rest is judged at the end of a step. The time of that has no derivative,
and the creeping motion depends on it: its derivatives are NaN. Forward mode only.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..model.chain_of_rods import AbstractChain
from ..model.state import PhasePoint
from ..motion.implicit import fixed, moving, solve, zeros_of
from ..motion.integrate import Motion
from ..motion.observation import Observation, Record
from ..motion.options import Method
from ..numerics.eigenvalues import eigenvalues
from ..numerics.numbers import Scalar
from ..results import Variable
from .certified import CertifiedMotion
from .contraction import Matrix
from .rest import Rest
from .shots import SHORTEST, blank_attempt, return_of, shot_motion, start_of
from .window_rule import SettleFold

Outputs = Float[Array, " m"]


class Place(NamedTuple):
    """The last part that was followed: a cycle's turn, or the end of a motion."""

    closed: Bool[Array, ""]
    known: Bool[Array, ""]  # whether an end is at a time that does not move
    z: Float[Array, " k"]  # of the cycle: x, T
    sign: Scalar
    before: Scalar  # the end: when it begins, and for how long it was observed
    span: Scalar
    rest: Rest
    method: Method  # of the motion
    level: Scalar | tuple[()] = ()  # of the section; (): 0


class Carried(NamedTuple):
    """Zeros that carry derivatives."""

    observed: Outputs  # the observers' numbers, in the order of their names
    span: Scalar
    radius: Scalar  # of the derivative of the last shot's return
    y: Float[Array, " k"]  # the last state


def carried(motion: CertifiedMotion, place: Place, size: int) -> Carried:
    """The derivatives that the numbers of a motion's result carry.

    **Arguments:** `motion`: of the scene as it is, derivatives included; `size`: of the
    observers' numbers.
    """
    dtype = jnp.result_type(float)
    p, make = moving((motion.column, motion.observation), dtype)
    y0 = jnp.stack([jnp.asarray(x, dtype) for x in motion.y0])
    k = len(motion.y0)

    @jax.custom_jvp
    def zeros(p, y0, place):
        return zeros_of((size + 2 + k,), p, y0, place)

    @zeros.defjvp
    def rule(primals, tangents):
        p, y0, place = primals
        dp, dy0, _ = tangents
        cycle = _cycle_moves(lambda z, p: _turn(*make(p), z, place), place, p, dp)
        end = jax.jvp(lambda p, y: _end(*make(p), y, place), (p, y0), (dp, dy0))[1]
        nothing = jnp.full(k, jnp.nan, dtype)
        none = jnp.zeros(1, dtype)
        end = jnp.concatenate([end[:-k], none, nothing[:1], end[-k:]])
        end = jnp.where(place.known, end, jnp.nan)
        cycle = jnp.concatenate([cycle, nothing])
        return zeros(*primals), jnp.where(place.closed, cycle, end)

    row = zeros(p, y0, fixed(place))
    return Carried(row[:size], row[size], row[size + 1], row[size + 2 :])


def _cycle_moves(turn, place: Place, p: Outputs, dp: Outputs) -> Outputs:
    """The changes of the observed numbers, of T and of the radius along dp."""

    def along(dz, dp):
        return jax.jvp(turn, (place.z, p), (dz, dp))

    k = place.z.size
    unit = jnp.eye(k + 1, k, dtype=p.dtype)
    last = jnp.arange(k + 1)[:, None] == k
    shown, rows = jax.vmap(along, out_axes=(None, 0))(
        unit, jnp.where(last, dp[None], 0.0)
    )
    moved, by_scene = rows[:k].T, rows[k]
    m = (k - 1) ** 2
    observed, image, slope = slice(0, -k - m), slice(-k - m, -m), slice(-m, None)
    jacobian = place.sign * moved[image] - jnp.eye(k, k=-1, dtype=p.dtype)
    dz = -solve(jacobian, place.sign * by_scene[image])
    after = by_scene + moved @ dz
    matrices = (x[slope].reshape(k - 1, k - 1) for x in (shown, after))
    radius = jax.jvp(_radius, (next(matrices),), (next(matrices),))[1]
    return jnp.concatenate([after[observed], dz[-1:], radius[None]])


def _radius(slope: Matrix) -> Scalar:
    """The largest modulus of an eigenvalue."""
    values = eigenvalues(slope)
    return jnp.abs(values[jnp.argmax(jnp.abs(values))])


def _turn(
    column: AbstractChain, observation: Observation, z: Float[Array, " k"], place: Place
) -> Outputs:
    """Observed numbers of a shot at the cycle, its end, and its return's derivative."""
    span = jnp.where(place.closed, z[-1], SHORTEST)
    displaced = not isinstance(place.level, tuple)
    attempt = blank_attempt(0.0 * span, z.size - 1, displaced)
    attempt = attempt._replace(
        x=z[:-1], span=span, sign=place.sign + 0.0 * span, fine=jnp.asarray(True)
    )._replace(level=place.level)
    start = start_of(attempt)
    system = column.system()
    shot = shot_motion(system, start, attempt, place.method, observation)
    run = shot.advance(shot.begin())
    record = Record(run.folded.record, span, run.y)
    slope = return_of(run, attempt).slope
    named = observation.variables(system, record)
    return jnp.concatenate([floats(named), jnp.stack(run.y), jnp.ravel(slope)])


def _end(
    column: AbstractChain,
    observation: Observation,
    y0: Float[Array, " k"],
    place: Place,
) -> Outputs:
    """Observed numbers of the end of a motion, and its last state."""
    fold = SettleFold(
        transient=jnp.where(place.known, place.before, 0.0),
        span=jnp.where(place.known, place.span, SHORTEST),
        most=1,
        agreement=1.0,
        escape=jnp.inf,
        rest=place.rest,
        observation=observation,
    )
    system = column.system()
    begin = Motion(
        system,
        PhasePoint(y0),
        fold,
        place.method,
        first_stop=fold.first_stop(),
        end=fold.last_stop(),
    )
    run = begin.advance(begin.begin())
    record = Record(run.folded.watch.observed, fold.span, run.y)
    named = observation.variables(system, record)
    return jnp.concatenate([floats(named), jnp.stack(run.y)])


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
