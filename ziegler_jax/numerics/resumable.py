"""A loop that can be paused, between any two of its steps.

A vmapped loop runs until its slowest lane ends. A sweep therefore lets every lane run
a chunk of steps, replaces those that have ended by new ones, and runs the next chunk,
as a hand-written kernel refills its lanes. To JAX a loop that a motion runs is one
primitive, `resumable_loop`: where a sweep finds it in a point's equations it cuts the
point there (`sweep/stages.py`); anywhere else it runs to its end. The arithmetic is the
same.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache, partial
from typing import Any, Generic, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import AbstractValue, eval_jaxpr
from jax.extend.core import Jaxpr, Primitive
from jax.interpreters import ad, batching, mlir, partial_eval
from jaxtyping import Array, Bool, Int, Shaped

from .jaxprs import ClosedJaxpr, JaxprEqn, Literal
from .materialise import if_any_lane, replaced

State = TypeVar("State")
ENDED = -1
WITHOUT_PAUSE = 2**30  # steps: more than any motion takes


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


def phase_of(stop: Stop[State], cost: float = 1.0) -> Phase[State]:
    """The phase in which lanes are decided on their way, those of a batch together."""

    def after(decision: Decision[State], lane: State) -> State:
        asked = decision.asks(lane)
        return if_any_lane(
            asked, lambda lane: replaced(asked, decision.decide(lane), lane), lane
        )

    def turn(number: Int[Array, ""], lane: State) -> State:
        lane = stop.steps(lane, steps_of_turn(number, stop.every))
        for decision in stop.decisions:
            lane = after(decision, lane)
        return lane

    def advance(lane: State, max_steps: Int[Array, ""]) -> State:
        return lax.fori_loop(0, turns(max_steps, stop.every), turn, lane)

    return Phase(advance, cost, stop)


def turns(max_steps: Int[Array, ""], every: int) -> Int[Array, ""]:
    """How many times lanes are looked at: first they are as they came."""
    return (jnp.asarray(max_steps, jnp.int32) - 1) // every + 2


def steps_of_turn(number: Int[Array, ""], every: int) -> Int[Array, ""]:
    """How many steps are taken before: none for the first."""
    return jnp.where(number == 0, 0, every).astype(jnp.int32)


def resumable(
    state: State,
    phases: Sequence[Phase[State]],
    status: Callable[[State], tuple[Int[Array, ""], Int[Array, ""]]],
    chunk: int = WITHOUT_PAUSE,
) -> State:
    """The last state of a loop that a sweep may pause.

    **Arguments:**

    - `state`: the first one, a pytree of arrays; it is in the first phase.
    - `phases`: how it is advanced. A lane that is in another one must stay as it is.
    - `status`: the number of the phase that a state is in, or `ENDED`, and the steps
        so far.
    - `chunk`: how many steps of a phase are run at a time where no sweep pauses the
        loop; the default: one phase, which runs to its end.
    """
    leaves, tree = jax.tree.flatten(state)
    if not any(isinstance(x, partial_eval.DynamicJaxprTracer) for x in leaves):
        # no equations are written down: JAX keeps what it compiled of each part
        return _to_the_end(state, [p.advance for p in phases], status, chunk)
    leaves = [jnp.asarray(leaf, jnp.result_type(leaf)) for leaf in leaves]
    bodies, constants = [], []
    for phase in phases:
        closed = [
            jax.make_jaxpr(part)(np.int32(1), *leaves)
            for part in _parts(phase, status, tree)
        ]
        constants += [x for part in closed for x in part.consts]
        every = None if phase.stop is None else phase.stop.every
        bodies.append(Body(tuple(part.jaxpr for part in closed), phase.cost, every))
    if any(part.effects for body in bodies for part in body.parts):
        # a law that calls back, or checks: the primitive would hide that from JAX
        return _to_the_end(state, [p.advance for p in phases], status, chunk)
    last = resumable_loop.bind(*constants, *leaves, bodies=tuple(bodies), chunk=chunk)
    return tree.unflatten(last)


def _parts(phase: Phase, status: Callable, tree: Any) -> list[Callable[..., Sequence]]:
    """A phase as functions of a number of steps and the state's leaves."""

    def flat(function: Callable, max_steps: Array, *leaves: Array) -> list[Array]:
        after = function(tree.unflatten(leaves), max_steps)
        pairs = zip(jax.tree.leaves(after), leaves, strict=True)
        return [b if a is b else jnp.asarray(a, b.dtype) for a, b in pairs]

    def whole(*numbers: Array) -> list[Array]:
        after = flat(phase.advance, *numbers)
        return [*after, *status(tree.unflatten(after))]

    def says(function: Callable, _: Array, *leaves: Array) -> list:
        return jax.tree.leaves(function(tree.unflatten(leaves)))

    def decides(decide: Callable, *numbers: Array) -> list[Array]:
        return flat(lambda state, _: decide(state), *numbers)

    if phase.stop is None:
        return [whole]
    parts: list[Callable[..., Sequence]] = [partial(flat, phase.stop.steps)]
    for asks, decide in phase.stop.decisions:
        parts += [partial(says, asks), partial(decides, decide)]
    return [*parts, partial(says, status)]


