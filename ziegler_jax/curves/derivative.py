r"""The derivative of a curve's points in all numbers of the column.

With the equations F(u; p) = 0 of a bifurcation, u the cycle, the first parameter
$\lambda$ and the null vectors, at a fixed second parameter, for each unknown $u_i$

$$\frac{du_i}{dp} = -\psi_i \cdot F_p, \qquad \psi_i^T F_u = e_i^T.$$

The second parameter is one of p: it moves the column as they do. $F_p$ has the
derivatives of the closing equations in p, and those along the null vector, central
differences as in `jets`. At a fold the null vector's part of $\psi_\lambda$ vanishes.
"""

from collections.abc import Callable

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..analysis.branch_point import BranchPoint
from ..model.column import Column
from ..motion.implicit import fixed, implicit, moving, solve
from ..motion.options import Method
from ..numerics.numbers import Scalar
from ..steady.jets import Bundle, carried_extent, carried_monodromy, follow_bundle
from .problem import CurveProblem, N

SECOND = N - 1  # the second parameter's place; before it the cycle's and the first's


def moving_point(
    problem: CurveProblem,
    make_column: Callable[[Scalar, Scalar], Column],
    point: BranchPoint,
    second: Scalar,
) -> BranchPoint:
    """The point at a second parameter, with derivatives in that and in the column."""
    first = point.x[N - 2] * problem.scale[N - 2]
    column = make_column(first, second)
    moves = _moves_of_cycle(problem, column, point) / problem.scale[: N - 1]
    x = point.x.at[: N - 1].add(moves)
    still = fixed(second)
    x = x.at[N - 1].add((second - still) / problem.scale[N - 1])
    # the largest angles and the multipliers, of the cycle and the column as they move
    ambient, sign = problem.ambient(x), problem.cycle.sign
    column = make_column(ambient[5], second)
    place = column, ambient[:4], ambient[4], problem.method
    extent = point.extent + carried_extent(*place)
    moved = point.moved + sign * carried_monodromy(*place)
    return point._replace(x=x, extent=extent, moved=moved)


def _moves_of_cycle(
    problem: CurveProblem, column: Column, point: BranchPoint
) -> Float[Array, "5"]:
    """Zeros, with the derivatives of the cycle, its period, the first parameter.

    In the column's numbers, at a fixed first parameter.
    """
    x = fixed(point.x)
    p, make = moving(column, x.dtype)
    if not p.size:
        return jnp.zeros(SECOND, x.dtype)
    psi = adjoints(point) * problem.scale[None, :SECOND]
    directions = problem.kind.directions(x[N:], problem.basis)[:, :5]
    start = problem.ambient(x)[:5]
    sign, method = problem.cycle.sign, problem.method
    still = start, directions, psi, sign, method

    def slope(
        p: Float[Array, " k"],
        start: Float[Array, "5"],
        directions: Float[Array, "v 5"],
        psi: Float[Array, "m 5"],
        sign: Float[Array, ""],
        method: Method,
    ) -> Float[Array, "5 k"]:
        wide = jnp.zeros((directions.shape[0], p.size), p.dtype)
        bundle = Bundle(
            make,
            jnp.concatenate([start, p]),
            jnp.concatenate([directions, wide], axis=1),
            method,
        )
        jet = follow_bundle(bundle, sign)
        k, arrived = directions.shape[0], jnp.where(jet.arrived, 1.0, jnp.nan)
        moves = psi[:4].T @ jet.first[:, 5:]
        along = psi[4 : 4 + 4 * k].reshape(k, 4, SECOND)
        moves += jnp.einsum("kiu,kij->uj", along, jet.second[:, :, 5:])
        return -moves * arrived

    return implicit((SECOND,), slope, p, *still)


def adjoints(point: BranchPoint) -> Float[Array, "m 5"]:
    """psi, with the second parameter fixed; not finite where the curve turns in it."""
    matrix = jnp.delete(fixed(point.matrix), SECOND, axis=1)
    return solve(matrix.T, jnp.eye(matrix.shape[0], SECOND, dtype=matrix.dtype))
