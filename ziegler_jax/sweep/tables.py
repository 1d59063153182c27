"""Large constants of a traced function, made arguments of it.

XLA is given a program's constants as text, ten times their size, and folds what is
computed of them. An array of some size that a function closes over therefore becomes an
input: calls that hold one are inlined, loops around them traced anew. Numbers and small
arrays stay constants, and so does what a call within a conditional holds: a batch of
lanes copies a conditional's inputs for each lane.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, cast

import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.extend.core import Jaxpr

from ..numerics.jaxprs import ClosedJaxpr, JaxprEqn
from ..numerics.resumable import (
    CALLS,
    INSIDE,
    Body,
    constants_of,
    evaluated,
    parts_of,
    resumable_loop,
)

LARGEST_CONSTANT = 1200  # bytes; the largest table of this package's own has 1152
InputOf = Callable[[object], object]  # the input that stands for a constant


def tables_as_inputs(whole: ClosedJaxpr) -> tuple[ClosedJaxpr, tuple[jax.Array, ...]]:
    """The same function, whose first inputs are its large constants; and these."""
    large = {id(x): x for x in whole.consts if _is_large(x)}
    large |= _Tables().within(whole.jaxpr)
    if not large:
        return whole, ()

    def function(tables, *args):
        inputs = dict(zip(large, tables, strict=True))

        def input_of(x):
            return inputs.get(id(x), x)

        return _run(whole.jaxpr, whole.consts, args, input_of)

    tables = tuple(
        x if isinstance(x, jax.Array) else jax.device_put(np.asarray(x))
        for x in large.values()
    )
    return jax.make_jaxpr(function)(tables, *whole.in_avals), tables


def _is_large(x: Any) -> bool:
    dtype = getattr(x, "dtype", None)
    if dtype is None or jnp.issubdtype(dtype, jax.dtypes.extended):
        return False
    if isinstance(x, jax.core.Tracer):
        return False
    return math.prod(np.shape(x)) * dtype.itemsize > LARGEST_CONSTANT


class _Tables:
    """The large constants within equations, looked for once in each part."""

    def __init__(self):
        self.known: dict[Jaxpr, dict[int, object]] = {}

    def within(self, jaxpr: Jaxpr) -> dict[int, object]:
        """By their identity."""
        if jaxpr not in self.known:
            large: dict[int, object] = {}
            for equation in jaxpr.eqns:
                large |= self.of_equation(equation)
            self.known[jaxpr] = large
        return self.known[jaxpr]

    def of_equation(self, equation: JaxprEqn) -> dict[int, object]:
        """Where it can be reached: not in a rule or a foreign primitive."""
        large: dict[int, object] = {}
        if not _is_opened(equation):
            return large
        for part in parts_of(equation):
            constants = getattr(part, "consts", ())
            large |= {id(x): x for x in constants if _is_large(x)}
            opened = part.jaxpr if isinstance(part, ClosedJaxpr) else part
            large |= self.within(opened)
        return large


def _is_opened(equation: JaxprEqn) -> bool:
    name = equation.primitive.name
    return name in CALLS or name in {"while", "scan", resumable_loop.name}


def _run(
    jaxpr: Jaxpr, consts: Sequence[object], args: Sequence[object], input_of: InputOf
) -> list:
    """The results of equations, with inputs for constants."""
    tables = _Tables()

    def with_inputs(equation: JaxprEqn, operands: Sequence) -> Sequence | None:
        if not tables.of_equation(equation):
            return None
        return _again(equation, [*operands], input_of)

    return evaluated(jaxpr, [*map(input_of, consts)], args, with_inputs)


def _again(equation: JaxprEqn, operands: list, input_of: InputOf) -> Sequence:
    """An equation that holds large constants, traced with inputs for them."""
    params = equation.params

    def inner(part: ClosedJaxpr | Jaxpr, *args) -> list:
        if isinstance(part, ClosedJaxpr):
            return _run(part.jaxpr, part.consts, args, input_of)
        return _run(part, (), args, input_of)

    match equation.primitive.name:
        case "while":
            first, second = params["cond_nconsts"], params["body_nconsts"]
            asks, does = operands[:first], operands[first : first + second]
            return lax.while_loop(
                lambda state: inner(params["cond_jaxpr"], *asks, *state)[0],
                lambda state: inner(params["body_jaxpr"], *does, *state),
                operands[first + second :],
            )
        case "scan":
            # by their shapes: parameters that count them have other names in JAX 0.12
            turned = cast(ClosedJaxpr, params["jaxpr"])
            carried = _alike(equation.outvars, turned.jaxpr.outvars)
            still = _alike(equation.invars, turned.jaxpr.invars) - carried
            own, rest = operands[:still], operands[still:]

            def turn(state, xs):
                after = inner(turned, *own, *state, *xs)
                return after[:carried], after[carried:]

            how = {key: params[key] for key in ("length", "reverse", "unroll")}
            state, ys = lax.scan(turn, rest[:carried], rest[carried:], **how)
            return [*state, *ys]
        case resumable_loop.name:
            return _loop_again(equation, operands, input_of)
        case _:
            part = next(params[key] for key in INSIDE if key in params)
            return inner(part, *operands)


def _alike(outside: Sequence, inside: Sequence) -> int:
    """How many have the same shape within a turn; others are one of several."""
    pairs = zip(outside, inside, strict=True)
    return sum(a.aval.shape == b.aval.shape for a, b in pairs)


def _loop_again(loop: JaxprEqn, operands: list, input_of: InputOf) -> list:
    """A loop that a sweep cuts, its parts traced again."""
    bodies, constants = [], []
    of_bodies, state = constants_of(loop.params["bodies"], operands)
    for body, of_parts in zip(loop.params["bodies"], of_bodies, strict=True):
        parts = []
        for part, mine in zip(body.parts, of_parts, strict=True):
            like = [v.aval for v in part.invars]
            closed = jax.make_jaxpr(
                lambda *args, part=part, mine=mine: _run(part, mine, args, input_of)
            )(*like)
            parts.append(closed.jaxpr)
            constants += closed.consts
        bodies.append(Body(tuple(parts), body.cost, body.every))
    params = {**loop.params, "bodies": tuple(bodies)}
    return resumable_loop.bind(*constants, *state, **params)
