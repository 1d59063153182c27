"""What a sweep sets over the scenes that it traces.

A `point` names its own tolerances. To rerun it at others, a sweep traces it within a
`Context`, which `settle` and `trajectory` obey. It is a context of JAX's own, so that
it is a part of every compilation cache's key; it is local to a thread.
"""

import itertools
import threading
from typing import Any, NamedTuple

import jax
from jax.extend.core import get_opaque_trace_state


class Context(NamedTuple):
    """What to set; hashable.

    `tolerance` replaces rtol, and atol follows in the scene's own ratio; `factor`
    multiplies both; `solver` replaces the solver, where it is not None. `narrow` lets
    plain functions compute in 32 bits, as a sweep of that precision asks. `trace` is a
    number of its own for each sweep: what JAX or diffrax traced for an earlier one is
    not asked, as it may have read an attribute that has changed since.
    """

    tolerance: float | None = None
    factor: float = 1.0
    solver: Any = None
    narrow: bool = False
    trace: int = 0


_CONTEXT = jax.make_user_context(default_value=Context())
_TRACES = itertools.count(1)


def within(context: Context) -> Any:
    """A context manager in which scenes that are traced obey `context`."""
    return _CONTEXT(context)


def current_context() -> Context:
    """What this thread's scenes obey."""
    return _CONTEXT.value


def of_its_own(narrow: bool) -> Context:
    """This thread's context, with a trace that no cache has seen."""
    return current_context()._replace(narrow=narrow, trace=next(_TRACES))


def overridden_tolerances(rtol: Any, atol: Any) -> tuple[Any, Any]:
    """The tolerances to use instead of the scene's own."""
    context = current_context()
    if context.tolerance is not None:
        atol = atol * (context.tolerance / rtol)
        rtol = 0.0 * rtol + context.tolerance  # keeps the kind of number it was
    return rtol * context.factor, atol * context.factor


def overridden_solver(solver: Any) -> Any:
    """The solver to use instead of the scene's own."""
    chosen = current_context().solver
    return solver if chosen is None else chosen


def is_traced() -> bool:
    """Whether JAX is tracing here: within `jit`, `vmap`, a derivative, a sweep."""
    clean: list[Any] = []  # a new thread traces nothing
    thread = threading.Thread(target=lambda: clean.append(get_opaque_trace_state()))
    thread.start()
    thread.join()
    return get_opaque_trace_state() != clean[0]
