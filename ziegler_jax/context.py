"""What a sweep sets over the scenes that it traces, and no signature shows.

- A `point` names its own tolerances. To rerun it at others, a sweep traces it within a
    `Context`, which `settle` and `trajectory` obey. It is a context of JAX's own, so
    that it is a part of every compilation cache's key; it is local to a thread.
- A vmapped loop runs until its slowest lane ends. A sweep therefore lets every lane run
    a leg, replaces those that have ended by new ones, and runs the next leg, as a
    hand-written kernel refills its lanes. A motion offers its state at the end of a leg
    to `Legs` and takes it back at the next; the arithmetic is that of one uninterrupted
    run. Outside a sweep there are no legs.
- JAX computes in 32 bits unless it is told otherwise, and most numbers here would be
    wrong in them without a word. A `plain` function therefore refuses a 32-bit session;
    a sweep that was asked for 32 bits says so in its `Context`.
"""

import itertools
import threading
from collections.abc import Callable
from contextlib import contextmanager
from contextvars import ContextVar
from functools import wraps
from typing import Any, NamedTuple, ParamSpec, TypeVar

import jax
import jax.numpy as jnp
from jax.extend.core import get_opaque_trace_state

from .runtime import own_flags


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


class Legs:
    """What passes between a sweep and the one computation that runs in legs.

    **Arguments:** `quota`: the most steps of a leg; `fresh`: whether the lane starts;
    `carry`: where it goes on if it does not, None to find out what is carried.
    """

    def __init__(self, quota: Any, fresh: Any, carry: Any):
        """Nothing has asked for legs yet."""
        self.quota, self.fresh, self.carry = quota, fresh, carry
        self.trace = get_opaque_trace_state()
        self.left: Any = None  # the leaves to go on from
        self.running: Any = None  # whether the lane must go on
        self.steps: Any = None  # how many it has taken
        self.calls = 0
        self.refused = False  # whether one asked that cannot run in legs

    def enter(self, start: Any) -> Any:
        """Where this leg begins: at the start or where the last one ended."""
        self.calls += 1
        if self.carry is None:
            return start
        leaves, tree = jax.tree.flatten(start)
        kept = zip(leaves, self.carry, strict=True)
        return tree.unflatten([jnp.where(self.fresh, new, old) for new, old in kept])

    def leave(self, carry: Any, running: Any, steps: Any) -> None:
        """Keep where this leg ended."""
        self.left = jax.tree.leaves(carry)
        self.running, self.steps = running, steps


_CURRENT: ContextVar[Legs | None] = ContextVar("legs", default=None)


def current_legs() -> Legs | None:
    """The legs that a sweep has set, if any.

    None, too, inside a transformation of the scene's own (`vmap`, `jvp`, `jit`): its
    numbers cannot be handed from there to the next leg.
    """
    legs = _CURRENT.get()
    if legs is None:
        return None
    if legs.trace != get_opaque_trace_state():
        legs.refused = True
        return None
    return legs


@contextmanager
def in_legs(legs: Legs):
    """Trace a scene with these legs."""
    token = _CURRENT.set(legs)
    try:
        yield legs
    finally:
        _CURRENT.reset(token)


Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def plain(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """A public function that computes: in 64 bits, and whatever is being debugged."""
    name = getattr(function, "__name__", "this")

    @wraps(function)
    def computed(*args: Arguments.args, **options: Arguments.kwargs) -> Result:
        if jnp.result_type(float) != jnp.float64 and not current_context().narrow:
            raise ValueError(
                f"`{name}` must compute in 64-bit arithmetic, but JAX is set to 32 "
                'bits; type `jax.config.update("jax_enable_x64", True)` before it, '
                "or use `sweep`."
            )
        with own_flags():
            return function(*args, **options)

    return computed
