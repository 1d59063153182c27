"""A column as a function of named numbers: its own leaves, or a scene's arguments."""

import inspect
import re
from collections.abc import Callable, Iterable, Mapping

import jax
import numpy as np
from jax.core import Tracer

from ..model.chain_of_rods import AbstractChain
from ..model.column import Column
from ..model.rods import NUMBERS, point_masses, uniform_rods
from ..numerics.numbers import Scalar

Make = Callable[..., AbstractChain]


def as_function(
    column: AbstractChain | Make,
    parameters: Mapping[str, Scalar] | Iterable[str] | None,
) -> tuple[Make, dict[str, Scalar | None]]:
    """A function of keywords that makes the column, and the keywords' values.

    A column or chain offers its leaves under their path, e.g. `kappa`, `damping.c1` or
    `springs.0`, all that its linear map uses if none are named. A function offers its
    arguments; those without a value get None.
    """
    if not isinstance(column, AbstractChain):
        if not callable(column):
            raise ValueError(
                "Argument `column` must be a `Column`, a `Chain`, or a function that "
                "makes one, "
                f"but is {column!r}."
            )
        if parameters is None:
            raise ValueError(
                "Argument `parameters` must be given where `column` is a function."
            )
        values = (
            dict(parameters)
            if isinstance(parameters, Mapping)
            else dict.fromkeys(parameters)
        )
        _takes(column, values)
        return column, values
    paths, tree = jax.tree_util.tree_flatten_with_path(column)
    leaves = {_named(path): leaf for path, leaf in paths}
    unused = {"q"}
    if isinstance(column, Column) and column.gravity is None:
        unused |= {"m2", "s1"}
    if isinstance(column, Column) and column.follower_only:
        unused |= {"l2"} if column.follower == 1.0 else set()
    unused |= {name for name, x in leaves.items() if np.ndim(x)}  # rows have no name
    names = [n for n in leaves if n not in unused] if parameters is None else parameters
    single = [name for name, x in leaves.items() if not np.ndim(x)]
    for name in names:
        if name not in single:
            raise ValueError(
                "Argument `parameters` must name leaves of the column, "
                f"{', '.join(single)}, but has {name!r}."
            )

    def make(**values: Scalar) -> AbstractChain:
        return jax.tree_util.tree_unflatten(tree, list((leaves | values).values()))

    for name in names:
        if isinstance(leaves[name], Tracer):
            raise ValueError(
                f"Argument `column` must have concrete numbers, but {name!r} is "
                "traced: call this outside `jax.jit` and `jax.vmap`, or differentiate "
                "`critical_load`."
            )
    return make, {name: float(np.asarray(leaves[name])) for name in names}


def _named(path: tuple) -> str:
    """A leaf's path; of `Viscous` beyond two joints as those of the first two."""
    name = jax.tree_util.keystr(path, simple=True, separator=".")
    return re.sub(r"\bc3_on\.(\d+)$", lambda place: f"c{int(place[1]) + 3}", name)


def _takes(function: Make, values: Mapping[str, Scalar | None]) -> None:
    """Raise where the function takes no argument of such a name."""
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):  # a builtin without one
        return
    known = signature.parameters.values()
    names = {
        p.name for p in known if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)
    }
    if any(p.kind is p.VAR_KEYWORD for p in known):
        names |= (
            set(NUMBERS) if function in (uniform_rods, point_masses) else set(values)
        )
    for name in values:
        if name not in names:
            raise ValueError(
                "Argument `parameters` must name arguments of the function, "
                f"{', '.join(sorted(names))}, but has {name!r}."
            )
