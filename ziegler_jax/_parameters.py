"""A column as a function of named numbers: its own leaves, or a scene's arguments."""

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import jax
import numpy as np

from .column import Column

Make = Callable[..., Column]


def as_function(
    column: Column | Make, parameters: Mapping[str, Any] | Iterable[str] | None
) -> tuple[Make, dict[str, float | None]]:
    """A function of keywords that makes the column, and the keywords' values.

    A `Column` offers its leaves under their path, e.g. `kappa` or `damping.c1`, all
    that its linear map uses if none are named. A function offers its arguments; those
    without a value get None.
    """
    if not isinstance(column, Column):
        if not callable(column):
            raise ValueError(
                "Argument `column` must be a `Column` or a function that makes one, "
                f"but is {column!r}."
            )
        if parameters is None:
            raise ValueError(
                "Argument `parameters` must be given where `column` is a function."
            )
        if isinstance(parameters, Mapping):
            return column, dict(parameters)
        return column, dict.fromkeys(parameters)
    paths, tree = jax.tree_util.tree_flatten_with_path(column)
    leaves = {
        jax.tree_util.keystr(path, simple=True, separator="."): leaf
        for path, leaf in paths
    }
    unused = {"q", "m2", "s1"} | ({"l2"} if column.follower == 1.0 else set())
    names = [n for n in leaves if n not in unused] if parameters is None else parameters
    for name in names:
        if name not in leaves:
            raise ValueError(
                "Argument `parameters` must name leaves of the column, "
                f"{', '.join(leaves)}, but has {name!r}."
            )

    def make(**values: Any) -> Column:
        return jax.tree_util.tree_unflatten(tree, list((leaves | values).values()))

    return make, {name: float(np.asarray(leaves[name])) for name in names}
