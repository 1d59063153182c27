r"""The derivative of a curve's points in all other numbers of the column.

With the equations F(u; p) = 0 of a bifurcation, u the cycle, the first parameter
$\lambda$ and the null vectors, at a fixed second parameter, for each unknown $u_i$

$$\frac{du_i}{dp} = -\psi_i \cdot F_p, \qquad \psi_i^T F_u = e_i^T.$$

$F_p$ has the derivatives of the closing equations in p, and those along the null
vector, central differences as in `jets`. At a fold the null vector's part of
$\psi_\lambda$ vanishes.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..analysis.branch_point import BranchPoint
from ..model.column import Column
from ..motion.implicit import fixed, implicit, moving, solve
from ..motion.options import Method
from .jets import Bundle, follow_bundle
from .problem import CurveProblem, N

SECOND = N - 1  # the second parameter's place; before it the cycle's and the first's


def moves_of_point(
    problem: CurveProblem, column: Column, point: BranchPoint
) -> Float[Array, "5"]:
    """Zeros, with the derivatives of the cycle, its period, the first parameter.

    In the column's numbers, at a fixed second parameter.
    """
    x = fixed(point.x)
    p, make = moving(column, x.dtype)
    if not p.size:
        return jnp.zeros(SECOND, x.dtype)
    psi = adjoints(point) * problem.scale[None, :SECOND]
    directions = problem.kind.directions(x[N:], problem.basis)[:, :5]
    start = problem.ambient(x)[:5]
    sign, method = problem.cycle.sign, problem.method
    still = start, directions, psi, sign, jnp.asarray(method.max_steps, jnp.int32)

    def slope(
        p: Float[Array, " k"],
        start: Float[Array, "5"],
        directions: Float[Array, "v 5"],
        psi: Float[Array, "m 5"],
        sign: Float[Array, ""],
        steps: Float[Array, ""],
    ) -> Float[Array, "5 k"]:
        wide = jnp.zeros((directions.shape[0], p.size), p.dtype)
        bundle = Bundle(
            make,
            jnp.concatenate([start, p]),
            jnp.concatenate([directions, wide], axis=1),
            Method(method.solver, method.rtol, method.atol).at_most(steps),
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
