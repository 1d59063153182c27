"""Derivatives of what a search found, by the implicit function theorem.

A search is not differentiated: what it found is a constant, to which a zero is added
that carries the derivative in the scene's numbers.
"""

import math
from collections.abc import Callable
from typing import TypeVar, TypeVarTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Float

from ..model.column import Column
from ..numerics.numbers import is_concrete
from .variational import Make, Parameters

Numbers = Float[Array, "..."]
Still = TypeVarTuple("Still")  # what a slope is asked with, not differentiated
Tree = TypeVar("Tree")  # a pytree of numbers, concrete ones among them


def moving(column: Column, dtype: DTypeLike) -> tuple[Parameters, Make]:
    """The column's traced numbers as a vector (n,), and the column of such a vector.

    An array among them, as a table of a law of one's own has it, is that many numbers.
    """
    # not `eqx.is_array`: concrete numbers are NumPy's, and have no derivative
    traced, known = eqx.partition(column, lambda x: not is_concrete(x))
    leaves, tree = jax.tree.flatten(traced)
    shapes = [jnp.shape(x) for x in leaves]
    ends = np.cumsum([math.prod(shape) for shape in shapes], dtype=int).tolist()

    def make(p: Parameters) -> Column:
        spans = zip(shapes, [0, *ends], ends, strict=False)
        parts = [p[i:j].reshape(shape) if shape else p[i] for shape, i, j in spans]
        return eqx.combine(jax.tree.unflatten(tree, parts), known)

    numbers = [jnp.asarray(x, dtype) for x in leaves]
    if any(shapes):
        return jnp.concatenate([jnp.ravel(x) for x in numbers]), make
    return (jnp.stack(numbers) if leaves else jnp.zeros(0, dtype)), make


def implicit(
    shape: tuple[int, ...],
    slope: Callable[[Parameters, *Still], Float[Array, "*shape n"]],
    p: Parameters,
    *still: *Still,
) -> Float[Array, "*shape"]:
    """Zeros that carry the derivative `slope(p, *still)`, (*shape, n), in p (n,)."""

    @jax.custom_jvp
    def zeros(p, *still):
        del still
        return jnp.zeros(shape, p.dtype)

    @zeros.defjvp
    def rule(primals: tuple[Parameters, *Still], tangents):
        return zeros(*primals), first_order(slope(*primals)) @ tangents[0]

    return zeros(p, *fixed(still))


def _refusing(sentence: str) -> Callable[[Numbers], Numbers]:
    """The same numbers; a derivative of them is refused."""

    @jax.custom_jvp
    def same(x: Numbers) -> Numbers:
        return x

    @same.defjvp
    def refuse(primals, tangents):
        raise ValueError(sentence)

    return same


first_order = _refusing(
    "Periodic orbits, their folds and thresholds have first derivatives only: "
    "the second ones would need second variations. Take differences of the first."
)
fixed_direction = _refusing(
    "The start of a least kick and its edge have no derivatives here: they would need "
    "second variations. Differentiate `energy`, or take differences."
)
undifferentiated = _refusing(
    "The monodromy matrix, its multipliers and `stable` have no derivatives here: "
    "they would need second variations. Read them outside of what is "
    "differentiated, or take differences."
)


def fixed(tree: Tree) -> Tree:
    """The same numbers without derivatives; concrete ones stay concrete."""
    return jax.tree.map(
        lambda x: jax.lax.stop_gradient(x) if isinstance(x, jax.Array) else x, tree
    )


def solve(
    matrix: Float[Array, "n n"], right: Float[Array, "n ..."]
) -> Float[Array, "n ..."]:
    """Solve a small linear system; NaN where it is not finite."""
    bad = ~jnp.all(jnp.isfinite(matrix))
    safe = jnp.where(bad, jnp.eye(matrix.shape[0], dtype=matrix.dtype), matrix)
    return jnp.where(bad, jnp.nan, jnp.linalg.solve(safe, right))
