r"""Eigenvalues of small matrices, one by one with their derivatives.

Of the characteristic polynomial $p(\lambda; M) = \det(\lambda I - M)$,

$$d\lambda = \frac{\mathrm{tr}(\mathrm{adj}(\lambda I - M)\,dM)}
{\mathrm{tr}\,\mathrm{adj}(\lambda I - M)},$$

where the divisor is $p'(\lambda)$, the product of the distances to the others: an
eigenvalue that is double has the derivative NaN, the others keep theirs. (By the
matrix of eigenvectors all would lose it.)

Source: the adjugate by D. K. Faddeev, V. N. Faddeeva (1963).
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Complex, Float

from .no_number import no_number

# Of its size: nearer to another one than that an eigenvalue has no derivative. It is
# then known to the root of the matrix' error, and the derivative to that error over the
# distance: 1 % of one with five digits.
DOUBLE = 1e-3


@jax.custom_jvp
def eigenvalues(matrix: Float[Array, "*b n n"]) -> Complex[Array, "*b n"]:
    """The eigenvalues, in LAPACK's order; NaN where the matrix is not finite."""
    bad = ~jnp.all(jnp.isfinite(matrix), axis=(-1, -2), keepdims=True)
    eye = jnp.eye(matrix.shape[-1], dtype=matrix.dtype)
    unit = jnp.broadcast_to(eye, matrix.shape)
    values = jnp.linalg.eigvals(jnp.where(bad, unit, matrix))
    return jnp.where(bad[..., 0], jnp.nan, values)


@eigenvalues.defjvp
def _eigenvalues_jvp(primals, tangents):
    """Each by its adjugate."""
    (m,), (dm,) = primals, tangents
    values = eigenvalues(m)
    adjugates, turn = _adjugates(m, values), jnp.swapaxes(dm, -1, -2)
    turned = jnp.sum(
        adjugates * turn[..., None, :, :].astype(adjugates.dtype), (-1, -2)
    )
    divisor = jnp.trace(adjugates, axis1=-2, axis2=-1)
    apart = jnp.abs(values[..., :, None] - values[..., None, :])
    itself = jnp.eye(m.shape[-1], dtype=bool)
    nearest = jnp.min(
        jnp.where(jnp.broadcast_to(itself, apart.shape), jnp.inf, apart), axis=-1
    )
    alone = nearest > DOUBLE * jnp.abs(values)
    one = jnp.ones_like(divisor)
    moved = turned / jnp.where(alone, divisor, one)
    return values, jnp.where(alone, moved, no_number(turned))


def _adjugates(
    m: Float[Array, "*b n n"], values: Complex[Array, "*b n"]
) -> Complex[Array, "*b n n n"]:
    """adj(lambda I - M) for each eigenvalue: a polynomial in it, its matrices in M."""
    n = m.shape[-1]
    eye = jnp.eye(n, dtype=m.dtype)
    b, terms = jnp.broadcast_to(eye, m.shape), []
    for k in range(1, n + 1):
        terms.append(b)
        image = m @ b
        trace = jnp.trace(image, axis1=-2, axis2=-1)[..., None, None]
        b = image - trace / k * jnp.broadcast_to(eye, m.shape)
    at = values[..., None, None]
    total = jnp.zeros((*values.shape, n, n), values.dtype)
    for term in terms:
        total = total * at + term[..., None, :, :].astype(values.dtype)
    return total
