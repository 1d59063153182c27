"""What a sweep sets over the scenes that it traces, and no signature shows.

- A `point` names its own tolerances. To rerun it at others, a sweep traces it within a
    `Context`, which `settle` and `trajectory` obey. It is a context of JAX's own, so
    that it is a part of every compilation cache's key; it is local to a thread.
- A vmapped loop runs until its slowest lane ends. A sweep therefore lets every lane run
    a chunk of steps, replaces those that have ended by new ones, and runs the next
    chunk, as a hand-written kernel refills its lanes. A loop that a motion runs is
    `resumable`: a sweep cuts the point there (`sweep/stages.py`). The arithmetic is
    that of one uninterrupted run. Outside a sweep nothing is cut.
- JAX computes in 32 bits unless it is told otherwise, and most numbers here would be
    wrong in them without a word. A `plain` function therefore refuses a 32-bit session;
    a sweep that was asked for 32 bits says so in its `Context`.
"""

import itertools
import threading
from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar
from functools import partial, wraps
from typing import Generic, NamedTuple, ParamSpec, TypeVar, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import AbstractValue
from jax.extend.core import Jaxpr, Primitive, get_opaque_trace_state
from jaxtyping import Array, Bool, Float, Int, Shaped

from .own_values import own_values
from .runtime import compiles_whole_loops, own_flags, refuse_forked


class Context(NamedTuple):
    """What to set; hashable.

    `tolerance` replaces rtol, and atol follows in the scene's own ratio; `factor`
    multiplies both; `solver` replaces the solver, where it is not None. `narrow` lets
    plain functions compute in 32 bits, as a sweep of that precision asks. `trace` is a
    number of its own for each sweep: what JAX or diffrax traced for an earlier one is
    not asked, as it may have read an attribute that has changed since. A question that
    holds nothing of the user's own has a key of its values there.
    """

    tolerance: float | None = None
    factor: float = 1.0
    solver: eqx.Module | None = None
    narrow: bool = False
    trace: Hashable = 0


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


def of_its_own(narrow: bool) -> Context:
    """This thread's context, with a trace that no cache has seen."""
    return current_context()._replace(narrow=narrow, trace=next(_TRACES))


def as_traced_before(*scene: object) -> AbstractContextManager[None]:
    """A context manager: JAX keeps what it traced of this question in earlier sweeps.

    Only where the scene holds nothing of the user's own, which might have changed.
    """
    context = current_context()
    # outside of a sweep JAX remembers as it always does
    key = own_values((scene, context.solver)) if context.trace else None
    return nullcontext() if key is None else within(context._replace(trace=key))


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


def is_traced() -> bool:
    """Whether JAX is tracing here: within `jit`, `vmap`, a derivative, a sweep."""
    clean: list[object] = []  # a new thread traces nothing
    thread = threading.Thread(target=lambda: clean.append(get_opaque_trace_state()))
    thread.start()
    thread.join()
    return get_opaque_trace_state() != clean[0]


resumable_loop = Primitive("resumable_loop")
resumable_loop.multiple_results = True


@resumable_loop.def_abstract_eval
def _state_again(
    *operands: AbstractValue, bodies: "tuple[Body, ...]"
) -> list[AbstractValue]:
    return [v.aval for v in bodies[0].parts[0].invars[1:]]


class Cuts:
    """Leave to cut the point that is traced here at its resumable loops."""

    def __init__(self):
        """For this trace, and none within it."""
        self.trace = get_opaque_trace_state()
        self.motions = False  # whether the point follows motions at all
        self.refused = False  # and one of them whole


_CUTS: ContextVar[Cuts | None] = ContextVar("cuts", default=None)


@contextmanager
def may_cut(cuts: Cuts | None) -> Iterator[None]:
    """Trace a point that may be cut; None: what may not."""
    token = _CUTS.set(cuts)
    try:
        yield
    finally:
        _CUTS.reset(token)


State = TypeVar("State")
ENDED = -1


def place_of(running: Bool[Array, ""]) -> Int[Array, ""]:
    """The status of a loop of one phase."""
    return jnp.where(running, 0, ENDED).astype(jnp.int32)


class Decision(NamedTuple, Generic[State]):
    """What few lanes wait for: whether one does, and its state after that."""

    asks: Callable[[State], Bool[Array, ""]]
    decide: Callable[[State], State]


class Stop(NamedTuple, Generic[State]):
    """Where lanes are looked at on their way, and few of them decided.

    `steps`: the state at most so many steps later; `decisions`: one after the other,
    each for the lanes that ask for it when its turn has come; `every`: how many steps
    are taken before lanes are looked at.
    """

    steps: Callable[[State, Int[Array, ""]], State]
    decisions: Sequence[Decision[State]]
    every: int


class Phase(NamedTuple, Generic[State]):
    """One of the ways in which a loop goes on, a program of its own.

    `advance`: the state at most so many steps later; `cost`: about that of a step
    against one of a motion alone; `stop`: the same advance in its parts, with which a
    sweep decides lanes one by one, where XLA makes one kernel of the loop.
    """

    advance: Callable[[State, Int[Array, ""]], State]
    cost: float = 1.0
    stop: Stop[State] | None = None


