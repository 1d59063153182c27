"""What a sweep is, in a few strings: to tell whether a store belongs to it.

The scene is known by a hash of its lowered program (StableHLO). That sees globals,
helpers, attributes and table values, which source code hides, and is the same in every
process. It does not see what a host callback does, and it changes with the version of
JAX.
"""

import hashlib
from collections.abc import Mapping
from importlib import metadata
from typing import Any

import numpy as np

from ._blocks import Blocks
from ._cpu import compiles_whole_loops
from ._program import Scene

_PACKAGES = ("ziegler_jax", "jax", "jaxlib")


def identity(scene: Scene, blocks: Blocks) -> dict[str, Any]:
    """Everything that a sweep's results depend on, the kind of processor apart."""
    return {
        **{name: metadata.version(name) for name in _PACKAGES},
        "axes": {
            name: [values.size, float(values[0]), float(values[-1]), digest_of(values)]
            for name, values in blocks.grid.items()
        },
        "where": blocks.digest,
        "block": list(blocks.chunk),
        "precision": "float64" if scene.wide else "float32",
        "settings": dict(scene.attributes),
        "batch_size": scene.batch_size,
        "loops": "whole" if compiles_whole_loops() else "in parts",
        "results": {
            name: [v.value.dtype.name, *v.dims] for name, v in scene.variables.items()
        },
        "scene": scene.digest,
    }


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
    for name in ("block", "precision", "batch_size"):
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
    if there["scene"] != here["scene"]:
        return "is of another scene: its program is not that of this `point`"
    return None


def digest_of(values: np.ndarray) -> str:
    """A hash of an axis, to the last bit."""
    return hashlib.sha256(np.ascontiguousarray(values, "<f8").tobytes()).hexdigest()
