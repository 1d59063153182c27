"""JAX's debugging flags, which are for the user's numbers and not for the package's.

Infinity and NaN stand for "none" in many places here, by design, and loops of compiled
programs are what a motion is made of. While the package computes, `jax_debug_nans`,
`jax_debug_infs` and `jax_disable_jit` are therefore off. A motion that does end in NaN
is told of by `_not_finite`.
"""

from contextlib import AbstractContextManager, ExitStack, nullcontext
from typing import Any

import jax


def own_flags() -> AbstractContextManager[Any]:
    """A context without JAX's debugging flags; nothing where none is set."""
    config: Any = jax.config
    nans, infs = config.jax_debug_nans, config.jax_debug_infs
    if not (nans or infs or config.jax_disable_jit):
        return nullcontext()
    flags = ExitStack()
    flags.enter_context(jax.debug_nans(False))
    flags.enter_context(jax.debug_infs(False))
    flags.enter_context(jax.disable_jit(False))
    return flags
