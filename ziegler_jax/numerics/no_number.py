"""Numbers whose derivatives are NaN, of forward mode alone, or refused.

The first two are primitives, for what they do to a cotangent no rule of JAX's own can
say.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array, Shaped

from .numbers import is_concrete

Numbers = Shaped[Array, "*shape"]
Tree = TypeVar("Tree")  # a pytree of numbers, concrete ones among them


def no_number(x: Numbers) -> Numbers:
    """NaN for each number that is not zero, and so for tangents and cotangents.

    Of zero it is zero, so that reverse mode of other numbers is not spoilt.
    """
    return _no_number.bind(x)


def forward_alone(x: Numbers, sentence: str) -> Numbers:
    """The same numbers; a cotangent of them is a `ValueError` with this sentence."""
    return _forward_alone.bind(x, sentence=sentence)


def refused(sentence: str, tree: Tree) -> Tree:
    """The same numbers; to take a derivative in them is a `ValueError`."""

    @jax.custom_jvp
    def same(x: Numbers) -> Numbers:
        return x

    @same.defjvp
    def refuse(primals, tangents):
        del primals, tangents
        raise ValueError(sentence)

    return jax.tree.map(lambda x: same(x) if moves(x) else x, tree)


def moves(x: object) -> bool:
    """Whether it is a number that a derivative may be taken in."""
    return not is_concrete(x) and jnp.issubdtype(jnp.result_type(x), jnp.floating)


def _linear(name: str, forward: Callable, backward: Callable) -> Primitive:
    """A linear map of each number alone, with its own map of cotangents."""
    primitive = Primitive(name)
    primitive.def_impl(forward)
    primitive.def_abstract_eval(lambda x, **_: x)
    ad.deflinear2(primitive, backward)
    batching.defvectorized(primitive)
    mlir.register_lowering(primitive, mlir.lower_fun(forward, multiple_results=False))
    return primitive


def _nan_where_it_moves(x: Numbers) -> Numbers:
    return jnp.where(x == 0, jnp.zeros_like(x), jnp.full_like(x, jnp.nan))


def _refuse(cotangent: Any, x: Any, *, sentence: str):
    del cotangent, x
    raise ValueError(sentence)


_no_number = _linear(
    "no_number", _nan_where_it_moves, lambda cotangent, _: [no_number(cotangent)]
)
_forward_alone = _linear("forward_alone", lambda x, *, sentence: x, _refuse)
