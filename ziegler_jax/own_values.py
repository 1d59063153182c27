"""Values that hold nothing of the user's own, as a key.

What this package's classes hold is in their fields, and their code does not change. So
what JAX traced of a question that is asked of such values alone it may keep. A user's
law, function or object may read anything: a global, an attribute, the environment.
"""

import dataclasses
import enum
from collections.abc import Hashable, Sequence
from typing import cast

import jax
import numpy as np

_PACKAGE = __name__.partition(".")[0]
_PLAIN = (type(None), bool, int, str)


class _OfTheUsers(Exception):
    """A value may read what no field of it shows."""


def own_values(value: object) -> Hashable | None:
    """A key of the value, by its classes and numbers; None where it may hold anything.

    Numbers of JAX are known by shape and dtype alone: what is traced takes them as
    arguments.
    """
    tokens: list[Hashable] = []
    try:
        _read(value, tokens)
    except _OfTheUsers:
        return None
    return tuple(tokens)


def _read(value: object, tokens: list[Hashable]) -> None:
    kind = type(value)
    own = kind.__module__.partition(".")[0] == _PACKAGE
    tokens.append(kind)
    if isinstance(value, jax.Array):  # a tracer is one, too
        tokens += value.shape, str(value.dtype)
    elif kind in _PLAIN or (own and isinstance(value, enum.Enum)):
        tokens.append(value)
    elif kind is float:
        tokens.append(cast(float, value).hex())  # 0.0 and -0.0 are equal
    elif isinstance(value, np.ndarray | np.generic) and kind.__module__ == "numpy":
        if value.dtype.kind not in "biufc":  # objects may be anything
            raise _OfTheUsers
        tokens += value.dtype.str, value.shape, value.tobytes()
    elif kind in (tuple, list) or (own and isinstance(value, tuple)):
        parts = cast(Sequence[object], value)
        tokens.append(len(parts))
        for part in parts:
            _read(part, tokens)
    elif kind is dict:
        _read(list(cast(dict, value).items()), tokens)
    elif own and dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            _read(getattr(value, field.name, None), tokens)
    else:
        raise _OfTheUsers
