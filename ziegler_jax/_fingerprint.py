"""What a sweep is, in a few strings: to tell whether a store belongs to it.

The scene is known by a hash of its lowered program (StableHLO). That sees globals,
helpers and table values, which source code hides, and is the same in every process. It
does not see what a host callback does, and it changes with the version of JAX.
"""

import hashlib
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from importlib import metadata
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ._blocks import Blocks
from ._cpu import compiles_whole_loops
from ._interrupt import held_interrupts
from ._scene import budgets_apart
from ._variables import named_variables

BUDGETS = ("max_windows", "max_steps")
_PACKAGES = ("ziegler_jax", "jax", "jaxlib")


@held_interrupts()
def scene_hash(
    point: Callable[..., Any],
    names: tuple[str, ...],
    wide: bool,
    apart_from_budgets: bool = False,
) -> str:
    """The hash of the program of one point."""

    def numbers(values):
        variables = named_variables(point(**dict(zip(names, values, strict=True))))
        return {name: jnp.asarray(v.value) for name, v in variables.items()}

    scalar = jax.ShapeDtypeStruct((), np.float64 if wide else np.float32)
    with jax.enable_x64(wide), budgets_apart() if apart_from_budgets else nullcontext():
        program = jax.jit(numbers).lower([scalar] * len(names)).as_text()
    return hashlib.sha256(program.encode()).hexdigest()


def fingerprint(
    point: Callable[..., Any],
    blocks: Blocks,
    *,
    scene: str,
    settings: Mapping[str, Any],
    batch_size: int,
    wide: bool,
) -> dict[str, Any]:
    """Everything that a sweep's results depend on, the kind of processor apart."""
    names = tuple(blocks.grid)
    return {
        **{name: metadata.version(name) for name in _PACKAGES},
        "axes": {
            name: [values.size, float(values[0]), float(values[-1]), _hash(values)]
            for name, values in blocks.grid.items()
        },
        "where": blocks.digest,
        "block": list(blocks.chunk),
        "precision": "float64" if wide else "float32",
        "settings": dict(settings),
        "batch_size": batch_size,
        "loops": "whole" if compiles_whole_loops() else "in parts",
        "scene": scene,
        "scene apart from budgets": scene_hash(point, names, wide, True),
    }


def difference(there: Mapping[str, Any], here: Mapping[str, Any]) -> str | None:
    """The first difference of two fingerprints as a part of a sentence, or None."""
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
    if there["scene"] != here["scene"]:
        return "is of another scene: its program is not that of this `point`"
    return None


def only_budgets_grew(there: Mapping[str, Any], here: Mapping[str, Any]) -> str | None:
    """None if these are one sweep with larger budgets, else the difference."""
    old, new = dict(there["settings"]), dict(here["settings"])
    for name in BUDGETS:
        if name in old and name in new:
            if new[name] < old[name]:
                return (
                    f"has {name} {old[name]}, which must not shrink, but is "
                    f"{new[name]} in this sweep"
                )
            new[name] = old[name]
    apart = here["scene apart from budgets"]
    same = there["scene apart from budgets"] == apart
    scene = there["scene"] if same else here["scene"]
    return difference(there, {**here, "settings": new, "scene": scene})


def _hash(values: np.ndarray) -> str:
    return hashlib.sha256(np.ascontiguousarray(values, "<f8").tobytes()).hexdigest()
