"""A sweep's identity, and its dataset before anything is computed.

One digest identifies a scene: a hash of its equations, as JAX traced them, with the
bytes of the numbers in them. It includes globals, helpers, attributes and table values,
which source code hides. It is the same in every process, thread and kind of CPU, and
changes with the version of JAX. Datasets (`scene_digest`) and stores have it. A point
with a host callback (`jax.pure_callback`) has none, since its equations do not show the
host's code. Units and lists of codes are not in the equations, and are compared as
well. Other labels of a variable, and its origin, are those of the dataset.
"""

import functools
import hashlib
import inspect
import platform
import warnings
from collections.abc import Callable, Mapping
from importlib import metadata
from typing import Any, cast
from uuid import uuid4

import jax
import numpy as np
import xarray as xr

from ..results import coordinate, labels, unlike_meaning
from ..runtime import compiles_whole_loops
from .grid import Grid, check_name
from .program import Scene
from .returned import empty

NONE = "none"  # the digest of a scene that has none
_PACKAGES = ("ziegler_jax", "jax", "jaxlib")


def identity(scene: Scene, grid: Grid) -> dict[str, Any]:
    """Everything that a sweep's results depend on, the kind of processor apart.

    Each by the words with which `difference` tells it: "the store has ...".
    """
    versions = {f"numbers by {name}": metadata.version(name) for name in _PACKAGES}
    axes = {str(name): axis.values for name, axis in grid.axes.coords.items()}
    return {
        **versions,
        **scene.attributes,  # in front: one that is named like an entry hides none
        "axes": list(grid.names),
        "dimensions": list(grid.dims),
        **{f"axis `{name}` of": _known_by(values) for name, values in axes.items()},
        "other points (`where`)": grid.digest,
        "blocks of": list(grid.chunk),
        "batch_size": scene.batch_size,
        "loops compiled": "whole" if compiles_whole_loops() else "in parts",
        "results": [
            " ".join([name, cast(jax.ShapeDtypeStruct, v.value).dtype.name, *v.dims])
            for name, v in scene.variables.items()
        ],
        # what the host computes is not known again: no two sweeps of it are one
        "scene": f"{NONE} {uuid4().hex}" if scene.known.hosts else scene.digest,
    }


def _known_by(values: np.ndarray) -> str:
    """An axis in words, and to the last bit."""
    if not values.ndim:
        return f"the number {values:.17g}"
    digest = hashlib.sha256(np.ascontiguousarray(values, "<f8").tobytes()).hexdigest()
    ends = f"{values[0]:.17g} to {values[-1]:.17g}"
    return f"{values.size} values from {ends}, with those between sha256 {digest}"


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
    if str(there["scene"]).startswith(NONE):
        return (
            "is of a point that has the host compute something (`pure_callback`, "
            "`io_callback`), which cannot be resumed; `open_sweep` reads what is there"
        )
    for what in ("axes", *here, *there):
        old, new = there.get(what), here.get(what)
        if old == new:
            continue
        if what == "scene":
            return "is of another scene: its program is not that of this `point`"
        return f"has {what} {_said(old)}, and this sweep {_said(new)}"
    return None


def _said(value: object) -> str:
    return ", ".join(map(str, value)) if isinstance(value, list) else str(value)


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


def check_names(scene: Scene, grid: Grid) -> None:
    """Refuse results whose names break the rule, or are an axis's or its dimension's.

    **Raises:** `ValueError`.
    """
    taken = set(scene.variables)
    for name, variable in scene.variables.items():
        check_name("Result", name)
        taken |= set(variable.dims)
    for name in [*grid.names, *grid.dims]:
        if name in taken:
            raise ValueError(
                f"Axis `{name}` must be named unlike a result or its dimensions, which "
                f"are {', '.join(sorted(taken))}."
            )


def template(grid: Grid, scene: Scene) -> xr.Dataset:
    """The dataset with nothing computed."""
    data, coords = {}, {}
    for name, variable in scene.variables.items():
        dims, values = grid.dims + variable.dims, empty(variable, grid.shape)
        data[name] = dims, values, labels(variable)
        known = [dim for dim in variable.dims if dim in scene.coordinates]
        coords |= {dim: coordinate(dim, scene.coordinates[dim]) for dim in known}
    ds = xr.Dataset(data, coords, provenance(scene, grid.points))
    return ds.assign_coords(grid.axes.coords)


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
