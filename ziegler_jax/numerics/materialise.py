"""Conditionals that a whole batch decides: for speed alone, never for results.

XLA on a CPU fuses a producer into each of its consumers and evaluates it once for
each: in an unrolled Runge-Kutta step the field of stage 1, which all later stages use,
would be computed a dozen times. A conditional whose predicate is known only at run time
ends a fusion; `lax.optimization_barrier` does not, it is dropped before.
"""

from collections.abc import Callable
from functools import partial, wraps
from typing import TypeVar, TypeVarTuple, cast

import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import eval_jaxpr
from jax.custom_batching import custom_vmap

from .jaxprs import Literal
from .numbers import Flag, Scalar

Inputs = TypeVarTuple("Inputs")
Output = TypeVar("Output")
Tree = TypeVar("Tree")  # a pytree of numbers


@custom_vmap
def _always(x: jax.Array) -> jax.Array:
    """True for every number, NaN included, but the compiler cannot know."""
    return ~(x * 0 > 1)


@_always.def_vmap
def _always_for_a_batch(axis_size, batched, x):
    # one answer for all lanes: a batched predicate would become a select of both sides
    del axis_size, batched
    return _always(x[0]), False


def materialise(
    at: Scalar, function: Callable[[*Inputs], Output], *args: *Inputs
) -> Output:
    """`function(*args)`, its results kept as arrays.

    **Arguments:**

    - `at`: any traced number of the lane, e.g. its time.
    - `function`: returns a pytree of arrays.

    On other devices than a CPU, where `at` is a whole array, and where it is not traced
    this is a plain call.
    """
    if jnp.ndim(at) or jax.default_backend() != "cpu":
        return function(*args)
    if not isinstance(at, jax.core.Tracer):
        # as one traced call: op by op, `debug_nans` would stop at a NaN on the way
        return traced_once(function, *args)(*args)
    leaves, tree = jax.tree.flatten(args)
    results_like = []  # their tree; of each the input that it is, shape and dtype

    def always(*inputs):
        same = cast("tuple[*Inputs]", jax.tree.unflatten(tree, inputs))
        results, structure = jax.tree.flatten(function(*same))
        results = [jnp.asarray(x) for x in results]
        places = {id(x): i for i, x in enumerate(inputs)}
        about = [(places.get(id(x)), x.shape, x.dtype) for x in results]
        results_like.append((structure, about))
        return results

    def never(*inputs):  # `lax.cond` traces it second
        _, about = results_like[-1]
        # what passes through both branches `lax.cond` leaves out: nothing is copied
        return [jnp.zeros(s, d) if i is None else inputs[i] for i, s, d in about]

    results = lax.cond(_always(lax.stop_gradient(at)), always, never, *leaves)
    structure, _ = results_like[-1]
    return jax.tree.unflatten(structure, results)


def traced_once(
    function: Callable[[*Inputs], Output], *args: *Inputs
) -> Callable[[*Inputs], Output]:
    """The same function of such arguments, traced here and nowhere again.

    A step evaluates its field many times. As a call of one traced program each time,
    it is a small part of what JAX has to trace, batch and lower; XLA inlines the calls.
    """
    closed, shapes = jax.make_jaxpr(function, return_shape=True)(*args)
    tree, jaxpr = jax.tree.structure(shapes), closed.jaxpr
    call = jax.jit(lambda consts, *leaves: eval_jaxpr(jaxpr, consts, *leaves))
    place = {v: i for i, v in enumerate(jaxpr.invars)}
    # an input that is a result, too, is known as such by the caller
    same = [None if isinstance(v, Literal) else place.get(v) for v in jaxpr.outvars]

    def again(*args: *Inputs) -> Output:
        leaves = jax.tree.leaves(args)
        results = call(closed.consts, *leaves)
        pairs = zip(results, same, strict=True)
        results = [x if i is None else jnp.asarray(leaves[i]) for x, i in pairs]
        return jax.tree.unflatten(tree, results)

    return again


def hoisted(
    function: Callable[[*Inputs], Output], *args: *Inputs
) -> tuple[Callable[..., Output], list]:
    """The same function of such arguments, behind numbers that it only closed over.

    **Returns:** the function, which closes over nothing that is traced, and the
    numbers, its first argument.
    """
    closed, shapes = jax.make_jaxpr(function, return_shape=True)(*args)
    tree, jaxpr = jax.tree.structure(shapes), closed.jaxpr

    def open_function(numbers, *args):
        results = eval_jaxpr(jaxpr, numbers, *jax.tree.leaves(args))
        return jax.tree.unflatten(tree, results)

    return open_function, closed.consts


def as_one_call(
    function: Callable[..., Output], inline: bool = False
) -> Callable[..., Output]:
    """The same function as a call of a program that JAX traces once for such arguments.

    A scene asks for its field ten times. Numbers of Python's own stay known to it.

    **Arguments:** `inline`: whether its equations stand in the caller's own program.
    """

    @partial(jax.jit, static_argnums=0, inline=inline)
    def call(still, moving):
        leaves, tree = still
        leaves = iter(leaves)
        numbers = iter(moving)
        merged = [next(numbers) if x is _MOVES else x for x in leaves]
        return function(*jax.tree.unflatten(tree, merged))

    @wraps(function)
    def called(*args):
        leaves, tree = jax.tree.flatten(args)
        moving = [x for x in leaves if isinstance(x, _ARRAYS)]
        if not any(isinstance(x, jax.core.Tracer) for x in moving):
            return function(*args)  # nothing is traced here
        still = tuple(_MOVES if isinstance(x, _ARRAYS) else x for x in leaves)
        return call((still, tree), moving)

    return called


_MOVES, _ARRAYS = object(), (jax.Array, np.ndarray)


def tree_where(flag: Flag, new: Tree, old: Tree) -> Tree:
    """`new` where the flag is set, else `old`: of each number of two alike trees."""
    return jax.tree.map(lambda a, b: b if a is b else jnp.where(flag, a, b), new, old)


def replaced(flag: Flag, new: Tree, old: Tree) -> Tree:
    """`tree_where`, with the kinds of numbers that `old` has."""

    def alike(a, b):
        return b if a is b else jnp.asarray(a, jnp.result_type(b))

    return tree_where(flag, jax.tree.map(alike, new, old), old)


@custom_vmap
def any_lane(flag: jax.Array) -> jax.Array:
    """Whether the flag is set in any lane of the batch."""
    return flag


@any_lane.def_vmap
def _any_lane_of_a_batch(axis_size, batched, flag):
    del axis_size, batched
    return any_lane(jnp.any(flag)), False


def if_any_lane(flag: Flag, function: Callable[[Tree], Tree], state: Tree) -> Tree:
    """`function(state)` if some lane of the batch needs it, else `state`.

    For work that is rare but not worth a loop of its own. `function` must leave the
    state of a lane whose flag is not set as it is, or lanes would depend on their
    batch mates: unless such a lane's numbers are thrown away.
    """
    if jax.default_backend() != "cpu":
        return function(state)
    if not isinstance(flag, jax.core.Tracer):
        function = traced_once(function, state)  # as `materialise` does
    leaves, tree = jax.tree.flatten(state)

    def needed(*leaves):
        return jax.tree.leaves(function(tree.unflatten(leaves)))

    # what only passes through is not copied where this is traced: it is left out
    before = map(jnp.asarray, leaves)
    after = lax.cond(any_lane(flag), needed, lambda *leaves: [*leaves], *before)
    return tree.unflatten(after)
