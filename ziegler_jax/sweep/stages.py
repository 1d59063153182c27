"""A point's program, cut at its resumable loops into stages.

Between loops a point computes straight on: a segment. A point with K loops of one phase
has 2 K + 1 stages: segment, loop, segment, ..., loop, segment. A lane goes through them
in order, between the phases of a loop to and fro, and what it takes along from one to
the next is a row of numbers: at a loop its state, and besides what the loop or a later
stage reads. What depends on no value of the lane is not taken along but computed in
each stage that reads it, at each of its calls: of tables, which are arguments of every
stage, and of constants.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple, cast

import jax
import jax.core
import jax.numpy as jnp
from jax import lax
from jax.core import eval_jaxpr
from jax.extend.core import Jaxpr, Var

from ..numerics.jaxprs import ClosedJaxpr, JaxprEqn, Literal
from ..numerics.materialise import materialise
from ..numerics.numbers import Count
from ..numerics.resumable import (
    Body,
    constants_of,
    resumable_loop,
    steps_of_turn,
    turns,
)
from ..runtime import compiles_whole_loops
from .packing import Packing, Run, some_number


class Stage(NamedTuple):
    """A part of a point as a function of a batch of lanes, which stand behind.

    A segment maps (tables, fixed, state) to the next stage's (fixed, state), the last
    one to the results; a loop's phase maps (tables, max_steps, fixed, state) to the
    state and an array of two rows, phases and steps. `max_steps` is a number, `tables`
    a tuple of arrays that all lanes share, all others are tuples of packed arrays.
    """

    function: Callable[..., tuple]
    fixed: Packing
    state: Packing
    equations: tuple  # what the function consists of, for its digest
    # of a loop the stages of its phases, and behind them where lanes go that have ended
    ways: tuple[int, ...] = ()
    cost: float = 1.0  # about that of a step against one of a motion alone
    lanes: int = 1  # how many it takes at a time

    @property
    def is_loop(self) -> bool:
        """Whether lanes stay in it for many calls."""
        return bool(self.ways)


Layouts = tuple[Packing, Packing]  # of what a stage only reads, and of its state


def needed(whole: ClosedJaxpr) -> ClosedJaxpr:
    """The same function, without equations that nothing asks for."""
    jaxpr = whole.jaxpr
    equations = _needed(jaxpr.eqns, jaxpr.outvars)
    return ClosedJaxpr(jaxpr.replace(eqns=equations), whole.consts)


def stages(whole: ClosedJaxpr, tables: int = 0) -> list[Stage]:
    """The stages of a traced point, each with the layout of what goes into it.

    **Arguments:** `whole`: what nothing asks for is left out already; `tables`: how
    many of its inputs, the first ones, are no values of a lane.
    """
    jaxpr = whole.jaxpr
    shared, fixed = list(jaxpr.invars[:tables]), list(jaxpr.invars[tables:])
    varies, parts, begin = _varying(jaxpr, fixed), [], 0
    state: list[Var] = []

    def free(place):
        return [e for e in jaxpr.eqns[:place] if _free(e, varies)]

    def segment(end, after, begun):
        own = [*free(begin), *jaxpr.eqns[begin:end]]
        inputs = [*shared, *fixed, *state]
        function = _function(whole, own, inputs, [*after, *begun])
        return function, (Packing(_avals(fixed)), Packing(_avals(state)))

    for cut, loop in enumerate(jaxpr.eqns):
        if loop.primitive is not resumable_loop:
            continue
        bodies = loop.params["bodies"]
        constants, begun = constants_of(bodies, loop.invars)
        of_bodies = [v for body in constants for mine in body for v in mine]
        read = [*_variables(of_bodies), *_read_behind(jaxpr, cut)]
        after = list(dict.fromkeys(v for v in read if v in varies))
        function, layouts = segment(cut, after, begun)
        results = Packing(_avals(after)), Packing(_avals(begun))
        parts.append(_between(function, layouts, results))
        ways = tuple(len(parts) + i for i in range(len(bodies) + 1))
        for body, of_parts in zip(bodies, constants, strict=True):
            traced = []
            for part, mine in zip(body.parts, of_parts, strict=True):
                numbers = _function(whole, free(cut), [*shared, *after], mine)
                moves = tuple(isinstance(v, Var) and v in varies for v in mine)
                traced.append(_Part(part, results[1], numbers, moves))
            if body.every is not None and _decides_one_by_one():
                function = _with_stops(traced, body.every, results)
            else:
                function = _loop(traced, body, results)
            about = [(x.jaxpr, x.numbers.closed, x.moves) for x in traced], body.every
            parts.append(Stage(function, *results, about, ways, body.cost))
        fixed, state, begin = after, list(loop.outvars), cut + 1
    function, layouts = segment(len(jaxpr.eqns), [], jaxpr.outvars)
    results = Packing(_avals(jaxpr.outvars))
    return [*parts, _last(function, layouts, results)]


def _between(function: "_Equations", layouts: Layouts, results: Layouts) -> Stage:
    fixed, state = layouts

    def segment(tables, packed, begun):
        leaves = *fixed.unpack(packed), *state.unpack(begun)
        leaves = of_lanes(partial(function, *tables))(*leaves)
        count = len(results[0].shapes)
        return results[0].pack(leaves[:count]), results[1].pack(leaves[count:])

    return Stage(segment, fixed, state, (function.closed, len(results[0].shapes)))


def _last(function: "_Equations", layouts: Layouts, results: Packing) -> Stage:
    fixed, state = layouts

    def segment(tables, packed, begun):
        leaves = *fixed.unpack(packed), *state.unpack(begun)
        return results.pack(of_lanes(partial(function, *tables))(*leaves))

    return Stage(segment, fixed, state, (function.closed, "results"))


class _Part(NamedTuple):
    """A part of a loop's body, as a function of some steps and the state.

    What it does not read is not unpacked for it.
    """

    jaxpr: Jaxpr
    state: Packing
    numbers: "_Equations"  # that it only reads, of tables and what is taken along
    moves: tuple[bool, ...]  # which of them belong to the lane

    def of_batch(self, values: list, rows: Sequence) -> list:
        """The result for all lanes, which are the last axis."""
        leaves = self._leaves(rows, self.jaxpr.outvars)
        return self._of_lanes(values, leaves, rows[0].shape[-1], 0)

    def changes(self, values: list, rows: Sequence, max_steps: Count) -> list:
        """The leaves that it changes in all lanes, None for the others."""
        leaves = self._leaves(rows, self._new(self.jaxpr.outvars))
        return self._new(self._of_lanes(values, leaves, rows[0].shape[-1], max_steps))

    def changes_of_lane(self, values: list, rows: Sequence, lane: jax.Array) -> list:
        """The same in one lane of a batch."""
        pairs = zip(self.numbers(*values), self.moves, strict=True)
        numbers = [_of_lane(x, lane) if moves else x for x, moves in pairs]
        results = self._new(self.jaxpr.outvars)
        runs = self.state.runs(self._read_for(results))

        def column():  # before any of it is overwritten
            return [_of_lane(rows[which][run], lane) for which, run in runs]

        number = some_number(rows)
        parts = column() if number is None else materialise(number, column)
        leaves = self._leaves(parts, results, runs)
        after = eval_jaxpr(self.jaxpr, numbers, jnp.int32(0), *leaves)
        # what is known now is Python's own
        return [None if x is None else jnp.asarray(x) for x in self._new(after)]

    def _of_lanes(
        self, values: list, leaves: list, count: int, max_steps: Count
    ) -> list:
        def of_a_lane(numbers, leaves):
            return eval_jaxpr(self.jaxpr, numbers, jnp.int32(max_steps), *leaves)

        axes = [-1 if moves else None for moves in self.moves]
        lanes = jax.vmap(of_a_lane, (axes, -1), -1, axis_size=count)
        return lanes(self.numbers(*values), leaves)

    def _leaves(self, rows: Sequence, results: list, runs: Sequence[Run] = ()) -> list:
        """The leaves that results are made of, None for the others."""
        read, leaf = self._read_for(results), self.state.leaf
        places = range(len(self.state.shapes))
        return [leaf(rows, i, runs) if i in read else None for i in places]

    def _read_for(self, results: list) -> list[int]:
        """The places of the leaves that results are made of."""
        read = _read_by(self.jaxpr.eqns, [v for v in results if v is not None])
        return [i for i, v in enumerate(self.jaxpr.invars[1:]) if v in read]

    def _new(self, results: list) -> list:
        """The outputs that it computes, None for those that it hands through."""
        pairs = zip(self.jaxpr.outvars, self.jaxpr.invars[1:], results, strict=True)
        return [None if new is old else result for new, old, result in pairs]


def _of_lane(array: jax.Array, lane: jax.Array) -> jax.Array:
    return lax.dynamic_index_in_dim(array, lane, -1, keepdims=False)


def _decides_one_by_one() -> bool:
    """Single numbers are only fast where they are parts of one kernel."""
    return jax.default_backend() == "cpu" and compiles_whole_loops()


def _loop(parts: Sequence[_Part], body: Body, layouts: Layouts):
    fixed, state = layouts
    axes = [[-1 if moves else None for moves in part.moves] for part in parts]

    def loop(tables, max_steps, packed, begun):
        values = [*tables, *fixed.unpack(packed)]

        def of_a_lane(numbers, leaves):
            return body.advance(numbers, leaves, jnp.asarray(max_steps, jnp.int32))

        lanes = jax.vmap(of_a_lane, (axes, -1), -1)
        numbers = [part.numbers(*values) for part in parts]
        leaves, status = lanes(numbers, state.unpack(begun))
        return state.pack(leaves), jnp.stack(status)

    return loop


def _with_stops(parts: Sequence[_Part], every: int, layouts):
    """A phase in which lanes are decided on their way, one by one.

    Few are at a time, and of many numbers: for all lanes at once each of these would be
    a loop, and half of what has to be compiled. One lane's are a column of the state.
    """
    fixed, state = layouts
    advance, *decisions, status = parts
    decisions = list(zip(decisions[::2], decisions[1::2], strict=True))

    def loop(tables, max_steps, packed, begun):
        values = [*tables, *fixed.unpack(packed)]

        def turn(number, rows):
            changes = advance.changes(values, rows, steps_of_turn(number, every))
            rows = state.put(rows, changes)
            for asks, decide in decisions:
                (asked,) = asks.of_batch(values, rows)
                rows = one_by_one(asked, decide, rows)
            return rows

        def one_by_one(asked, decide, rows):
            def passed(lane):
                return (lane < len(asked)) & ~_of_lane(asked, lane)

            def following(lane):  # number by number: most of them are near
                return lax.while_loop(passed, lambda lane: lane + 1, lane + 1)

            def with_decision(now):
                lane, rows = now
                changes = decide.changes_of_lane(values, rows, lane)
                return following(lane), state.put(rows, changes, lane)

            def asks_on(now):
                return now[0] < len(asked)

            first = following(jnp.int32(-1)), rows
            return lax.while_loop(asks_on, with_decision, first)[1]

        rows = lax.fori_loop(0, turns(max_steps, every), turn, begun)
        return rows, jnp.stack(status.of_batch(values, rows))

    return loop


def of_lanes(function: Callable) -> Callable:
    """A function of a lane's leaves as one of a batch's."""
    return jax.vmap(function, in_axes=-1, out_axes=-1)


class _Equations(NamedTuple):
    """A function that is known by its equations."""

    closed: ClosedJaxpr

    def __call__(self, *inputs) -> list:
        """The results of the equations."""
        return eval_jaxpr(self.closed.jaxpr, self.closed.consts, *inputs)


def _function(whole, equations, inputs, outputs) -> _Equations:
    """The outputs as a function of the inputs, by those equations that they need."""
    equations = _needed(equations, outputs)
    read = _read_by(equations, outputs)
    pairs = zip(whole.jaxpr.constvars, whole.consts, strict=True)
    constants = [(v, value) for v, value in pairs if v in read]
    jaxpr = whole.jaxpr.replace(
        constvars=[v for v, _ in constants],
        invars=inputs,
        outvars=outputs,
        eqns=equations,
        debug_info=whole.jaxpr.debug_info.with_unknown_names(),
    )
    return _Equations(ClosedJaxpr(jaxpr, [value for _, value in constants]))


def _read_by(equations: list[JaxprEqn], outputs: list) -> set[Var]:
    """The variables that they read, and the outputs."""
    return {v for e in equations for v in _variables(e.invars)} | {*_variables(outputs)}


def _needed(equations: list[JaxprEqn], outputs: list) -> list[JaxprEqn]:
    """The equations that the outputs need, in their order."""
    read, needed = set(_variables(outputs)), []
    for equation in reversed(equations):
        if _any_of(equation.outvars, read) or equation.effects:
            needed.append(equation)
            read.update(_variables(equation.invars))
    return needed[::-1]


def _varying(jaxpr: Jaxpr, of_lane: Sequence[Var]) -> set[Var]:
    """The variables that depend on the lane; of a loop all, it ends lane by lane."""
    varies = set(of_lane)
    for equation in jaxpr.eqns:
        read = _variables(equation.invars)
        if equation.primitive is resumable_loop or _any_of(read, varies):
            varies.update(equation.outvars)
    return varies


def _read_behind(jaxpr: Jaxpr, cut: int) -> list[Var]:
    """The variables that are computed before an equation and read after it."""
    behind = [*(v for e in jaxpr.eqns[cut + 1 :] for v in e.invars), *jaxpr.outvars]
    new = {v for e in jaxpr.eqns[cut:] for v in e.outvars}
    return [v for v in _variables(behind) if v not in new]


def _variables(operands) -> list[Var]:
    return [v for v in operands if not isinstance(v, Literal)]


def _free(equation: JaxprEqn, varies: set[Var]) -> bool:
    """Whether it varies with no lane, and does nothing beside."""
    return not equation.effects and not _any_of(equation.outvars, varies)


def _any_of(variables, among) -> bool:
    return any(v in among for v in variables)


def _avals(variables) -> list[jax.core.ShapedArray]:
    return cast(list[jax.core.ShapedArray], [v.aval for v in variables])
