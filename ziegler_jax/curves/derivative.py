r"""The derivative of a curve's points in all other numbers of the column.

With the equations F(u; p) = 0 of a bifurcation, u the cycle, the first parameter
$\lambda$ and the null vectors, at a fixed second parameter,

$$\frac{d\lambda}{dp} = -\psi \cdot F_p, \qquad \psi^T F_u = e_\lambda^T.$$

$F_p$ has the derivatives of the closing equations in p, and those along the null
vector, central differences as in `jets`. At a fold the null vector's part of $\psi$
vanishes.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..analysis.branch_point import BranchPoint
from ..model.column import Column
from ..motion.implicit import fixed, implicit, moving, solve
from ..motion.options import Method
from .jets import Bundle, follow_bundle
from .problem import CurveProblem, N

FIRST, SECOND = N - 2, N - 1  # the places of both parameters


def moves_of_first(
    problem: CurveProblem, column: Column, point: BranchPoint
) -> Float[Array, ""]:
    """Zero, with the derivative of the first parameter in the column's numbers."""
    x = fixed(point.x)
    p, make = moving(column, x.dtype)
    if not p.size:
        return jnp.zeros((), x.dtype)
    psi = adjoint(point) * problem.scale[FIRST]
    directions = problem.kind.directions(x[N:], problem.basis)[:, :5]
    start = problem.ambient(x)[:5]
    sign, method = problem.cycle.sign, problem.method
    still = start, directions, psi, sign, jnp.asarray(method.max_steps, jnp.int32)

    def slope(
        p: Float[Array, " k"],
        start: Float[Array, "5"],
        directions: Float[Array, "v 5"],
        psi: Float[Array, " m"],
        sign: Float[Array, ""],
        steps: Float[Array, ""],
    ) -> Float[Array, "1 k"]:
        wide = jnp.zeros((directions.shape[0], p.size), p.dtype)
        bundle = Bundle(
            make,
            jnp.concatenate([start, p]),
            jnp.concatenate([directions, wide], axis=1),
            Method(method.solver, method.rtol, method.atol).at_most(steps),
        )
        jet = follow_bundle(bundle, sign)
        k, arrived = directions.shape[0], jnp.where(jet.arrived, 1.0, jnp.nan)
        moves = psi[:4] @ jet.first[:, 5:]
        along = psi[4 : 4 + 4 * k].reshape(k, 4)
        moves += jnp.einsum("ki,kij->j", along, jet.second[:, :, 5:])
        return -(moves * arrived)[None]

    return implicit((1,), slope, p, *still)[0]


def adjoint(point: BranchPoint) -> Float[Array, " m"]:
    """psi, with the second parameter fixed; not finite where the curve turns in it."""
    matrix = jnp.delete(fixed(point.matrix), SECOND, axis=1)
    unit = jnp.zeros(matrix.shape[0], matrix.dtype).at[FIRST].set(1.0)
    return solve(matrix.T, unit)
