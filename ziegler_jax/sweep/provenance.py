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
import platform
import warnings
from collections.abc import Callable, Iterable, Mapping
from importlib import metadata
from typing import Any, cast
from uuid import uuid4

import jax
import numpy as np
import xarray as xr

from ..results import AXES, coordinate, labels, unlike_meaning
from ..runtime import compiles_whole_loops
from .axes import check_name, empty, parameters
from .partition import Blocks
from .program import Scene

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
    """A point's name and source, for people to read."""
    point = point.func if isinstance(point, functools.partial) else point
    try:
        source = inspect.getsource(point)
    except (OSError, TypeError):
        source = repr(point)
    module, name = (getattr(point, key, "") for key in ("__module__", "__qualname__"))
    return {
        "scene": source,
        "scene_function": f"{module}:{name}" if name else "",
    }


@functools.cache  # reading them takes 25 ms
def _versions() -> dict[str, str]:
    packages = ("ziegler_jax", "jax", "jaxlib", "diffrax", "numpy")
    versions = {f"{package}_version": metadata.version(package) for package in packages}
    return {**versions, "python_version": platform.python_version()}
