r"""A step with tangents in the state alone: its stages are turns of one loop.

With vectors v along a motion go their slopes,

$$\dot v = J(y)\, v, \qquad J = \partial f / \partial y,$$

by one Jacobian a stage for all of them. Written out stage by stage, as that of a motion
alone, such a step is long, and XLA takes in proportion to compile it. The turns of a
loop over the rows of the tableau are compiled once. They keep accelerations alone, in
Nystroem's form: with A the tableau's matrix, c its nodes, x the angles and w the rates,

$$x_i = x_0 + c_i h\, w_0 + h^2 \sum_j (A^2)_{ij}\, \dot w_j, \qquad
w_i = w_0 + h \sum_j A_{ij}\, \dot w_j,$$

which is the same step to rounding (Hairer, Norsett & Wanner, *Solving Ordinary
Differential Equations I*, 2nd ed., Springer 1993, section II.14).
"""

import math
from collections.abc import Callable
from functools import partial
from typing import cast

import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import eval_jaxpr
from jax.custom_batching import custom_vmap
from jax.extend.core import (
    ClosedJaxpr,  # pyright: ignore[reportPrivateImportUsage]
    Literal,
)

from ..model.column import Column
from ..motion.scene import field
from ..motion.tangents import Vectors, apart
from ..numerics.materialise import as_one_call, hoisted, materialise
from ..numerics.numbers import Numbers, Pair, Scalar, Traced, Traced4
from ..solvers import Explicit
from ..solvers.explicit import Integrand


def push_along(
    solver: Explicit,
    column: Column,
    t0: Traced,
    t1: Traced,
    y0: Traced4,
    vectors: Vectors,
    integrand: Integrand | None = None,
    first: Numbers | None = None,
) -> tuple[Numbers, Numbers, Numbers, Numbers]:
    """A step from y0, and its derivative along vectors in the state alone.

    **Arguments:** `column`: in the modes of the step, where friction is set-valued;
    `integrand`: of the state, see `Explicit.advance`; `first`: the slopes of y and of
    each vector, where they are known.

    **Returns:** y1 and the images; the error estimate; the last slopes of both; the
    integrals.
    """
    both = cast(Numbers, sum(vectors, y0))
    if first is None:
        first = materialise(t0, tangent_field, t0, both, column)

    def watched(y):
        return () if integrand is None else integrand(y)

    def whole(t, y):
        return *accelerations_and_slopes(t, y, column), watched(y)

    stage, numbers = hoisted(lambda t, y: materialise(t, whole, t, y), t0, y0)

    def of_a_lane(numbers, *own):
        return _turn_by_turn(solver, partial(stage, numbers), *own)

    @custom_vmap
    def of_lanes(numbers, *own):
        return of_a_lane(numbers, *own)

    @of_lanes.def_vmap
    def _of_a_batch(size, batched, numbers, *own):
        # one step, too, of longer arrays: lanes stand behind
        axes = jax.tree.map(lambda moves: 0 if moves else None, batched[0])
        stages = jax.vmap(stage, in_axes=(axes, 0, 0), out_axes=-1)

        def behind(x, moves):
            x = x if moves else jnp.broadcast_to(x, (size, *x.shape))
            return jnp.moveaxis(x, 0, -1)

        own = jax.tree.map(behind, own, tuple(batched[1:]))
        done = _turn_by_turn(solver, partial(stages, numbers), *own)
        done = jax.tree.map(lambda x: jnp.moveaxis(x, -1, 0), done)
        return done, jax.tree.map(lambda _: True, done)

    # JAX derives no batch of which some numbers move and others do not
    step = jax.custom_jvp(of_lanes)
    step.defjvp(partial(jax.jvp, of_a_lane))
    return step(numbers, t0, t1 - t0, both, first, watched(y0))


# a stage of a motion: accelerations, their derivatives by the state, and integrands
_Stage = Callable[[Traced, Traced4], tuple[Pair, tuple[Traced4, Traced4], Numbers]]


def _turn_by_turn(
    solver: Explicit,
    stage: _Stage,
    t0: jax.Array,
    h: jax.Array,
    both: Numbers,
    first: Numbers,
    integrands: Numbers,
) -> tuple[Numbers, Numbers, Numbers, Numbers]:
    """The step of a lane, or of many that stand behind; see `push_along`.

    Angles and rates are an array each, and accelerations one of all stages: by rod, by
    whose they are, of the state or of a vector, and by lane.
    """
    rows, b, b_error = _tableau(solver)
    nodes, shares = (jnp.asarray(x, h.dtype) for x in ([*map(math.fsum, rows)], b))
    angles, rates = _by_whose(both, h)
    _, begun = _by_whose(first, h)
    stages = jnp.zeros((len(rows), *begun.shape), h.dtype).at[0].set(begun)
    hs = h[None, None]

    def moved(row, stages):
        # each row for itself: what a stage does not weigh is not read
        far = hs * _combined(_product(row, rows), stages)
        moved_angles = angles + hs * (math.fsum(row) * rates + far)
        return moved_angles, rates + hs * _combined(row, stages)

    def turn(i, place):
        *_, stages, sums = place
        x, w = lax.switch(i, [partial(moved, row) for row in rows[1:]], stages)
        state = x[0, 0], x[1, 0], w[0, 0], w[1, 0]
        accelerations, jacobian, more = stage(t0 + nodes[i + 1] * h, state)
        vectors = *x[:, 1:], *w[:, 1:]
        for rod, (a, row) in enumerate(zip(accelerations, jacobian, strict=True)):
            along = sum(g[None] * v for g, v in zip(row, vectors, strict=True))
            stages = _put(stages, jnp.asarray(a)[None], i + 1, rod, 0)
            stages = _put(stages, cast(jax.Array, along), i + 1, rod, 1)
        pairs = zip(sums, more, strict=True)
        return x, w, stages, tuple(s + shares[i + 1] * g for s, g in pairs)

    sums = tuple(shares[0] * g for g in integrands)
    place = angles, rates, stages, sums
    x, w, stages, sums = lax.fori_loop(0, len(rows) - 1, turn, place)
    own = stages[:, :, 0]
    errors = h[None] * h[None] * _combined(_product(b_error, rows), own)
    errors = *errors, *(h[None] * _combined(b_error, own))
    integrals = tuple(lax.broadcast_to_rank(h, jnp.ndim(s)) * s for s in sums)
    return _one_by_one(x, w), errors, _one_by_one(w, stages[-1]), integrals


