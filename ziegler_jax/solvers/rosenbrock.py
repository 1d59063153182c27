r"""A Rosenbrock method for stiff lanes, its linear algebra written out.

One step solves, for $i = 1 \dots 8$,

$$\Bigl(\frac{1}{\gamma h} I - J\Bigr) U_i = f\Bigl(y_0 + \sum_{j<i} a_{ij} U_j\Bigr)
  + \frac1h \sum_{j<i} c_{ij} U_j, \qquad y_1 = y_0 + \sum_i m_i U_i,$$

with the Jacobian J of f at $y_0$: linear systems with one matrix, no iteration.
Smoothed friction is stiff in the rates alone. With $y = (\phi, \omega)$,
$\dot\phi = \omega$ and $J = [[0, I], [P, Q]]$ the angles drop out of each system,

$$\bigl(I - g Q - g^2 P\bigr)\, u_\omega = g\,(r_\omega + g P r_\phi), \qquad
  u_\phi = g\,(r_\phi + u_\omega), \qquad g = \gamma h,$$

and an n x n matrix, inverted once a step, is all that is left to solve.

Of a field that depends on time the time is one number more of the state, with the slope
1: the stages' times are $t_0 + \alpha_i h$, and $\delta_i h\, \partial f/\partial t$
at $t_0$ is added to the right-hand side.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from ..model.jacobian import with_slopes
from ..model.state import PhasePoint
from ..numerics.materialise import materialise
from ..numerics.numbers import Numbers, Scalar
from ..numerics.series import sum_of
from .explicit import Field, Integrand, weighted

# Rodas5P: G. Steinebach, Construction of Rosenbrock-Wanner method Rodas5P and numerical
# benchmarks within the Julia Differential Equations package, BIT Numerical Mathematics
# 63 (2023) 27, doi:10.1007/s10543-023-00967-x; in the digits of that package. Order 5,
# L-stable, stiffly accurate; the embedded method has order 4 and is L-stable, too.
GAMMA = 0.21193756319429014
_LAST = (
    -7.502846399306121,
    2.561846144803919,
    -11.627539656261098,
    -0.18268767659942256,
    0.030198172008377946,
)
A = (
    (3.0,),
    (2.849394379747939, 0.45842242204463923),
    (-6.954028509809101, 2.489845061869568, -10.358996098473584),
    (
        2.8029986275628964,
        0.5072464736228206,
        -0.3988312541770524,
        -0.04721187230404641,
    ),
    _LAST,
    (*_LAST, 1.0),
    (*_LAST, 1.0, 1.0),
)
C = (
    (-14.155112264123755,),
    (-17.97296035885952, -2.859693295451294),
    (147.12150275711716, -1.41221402718213, 71.68940251302358),
    (
        165.43517024871676,
        -0.4592823456491126,
        42.90938336958603,
        -5.961986721573306,
    ),
    (
        24.854864614690072,
        -3.0009227002832186,
        47.4931110020768,
        5.5814197821558125,
        -0.6610691825249471,
    ),
    (
        30.91273214028599,
        -3.1208243349937974,
        77.79954646070892,
        34.28646028294783,
        -19.097331116725623,
        -28.087943162872662,
    ),
    (
        37.80277123390563,
        -3.2571969029072276,
        112.26918849496327,
        66.9347231244047,
        -40.06618937091002,
        -54.66780262877968,
        -9.48861652309627,
    ),
)
# y1 is the last stage's argument and U_8, which is the error estimate as well
M = (*A[-1], 1.0)
# The continuous extension, of order 4: with x from 0 to 1 over the step
# (1-x) y0 + x (y1 + (1-x) (H_1 U + x (H_2 U + x H_3 U))).
H = (
    (
        25.948786856663858,
        -2.5579724845846235,
        10.433815404888879,
        -2.3679251022685204,
        0.524948541321073,
        1.1241088310450404,
        0.4272876194431874,
        -0.17202221070155493,
    ),
    (
        -9.91568850695171,
        -0.9689944594115154,
        3.0438037242978453,
        -24.495224566215796,
        20.176138334709044,
        15.98066361424651,
        -6.789040303419874,
        -6.710236069923372,
    ),
    (
        11.419903575922262,
        2.8879645146136994,
        72.92137995996029,
        80.12511834622643,
        -52.072871366152654,
        -59.78993625266729,
        -0.15582684282751913,
        4.883087185713722,
    ),
)
# h times the extension's slope at the step's end
_END = tuple(m - sum(column) for m, column in zip(M, zip(*H, strict=True), strict=True))


def _times() -> tuple[list[float], list[float]]:
    """Each stage's time and its share of the field's slope in time, in steps."""
    places, shares = [0.0], [GAMMA]
    for a, c in zip(A, C, strict=True):
        places.append(sum(x * s for x, s in zip(a, shares, strict=True)))
        shares.append(GAMMA * (1 + sum(x * s for x, s in zip(c, shares, strict=True))))
    return places, shares


PLACES, SHARES = _times()

Rows = tuple[Numbers, ...]  # of a matrix


class Linearised(NamedTuple):
    """The field at a step's start, and the matrices of the step."""

    field: PhasePoint
    p: Rows  # g P, row by row
    inverse: Rows  # of I - g Q - g^2 P


