"""A point's program, cut at its resumable loops into stages.

Between loops a point computes straight on: a segment. A point with K loops of one phase
has 2 K + 1 stages: segment, loop, segment, ..., loop, segment. A lane goes through them
in order, between the phases of a loop to and fro, and what it takes along from one to
the next is a row of numbers: at a loop its state, and besides what the loop or a later
stage reads. What depends on no value of the lane is not taken along but computed in
each stage that reads it, at each of its calls.
"""

from collections.abc import Callable, Iterable, Sequence
from itertools import groupby
from typing import NamedTuple, TypeVar, cast

import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from jax.extend.core import (
    ClosedJaxpr,  # pyright: ignore[reportPrivateImportUsage]
    Jaxpr,
    JaxprEqn,
    Literal,
    Var,
    jaxpr_as_fun,
)

from ..context import resumable_loop

Packed = TypeVar("Packed", jax.Array, np.ndarray)


class Packing:
    """Many small arrays a lane as one array: a call then has few arguments.

    Flags and whole numbers of up to 32 bits travel as float64, which holds them, where
    there is one; what is left stands in an array a dtype.
    """

    def __init__(self, shapes: Iterable[jax.ShapeDtypeStruct | jax.core.ShapedArray]):
        """Lay out leaves of these shapes and dtypes."""
        self.shapes = [(tuple(s.shape), np.dtype(s.dtype)) for s in shapes]
        wide = any(dtype == np.float64 for _, dtype in self.shapes)
        travels = [_held(dtype) if wide else dtype for _, dtype in self.shapes]
        self.dtypes = sorted(set(travels), key=str)
        self.places = [(0, slice(0))] * len(self.shapes)  # which array, and where in it
        self.used = [0] * len(self.dtypes)
        # those of a kind stand together
        self.order = sorted(
            range(len(self.shapes)), key=lambda i: (travels[i], str(self.shapes[i][1]))
        )
        for i in self.order:
            shape, which = self.shapes[i][0], self.dtypes.index(travels[i])
            first = self.used[which]
            self.used[which] += int(np.prod(shape))
            self.places[i] = which, slice(first, self.used[which])

    def pack(self, leaves: Sequence[jax.Array]) -> tuple[jax.Array, ...]:
        """The arrays of leaves that have their lanes behind.

        Rows of lanes are put one below the other: a vector for each lane would be
        gathered number by number. Those of a kind change it together.
        """
        parts: list[list[jax.Array]] = [[] for _ in self.dtypes]
        for _, alike in groupby(self.order, lambda i: self.shapes[i][1]):
            alike = list(alike)
            rows = [leaves[i].reshape(-1, leaves[i].shape[-1]) for i in alike]
            which = self.places[alike[0]][0]
            parts[which].append(jnp.concatenate(rows).astype(self.dtypes[which]))
        return tuple(map(jnp.concatenate, parts))

    def unpack(self, packed: Sequence[Packed]) -> list[Packed]:
        """The leaves again; lanes stand behind, and stay there."""
        pairs = zip(self.shapes, self.places, strict=True)
        return [
            packed[which][place].reshape(shape + packed[which].shape[1:]).astype(dtype)
            for (shape, dtype), (which, place) in pairs
        ]

    def empty(self, lanes: int) -> tuple[np.ndarray, ...]:
        """Zeros for so many lanes."""
        pairs = zip(self.used, self.dtypes, strict=True)
        return tuple(np.zeros((used, lanes), dtype) for used, dtype in pairs)


def _held(dtype: np.dtype) -> np.dtype:
    """float64 where it holds every number of a dtype, else that dtype."""
    fits = dtype.itemsize <= 4 and np.can_cast(dtype, np.float64)
    return np.dtype(np.float64) if fits else dtype


class Stage(NamedTuple):
    """A part of a point as a function of a batch of lanes, which stand behind.

    A segment maps (fixed, state) to the next stage's (fixed, state), the last one to
    the results; a loop's phase maps (max_steps, fixed, state) to the state and an array
    of two rows, phases and steps. `max_steps` is a number, all others are tuples of
    packed arrays.
    """

    function: Callable[..., tuple]
    fixed: Packing
    state: Packing
    # of a loop the stages of its phases, and behind them where lanes go that have ended
    ways: tuple[int, ...] = ()
    cost: float = 1.0  # about that of a step against one of a motion alone
    lanes: int = 1  # how many it takes at a time

    @property
    def is_loop(self) -> bool:
        """Whether lanes stay in it for many calls."""
        return bool(self.ways)