def _tableau(solver: Explicit) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A square matrix of its stages, b, and that of the error.

    The last stage is the end of the step, if need be one more than the tableau has.
    """
    rows = [(), *solver.a]
    if not solver.last_stage_is_next_first:
        rows.append(solver.b)
    filled = [
        (*row, *(0.0,) * (len(rows) - len(row)))
        for row in (*rows, solver.b, solver.b_error)
    ]
    *matrix, b, b_error = np.asarray(filled)
    return np.asarray(matrix), b, b_error


def _product(row: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """A row times a matrix, to the same bits on every processor: BLAS has its own."""
    return np.asarray([math.fsum(row * column) for column in matrix.T])


def _combined(row: np.ndarray, stages: jax.Array) -> jax.Array:
    """What a row weighs; zeros are left out."""
    pairs = zip(row.tolist(), stages, strict=True)
    weighed = [w * stage for w, stage in pairs if w != 0.0]
    total = sum(weighed) if weighed else jnp.zeros_like(stages[0])
    return cast(jax.Array, total)


def _put(
    stages: jax.Array, part: jax.Array, stage: Scalar, rod: int, whose: int
) -> jax.Array:
    """The accelerations with a part of them in its place, in place."""
    where = stage, rod, whose, *(0,) * (stages.ndim - 3)
    return lax.dynamic_update_slice(stages, part[None, None], where)


def _by_whose(numbers: Numbers, like: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The first two numbers of a state and of the vectors behind it, and the others."""
    rows = jnp.stack(numbers).reshape(-1, 2, 2, *like.shape)
    first, second = (jnp.stack([rows[:, k, rod] for rod in (0, 1)]) for k in (0, 1))
    return first, second


def _one_by_one(first: jax.Array, second: jax.Array) -> Numbers:
    """The same numbers in a row again."""
    whose = range(first.shape[1])
    return sum(((*first[:, i], *second[:, i]) for i in whose), ())


def tangent_field(t: Scalar, both: Numbers, column: Column) -> Numbers:
    """The slopes of a state, and of the vectors that stand behind its four numbers.

    The field's Jacobian is worked out once, whatever the number of vectors. Each number
    is an array of its own: one of all vectors would not have the lanes behind, and
    steps would shuffle them (`benchmarks/README.md` counts).
    """
    y, vectors = apart(both)
    (a1, a2), rows = materialise(t, accelerations_and_slopes, t, y, column)
    slopes = [y[2], y[3], a1, a2]
    for v in vectors:
        slopes += [v[2], v[3], *(_dot(row, v) for row in rows)]
    return tuple(slopes)


@as_one_call
def accelerations_and_slopes(
    t: Scalar, y: Traced4, column: Column
) -> tuple[Pair, tuple[Traced4, Traced4]]:
    """Both accelerations, and the derivatives of each by the state's four numbers."""
    accelerations, along = jax.linearize(lambda *y: field(t, y, column)[2:], *y)
    linear = jax.make_jaxpr(along)(*y)
    columns = [_along_one(linear, i, jnp.ones_like(y[0])) for i in range(4)]
    first, second = zip(*columns, strict=True)
    return cast(Pair, accelerations), (cast(Traced4, first), cast(Traced4, second))


def _along_one(linear: ClosedJaxpr, place: int, one: Traced) -> Pair:
    """A linear function of one of its arguments, the others being zero.

    What they alone would move is left out: a compiler keeps products with zero. (A
    transposed function would be as short, but is not a number where `jnp.where` leaves
    out a branch of infinite slope, and does not pass a loop of a law's own.)
    """
    jaxpr = linear.jaxpr
    moved, equations = {jaxpr.invars[place]}, []
    still = dict.fromkeys(jaxpr.invars)  # in order: a program's text is its identity
    still.pop(jaxpr.invars[place])
    for equation in jaxpr.eqns:
        read = [v for v in equation.invars if not isinstance(v, Literal)]
        if not moved.isdisjoint(read):
            moved.update(equation.outvars)
        elif not still.keys().isdisjoint(read):
            still.update(dict.fromkeys(equation.outvars))
            continue
        equations.append(equation)
    zeros = [v for v in still if v not in jaxpr.invars]
    body = jaxpr.replace(
        invars=[*jaxpr.invars, *zeros],
        eqns=equations,
        debug_info=jaxpr.debug_info.with_unknown_names(),
    )
    values = [0.0 * one] * 4
    values[place] = one
    avals = (cast(jax.core.ShapedArray, v.aval) for v in zeros)
    values += [jnp.zeros(a.shape, a.dtype) for a in avals]
    return cast(Pair, tuple(eval_jaxpr(body, linear.consts, *values)))


def _dot(v: Traced4, e: Traced4) -> Traced:
    return v[0] * e[0] + v[1] * e[1] + v[2] * e[2] + v[3] * e[3]