class Rosenbrock(eqx.Module):
    r"""Rodas5P for fields of $(\phi, \omega)$.

    For smoothed friction with $v_{smooth}$ far below $\tau$, or strong damping: where
    a joint creeps, the steps of an explicit method stay below a few of its decay times,
    these do not. A step costs 1.7 of `Explicit()`'s.

    The slope that is handed on, to observers and to interpolation, is that of the
    method's continuous extension, not f(y1): there the stiff part would magnify the
    step's error by its rate. The error estimate of a rate is the larger of the embedded
    method's and of $h (I - gQ - g^2 P)^{-1} (f(y_1) - \dot y(t_1))$, the extension's
    defect at the step's end, of the same order. The embedded method alone does not see
    a friction layer that a rate crosses within a step: with v_smooth of 1e-5 to 1e-7 it
    left errors of up to 10 000 tolerances (both: 40) for the same number of steps.
    """

    name: ClassVar[str] = "Rodas5P"
    order: ClassVar[int] = 5

    def advance(
        self,
        field: Field[PhasePoint],
        t0: Scalar,
        t1: Scalar,
        y0: PhasePoint,
        first: PhasePoint,
        integrand: Integrand | None = None,
        autonomous: bool = True,
    ) -> tuple[PhasePoint, PhasePoint, PhasePoint, Numbers]:
        r"""One step from y0.

        **Arguments:** `autonomous`: whether field and integrand are known not to depend
        on time; else as of `Explicit.advance`.

        **Returns:** y1, the error estimate, the slope at y1, and the integrals
        $\int_{t_0}^{t_1} p(y)\,dt$ of `integrand`, a function p that returns a tuple;
        to the order of the method, as if the integrals were part of
        the state: with the stages' arguments $Y_i$ theirs are
        $Z_i = g\,\bigl(p(Y_i) + p'(y_0)\,U_i\bigr) + \gamma \sum_{j<i} c_{ij} Z_j$.
        """
        del first  # the linearisation holds the field
        h, n = t1 - t0, len(y0.phi)
        g, per_h = GAMMA * h, 1.0 / h
        start = materialise(t0, lambda: _linearised(lambda y: field(t0, y), y0, g))
        quantities = (lambda t, y: ()) if integrand is None else integrand
        first_parts, along = jax.linearize(lambda y: quantities(t0, y), y0)
        drift, part_drift = (), ()
        if not autonomous:

            def in_time(t):
                return field(t, y0).omega, quantities(t, y0)

            slopes = jax.jvp(in_time, (t0,), (jnp.ones_like(t0),))[1]
            drift, part_drift = materialise(t0, lambda: slopes)

        def solved(slope, push):
            total = _sums(slope, push)
            r = total[:n]
            rows = zip(total[n:], start.p, strict=True)
            s = [sum_of([x, *products(row, r)]) for x, row in rows]
            w = [g * sum_of(products(row, s)) for row in start.inverse]
            return (*(g * (a + b) for a, b in zip(r, w, strict=True)), *w)

        def moved(i, slope):
            """With what the field's slope in time adds in a stage."""
            more = tuple(SHARES[i] * h * x for x in drift)
            return PhasePoint.of(slope.phi, _sums(slope.omega, more)) if more else slope

        def summed(i, parts, u):
            more = tuple(SHARES[i] * h * x for x in part_drift)
            parts = _sums(parts, along(PhasePoint(u)))
            return _sums(parts, more) if more else parts

        def stage(i, t, y, push):
            u = solved(moved(i, field(t, y)), push)
            return u, summed(i, quantities(t, y), u)

        def first_stage():
            u = solved(moved(0, start.field), (0.0,) * (2 * n))
            return u, summed(0, first_parts, u)

        y = y0
        u, parts = materialise(t0, first_stage)
        stages, works = [u], [tuple(g * x for x in parts)]
        for i, (a, c) in enumerate(zip(A, C, strict=True), 1):
            y = PhasePoint(x + weighted(a, stages, i) for i, x in enumerate(y0))
            push = tuple(per_h * weighted(c, stages, i) for i in range(2 * n))
            t = t0 if autonomous else t0 + PLACES[i] * h
            u, parts = materialise(t0, partial(stage, i, t), y, push)
            stages.append(u)
            works.append(
                tuple(
                    g * x + GAMMA * weighted(c, works, i) for i, x in enumerate(parts)
                )
            )
        y1 = PhasePoint(_sums(y, stages[-1]))
        slopes = tuple(per_h * weighted(_END, stages, i) for i in range(n, 2 * n))

        def errors():
            there = field(t0 if autonomous else t1, y1)
            pairs = zip(there.omega, slopes, strict=True)
            missed = [h * (a - b) for a, b in pairs]
            last = PhasePoint(stages[-1])
            rates = list(last.omega)
            for i, row in enumerate(start.inverse):
                defect = sum_of(products(row, missed))
                larger = jnp.abs(defect) > jnp.abs(rates[i])
                rates[i] = jnp.where(larger, defect, rates[i])
            return PhasePoint.of(last.phi, rates)

        error = materialise(t0, errors)
        integrals = tuple(weighted(M, works, i) for i in range(len(works[0])))
        last = PhasePoint.of(y1.omega, slopes)
        return y1, error, last, integrals


