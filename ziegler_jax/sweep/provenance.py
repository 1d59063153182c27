"""What a sweep is: its identity, and its dataset before anything is computed.

A scene is known by one digest: of its equations, as JAX traced them, with the bytes of
the numbers in them. That sees globals, helpers, attributes and table values, which
source code hides; it is the same in every process, thread and kind of CPU, and changes
with the version of JAX. It stands in the dataset (`scene_digest`), and in stores. A
point that has the host compute something (`jax.pure_callback`) has none: its equations
do not show what that is. Units and lists of codes are in no equation, and are compared
beside it. What else labels a variable, and its origin, are those of the dataset.
"""

import functools
import hashlib
import inspect
import json
import platform
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from importlib import metadata
from types import FunctionType, SimpleNamespace
from typing import Any, TypeAlias, cast
from uuid import uuid4

import jax
import numpy as np
import xarray as xr
from jax.core import Tracer

from ..results import AXES, coordinate, labels, unlike_meaning
from ..runtime import compiles_whole_loops
from .axes import check_name, empty, parameters
from .partition import Blocks
from .program import Scene, is_the_users

NONE = "none"  # the digest of a scene that has none
_PACKAGES = ("ziegler_jax", "jax", "jaxlib")


def identity(scene: Scene, blocks: Blocks) -> dict[str, Any]:
    """Everything that a sweep's results depend on, the kind of processor apart."""
    return {
        **{name: metadata.version(name) for name in _PACKAGES},
        "axes": {
            name: [values.size, float(values[0]), float(values[-1]), digest_of(values)]
            for name, values in parameters(blocks.grid).items()
        },
        "dimensions": list(blocks.grid),
        "where": blocks.digest,
        "block": list(blocks.chunk),
        "settings": dict(scene.attributes),
        "batch_size": scene.batch_size,
        "loops": "whole" if compiles_whole_loops() else "in parts",
        "results": {
            name: [cast(jax.ShapeDtypeStruct, v.value).dtype.name, *v.dims]
            for name, v in scene.variables.items()
        },
        # what the host computes is not known again: no two sweeps of it are one
        "scene": f"{NONE} {uuid4().hex}" if scene.known.hosts else scene.digest,
    }


def warn_of_hosts(scene: Scene) -> None:
    """Say that a point which calls functions of the host cannot be resumed."""
    if scene.known.hosts:
        warnings.warn(
            "The sweep cannot be resumed from its store: `point` has the host call "
            f"{', '.join(sorted(scene.known.hosts))} (`pure_callback`, `io_callback`), "
            "and what that computes does not stand in the program. `open_sweep` reads "
            "what is finished.",
            stacklevel=3,
        )


def difference(there: Mapping[str, Any], here: Mapping[str, Any]) -> str | None:
    """The first difference of two identities as a part of a sentence, or None."""
    for name in _PACKAGES:
        if there[name] != here[name]:
            return f"was computed with {name} {there[name]}, and this is {here[name]}"
    if list(there["axes"]) != list(here["axes"]):
        return (
            f"has the axes {', '.join(there['axes'])}, and this sweep has "
            f"{', '.join(here['axes'])}"
        )
    if list(there["dimensions"]) != list(here["dimensions"]):
        return (
            f"has the dimensions {', '.join(there['dimensions'])}, and this sweep has "
            f"{', '.join(here['dimensions'])}"
        )
    for name, old in there["axes"].items():
        new = here["axes"][name]
        if old != new:
            which = "" if old[:3] != new[:3] else ", others between them"
            return (
                f"has axis `{name}` with {old[0]} values from {old[1]:.17g} to "
                f"{old[2]:.17g}, and this sweep {new[0]} from {new[1]:.17g} to "
                f"{new[2]:.17g}{which}"
            )
    if there["where"] != here["where"]:
        return "has other points: `where` chooses others in this sweep"
    if there["loops"] != here["loops"]:
        return (
            f"was computed with loops compiled {there['loops']}, and this sweep "
            f"compiles them {here['loops']} (see `configure_cpu`)"
        )
    for name in ("block", "batch_size"):
        if there[name] != here[name]:
            return f"has {name} {there[name]}, and this sweep {here[name]}"
    old, new = there["settings"], here["settings"]
    for name in sorted({*old, *new}):
        if old.get(name) != new.get(name):
            return f"has {name} {old.get(name)}, and this sweep {new.get(name)}"
    if list(there["results"].items()) != list(here["results"].items()):
        return (
            f"holds {', '.join(there['results'])}, and this sweep gives "
            f"{', '.join(here['results'])}, or other types or dimensions of them"
        )
    if str(there["scene"]).startswith(NONE):
        return (
            "is of a point that has the host compute something (`pure_callback`, "
            "`io_callback`), which cannot be resumed; `open_sweep` reads what is there"
        )
    if there["scene"] != here["scene"]:
        return "is of another scene: its program is not that of this `point`"
    return None


