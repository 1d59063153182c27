r"""Explicit Runge-Kutta methods, unrolled over a tuple of scalars.

diffrax's own explicit solvers loop over their stages, which serves large states. Here
the state is four scalars and the lanes are many: the stages are unrolled, each a row of
the tableau,

$$k_i = f\Bigl(t_0 + c_i h,\; y_0 + h \sum_{j<i} a_{ij} k_j\Bigr), \qquad
y_1 = y_0 + h \sum_i b_i k_i,$$

zeros of the tableau are left out, and each stage is kept as an array.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple, TypeVar, cast

import diffrax as dfx
import equinox as eqx
import jax.numpy as jnp

from ..model.state import PhasePoint
from ..numerics.materialise import materialise, traced_once
from ..numerics.numbers import Numbers, Scalar

_Row = tuple[float, ...]
# a state, or one with others behind it in a row
Y = TypeVar("Y", bound=Numbers)
# functions of time and state to be integrated along the motion
Integrand = Callable[[Scalar, PhasePoint], Numbers]
# a right-hand side of time and state
Field = Callable[[Scalar, Y], Y]


class Explicit(eqx.Module):
    """Any explicit Runge-Kutta method, for states that are tuples of scalars.

    **Arguments:**

    - `tableau`: a `diffrax.ButcherTableau`, or a solver of diffrax that has one, e.g.
        `diffrax.Dopri8()`; Tsit5 by default; `Explicit(*CALVO7)` of
        `solvers.tableaus`.
    - `order`, `name`: those of the solver where one is given; known for Tsit5's and
        Dopri8's tableau, else the order must be given.

    **Raises:** `ValueError` if it is no tableau, or implicit, or its order is not
    known.
    """

    # a part of the program, not numbers of it: a method may be an argument of a `jit`
    a: tuple[_Row, ...] = eqx.field(static=True)
    b: _Row = eqx.field(static=True)
    b_error: _Row = eqx.field(static=True)
    bend: _Row | None = eqx.field(
        static=True
    )  # the interpolant's: see `HermiteQuartic`
    c: _Row = eqx.field(static=True)
    last_stage_is_next_first: bool = eqx.field(static=True)
    order: int = eqx.field(static=True)
    name: str = eqx.field(static=True)

    def __init__(
        self,
        tableau: dfx.ButcherTableau | dfx.AbstractERK = dfx.Tsit5.tableau,
        order: int | None = None,
        name: str | None = None,
    ):
        """Turn the tableau into numbers of the program."""
        if isinstance(tableau, dfx.AbstractERK):
            order = tableau.order(None) if order is None else order  # pyright: ignore
            name = type(tableau).__name__ if name is None else name
            tableau = cast(dfx.ButcherTableau, tableau.tableau)
        if not isinstance(tableau, dfx.ButcherTableau):
            raise ValueError(
                "Argument `tableau` must be a `diffrax.ButcherTableau` or an explicit "
                f"solver of diffrax, but is {tableau!r}."
            )
        if tableau.implicit:
            raise ValueError("Argument `tableau` must be explicit, but is implicit.")
        usual, known, bend = _KNOWN.get(id(tableau), ("explicit", None, None))
        order = known if order is None else order
        if order is None:
            raise ValueError(
                "Argument `order` must be given for a tableau other than "
                "`diffrax.Tsit5.tableau` and `diffrax.Dopri8.tableau`."
            )
        self.a = tuple(tuple(map(float, row)) for row in tableau.a_lower)
        self.b = tuple(map(float, tableau.b_sol))
        self.b_error = tuple(map(float, tableau.b_error))
        self.bend = bend
        self.c = tuple(map(float, tableau.c))
        self.last_stage_is_next_first = bool(tableau.fsal and tableau.ssal)
        self.order = order
        self.name = usual if name is None else name

    def __repr__(self) -> str:
        """Its name: the tableau is long."""
        return f"Explicit({self.name})"

    def advance(
        self,
        field: Field[Y],
        t0: Scalar,
        t1: Scalar,
        y0: Y,
        first: Y,
        integrand: Callable[[Scalar, Y], Numbers] | None = None,
    ) -> tuple[Y, Y, Y, Numbers, Stages]:
        r"""One step from y0, where the right-hand side is `first`.

        **Returns:** y1, the error estimate, the right-hand side at y1, the integrals
        $\int_{t_0}^{t_1} g(t, y)\,dt \approx h \sum_i b_i g(t_i, Y_i)$ of
        `integrand`, which returns a tuple, to the order of the method, as if
        the integrals were part of the state; and the stages.
        """
        h = t1 - t0
        stages = [first]
        integrands = [] if integrand is None else [integrand(t0, y0)]

        def whole(t, y):
            return field(t, y), (() if integrand is None else integrand(t, y))

        once = traced_once(whole, t0, y0)

        def stage(t, y):
            return y, *once(t, y)

        y = y0
        for row, c in zip(self.a, self.c, strict=True):
            y = _increment(y0, h, row, stages)
            y, k, more = materialise(t0, stage, t0 + c * h, y)
            stages.append(k)
            integrands.append(more)
        if self.last_stage_is_next_first:
            y1, last = y, stages[-1]
        else:
            y1 = _increment(y0, h, self.b, stages)
            y1, last, _ = materialise(t0, stage, t1, y1)
        rows = range(len(y0))
        error = materialise(
            t0, lambda: like(y0, (h * weighted(self.b_error, stages, i) for i in rows))
        )
        integrals = ()
        if integrand is not None:
            parts = range(len(integrands[0]))
            integrals = tuple(h * weighted(self.b, integrands, i) for i in parts)
        return y1, error, last, integrals, Stages(stages, integrands)

    def bends(self, h: Scalar, stages: Sequence[Numbers]) -> Numbers:
        r"""What bends the interpolant of each number, $h \sum_i d_i k_i$."""
        assert self.bend is not None
        return tuple(h * weighted(self.bend, stages, i) for i in range(len(stages[0])))


# Tsitouras, Computers & Mathematics with Applications 62 (2011) 770-775: the leading
# coefficients of the interpolant's b_i(x)
_TSIT5_BEND = (
    *(-1.0530884977290216, 0.1017, 2.490627285651252793, -16.54810288924490272),
    *(47.37952196281928122, -34.87065786149660974, 2.5),
)
_KNOWN = {
    id(dfx.Tsit5.tableau): ("Tsit5", 5, _TSIT5_BEND),
    id(dfx.Dopri8.tableau): ("Dopri8", 8, None),
}


class Stages(NamedTuple):
    """The right-hand sides and the integrands at a step's stages."""

    slopes: Sequence[Numbers]
    integrands: Sequence[Numbers]


def weighted(row: Sequence[float], stages: Sequence[Numbers], i: int) -> Scalar:
    """The sum of a number of the stages, each times its weight; zeros are left out."""
    terms = [w * k[i] for w, k in zip(row, stages, strict=False) if w != 0.0]
    return sum(terms[1:], terms[0]) if terms else jnp.zeros_like(stages[0][i])


def like(y: Y, numbers: Iterable[Scalar]) -> Y:
    """Numbers in a row of the same kind."""
    return type(y)(numbers)  # pyright: ignore[reportCallIssue]


def _increment(y0: Y, h: Scalar, row: _Row, stages: Sequence[Numbers]) -> Y:
    return like(y0, (y + h * weighted(row, stages, i) for i, y in enumerate(y0)))
