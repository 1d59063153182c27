"""In what arithmetic the library computes, and what a plain function sets up first.

JAX computes in 32 bits unless it is told otherwise, and most numbers here would be
wrong in them without a word. A plain function therefore refuses a 32-bit session; a
sweep that was asked for 32 bits traces its point within `in_32_bits()`. That is a
context of JAX's own: it is a part of every compilation cache's key and local to a
thread.
"""

from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import wraps
from typing import Any, ParamSpec, TypeVar

import jax
import jax.numpy as jnp

from ._debug import own_flags

_NARROW = jax.make_user_context(default_value=False)

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def in_32_bits() -> AbstractContextManager[Any]:
    """A context in which plain functions compute in 32 bits, as a sweep may ask."""
    return _NARROW(True)


def narrow_allowed() -> bool:
    """Whether this thread may compute in 32 bits."""
    return bool(_NARROW.value)


def plain(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """A public function that computes: in 64 bits, and whatever is being debugged."""
    name = getattr(function, "__name__", "this")

    @wraps(function)
    def computed(*args: Arguments.args, **options: Arguments.kwargs) -> Result:
        if jnp.result_type(float) != jnp.float64 and not narrow_allowed():
            raise ValueError(
                f"`{name}` must compute in 64-bit arithmetic, but JAX is set to 32 "
                'bits; type `jax.config.update("jax_enable_x64", True)` before it, '
                "or use `sweep`."
            )
        with own_flags():
            return function(*args, **options)

    return computed