def stages(whole: ClosedJaxpr) -> list[Stage]:
    """The stages of a traced point, each with the layout of what goes into it."""
    jaxpr = whole.jaxpr.replace(eqns=_needed(whole.jaxpr.eqns, whole.jaxpr.outvars))
    varies, parts, begin = _varying(jaxpr), [], 0
    fixed, state = list(jaxpr.invars), []

    def free(place):
        return [e for e in jaxpr.eqns[:place] if _free(e, varies)]

    def segment(end, after, begun):
        own = [*free(begin), *jaxpr.eqns[begin:end]]
        function = _function(whole, own, [*fixed, *state], [*after, *begun])
        return function, (Packing(_avals(fixed)), Packing(_avals(state)))

    for cut, loop in enumerate(jaxpr.eqns):
        if loop.primitive is not resumable_loop:
            continue
        constants, begun = _operands(loop)
        read = [*_variables(constants), *_read_behind(jaxpr, cut)]
        after = list(dict.fromkeys(v for v in read if v in varies))
        function, layouts = segment(cut, after, begun)
        results = Packing(_avals(after)), Packing(_avals(begun))
        parts.append(Stage(_between(function, layouts, results), *layouts))
        bodies, costs = loop.params["bodies"], loop.params["costs"]
        ways = tuple(len(parts) + i for i in range(len(bodies) + 1))
        for body, cost in zip(bodies, costs, strict=True):
            count = len(body.constvars)
            mine, constants = constants[:count], constants[count:]
            values = _function(whole, free(cut), after, mine)
            function = _loop(body, values, results)
            parts.append(Stage(function, *results, ways, cost))
        fixed, state, begin = after, list(loop.outvars), cut + 1
    function, layouts = segment(len(jaxpr.eqns), [], jaxpr.outvars)
    results = Packing(_avals(jaxpr.outvars))
    return [*parts, Stage(_last(function, layouts, results), *layouts)]


def _between(function, layouts, results):
    fixed, state = layouts

    def segment(packed, begun):
        leaves = of_lanes(function)(*fixed.unpack(packed), *state.unpack(begun))
        count = len(results[0].shapes)
        return results[0].pack(leaves[:count]), results[1].pack(leaves[count:])

    return segment


def _last(function, layouts, results):
    fixed, state = layouts

    def segment(packed, begun):
        leaves = *fixed.unpack(packed), *state.unpack(begun)
        return results.pack(of_lanes(function)(*leaves))

    return segment


def _loop(body, constants, layouts):
    fixed, state = layouts

    def lane(max_steps, values, begun):
        closed = ClosedJaxpr(body, constants(*values))
        return jaxpr_as_fun(closed)(max_steps, *begun)

    lanes = jax.vmap(lane, in_axes=(None, -1, -1), out_axes=-1)

    def loop(max_steps, packed, begun):
        values, begun = fixed.unpack(packed), state.unpack(begun)
        *leaves, phase, steps = lanes(max_steps, values, begun)
        return state.pack(leaves), jnp.stack([phase, steps])

    return loop


def of_lanes(function: Callable) -> Callable:
    """A function of a lane's leaves as one of a batch's."""
    return jax.vmap(function, in_axes=-1, out_axes=-1)


def _function(whole, equations, inputs, outputs):
    """The outputs as a function of the inputs, by those equations that they need."""
    equations = _needed(equations, outputs)
    read = {v for e in equations for v in _variables(e.invars)} | {*_variables(outputs)}
    pairs = zip(whole.jaxpr.constvars, whole.consts, strict=True)
    constants = [(v, value) for v, value in pairs if v in read]
    jaxpr = whole.jaxpr.replace(
        constvars=[v for v, _ in constants],
        invars=inputs,
        outvars=outputs,
        eqns=equations,
        debug_info=whole.jaxpr.debug_info.with_unknown_names(),
    )
    return jaxpr_as_fun(ClosedJaxpr(jaxpr, [value for _, value in constants]))


def _needed(equations: list[JaxprEqn], outputs: list) -> list[JaxprEqn]:
    """Those that the outputs need, in their order."""
    read, needed = set(_variables(outputs)), []
    for equation in reversed(equations):
        if _any_of(equation.outvars, read) or equation.effects:
            needed.append(equation)
            read.update(_variables(equation.invars))
    return needed[::-1]


def _varying(jaxpr: Jaxpr) -> set[Var]:
    """The variables that depend on the lane; of a loop all, it ends lane by lane."""
    varies = set(jaxpr.invars)
    for equation in jaxpr.eqns:
        read = _variables(equation.invars)
        if equation.primitive is resumable_loop or _any_of(read, varies):
            varies.update(equation.outvars)
    return varies


def _read_behind(jaxpr: Jaxpr, cut: int) -> list[Var]:
    """What was computed before an equation and is read behind it."""
    behind = [*(v for e in jaxpr.eqns[cut + 1 :] for v in e.invars), *jaxpr.outvars]
    new = {v for e in jaxpr.eqns[cut:] for v in e.outvars}
    return [v for v in _variables(behind) if v not in new]


def _operands(loop: JaxprEqn) -> tuple[list, list]:
    """What a loop's bodies read besides its state, and the state's first values."""
    count = sum(len(body.constvars) for body in loop.params["bodies"])
    return list(loop.invars[:count]), list(loop.invars[count:])


def _variables(operands) -> list[Var]:
    return [v for v in operands if not isinstance(v, Literal)]


def _free(equation: JaxprEqn, varies: set[Var]) -> bool:
    """Whether it varies with no lane, and does nothing beside."""
    return not equation.effects and not _any_of(equation.outvars, varies)


def _any_of(variables, among) -> bool:
    return any(v in among for v in variables)


def _avals(variables) -> list[jax.core.ShapedArray]:
    return cast(list[jax.core.ShapedArray], [v.aval for v in variables])
