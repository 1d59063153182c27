"""What a plain function sets up before it computes: its arithmetic, and JAX's flags.

JAX computes in 32 bits unless it is told otherwise, and most numbers here would be
wrong in them without a word. A plain function therefore refuses a 32-bit session; a
sweep that was asked for 32 bits says so in its `Context`.
"""

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

import jax.numpy as jnp

from ._context import current_context
from ._debug import own_flags

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def plain(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """A public function that computes: in 64 bits, and whatever is being debugged."""
    name = getattr(function, "__name__", "this")

    @wraps(function)
    def computed(*args: Arguments.args, **options: Arguments.kwargs) -> Result:
        if jnp.result_type(float) != jnp.float64 and not current_context().narrow:
            raise ValueError(
                f"`{name}` must compute in 64-bit arithmetic, but JAX is set to 32 "
                'bits; type `jax.config.update("jax_enable_x64", True)` before it, '
                "or use `sweep`."
            )
        with own_flags():
            return function(*args, **options)

    return computed