def _linearised(
    function: Callable[[PhasePoint], PhasePoint], y0: PhasePoint, g: Scalar
) -> Linearised:
    """The field at y0, and what its Jacobian makes of the step's linear systems."""
    rates, slopes = with_slopes(lambda *y: function(PhasePoint(y)).omega, y0)
    field, n = PhasePoint.of(y0.omega, rates), len(rates)
    p = tuple(tuple(g * x for x in row[:n]) for row in slopes)
    matrix = [
        [(1.0 if i == j else 0.0) - g * (row[j + n] + p[i][j]) for j in range(n)]
        for i, row in enumerate(slopes)
    ]
    return Linearised(field, p, _inverse(matrix))


def _inverse(matrix: list[list[Scalar]]) -> Rows:
    """Of two rods written out, of more by LAPACK."""
    if len(matrix) > 2:
        inverse = jnp.linalg.inv(jnp.stack([jnp.stack(row) for row in matrix]))
        return tuple(tuple(row) for row in inverse)
    (m11, m12), (m21, m22) = matrix
    over = 1.0 / (m11 * m22 - m12 * m21)
    return (m22 * over, -m12 * over), (-m21 * over, m11 * over)


def products(row: Sequence[Scalar], x: Sequence[Scalar]) -> list[Scalar]:
    """Number by number."""
    return [a * b for a, b in zip(row, x, strict=True)]


def _sums(values: Numbers, changes: Numbers) -> Numbers:
    return tuple(v + c for v, c in zip(values, changes, strict=True))