def turns(max_steps: Int[Array, ""], every: int) -> Int[Array, ""]:
    """How many times lanes are looked at: first they are as they came."""
    return (jnp.asarray(max_steps, jnp.int32) - 1) // every + 2


def steps_of_turn(number: Int[Array, ""], every: int) -> Int[Array, ""]:
    """How many steps are taken before: none for the first."""
    return jnp.where(number == 0, 0, every).astype(jnp.int32)


class Body(NamedTuple):
    """A phase as it was traced.

    `parts`: one, the state after some steps and its status; of a phase whose lanes are
    decided one by one `steps`, `asks` and `decide` of each decision, and the status.
    Each takes a number of steps and the state. `whole`: what runs instead of several,
    where XLA makes many kernels of a loop; the digest of a scene is that of its parts.
    """

    parts: tuple[Jaxpr, ...]
    cost: float
    every: int | None
    whole: Jaxpr | None = None

    def traced(self) -> tuple[Jaxpr, ...]:
        """All that there is, in the order of the loop's operands."""
        return self.parts if self.whole is None else (*self.parts, self.whole)


def resumable(
    state: State,
    phases: Sequence[Phase[State]],
    status: Callable[[State], tuple[Int[Array, ""], Int[Array, ""]]],
) -> State | None:
    """The last state of a loop that a sweep runs in chunks.

    **Arguments:**

    - `state`: the first one, a pytree of arrays; it is in the first phase.
    - `phases`: how it is advanced. A lane that is in another one must stay as it is.
    - `status`: the number of the phase that a state is in, or `ENDED`, and the steps
        so far.

    **Returns:** the last state; None where no sweep may cut: outside of one, and inside
    a transformation of the point's own (`vmap`, `jvp`, `jit`), whose numbers do not
    outlast it. Then the caller has to run its loop.
    """
    cuts = _CUTS.get()
    if cuts is None:
        return None
    cuts.motions = True
    if cuts.trace != get_opaque_trace_state():
        cuts.refused = True
        return None
    leaves, tree = jax.tree.flatten(state)
    leaves = [jnp.asarray(leaf, jnp.result_type(leaf)) for leaf in leaves]

    def flat(
        function: Callable[[State, Int[Array, ""]], State],
        max_steps: Int[Array, ""],
        *leaves: Shaped[Array, "..."],
    ) -> list[Array]:
        after = function(tree.unflatten(leaves), max_steps)
        pairs = zip(jax.tree.leaves(after), leaves, strict=True)
        return [b if a is b else jnp.asarray(a, b.dtype) for a, b in pairs]

    def whole(phase: Phase[State], *numbers: Shaped[Array, "..."]) -> tuple:
        after = flat(phase.advance, *numbers)
        return *after, *status(tree.unflatten(after))

    def says(function: Callable[[State], object], _, *leaves: Array) -> list:
        return jax.tree.leaves(function(tree.unflatten(leaves)))

    def decides(decide: Callable[[State], State], *numbers: Array) -> list[Array]:
        return flat(lambda state, _: decide(state), *numbers)

    # single numbers are only fast where they are parts of one kernel
    one_by_one = jax.default_backend() == "cpu" and compiles_whole_loops()

    def parts(phase: Phase[State]) -> list[Callable[..., tuple | list]]:
        stop = phase.stop
        if stop is None:
            return [partial(whole, phase)]
        decisions: list[Callable[..., tuple | list]] = []
        for asks, decide in stop.decisions:
            decisions += [partial(says, asks), partial(decides, decide)]
        several = [partial(flat, stop.steps), *decisions, partial(says, status)]
        return several if one_by_one else [*several, partial(whole, phase)]

    with may_cut(None):  # a loop within is a part of this one
        closed = [
            [jax.make_jaxpr(part)(np.int32(1), *leaves) for part in parts(phase)]
            for phase in phases
        ]
    last = resumable_loop.bind(
        *(x for each in closed for part in each for x in part.consts),
        *leaves,
        bodies=tuple(
            _body(tuple(part.jaxpr for part in each), phase, one_by_one)
            for each, phase in zip(closed, phases, strict=True)
        ),
    )
    return tree.unflatten(last)


def _body(parts: tuple[Jaxpr, ...], phase: Phase[State], one_by_one: bool) -> Body:
    if phase.stop is None:
        return Body(parts, phase.cost, None)
    if one_by_one:
        return Body(parts, phase.cost, phase.stop.every)
    return Body(parts[:-1], phase.cost, phase.stop.every, parts[-1])


Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def plain(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """A public function that computes: in 64 bits, and whatever is being debugged."""
    name = getattr(function, "__name__", "this")

    @wraps(function)
    def computed(*args: Arguments.args, **options: Arguments.kwargs) -> Result:
        refuse_forked()
        if jnp.result_type(float) != jnp.float64 and not current_context().narrow:
            raise ValueError(
                f"`{name}` must compute in 64-bit arithmetic, but JAX is set to 32 "
                'bits; type `jax.config.update("jax_enable_x64", True)` before it, '
                "or use `sweep`."
            )
        with own_flags(), as_traced_before(args, options):
            return function(*args, **options)

    return computed
