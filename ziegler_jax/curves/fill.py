r"""Filling a curve: many points between a few, all corrected in one batch.

Between two points of the walk, a chord h apart, with unit tangents t, the cubic

$$x(s) = H_{00} x_0 + H_{10} h t_0 + H_{01} x_1 + H_{11} h t_1$$

is within $O(h^4)$ of the curve. From there Newton's method needs two or three shots,
and no point waits for another.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from ..analysis.branch_point import BranchPoint
from .problem import CurveProblem, N

BATCH = 64  # points that are corrected together: their numbers stay in the cache
BISECTIONS = 50
NEAR = 1e-8  # of a bound, at which a walk ends within its own error
CLOSED = 1e-10  # what is left of each equation, at most


class Knots(NamedTuple):
    """Points of the walk in order along the curve, and how many there are."""

    x: Float[Array, "m n"]
    tangent: Float[Array, "m n"]
    filled: Int[Array, ""]
    begin: Int[Array, ""]  # where the walk began

    @property
    def arc(self) -> Float[Array, " m"]:
        """The length along the chords up to each; beyond the last that of the whole."""
        gaps = jnp.diff(self.x[:, :N], axis=0)
        inside = jnp.arange(1, self.x.shape[0], dtype=jnp.int32) < self.filled
        lengths = jnp.where(inside, jnp.sqrt(jnp.sum(gaps * gaps, axis=1)), 0.0)
        return jnp.concatenate([jnp.zeros(1, lengths.dtype), jnp.cumsum(lengths)])


class Filled(NamedTuple):
    """Points of a curve, arrays with the points in front."""

    point: BranchPoint
    good: Bool[Array, " p"]
    residual: Float[Array, " p"]
    steps: Int[Array, " p"]


def joined(down: Knots, up: Knots) -> Knots:
    """Two walks from one point, the first one turned round."""
    room = down.x.shape[0]
    i = jnp.arange(2 * room - 1, dtype=jnp.int32)
    before = i < down.filled
    back = jnp.clip(down.filled - 1 - i, 0, room - 1)
    on = jnp.clip(i - down.filled + 1, 0, room - 1)

    def chosen(a: Float[Array, "m n"], b: Float[Array, "m n"]) -> Float[Array, "k n"]:
        return jnp.where(before[:, None], a[back], b[on])

    count = jnp.maximum(down.filled + up.filled - 1, 0)
    tangent = chosen(-down.tangent, up.tangent)
    begin = jnp.maximum(down.filled - 1, 0)
    return Knots(chosen(down.x, up.x), tangent, count, begin)


def evenly(
    knots: Knots, points: int
) -> tuple[Float[Array, "p n"], Float[Array, "p n"]]:
    """So many predictions at equal distances along the arc, and the tangents there."""
    arc = knots.arc
    s = jnp.linspace(0.0, 1.0, points, dtype=arc.dtype) * arc[-1]
    last = jnp.maximum(knots.filled - 2, 0)
    place = jnp.searchsorted(arc, s, side="right").astype(jnp.int32) - 1
    place = jnp.clip(place, 0, last)
    length = arc[place + 1] - arc[place]
    share = (s - arc[place]) / jnp.where(length > 0, length, 1.0)
    return jax.vmap(lambda i, u: _between(knots, arc, i, u))(place, share)


def at_values(
    knots: Knots, values: Float[Array, " p"]
) -> tuple[Float[Array, "p n"], Float[Array, "p n"]]:
    """Predictions at these values of the second parameter, scaled.

    On the piece that is nearest to the start of the walk, counted in its points; NaN
    where there is none.
    """
    arc, here = knots.arc, knots.x[:, N - 1]
    places = jnp.arange(here.size - 1, dtype=jnp.int32)
    inside = places + 1 < knots.filled

    def one(value: Float[Array, ""]) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
        low, high = here[:-1] - value, here[1:] - value
        within = (low * high < 0) | (jnp.abs(low) < NEAR) | (jnp.abs(high) < NEAR)
        crossed = inside & within
        off = jnp.abs((places - knots.begin).astype(arc.dtype) + 0.5)
        place = jnp.argmin(jnp.where(crossed, off, jnp.inf)).astype(jnp.int32)
        there = jnp.any(crossed)
        rises = high[place] > low[place]

        def halve(
            _: int, ends: tuple[Float[Array, ""], Float[Array, ""]]
        ) -> tuple[Float[Array, ""], Float[Array, ""]]:
            left, right = ends
            middle = (left + right) / 2
            x = _between(knots, arc, place, middle)[0][N - 1]
            below = (x < value) == rises
            return jnp.where(below, middle, left), jnp.where(below, right, middle)

        zero = jnp.zeros_like(value)
        share = lax.fori_loop(0, BISECTIONS, halve, (zero, zero + 1.0))[0]
        x, tangent = _between(knots, arc, place, share)
        return jnp.where(there, x.at[N - 1].set(value), jnp.nan), tangent

    return jax.vmap(one)(values)


def corrected(
    problem: CurveProblem, x: Float[Array, "p n"], rows: Float[Array, "p n"]
) -> Filled:
    """The points of the curve near x on the planes across `rows`."""
    count = x.shape[0]
    batch = min(BATCH, count)
    chunks = -(-count // batch)
    rest = chunks * batch - count

    def one(x: Float[Array, " n"], row: Float[Array, " n"]) -> Filled:
        budget = jnp.asarray(problem.method.max_steps, jnp.int32)
        point, good, _, left, residual = problem.corrected(x, row, budget, CLOSED)
        return Filled(point, good, residual, budget - left)

    def padded(a: Float[Array, "p n"]) -> Float[Array, "c b n"]:
        last = jnp.broadcast_to(a[-1:], (rest, a.shape[1]))
        return jnp.concatenate([a, last]).reshape(chunks, batch, a.shape[1])

    done = lax.map(lambda both: jax.vmap(one)(*both), (padded(x), padded(rows)))
    return jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:])[:count], done)


def _between(
    knots: Knots, arc: Float[Array, " m"], place: Int[Array, ""], u: Float[Array, ""]
) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
    """The cubic at a share u of the way from a knot to the next, and its direction."""
    (x0, x1), (t0, t1) = ((a[place], a[place + 1]) for a in (knots.x, knots.tangent))
    h = arc[place + 1] - arc[place]
    v = 1 - u
    x = v * v * ((1 + 2 * u) * x0 + u * h * t0) + u * u * (
        (1 + 2 * v) * x1 - v * h * t1
    )
    return x, v * t0 + u * t1
