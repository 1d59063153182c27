"""What a sweep's dataset is before anything is computed: labels, units, origin."""

import functools
import inspect
import json
import platform
from collections.abc import Callable, Iterator, Mapping
from importlib import metadata
from types import FunctionType, SimpleNamespace
from typing import Any

import jax
import numpy as np
import xarray as xr
from jax.core import Tracer

from ._axes import check_name
from ._program import Scene, is_the_users
from ._variables import AXES, empty
from .outcome import flag_attributes

LONGEST_TABLE = 100  # values of an array that are recorded; of longer ones the ends


def check_names(scene: Scene) -> None:
    """Refuse results whose names break the rule, or are an axis's.

    **Raises:** `ValueError`.
    """
    taken = set(scene.variables)
    for name, variable in scene.variables.items():
        check_name("Result", name)
        taken |= set(variable.dims)
    for name in scene.names:
        if name in taken:
            raise ValueError(
                f"Axis `{name}` must be named unlike a result or its dimensions, which "
                f"are {', '.join(sorted(taken))}."
            )


def template(
    grid: Mapping[str, np.ndarray],
    scene: Scene,
    shape: tuple[int, ...],
    attributes: Mapping[str, Any],
) -> xr.Dataset:
    """The dataset with nothing computed."""
    data, used, coords = {}, {}, {}
    for name, variable in scene.variables.items():
        attrs: dict[str, Any] = {
            "long_name": variable.long_name,
            "units": variable.units,
        }
        if variable.codes is not None:
            attrs = {"long_name": variable.long_name, **flag_attributes(variable.codes)}
        data[name] = (tuple(grid) + variable.dims, empty(variable, shape), attrs)
        used |= {dim: scene.coordinates[dim] for dim in variable.dims}
    for name, values in {**used, **grid}.items():
        if name in used and name not in AXES:  # rods, joints, branches
            coords[name] = list(values)
            continue
        meaning, units, symbol = AXES.get(name, (name, "1", name))
        attrs = {"long_name": meaning, "units": units, "symbol": symbol}
        coords[name] = (name, np.asarray(values), attrs)
    return xr.Dataset(data, coords, attributes)


def provenance(scene: Scene, points: int) -> dict[str, Any]:
    """Where a sweep's numbers come from."""
    try:
        source = inspect.getsource(scene.point)
    except (OSError, TypeError):
        source = repr(scene.point)
    return {
        **_versions(),
        "scene": source,
        "scene_constants": json.dumps(constants(scene.point)),
        **scene.attributes,
        "precision": "float64" if scene.wide else "float32",
        "batch_size": scene.batch_size,
        "points": points,
    }


@functools.cache  # reading them takes 25 ms
def _versions() -> dict[str, str]:
    packages = ("ziegler_jax", "jax", "jaxlib", "diffrax", "numpy")
    versions = {f"{package}_version": metadata.version(package) for package in packages}
    return {**versions, "python_version": platform.python_version()}


def constants(point: Callable) -> dict[str, Any]:
    """The numbers that a point takes from around it, for the record.

    By the names they go by in its code: globals, enclosed variables, defaults, those of
    the helpers that it calls (`helper.factor`) and of objects (`cfg.c`). It is a record
    and no more: whether a scene has changed is seen from its lowered program.
    """
    found: dict[str, Any] = {}
    _record(found, "", point, set())
    return found


def _record(found: dict[str, Any], prefix: str, value: Any, seen: set[int]) -> None:
    if id(value) in seen or len(seen) > 1000:
        return
    seen.add(id(value))
    for name, inner in _around(value):
        path = f"{prefix}{name}"
        plain = _plain(inner)
        if plain is not None:
            found[path] = plain
        else:
            _record(found, f"{path}.", inner, seen)


def _around(value: Any) -> Iterator[tuple[str, Any]]:
    """What a function, a partial or an object refers to, by name."""
    if isinstance(value, functools.partial):
        yield from _around(value.func)
        yield from ((f"argument {i}", v) for i, v in enumerate(value.args))
        yield from value.keywords.items()
        return
    owner = getattr(value, "__self__", None)
    function = inspect.unwrap(value) if callable(value) else value
    function = getattr(function, "__func__", function)
    if isinstance(function, FunctionType):
        if not is_the_users(function.__code__.co_filename):
            return
        around = inspect.getclosurevars(function)
        yield from sorted({**around.globals, **around.nonlocals}.items())
        for parameter in inspect.signature(function).parameters.values():
            if parameter.default is not parameter.empty:
                yield parameter.name, parameter.default
        if owner is not None:
            yield "self", owner
    elif isinstance(value, SimpleNamespace) or _is_of_the_users(type(value)):
        yield from sorted(getattr(value, "__dict__", {}).items())


def _is_of_the_users(kind: type) -> bool:
    """Whether a class is defined in the user's own code."""
    try:
        return is_the_users(inspect.getfile(kind))
    except (OSError, TypeError):  # built in, or typed at a prompt
        return kind.__module__ == "__main__"


def _plain(value: Any) -> Any:
    """A number, text or table as JSON has it; None for anything else."""
    if isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray | jax.Array) and not isinstance(value, Tracer):
        array = np.asarray(value)
        if array.dtype.kind not in "biuf":
            return None
        if array.size <= LONGEST_TABLE:
            return array.tolist()
        ends = f"{array.flat[0]:.17g} to {array.flat[-1]:.17g}"
        return f"array of shape {array.shape}, from {ends}"
    if isinstance(value, dict):
        plain = {k: _plain(v) for k, v in value.items() if isinstance(k, str)}
        whole = len(plain) == len(value) and None not in plain.values()
        return plain if whole else None
    if isinstance(value, list | tuple):
        items = [_plain(v) for v in value]
        return None if None in items else items
    return None
