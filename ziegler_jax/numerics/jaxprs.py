"""JAX's own programs, as it lets others hold them."""

from collections.abc import Callable

import jax
from jax.extend.core import (
    ClosedJaxpr,  # pyright: ignore[reportPrivateImportUsage]
    JaxprEqn,  # pyright: ignore[reportPrivateImportUsage]
    Literal,
)

from .numbers import Numbers, Scalar

__all__ = ["ClosedJaxpr", "JaxprEqn", "Literal", "reads_first"]


def reads_first(
    function: Callable[..., object], first: Scalar | Numbers, *others: object
) -> bool:
    """Whether a function reads its first argument, a number or several."""
    # jitted parts written out: as one call they read all that they are given
    with jax.disable_jit():
        jaxpr = jax.make_jaxpr(function)(first, *others).jaxpr
    count = len(jax.tree.leaves(first))
    read = [*jaxpr.outvars, *(x for e in jaxpr.eqns for x in e.invars)]
    return any(x is own for x in read for own in jaxpr.invars[:count])
