"""Where a motion turned into NaN, for a user who looks for that with `jax_debug_nans`.

The package computes without that flag (`own_flags`). Where it was set and the motion
could not go on, the column's field is evaluated there once more, operation by operation
and with the flag: what it raises names the line of a law of the user's own.
"""

from collections.abc import Callable
from functools import wraps
from typing import Protocol, TypeVar, cast

import jax
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from ..model.chain_of_rods import AbstractChain
from ..model.state import PhasePoint, State
from ..results import CODE, AbstractMotionResult
from ..runtime import Arguments, own_flags, requires_x64
from .checks import float_state
from .integrate import Motion, follow
from .method import method_of, usual_method
from .observation import Watching
from .options import Method

Result = TypeVar("Result")


class Timed(Protocol):
    """A result at given times."""

    @property
    def ts(self) -> Float[Array, " n"]:
        """The times."""
        ...


LONG = 1e4  # a motion is followed once more for so long
# A step that meets NaN is made shorter until it vanishes in front of it.
BEYOND = (0.0, 1e-12, 1e-10, 1e-8, 1e-6, 1e-4, 1e-2)


def motion(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """A public function of a column's motion, whose NaN the user may look for."""
    computed = requires_x64(function)
    name = getattr(function, "__name__", "this")

    @wraps(function)
    def watched(*args: Arguments.args, **options: Arguments.kwargs) -> Result:
        result = computed(*args, **options)
        if jax.config.jax_debug_nans:  # pyright: ignore[reportAttributeAccessIssue]
            scene = (*args, *(options[k] for k in ("column", "start") if k in options))
            column, start = cast(AbstractChain, scene[0]), cast(State, scene[1])
            ended = cast(AbstractMotionResult[State], result)
            look_for_nan(name, column, start, ended)
        return result

    return watched


def look_for_nan(
    name: str, column: AbstractChain, start: State, result: AbstractMotionResult[State]
) -> None:
    """Raise where the motion ended because it, or what comes next, is not finite.

    **Raises:** `FloatingPointError` from what the column's field raises there.
    """
    if any(isinstance(x, Tracer) for x in jax.tree.leaves((column, start, result))):
        return
    outcome = int(result.outcome)
    if outcome not in (CODE.not_finite, CODE.step_vanished):
        return
    t, y = _last(column, start, result)
    at = ", ".join(f"{x:.9g}" for x in y)
    rods = range(1, len(y) // 2 + 1)
    names = ", ".join(f"{kind}{i}" for kind in ("phi", "omega") for i in rods)
    sentence = (
        f"The motion in `{name}` is not a finite number at t = {t:.9g}, where "
        f"({names}) = ({at}), or just beyond."
    )
    cause = _raised(column, t, y)
    if cause is not None:
        raise FloatingPointError(sentence) from cause
    if outcome == CODE.not_finite:
        raise FloatingPointError(sentence)


def _last(
    column: AbstractChain, start: State, result: AbstractMotionResult[State]
) -> tuple[float, list[float]]:
    """The last time and state: the result's own, or found by following it once more."""
    if hasattr(result, "final"):
        return float(result.time), [float(x) for x in result.final.y]
    system = column.system()
    method = method_of("settle", Method(), system, usual_method(system))
    again = Motion(system, float_state(start), Watching(), method, end=LONG)
    with own_flags():
        run = follow(again)
    timed = cast(Timed, result)
    begun = float(np.asarray(timed.ts)[0]) if hasattr(result, "ts") else 0.0
    return begun + float(run.time), [float(x) for x in run.y]


def _raised(
    column: AbstractChain, t: float, y: list[float]
) -> FloatingPointError | None:
    """The error that the field raises at this state, or on the way on from it."""
    system, slope = column.system(), [0.0] * len(y)
    with jax.debug_nans(True), jax.disable_jit():
        for h in BEYOND:
            try:
                pairs = zip(y, slope, strict=True)
                now = system.field(t + h, PhasePoint(x + h * f for x, f in pairs))
            except FloatingPointError as error:
                return error
            slope = slope if h else [float(f) for f in now]
    return None
