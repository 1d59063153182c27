"""What the results of a program ask for, through its calls, branches and loops.

JAX keeps an equation that nothing reads, or an operand of a loop that nothing in it
reads, while anything holds the tracer: a collector of garbage that has not run, a
profiler that looks at a frame. A program is therefore known by what it is asked for.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import jax
from jax.extend.core import Jaxpr, Var

from .jaxprs import ClosedJaxpr, JaxprEqn, Literal
from .resumable import CALLS, INSIDE, constants_of, resumable_loop

Operand = Var | Literal


class Part(NamedTuple):
    """Equations within an equation.

    `given`: what the first of their constants and inputs stand for outside; behind are
    a loop's own, its state, its row, the number of a step; `results`: which are asked
    for.
    """

    jaxpr: Jaxpr
    given: Sequence[Operand]
    results: tuple[bool, ...]

    @property
    def key(self) -> tuple[int, tuple[bool, ...]]:
        """What of it beside the equations themselves decides how they are read."""
        return len(self.given), self.results


class Inside(NamedTuple):
    """An equation with parts.

    `operands`: those read whatever the parts read; `parts`: with their names;
    `results`: which come of it, in a loop all of the state; `said`: the parameters that
    this says already.
    """

    operands: Sequence[Operand]
    parts: Sequence[tuple[str, Part]]
    results: tuple[bool, ...]
    said: set[str]


class Asked(NamedTuple):
    """What some results ask for.

    `results`: of each equation which are read, None if it is not needed; `inputs`:
    which constants and inputs are.
    """

    results: Sequence[tuple[bool, ...] | None]
    inputs: tuple[bool, ...]


_asked_before: WeakKeyDictionary[Jaxpr, dict[tuple[bool, ...], Asked]]
_asked_before = WeakKeyDictionary()


def asked(jaxpr: Jaxpr, results: tuple[bool, ...]) -> Asked:
    """What these results ask for, and effects."""
    before = _asked_before.setdefault(jaxpr, {})
    if results not in before:
        before[results] = _asked(jaxpr, results)
    return before[results]


def _asked(jaxpr: Jaxpr, results: tuple[bool, ...]) -> Asked:
    read = set(_variables(_where(results, jaxpr.outvars)))
    of_equations = []
    for equation in reversed(jaxpr.eqns):
        mine = tuple(v in read for v in equation.outvars)
        needed = any(mine) or bool(equation.effects)
        of_equations.append(mine if needed else None)
        if needed:
            read.update(_variables(_read(equation, mine)))
    inputs = tuple(v in read for v in (*jaxpr.constvars, *jaxpr.invars))
    return Asked(of_equations[::-1], inputs)


def _read(equation: JaxprEqn, results: tuple[bool, ...]) -> list[Operand]:
    """The operands that an equation reads for some of its results."""
    inside = inside_of(equation, results)
    if inside is None:
        return [*equation.invars]
    read = [*inside.operands]
    for _, part in inside.parts:
        inputs = asked(part.jaxpr, part.results).inputs
        read += _where(inputs[: len(part.given)], part.given)
    return read


def inside_of(equation: JaxprEqn, results: tuple[bool, ...]) -> Inside | None:
    """The parts of a call, a conditional or a loop; None of another equation."""
    name, of, operands = equation.primitive.name, equation.params, equation.invars
    if equation.primitive is resumable_loop:
        return _inside_resumable(equation)
    if name in CALLS or is_of_this_package(equation):
        key = next((key for key in (*INSIDE, "call") if key in of), None)
        if key is None:
            return None
        part = part_of(of[key], operands, results)
        return Inside([], [(key, part)], results, {key, "num_consts"})
    if name == "cond":
        parts = [part_of(x, operands[1:], results) for x in of["branches"]]
        parts = [("branch", part) for part in parts]
        return Inside(operands[:1], parts, results, {"branches"})
    if name == "while":
        return _inside_while(equation)
    if name == "scan":
        constants, carried = _counts_of_scan(of)
        results = (*(True,) * carried, *results[carried:])
        part = part_of(of["jaxpr"], operands[:constants], results)
        parts = [(f"row, {carried} of it carried", part)]
        said = {"jaxpr", "linear", "num_consts", "num_carry", "ft_in", "ft_out"}
        return Inside(operands[constants:], parts, results, said)
    return None


def is_of_this_package(equation: JaxprEqn) -> bool:
    """Whether a batch of a call is computed by a rule that this package wrote.

    Such a rule computes what the call does.
    """
    if equation.primitive.name != "custom_vmap_call":
        return False
    rule = equation.params["rule"]
    module = getattr(getattr(rule, "rule", rule), "__module__", "")
    return module.partition(".")[0] == __name__.partition(".")[0]


def _inside_while(equation: JaxprEqn) -> Inside:
    of, operands = equation.params, equation.invars
    first, second = of["cond_nconsts"], of["body_nconsts"]
    state = operands[first + second :]
    whole = (True,) * len(state)
    asks = part_of(of["cond_jaxpr"], operands[:first], (True,))
    turn = part_of(of["body_jaxpr"], operands[first : first + second], whole)
    parts = ("cond_jaxpr", asks), ("body_jaxpr", turn)
    said = {"cond_nconsts", "body_nconsts", "cond_jaxpr", "body_jaxpr"}
    return Inside(state, parts, whole, said)


def _inside_resumable(loop: JaxprEqn) -> Inside:
    bodies = loop.params["bodies"]
    constants, state = constants_of(bodies, loop.invars)
    # not `part_of`: what they are closed with stands among the operands
    parts = [
        (f"body {body.cost!r} {body.every}", Part(part, mine, _all_of(part)))
        for body, of_body in zip(bodies, constants, strict=True)
        for part, mine in zip(body.parts, of_body, strict=True)
    ]
    return Inside(state, parts, (True,) * len(state), {"bodies"})


def part_of(
    equations: ClosedJaxpr | Jaxpr,
    given: Sequence[Operand] = (),
    results: tuple[bool, ...] | None = None,
) -> Part:
    """A part; all its results are asked for if they are None."""
    jaxpr = equations.jaxpr if isinstance(equations, ClosedJaxpr) else equations
    closed = equations.consts if isinstance(equations, ClosedJaxpr) else []
    constants = [Literal(x, jax.typeof(x)) for x in closed]
    results = _all_of(jaxpr) if results is None else results
    return Part(jaxpr, [*constants, *given], results)


def _all_of(jaxpr: Jaxpr) -> tuple[bool, ...]:
    """Flags of all its results."""
    return (True,) * len(jaxpr.outvars)


def _counts_of_scan(of: Mapping[str, Any]) -> tuple[int, int]:
    """How many operands a scan only reads, and carries; JAX 0.12 says so in a tree."""
    if "num_consts" in of:
        return of["num_consts"], of["num_carry"]
    constants, carried, _ = of["ft_in"].unpack()
    return len(constants), len(carried)


def _where(flags: Sequence[bool], values: Sequence) -> list:
    return [x for flag, x in zip(flags, values, strict=True) if flag]


def _variables(operands: Sequence[Operand]) -> list[Var]:
    return [v for v in operands if isinstance(v, Var)]
