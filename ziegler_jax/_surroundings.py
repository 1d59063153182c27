"""What a scene refers to beyond its arguments: JAX would not notice that it changed."""

import inspect
import sysconfig
from collections.abc import Callable, Iterator
from hashlib import sha256
from types import FunctionType
from typing import Any

import jax
import numpy as np
from jax.core import Tracer

_PLAIN = (bool, int, float, complex, str, bytes, type(None), np.generic)
_INSTALLED = tuple(sysconfig.get_paths()[key] for key in ("stdlib", "purelib"))


class _Same:
    """An object as itself: equal to nothing else, and alive as long as it is a key."""

    def __init__(self, value: Any):
        self.value = value

    def __hash__(self):
        return id(self.value)

    def __eq__(self, other: object):
        return isinstance(other, _Same) and self.value is other.value


def surroundings(point: Callable) -> tuple:
    """A key that changes with everything that `point` refers to.

    Numbers, arrays and containers count by value, what the scene's own helper functions
    and callable objects refer to likewise; anything else by identity.
    """
    return _key(point, set(), the_scene=True)


def constants(point: Callable) -> dict[str, Any]:
    """The numbers that `point` takes from around it, alone or in containers."""
    around = _around(point, the_scene=True)
    return {name: value for name, value in around if _is_plain(value)}


def _key(value: Any, seen: set[int], the_scene: bool = False) -> tuple:
    if isinstance(value, _PLAIN):
        return type(value), value
    if isinstance(value, np.ndarray | jax.Array) and not isinstance(value, Tracer):
        array = np.asarray(value)
        digest = sha256(np.ascontiguousarray(array).tobytes()).digest()
        return array.dtype.str, array.shape, digest
    if id(value) in seen:
        return (_Same(value),)
    seen = seen | {id(value)}
    if isinstance(value, dict):
        return dict, *((_key(k, seen), _key(v, seen)) for k, v in value.items())
    if isinstance(value, list | tuple):
        return type(value), *(_key(v, seen) for v in value)
    if isinstance(value, set | frozenset):
        return type(value), frozenset(_key(v, seen) for v in value)
    around = _around(value, the_scene)
    around = tuple((name, _key(v, seen)) for name, v in around)
    return _Same(value), around


def _around(value: Any, the_scene: bool = False) -> Iterator[tuple[str, Any]]:
    """What the scene, a helper of the user's, or a callable object refers to."""
    owner = getattr(value, "__self__", None)
    function = inspect.unwrap(value) if callable(value) else value
    function = getattr(function, "__func__", function)
    if isinstance(function, FunctionType):
        package = function.__module__.split(".")[0]
        file = function.__code__.co_filename
        installed = package == "ziegler_jax" or file.startswith(_INSTALLED)
        if installed and not the_scene:
            return
        found = inspect.getclosurevars(function)
        yield from sorted({**found.globals, **found.nonlocals}.items())
        for parameter in inspect.signature(function).parameters.values():
            if parameter.default is not parameter.empty:
                yield parameter.name, parameter.default
        if owner is not None:
            yield "self", owner
    elif callable(value) and not isinstance(value, type):
        # functools.partial and the like
        for name in ("func", "args", "keywords"):
            if hasattr(value, name):
                yield name, getattr(value, name)
        yield from sorted(getattr(value, "__dict__", {}).items())


def _is_plain(value: Any) -> bool:
    if isinstance(value, dict):
        return all(isinstance(k, str) and _is_plain(v) for k, v in value.items())
    if isinstance(value, list | tuple):
        return all(map(_is_plain, value))
    return isinstance(value, bool | int | float | str)
