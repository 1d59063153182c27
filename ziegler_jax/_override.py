"""Options that are set over a scene's own from outside, to ask how wrong it is.

A `point` names its own tolerances. To rerun it at others, a sweep traces it within an
`Override`, which `settle` and `trajectory` obey. It is a context of JAX's own, so that
it is a part of every compilation cache's key; it is local to a thread.
"""

from typing import Any, NamedTuple

import jax


class Override(NamedTuple):
    """What to set; hashable.

    `tolerance` replaces rtol, and atol follows in the scene's own ratio; `factor`
    multiplies both; `solver` replaces the solver, where it is not None.
    """

    tolerance: float | None = None
    factor: float = 1.0
    solver: Any = None


_CONTEXT = jax.make_user_context(default_value=Override())


def overriding(override: Override) -> Any:
    """A context in which scenes that are traced obey `override`."""
    return _CONTEXT(override)


def current_override() -> Override:
    """What this thread's scenes obey."""
    return _CONTEXT.value


def overridden_tolerances(rtol: Any, atol: Any) -> tuple[Any, Any]:
    """The tolerances to use instead of the scene's own."""
    override = current_override()
    if override.tolerance is not None:
        atol = atol * (override.tolerance / rtol)
        rtol = 0.0 * rtol + override.tolerance  # keeps the kind of number it was
    return rtol * override.factor, atol * override.factor


def overridden_solver(solver: Any) -> Any:
    """The solver to use instead of the scene's own."""
    chosen = current_override().solver
    return solver if chosen is None else chosen
