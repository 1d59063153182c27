"""The derivatives of numbers found by a search, or by a motion of its own length.

A search is not differentiated: its result is a constant, to which a zero is added that
carries the derivative in the numbers of column and start. A number's derivative is
right, NaN, or a sentence, never a silent zero: where a number has none, it is `lost`
(NaN) if others of the same result have theirs, and else the function refuses with
`refused` (a sentence, in `numerics/no_number.py`). `fixed` is for use inside a search
only.
"""

from collections.abc import Callable
from typing import TypeVar, TypeVarTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import DTypeLike
from jaxtyping import Array, Float

from ..numerics.no_number import forward_alone, moves, no_number, refused
from .variational import Parameters

Numbers = Float[Array, "..."]
Still = TypeVarTuple("Still")  # what a slope is asked with, not differentiated
Tree = TypeVar("Tree")  # a pytree of numbers, concrete ones among them


def moving(
    tree: Tree, dtype: DTypeLike
) -> tuple[Parameters, Callable[[Parameters], Tree]]:
    """A tree's traced real numbers as a vector (n,), and the tree of such a vector."""
    # not `eqx.is_array`: concrete numbers are NumPy's, and have no derivative
    traced, known = eqx.partition(tree, moves)
    leaves, structure = jax.tree.flatten(traced)
    ends = [0]
    for leaf in leaves:
        ends.append(ends[-1] + leaf.size)

    def make(p: Parameters) -> Tree:
        parts = [
            p[begin] if leaf.ndim == 0 else p[begin:end].reshape(leaf.shape)
            for leaf, begin, end in zip(leaves, ends, ends[1:], strict=False)
        ]
        return eqx.combine(jax.tree.unflatten(structure, parts), known)

    numbers = [jnp.ravel(jnp.asarray(x, dtype)) for x in leaves]
    return (jnp.concatenate(numbers) if leaves else jnp.zeros(0, dtype)), make


def implicit(
    shape: tuple[int, ...],
    slope: Callable[[Parameters, *Still], Float[Array, "*shape n"]],
    p: Parameters,
    *still: *Still,
) -> Float[Array, "*shape"]:
    """Zeros that carry the derivative `slope(p, *still)`, (*shape, n), in p (n,)."""

    @jax.custom_jvp
    def zeros(p, *still):
        return zeros_of(shape, p, *still)

    @zeros.defjvp
    def rule(primals: tuple[Parameters, *Still], tangents):
        return zeros(*primals), _moved(first_order(slope(*primals)), tangents[0])

    return zeros(p, *fixed(still))


def _moved(slope: Float[Array, "*shape n"], dp: Parameters) -> Float[Array, "*shape"]:
    """The product; NaN of a slope is NaN where it is asked for, in either mode."""
    bad = jnp.isnan(slope)
    spread = jnp.broadcast_to(no_number(dp), slope.shape)
    none = jnp.sum(jnp.where(bad, spread, 0.0), axis=-1)
    return jnp.where(bad, 0.0, slope) @ dp + no_number(none)


def zeros_of(shape: tuple[int, ...], p: Parameters, *still: object) -> Numbers:
    """Zeros that are a batch where one of the arguments is.

    JAX derives a batch of a function with a rule of its own wrongly (a `TypeError`)
    where the function's result is the same for all of it, and the rule's is not.
    """
    zero = jnp.zeros((), p.dtype)
    for x in jax.tree.leaves((p, still)):
        if isinstance(x, jax.Array) and x.size:
            first = jnp.ravel(x)[0]
            zero += jnp.where(first == first, zero, zero)
    return jnp.broadcast_to(zero, shape)


# ---- what has no derivative


def first_order(x: Numbers) -> Numbers:
    """A first derivative; one of it is refused."""
    return refused(
        "Periodic orbits, their folds and thresholds have first derivatives only: "
        "the second ones would need second variations. Take differences of the first.",
        x,
    )


def lost(tree: Tree, inputs: object) -> Tree:
    """The same numbers; their derivatives in the traced numbers of `inputs` are NaN.

    A cotangent of zero stays zero, so that reverse mode of other numbers of the same
    result is not spoilt.
    """
    p, _ = moving(inputs, jnp.result_type(float))
    if not p.size:
        return tree

    @jax.custom_jvp
    def nothing(p: Parameters) -> Float[Array, ""]:
        return zeros_of((), p)

    @nothing.defjvp
    def rule(primals, tangents):
        zero = nothing(*primals)
        # the factor has no derivative either, and so there is no second one
        return zero, jnp.sum(no_number(tangents[0])) * (1.0 + zero)

    # broadcast behind the zero, for cotangents of unlike sign may have no sum
    zero = nothing(p)

    def without(x: Numbers) -> Numbers:
        spread = jnp.broadcast_to(zero, jnp.shape(x)).astype(x.dtype)
        return x + no_number(spread)

    return jax.tree.map(lambda x: without(x) if moves(x) else x, tree)


def forward_only(question: str, tree: Tree, *, once: bool) -> Tree:
    """The same numbers; to take their derivatives in reverse mode is a `ValueError`.

    **Arguments:** `once`: whether to take second ones is one, too.
    """
    if once:
        tree = _once(question, tree)
    sentence = (
        f"`{question}` has derivatives in forward mode only (the number of its steps "
        "is not known beforehand): use `jax.jvp` or `jax.jacfwd` for `jax.grad`, "
        "`jax.vjp` and `jax.jacrev`."
    )

    def marked(x: Numbers) -> Numbers:
        return forward_alone(x, sentence) if moves(x) else x

    return jax.tree.map(marked, tree)


def _once(question: str, tree: Tree) -> Tree:
    sentence = (
        f"`{question}` has first derivatives only: second ones would need second "
        "variations of cycles, and of when joints stick and slip. Take differences of "
        "the first."
    )

    @jax.custom_jvp
    def same(x: Numbers) -> Numbers:
        return x

    @same.defjvp
    def rule(primals, tangents):
        return same(*primals), refused(sentence, tangents[0])

    return jax.tree.map(lambda x: same(x) if moves(x) else x, tree)


def fixed(tree: Tree) -> Tree:
    """The same numbers without derivatives; concrete ones stay concrete.

    Of a search's own numbers alone. What is shown to a user passes through `lost`.
    """
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
