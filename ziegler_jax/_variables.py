"""How a result of the library tells a sweep what its numbers are called and mean."""

from typing import Any, NamedTuple

from .outcome import Code


class Variable(NamedTuple):
    """One named quantity of a result.

    `value` has the shape that `dims` names; under `vmap` lanes stand in front.
    """

    value: Any
    long_name: str
    units: str = "1"
    dims: tuple[str, ...] = ()
    codes: type[Code] | None = None  # for flag variables


# The dimensions that results use, with their coordinates.
DIMENSIONS = {"rod": (1, 2), "joint": (1, 2)}