def _to_the_end(
    state: State,
    advances: Sequence[Callable[[State, Int[Array, ""]], State]],
    status: Callable[[State], Sequence[Array]],
    chunk: int,
) -> State:
    def turn(state: State) -> State:
        for advance in advances:
            state = advance(state, jnp.asarray(chunk, jnp.int32))
        return state

    if chunk == WITHOUT_PAUSE:
        return turn(state)
    return lax.while_loop(lambda state: status(state)[0] != ENDED, turn, state)


# As a primitive -----------------------------------------------------------------------


class Body(NamedTuple):
    """A phase as it was traced.

    `parts`: one, the state after some steps and its status; of a phase whose lanes are
    decided one by one `steps`, `asks` and `decide` of each decision, and the status.
    Each takes a number of steps and the state, and its constants as `constvars`.
    """

    parts: tuple[Jaxpr, ...]
    cost: float
    every: int | None

    def advance(
        self, constants: Sequence[Sequence], leaves: Sequence, max_steps: Array
    ) -> tuple[list[Array], list[Array]]:
        """The leaves at most so many steps later, and their status."""
        parts = [
            partial(eval_jaxpr, jaxpr, numbers)
            for jaxpr, numbers in zip(self.parts, constants, strict=True)
        ]
        if self.every is None:
            *leaves, phase, steps = parts[0](max_steps, *leaves)
            return [*leaves], [phase, steps]
        none = jnp.asarray(0, jnp.int32)
        first, *decisions, status = parts
        pairs = zip(decisions[::2], decisions[1::2], strict=True)
        stop = Stop(
            lambda leaves, steps: first(steps, *leaves),
            [
                Decision(
                    lambda leaves, asks=asks: asks(none, *leaves)[0],
                    lambda leaves, decide=decide: decide(none, *leaves),
                )
                for asks, decide in pairs
            ],
            self.every,
        )
        after = phase_of(stop).advance([*leaves], max_steps)
        return after, status(none, *after)


def constants_of(
    bodies: Sequence[Body], operands: Sequence
) -> tuple[list[list[list]], list]:
    """What each part of each body only reads; and the state, which stands behind."""
    operands, constants = list(operands), []
    for body in bodies:
        mine = []
        for part in body.parts:
            count = len(part.constvars)
            mine.append(operands[:count])
            operands = operands[count:]
        constants.append(mine)
    return constants, operands


resumable_loop = Primitive("resumable_loop")
resumable_loop.multiple_results = True


def _whole(*operands: Array, bodies: tuple[Body, ...], chunk: int) -> list[Array]:
    """The loop to its end."""
    constants, leaves = constants_of(bodies, operands)

    def advance(body: Body, mine: list, now: tuple, max_steps: Array) -> tuple:
        leaves, status = body.advance(mine, now[0], max_steps)
        return leaves, status[0]

    advances = [
        partial(advance, body, mine)
        for body, mine in zip(bodies, constants, strict=True)
    ]
    begun = leaves, jnp.zeros((), jnp.int32)
    after, _ = _to_the_end(begun, advances, lambda now: now[1:], chunk)
    return after


@resumable_loop.def_abstract_eval
def _state_again(
    *operands: AbstractValue, bodies: tuple[Body, ...], chunk: int
) -> list[AbstractValue]:
    del operands, chunk
    return [v.aval for v in bodies[0].parts[0].invars[1:]]


def _batch(operands, dims, **params):
    run = jax.vmap(partial(_whole, **params), in_axes=tuple(dims))
    after = run(*operands)
    return after, [0] * len(after)


