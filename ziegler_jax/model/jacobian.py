"""The Jacobian of the accelerations, by the numbers of the state."""

from collections.abc import Callable
from typing import cast

import jax
import jax.core
import jax.numpy as jnp
from jax.core import eval_jaxpr

from ..numerics.jaxprs import ClosedJaxpr, Literal
from ..numerics.materialise import as_one_call
from ..numerics.numbers import Numbers, Scalar
from .state import PhasePoint
from .system import System, field


@as_one_call
def accelerations_and_slopes(
    t: Scalar, y: PhasePoint, system: System
) -> tuple[Numbers, tuple[Numbers, ...]]:
    """The accelerations, and the derivatives of each by the state's numbers."""
    return with_slopes(lambda *y: field(t, PhasePoint(y), system).omega, y)


def with_slopes(
    function: Callable[..., Numbers], y: Numbers
) -> tuple[Numbers, tuple[Numbers, ...]]:
    """Numbers of y, and of each its derivatives by those of y, row by row."""
    values, along = jax.linearize(function, *y)
    linear = jax.make_jaxpr(along)(*y)
    one = jnp.ones_like(y[0])
    columns = [_along_one(linear, i, one) for i in range(len(y))]
    return values, tuple(zip(*columns, strict=True))


def _along_one(linear: ClosedJaxpr, place: int, one: Scalar) -> Numbers:
    """A linear function of one of its arguments, the others being zero.

    What they alone would move is left out: a compiler keeps products with zero. (A
    transposed function would be as short, but is not a number where `jnp.where` leaves
    out a branch of infinite slope, and does not pass a loop of a law's own.)
    """
    jaxpr = linear.jaxpr
    moved, equations = {jaxpr.invars[place]}, []
    still = dict.fromkeys(jaxpr.invars)  # in order: a program's text is its identity
    still.pop(jaxpr.invars[place])
    for equation in jaxpr.eqns:
        read = [v for v in equation.invars if not isinstance(v, Literal)]
        if not moved.isdisjoint(read):
            moved.update(equation.outvars)
        elif not still.keys().isdisjoint(read):
            still.update(dict.fromkeys(equation.outvars))
            continue
        equations.append(equation)
    zeros = [v for v in still if v not in jaxpr.invars]
    body = jaxpr.replace(
        invars=[*jaxpr.invars, *zeros],
        eqns=equations,
        debug_info=jaxpr.debug_info.with_unknown_names(),
    )
    values = [0.0 * one] * len(jaxpr.invars)
    values[place] = one
    avals = (cast(jax.core.ShapedArray, v.aval) for v in zeros)
    values += [jnp.zeros(a.shape, a.dtype) for a in avals]
    return tuple(eval_jaxpr(body, linear.consts, *values))
