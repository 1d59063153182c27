"""JAX's own programs, as it lets others hold them."""

from jax.extend.core import (
    ClosedJaxpr,  # pyright: ignore[reportPrivateImportUsage]
    JaxprEqn,  # pyright: ignore[reportPrivateImportUsage]
    Literal,
)

__all__ = ["ClosedJaxpr", "JaxprEqn", "Literal"]