def _push_along(operands, tangents, **params):
    tangents = [ad.instantiate_zeros(x) for x in tangents]
    return jax.jvp(partial(_whole, **params), tuple(operands), tuple(tangents))


@lru_cache(maxsize=64)
def _compiled(bodies: tuple[Body, ...], chunk: int) -> Callable[..., list[Array]]:
    return jax.jit(partial(_whole, bodies=bodies, chunk=chunk))


resumable_loop.def_impl(lambda *a, **params: _compiled(**params)(*a))
mlir.register_lowering(resumable_loop, mlir.lower_fun(_whole, multiple_results=True))
batching.primitive_batchers[resumable_loop] = _batch
ad.primitive_jvps[resumable_loop] = _push_along

CALLS = {"jit", "pjit", "closed_call", "core_call", "checkpoint", "remat", "remat2"}
CALLS |= {"custom_jvp_call", "custom_vjp_call", "custom_vjp_call_jaxpr"}
INSIDE = ("jaxpr", "call_jaxpr", "fun_jaxpr")  # of a call


def inlined(closed: ClosedJaxpr) -> ClosedJaxpr:
    """The same function, without calls around its resumable loops."""
    if not any(_calls_a_loop(equation) for equation in closed.jaxpr.eqns):
        return closed
    run = partial(_inlined, closed.jaxpr, closed.consts)
    return jax.make_jaxpr(run)(*closed.in_avals)


def _calls_a_loop(equation: JaxprEqn) -> bool:
    if equation.primitive.name not in CALLS or equation.effects:
        return False  # what it does beside is done where it stands
    variables = [*equation.invars, *equation.outvars]
    variables += [v for e in equations_within(equation) for v in e.outvars]
    if any(jnp.issubdtype(v.aval.dtype, jax.dtypes.extended) for v in variables):
        return False  # a stage hands on numbers alone, no keys
    return any(e.primitive is resumable_loop for e in equations_within(equation))


def _inlined(jaxpr: Jaxpr, consts: Sequence, *inputs: Shaped[Array, "..."]) -> list:
    def without_call(equation: JaxprEqn, operands: Sequence) -> Sequence | None:
        if not _calls_a_loop(equation):
            return None
        part = next(equation.params[k] for k in INSIDE if k in equation.params)
        own = getattr(part, "consts", ())
        return _inlined(getattr(part, "jaxpr", part), own, *operands)

    return evaluated(jaxpr, consts, inputs, without_call)


def evaluated(
    jaxpr: Jaxpr,
    consts: Sequence,
    inputs: Sequence,
    instead: Callable[[JaxprEqn, Sequence], Sequence | None],
) -> list:
    """What equations give.

    **Arguments:** `instead`: what an equation gives for its operands, if not its own.
    """
    variables = [*jaxpr.constvars, *jaxpr.invars]
    values = dict(zip(variables, [*consts, *inputs], strict=True))

    def read(v):
        return v.val if isinstance(v, Literal) else values[v]

    unknown = jaxpr.debug_info.with_unknown_names()
    for equation in jaxpr.eqns:
        results = instead(equation, [read(v) for v in equation.invars])
        if results is None:
            mine = {v: values[v] for v in equation.invars if not isinstance(v, Literal)}
            alone = jaxpr.replace(
                constvars=[], invars=[*mine], outvars=equation.outvars,
                eqns=[equation], debug_info=unknown,
            )  # fmt: skip
            results = eval_jaxpr(alone, (), *mine.values())
        values |= dict(zip(equation.outvars, results, strict=True))
    return [read(v) for v in jaxpr.outvars]


def equations_within(equation: JaxprEqn) -> Iterator[JaxprEqn]:
    """The equations of its parts, and of theirs."""
    for part in parts_of(equation):
        for inner in getattr(part, "jaxpr", part).eqns:
            yield inner
            yield from equations_within(inner)


def parts_of(equation: JaxprEqn) -> list[ClosedJaxpr | Jaxpr]:
    """The equations within an equation, closed or not."""
    if equation.primitive is resumable_loop:
        return [part for body in equation.params["bodies"] for part in body.parts]
    values = equation.params.values()
    values = [x for v in values for x in (v if isinstance(v, tuple) else (v,))]
    return [x for x in values if isinstance(x, ClosedJaxpr | Jaxpr)]
