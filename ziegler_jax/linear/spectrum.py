r"""The column near its equilibrium: eigenvalues, and regimes without them.

$M \ddot\phi + C \dot\phi + K \phi = 0$ with

$$M = \begin{bmatrix} a & b \\ b & d \end{bmatrix},\qquad
K = \begin{bmatrix} \kappa + 1 - q & \eta q - 1 \\ -1 & 1 - (1-\eta) l_2 q
\end{bmatrix}$$

and C of the damping law. K is not symmetric: the follower load has no potential, and
the column can lose stability oscillating. Joint friction has no linear map (in stick
the joints are rigid): every function here refuses it and names `tangent_column`.

A chain of more rods, and one that more than its load acts on, is taken about its
equilibrium, and told by its eigenvalues (`chains`).
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import Array, Int

from ..model.chain_of_rods import AbstractChain, check_column
from ..model.column import Column, check_autonomous, refuse_si
from ..model.damping import Sum, Viscous, at_rest
from ..model.friction import AbstractRateFriction, slopes_at_rest
from ..numerics.numbers import Pair, Scalar, is_concrete
from ..numerics.series import value
from ..results import CODE
from ..runtime import requires_x64
from .chains import ROUNDING
from .characteristic import Characteristic, characteristic, inertia, stiffness
from .matrices import Matrices, about, equilibrium, of_first_order


class Linear(NamedTuple):
    """M, C, K of the linear column, arrays of shape (rods, rods)."""

    mass: jax.Array
    damping: jax.Array
    stiffness: jax.Array


@requires_x64
def linearise(column: AbstractChain) -> Linear:
    """M, C and K at the column's own load; C is zero where it has no damping law.

    They are those about its equilibrium, which is not at angles of zero where rest
    angles, or forces across it, displace it: there the one that the springs' own shape
    goes over to as all that acts is raised from nothing.

    **Raises:** `ValueError` if the column has friction, and where it has no such
    equilibrium; NaN where that is only known when traced.
    """
    refuse_friction("linearise", column)
    if not is_plain(column):
        mass, damping, stiff, _ = _at_equilibrium(column)
        return Linear(mass, jnp.zeros_like(mass) if damping is None else damping, stiff)
    assert isinstance(column, Column)
    rows = ((0.0, 0.0), (0.0, 0.0))
    if column.damping is not None:
        rows = at_rest(column.damping)
    mass, stiff = inertia(column), stiffness(column)
    return Linear(*map(_matrix, (mass, rows, stiff)))


@requires_x64
def spectrum(column: AbstractChain) -> jax.Array:
    r"""The eigenvalues s of $\det(M s^2 + C s + K) = 0$, in $\sqrt{k/(m l^2)}$.

    Two a rod. By `jnp.linalg.eigvals` of the first-order matrix, one LAPACK call a
    column: for maps of many points `regime` is tens of times faster. Where two
    eigenvalues meet (undamped flutter) they carry half the digits, and their
    derivatives do not exist: differentiate `critical_load`.

    **Returns:** complex, shape (4,), of n rods (2 n,), in no order; NaN where the
    numbers are invalid.

    **Raises:** `ValueError` if the column has friction.
    """
    if not is_plain(column):
        refuse_friction("spectrum", column)
        matrix = of_first_order(_at_equilibrium(column))
        valid = column.valid() & jnp.all(jnp.isfinite(matrix))
        values = jnp.linalg.eigvals(jnp.where(valid, matrix, jnp.eye(len(matrix))))
        return jnp.where(valid, values, jnp.nan)
    m, c, k = linearise(column)
    assert isinstance(column, Column)
    inverse = jnp.array([[m[1, 1], -m[0, 1]], [-m[1, 0], m[0, 0]]])
    inverse = inverse / (m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0])
    zero, one = jnp.zeros((2, 2), m.dtype), jnp.eye(2, dtype=m.dtype)
    first_order = jnp.block([[zero, one], [-inverse @ k, -inverse @ c]])
    valid = characteristic(column).valid
    values = jnp.linalg.eigvals(jnp.where(valid, first_order, one[0, 0]))
    return jnp.where(valid, values, jnp.nan)


@requires_x64
def spectral_abscissa(column: AbstractChain) -> jax.Array:
    """The largest real part of the spectrum: the growth rate, in sqrt(k/(m l^2)).

    Undamped and below flutter it is zero up to rounding, about 1e-16, and 1e-8 where
    two eigenvalues nearly meet.
    """
    return jnp.max(jnp.real(spectrum(column)))


@requires_x64
def regime(column: AbstractChain) -> jax.Array:
    r"""Which regime the column is in at its load: a `CODE`.

    By conditions on the characteristic polynomial $p_0 s^4 + \dots + p_4$ alone.
    Undamped: the roots of $p_0 \sigma^2 + p_2 \sigma + p_4$ in $\sigma = s^2$ are real
    and negative (marginal), complex (flutter), or one is positive (divergence).
    Damped: Hurwitz' $p_1, p_3, p_4 > 0$ and $p_1 p_2 p_3 - p_0 p_3^2 - p_1^2 p_4 > 0$
    (stable); else the number of positive real roots by Sturm's chain. Divergence is
    any real s > 0, whether or not a pair grows beside it; a point exactly on a
    boundary counts as marginal.

    Damping however small is told from none, down to the smallest normal number,
    2.2e-308: growth at a rate of 1e-100 is flutter. Upward the coefficients overflow
    near 1e75; and where one joint alone is damped beyond about 1e11, flutter cannot
    be told from divergence with $\det K > 0$.

    Of more than two rods, and where more than the load acts, by eigenvalues: what grows
    or falls by less than 1e-13 of the fastest rate is neither; without damping 1e-8, as
    eigenvalues that meet carry half the digits.

    **Returns:** int32, `invalid` for such damping, and where numbers only known when
    traced break a rule.

    **Raises:** `ValueError` if the column has friction.
    """
    refuse_friction("regime", column)
    if not is_plain(column):
        return _regime_of(spectrum(column), column.system().damping is not None)
    assert isinstance(column, Column)
    return _regime(characteristic(column), jnp.asarray(column.q, dtype=float))


@requires_x64
def tangent_column(column: AbstractChain) -> AbstractChain:
    r"""The column with smoothed friction replaced by its tangent at rest.

    $\tanh(u/v_{smooth})$ is at rest viscous damping $c_i = \tau_{s,i} / v_{smooth}$,
    with $\tau_s = \mu_s \rho N$ and N the load at rest (|q| for `FollowerLoad` and
    `JointReaction`). That is what a linear function may see of friction, and it must
    be read with care: set-valued friction holds the column at EVERY load, there is
    no infinitesimal onset. An eigenvalue map of the smoothed column is a map of
    $v_{smooth}$, a number of the smoothing and not of the friction, and brings the
    paradox of small damping with it. How far flutter reaches under friction is a
    question of amplitude: `settle`, `critical_kick`.

    The damping is that at the column's own q. `regime` and `spectrum` of it are right
    at that q; `critical_load` of it moves q with the damping held.

    **Returns:** a column without friction, its damping the sum of both.

    **Raises:** `ValueError` if the friction is set-valued: it has no tangent.
    """
    refuse_si(column)
    check_autonomous("tangent_column", column)
    law = column.friction
    if law is None:
        return column
    if not isinstance(law, AbstractRateFriction):
        raise ValueError(
            "Argument `column` must have friction that is a function of the rates, "
            "such as `SmoothCoulomb`, or none for `tangent_column`, but has "
            f"{type(law).__name__}: in stick the joints are rigid, and the law has no "
            "tangent at rest."
        )
    load, n = law.load_law(), column.joints
    pulls = tuple(jnp.asarray(q) for q in column.pulls)
    normal = (1.0,) * n if load is None else load.at_rest(pulls)
    slopes = slopes_at_rest(law, n)
    damping = Viscous(*(c * x for c, x in zip(slopes, normal, strict=True)))
    return eqx.tree_at(
        lambda c: (c.damping, c.friction),
        column,
        (damping if column.damping is None else Sum(column.damping, damping), None),
        is_leaf=lambda x: x is None,
    )


def is_plain(column: AbstractChain) -> bool:
    """Whether it is two rods under a load alone: then formulas know all."""
    return isinstance(column, Column) and column.follower_only


def _at_equilibrium(column: AbstractChain) -> Matrices:
    """The matrices about the equilibrium.

    **Raises:** `ValueError` where it is known that there is none.
    """
    system = column.system()
    angles, there = equilibrium(system)
    if is_concrete(there) or not isinstance(there, Tracer):
        if not bool(there):
            raise ValueError(
                "Argument `column` must have an equilibrium that its springs' own "
                f"shape goes over to, but at q = {float(column.q):g} has none: on the "
                "way there it ends, or leaps to another."
            )
    if is_concrete(there):
        return about(system, angles)
    return jax.tree.map(lambda x: jnp.where(there, x, jnp.nan), about(system, angles))


def _regime_of(s: jax.Array, damped: bool) -> jax.Array:
    """By the eigenvalues."""
    noise = (ROUNDING if damped else 1e-8) * jnp.max(jnp.abs(s))
    grows = s.real > noise
    real = jnp.any(grows & (jnp.abs(s.imag) <= noise))
    code = jnp.where(real, CODE.divergence, CODE.flutter)
    code = jnp.where(jnp.any(grows), code, CODE.marginal)
    code = jnp.where(jnp.all(s.real < -noise), CODE.stable, code)
    valid = jnp.all(jnp.isfinite(s))
    return jnp.where(valid, code, CODE.invalid).astype(jnp.int32)


def refuse_friction(who: str, column: AbstractChain) -> None:
    """Raise for a column whose friction a linear function cannot see."""
    check_column(column)
    refuse_si(column)
    check_autonomous(who, column)
    if column.friction is not None:
        raise ValueError(
            f"Argument `column` must have no friction for `{who}`, but has "
            f"{type(column.friction).__name__}: friction has no linear map. "
            "`tangent_column(column)` gives what a linear function may see of a "
            "smoothed law, viscous damping tau_s / v_smooth."
        )


@jax.jit
def _regime(p: Characteristic, q: jax.Array) -> jax.Array:
    p0, p2, p4 = p.p0, value(p.p2, q), value(p.p4, q)
    gap = p2 * p2 - 4 * p0 * p4
    if p.p1 is None or p.p3 is None or p.damped is None:
        stable = jnp.zeros_like(gap, dtype=bool)
        marginal = (gap >= 0) & (p2 >= 0) & (p4 >= 0)
        real, lost = gap >= 0, jnp.zeros_like(stable)
    else:
        p1, p3 = p.p1, value(p.p3, q)
        first, ratio = p.damped.p1, value(p.damped.ratio, q)
        hurwitz = value(p.damped.boundary, q)
        # a biquadratic: as if there were no law
        none = (first == 0) & (ratio == 0)
        stable = (first > 0) & (ratio > 0) & (p4 > 0) & (hurwitz > 0)
        marginal = (p2 >= 0) & (ratio >= 0) & (p4 >= 0)
        marginal &= jnp.where(none, gap >= 0, (first > 0) & (hurwitz >= 0))
        real = _positive_roots(p1 / p0, p2 / p0, p3 / p0, p4 / p0) > 0
        # large damping: two slow roots, p2 s^2 + p3 s + p4 = 0, that Sturm cannot tell
        size = jnp.maximum(jnp.abs(p3) / p2, jnp.sqrt(jnp.abs(p4) / p2))
        slow = (p1 * size < 1e-8 * p2) & (p0 * size * size < 1e-8 * p2) & (p2 > 0)
        slow_real = (ratio < 0) & (p3 * (p3 / p2) >= 4 * p4)
        real = (p4 < 0) | jnp.where(slow, slow_real, real)
        # worst measured: Sturm's chain is right to 1e12
        lost = (p1 > 1e11 * p0) & ~slow & (p4 >= 0) & ~stable & ~marginal
    code = jnp.where(real, int(CODE.divergence), int(CODE.flutter))
    code = jnp.where(marginal, int(CODE.marginal), code)
    code = jnp.where(stable, int(CODE.stable), code)
    valid = p.valid & jnp.isfinite(gap) & ~lost
    return jnp.where(valid, code, int(CODE.invalid)).astype(jnp.int32)


def _matrix(rows: tuple[Pair, Pair]) -> jax.Array:
    return jnp.stack([jnp.stack([jnp.asarray(x, float) for x in row]) for row in rows])


def _positive_roots(b: Scalar, c: Scalar, d: Scalar, e: Scalar) -> Int[Array, ""]:
    """How many distinct positive roots x^4 + b x^3 + c x^2 + d x + e has: Sturm.

    The chain, without its divisions: f, f', then alpha x^2 + beta x + gamma,
    lambda x + mu and a constant.
    """
    alpha, beta, gamma = 3 * b * b / 16 - c / 2, b * c / 8 - 3 * d / 4, b * d / 16 - e
    u = 3 * b * alpha - 4 * beta
    lam = u * beta - alpha * (2 * c * alpha - 4 * gamma)
    mu = u * gamma - alpha * (d * alpha)
    last = -(alpha * mu * mu - beta * lam * mu + gamma * lam * lam)
    one = jnp.ones_like(alpha)
    return _changes(e, d, gamma, mu, last) - _changes(one, one, alpha, lam, last)


def _changes(*chain: Scalar) -> Int[Array, ""]:
    """How often the sign changes along the chain, zeros left out."""
    count, before = 0, jnp.sign(chain[0])
    for x in chain[1:]:
        now = jnp.sign(x)
        count = count + (now * before < 0).astype(int)
        before = jnp.where(now == 0, before, now)
    return jnp.asarray(count)
