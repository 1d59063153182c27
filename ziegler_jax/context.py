"""What a sweep sets over the scenes that it traces, and no signature shows.

- A `point` names its own tolerances. To rerun it at others, a sweep traces it within a
    `Context`, which `settle` and `trajectory` obey. It is a context of JAX's own, so
    that it is a part of every compilation cache's key; it is local to a thread.
- JAX computes in 32 bits unless it is told otherwise, and most numbers here would be
    wrong in them without a word. A `plain` function therefore refuses a 32-bit session,
    and a sweep computes in 64 bits whatever JAX is set to.
"""

import itertools
from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import wraps
from typing import NamedTuple, ParamSpec, TypeVar, cast

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .runtime import own_flags, refuse_forked


class Context(NamedTuple):
    """What to set; hashable.

    `tolerance` replaces rtol, and atol follows in the scene's own ratio; `factor`
    multiplies both; `solver` replaces the solver, where it is not None. `trace` is a
    number of its own for each sweep: what JAX or diffrax traced for an earlier one is
    not asked, as it may have read an attribute that has changed since.
    """

    tolerance: float | None = None
    factor: float = 1.0
    solver: eqx.Module | None = None
    trace: int = 0


Solver = TypeVar("Solver")
Tolerance = Float[Array, ""] | float
_CONTEXT = jax.make_user_context(default_value=Context())
_TRACES = itertools.count(1)


def within(context: Context) -> AbstractContextManager[None]:
    """A context manager in which scenes that are traced obey `context`."""
    return _CONTEXT(context)


def current_context() -> Context:
    """What this thread's scenes obey."""
    return _CONTEXT.value


def of_its_own() -> Context:
    """This thread's context, with a trace that no cache has seen."""
    return current_context()._replace(trace=next(_TRACES))


def overridden_tolerances(
    rtol: Tolerance, atol: Tolerance
) -> tuple[Tolerance, Tolerance]:
    """The tolerances to use instead of the scene's own."""
    context = current_context()
    if context.tolerance is not None:
        atol = atol * (context.tolerance / rtol)
        rtol = 0.0 * rtol + context.tolerance  # keeps the kind of number it was
    return rtol * context.factor, atol * context.factor


def overridden_solver(solver: Solver) -> Solver:
    """The solver to use instead of the scene's own."""
    chosen = current_context().solver
    return solver if chosen is None else cast(Solver, chosen)


Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def plain(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """A public function that computes: in 64 bits, and whatever is being debugged."""
    name = getattr(function, "__name__", "this")

    @wraps(function)
    def computed(*args: Arguments.args, **options: Arguments.kwargs) -> Result:
        refuse_forked()
        if jnp.result_type(float) != jnp.float64:
            raise ValueError(
                f"`{name}` must compute in 64-bit arithmetic, but JAX is set to 32 "
                'bits; type `jax.config.update("jax_enable_x64", True)` before it, '
                "or use `sweep`."
            )
        with own_flags():
            return function(*args, **options)

    return computed
