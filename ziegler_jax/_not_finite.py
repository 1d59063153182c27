"""Where a motion turned into NaN, for a user who looks for that with `jax_debug_nans`.

The package computes without that flag (`_debug`). Where it was set and the motion could
not go on, the column's field is evaluated there once more, operation by operation and
with the flag: what it raises names the line of a law of the user's own.
"""

from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar

import jax
import numpy as np
from jax.core import Tracer

from ._context import Arguments, plain
from ._scene import prepared
from .column import Column, vector_field
from .outcome import OUTCOME

Result = TypeVar("Result")
# A step that meets NaN is made shorter until it vanishes in front of it.
BEYOND = (0.0, 1e-12, 1e-10, 1e-8, 1e-6, 1e-4, 1e-2)


def motion(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """A plain function of a column's motion, whose NaN the user may look for."""
    computed = plain(function)
    name = getattr(function, "__name__", "this")

    @wraps(function)
    def watched(*args: Arguments.args, **options: Arguments.kwargs) -> Result:
        result = computed(*args, **options)
        if jax.config.jax_debug_nans:  # pyright: ignore[reportAttributeAccessIssue]
            look_for_nan(name, args[0] if args else options["column"], result)
        return result

    return watched


def look_for_nan(name: str, column: Any, result: Any) -> None:
    """Raise where the motion ended because it, or what comes next, is not finite.

    **Raises:** `FloatingPointError` from what the column's field raises there.
    """
    if any(isinstance(x, Tracer) for x in jax.tree.leaves((column, result))):
        return
    outcome = int(result.outcome)
    if outcome not in (OUTCOME.not_finite, OUTCOME.step_vanished):
        return
    t, y = _last(result)
    at = ", ".join(f"{x:.9g}" for x in y)
    sentence = (
        f"The motion in `{name}` is not a finite number at t = {t:.9g}, where "
        f"(phi1, phi2, omega1, omega2) = ({at}), or just beyond."
    )
    found = _raised(column, t, y)
    if found is not None:
        raise FloatingPointError(sentence) from found
    if outcome == OUTCOME.not_finite:
        raise FloatingPointError(sentence)


def _last(result: Any) -> tuple[float, list[float]]:
    """The last time and state that are known."""
    if hasattr(result, "final"):
        return float(result.time), [float(x) for x in result.final.y]
    rows = np.concatenate([result.phi, result.omega], axis=-1)
    known = np.flatnonzero(np.all(np.isfinite(rows), axis=-1))
    last = known[-1] if known.size else 0
    times = result.ts if hasattr(result, "ts") else result.times
    return float(times[last]), [float(x) for x in rows[last]]


def _raised(column: Column, t: float, y: list[float]) -> FloatingPointError | None:
    """What the field raises at this state, or on the way on from it."""
    whole, slope = prepared(column), [0.0] * 4
    with jax.debug_nans(True), jax.disable_jit():
        for h in BEYOND:
            try:
                ahead = tuple(x + h * f for x, f in zip(y, slope, strict=True))
                now = vector_field(t + h, ahead, whole)  # pyright: ignore
            except FloatingPointError as error:
                return error
            slope = slope if h else [float(f) for f in now]
    return None