def difference_of_meaning(
    there: Mapping[str, Mapping], here: Mapping[str, Mapping]
) -> str | None:
    """The first unit or list of codes that differs, as a part of a sentence, or None.

    A digest is of what is computed, and does not see them.

    **Arguments:** what two stores of the same variables say of their sweeps.
    """
    for kind in ("data_vars", "coords"):
        for name, own in here["metadata"][kind].items():
            old, new = there["metadata"][kind][name]["attrs"], own["attrs"]
            key = unlike_meaning(old, new)
            if key is not None:
                return (
                    f"has `{name}` with {key} {old.get(key)!r}, and this sweep "
                    f"{new.get(key)!r}"
                )
    return None


def digest_of(values: np.ndarray) -> str:
    """A hash of an axis, to the last bit."""
    return hashlib.sha256(np.ascontiguousarray(values, "<f8").tobytes()).hexdigest()


# a number, text or table as JSON has it
Plain: TypeAlias = bool | int | float | str | list["Plain"] | dict[str, "Plain"]
LONGEST_TABLE = 100  # values of an array that are recorded; of longer ones the ends


def check_names(scene: Scene, grid: Iterable[str]) -> None:
    """Refuse results whose names break the rule, or are an axis's or its dimension's.

    **Raises:** `ValueError`.
    """
    taken = set(scene.variables)
    for name, variable in scene.variables.items():
        check_name("Result", name)
        taken |= set(variable.dims)
    for name in [*scene.names, *grid]:
        if name in taken:
            raise ValueError(
                f"Axis `{name}` must be named unlike a result or its dimensions, which "
                f"are {', '.join(sorted(taken))}."
            )


def template(
    grid: Mapping[str, np.ndarray],
    scene: Scene,
    shape: tuple[int, ...],
    attributes: Mapping[str, object],
    own: Mapping[str, Mapping[str, str]],
) -> xr.Dataset:
    """The dataset with nothing computed; `own`: what the user says of the axes."""
    data, used, coords = {}, {}, {}
    along = {name: dim for dim in grid for name in parameters({dim: grid[dim]})}
    for name, variable in scene.variables.items():
        dims, values = tuple(grid) + variable.dims, empty(variable, shape)
        data[name] = (dims, values, labels(variable))
        known = scene.coordinates
        used |= {dim: known[dim] for dim in variable.dims if dim in known}
    for name, values in {**used, **parameters(grid)}.items():
        _, *labelled = coordinate(name, values)
        if name in along:
            usual = {"long_name": name, "units": "1", "symbol": name}
            about = labelled[1] if name in AXES else usual
            labelled = [np.asarray(values), {**about, **own.get(name, {})}]
        coords[name] = (along.get(name, name), *labelled)
    return xr.Dataset(data, coords, attributes)


def provenance(scene: Scene, points: int) -> dict[str, object]:
    """Where a sweep's numbers come from."""
    return {
        **_versions(),
        **origin(scene.point),
        "scene_axes": ", ".join(scene.names),
        "scene_digest": NONE if scene.known.hosts else scene.digest,
        **scene.attributes,
        "batch_size": scene.batch_size,
        "points": points,
    }


def origin(point: Callable[..., object]) -> dict[str, str]:
    """What a point is, for the record: its name, source and the numbers around it."""
    try:
        source = inspect.getsource(point)
    except (OSError, TypeError):
        source = repr(point)
    module, name = (getattr(point, key, "") for key in ("__module__", "__qualname__"))
    return {
        "scene": source,
        "scene_function": f"{module}:{name}" if name else "",
        "scene_constants": json.dumps(constants(point)),
    }


@functools.cache  # reading them takes 25 ms
def _versions() -> dict[str, str]:
    packages = ("ziegler_jax", "jax", "jaxlib", "diffrax", "numpy")
    versions = {f"{package}_version": metadata.version(package) for package in packages}
    return {**versions, "python_version": platform.python_version()}


def constants(point: Callable[..., object]) -> dict[str, Plain]:
    """The numbers that a point takes from around it, for the record.

    By the names they go by in its code: globals, enclosed variables, defaults, those of
    the helpers that it calls (`helper.factor`) and of objects (`cfg.c`). It is a record
    and no more: whether a scene has changed is seen from its digest.
    """
    numbers: dict[str, Plain] = {}
    _record(numbers, "", point, set())
    return numbers


def _record(
    numbers: dict[str, Plain], prefix: str, value: object, visited: set[int]
) -> None:
    if id(value) in visited or len(visited) > 1000:
        return
    visited.add(id(value))
    for name, inner in _around(value):
        path = f"{prefix}{name}"
        plain = _plain(inner)
        if plain is not None:
            numbers[path] = plain
        else:
            _record(numbers, f"{path}.", inner, visited)


def _around(value: object) -> Iterator[tuple[str, object]]:
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


def _plain(value: object) -> Plain | None:
    """A number, text or table as JSON has it; None for anything else."""
    if isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray | jax.Array) and not isinstance(value, Tracer):
        if jax.numpy.issubdtype(value.dtype, jax.dtypes.prng_key):
            value = jax.random.key_data(value)  # NumPy has no such dtype
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
        return cast(Plain, plain) if whole else None
    if isinstance(value, list | tuple):
        items = [_plain(v) for v in value]
        return None if None in items else cast(Plain, items)
    return None
