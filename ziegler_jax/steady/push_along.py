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

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.custom_batching import custom_vmap

from ..model.jacobian import accelerations_and_slopes
from ..model.state import PhasePoint
from ..model.system import System
from ..motion.tangents import Vectors, apart, dot, joined
from ..numerics.materialise import hoisted, materialise
from ..numerics.numbers import Numbers, Scalar
from ..numerics.series import sum_of
from ..solvers import Explicit
from ..solvers.explicit import Integrand


def push_along(
    solver: Explicit,
    system: System,
    t0: Scalar,
    t1: Scalar,
    y0: PhasePoint,
    vectors: Vectors,
    integrand: Integrand | None = None,
    first: Numbers | None = None,
) -> tuple[Numbers, Numbers, Numbers, Numbers]:
    """A step from y0, and its derivative along vectors in the state alone.

    **Arguments:** `system`: in the modes of the step, where friction is set-valued;
    `integrand`: of the state, see `Explicit.advance`; `first`: the slopes of y and of
    each vector, where they are known.

    **Returns:** y1 and the images; the error estimate; the last slopes of both; the
    integrals.
    """
    both = joined(y0, vectors)
    if first is None:
        first = materialise(t0, tangent_field, t0, both, system)

    def watched(t, y):
        return () if integrand is None else integrand(t, y)

    def whole(t, y):
        return *accelerations_and_slopes(t, y, system), watched(t, y)

    stage, numbers = hoisted(lambda t, y: materialise(t, whole, t, y), t0, y0)

    def of_a_lane(numbers, *own):
        return _turn_by_turn(solver, system.joints, partial(stage, numbers), *own)

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
        done = _turn_by_turn(solver, system.joints, partial(stages, numbers), *own)
        done = jax.tree.map(lambda x: jnp.moveaxis(x, -1, 0), done)
        return done, jax.tree.map(lambda _: True, done)

    # JAX derives no batch of which some numbers move and others do not
    step = jax.custom_jvp(of_lanes)
    step.defjvp(partial(jax.jvp, of_a_lane))
    return step(numbers, t0, t1 - t0, both, first, watched(t0, y0))


# a stage of a motion: accelerations, their derivatives by the state, and integrands
_Stage = Callable[[Scalar, PhasePoint], tuple[Numbers, tuple[Numbers, ...], Numbers]]


def _turn_by_turn(
    solver: Explicit,
    rods: int,
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
    angles, rates = _by_whose(both, rods, h)
    _, begun = _by_whose(first, rods, h)
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
        state = PhasePoint((*x[:, 0], *w[:, 0]))
        accelerations, jacobian, more = stage(t0 + nodes[i + 1] * h, state)
        vectors = *x[:, 1:], *w[:, 1:]
        for rod, (a, row) in enumerate(zip(accelerations, jacobian, strict=True)):
            each = zip(map(jnp.asarray, row), vectors, strict=True)
            along = sum_of([g[None] * v for g, v in each])
            stages = _put(stages, jnp.asarray(a)[None], i + 1, rod, 0)
            stages = _put(stages, jnp.asarray(along), i + 1, rod, 1)
        pairs = zip(sums, more, strict=True)
        return x, w, stages, tuple(s + shares[i + 1] * g for s, g in pairs)

    sums = tuple(shares[0] * g for g in integrands)
    place = angles, rates, stages, sums
    x, w, stages, sums = lax.fori_loop(0, len(rows) - 1, turn, place)
    own = stages[:, :, 0]
    errors = h[None] * h[None] * _combined(_product(b_error, rows), own)
    errors = PhasePoint((*errors, *(h[None] * _combined(b_error, own))))
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
    """The sum that a row weighs, without its zeros."""
    pairs = zip(row.tolist(), stages, strict=True)
    weighed = [w * stage for w, stage in pairs if w != 0.0]
    total = sum(weighed) if weighed else jnp.zeros_like(stages[0])
    return jnp.asarray(total)


def _put(
    stages: jax.Array, part: jax.Array, stage: Scalar, rod: int, whose: int
) -> jax.Array:
    """The accelerations with a part of them in its place, in place."""
    where = stage, rod, whose, *(0,) * (stages.ndim - 3)
    return lax.dynamic_update_slice(stages, part[None, None], where)


def _by_whose(
    numbers: Numbers, rods: int, like: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """The first half of a state and of the vectors behind it, and the second."""
    rows = jnp.stack(numbers).reshape(-1, 2, rods, *like.shape)
    first, second = (
        jnp.stack([rows[:, k, rod] for rod in range(rods)]) for k in (0, 1)
    )
    return first, second


def _one_by_one(first: jax.Array, second: jax.Array) -> Numbers:
    """The same numbers in a row again."""
    whose = range(first.shape[1])
    return sum(((*first[:, i], *second[:, i]) for i in whose), ())


def tangent_field(t: Scalar, both: Numbers, system: System) -> Numbers:
    """The slopes of a state, and of the vectors that stand behind its numbers.

    The field's Jacobian is worked out once, whatever the number of vectors. Each number
    is an array of its own: one of all vectors would not have the lanes behind, and
    steps would shuffle them (`benchmarks/README.md` counts).
    """
    y, vectors = apart(both, 2 * system.joints)
    accelerations, rows = materialise(t, accelerations_and_slopes, t, y, system)
    turned = [PhasePoint.of(v.omega, [dot(row, v) for row in rows]) for v in vectors]
    return joined(PhasePoint.of(y.omega, accelerations), turned)
