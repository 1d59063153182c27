r"""Critical loads: where the column loses stability, and how that load moves.

Raised from zero, the load takes the column out of stability where an eigenvalue s
reaches the imaginary axis. On the axis the characteristic polynomial
$p_0 s^4 + p_1 s^3 + p_2(q) s^2 + p_3(q) s + p_4(q)$ leaves one condition on q:

- flutter, undamped: the two frequencies meet, the discriminant $p_2^2 - 4 p_0 p_4$
  of the polynomial in $s^2$, with $\omega^2 = p_2 / (2 p_0)$;
- flutter, damped: a pair $\pm i \omega$, Hurwitz' determinant over $p_1^2$,
  $r (p_2 - p_0 r) - p_4$ with $\omega^2 = r(q) = p_3 / p_1$;
- divergence: s = 0, $p_4 = \det K$.

Each is a quadratic in q, so its roots are known without a search, and the one that an
eigenvalue crosses to the right is the critical load. The determinant over $p_1^2$
depends on the damping through ratios and det C alone: damping may be as small as the
smallest normal number, 2.2e-308; below it counts as none.
"""

from __future__ import annotations

from functools import partial
from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Int

from ..model.chain_of_rods import AbstractChain
from ..model.column import Column
from ..numerics.numbers import Flag, Scalar
from ..numerics.rules import choice
from ..numerics.series import value
from ..results import CODE, CRITICAL_LOADS, RATE, AbstractResult, Settings, quantity
from ..runtime import requires_x64
from .chains import first_loss
from .characteristic import Characteristic, characteristic, slope
from .spectrum import is_plain, refuse_friction

Kind = Literal["flutter", "divergence", "flutter_end"]
KINDS = ("flutter", "divergence", "flutter_end")


class CriticalLoad(AbstractResult):
    r"""A critical load.

    `q_cr`: the load $F l/k$; `frequency`: $\omega = |{\rm Im}\, s|$ of the eigenvalue
    that crosses, in $\sqrt{k/(m l^2)}$, 0 for divergence; `outcome`: a `CODE`,
    `found` where stability is lost there first; `kind`: what was asked for. There are
    no tolerances: the load is a formula's.
    """

    q_cr: jax.Array = eqx.field(metadata=quantity("critical load", "k/l"))
    frequency: jax.Array = eqx.field(
        metadata=quantity("frequency at the critical load", RATE)
    )
    outcome: jax.Array = eqx.field(
        metadata=quantity("how the critical load was found", codes=CRITICAL_LOADS)
    )
    kind: str = eqx.field(static=True)

    @property
    def settings(self) -> Settings:  # pyright: ignore[reportIncompatibleVariableOverride]
        """What was asked for."""
        return (("kind", self.kind),)


@requires_x64
def critical_load(column: AbstractChain, kind: Kind = "flutter") -> CriticalLoad:
    r"""The first load from q = 0 up at which the column loses stability.

    **Arguments:**

    - `column`: without friction; its own `q` does not matter.
    - `kind`: `"flutter"`, a pair $\pm i\omega$ leaves the imaginary axis to the right;
        `"divergence"`, a real eigenvalue passes zero to the right;
        `"flutter_end"`, of a column without damping law: the load above q_cr at which
        the two frequencies part again, as growing real s (the end of flutter under a
        pure follower load: divergence without $\det K = 0$), or on the axis.

    **Returns:** `.q_cr`, `.frequency`, `.outcome`. The outcome is `found`; `preceded`
    if the other kind comes at a lower load (stability may have come back in between);
    `undamped` (below); `no_load` if no load crosses such a boundary (flutter that grows
    out of divergence, two growing real s that meet, crosses none). For `no_load`,
    `double_root`, `unstable_at_zero` and `invalid` the numbers and all their
    derivatives are NaN: to mask lanes in a sum that is differentiated, mask their
    parameters.

    **Derivatives:** forward and reverse, first and second, in every leaf, by the
    implicit function theorem on the boundary function: exact where the eigenvalues'
    own are infinite. They grow as one over the root of the distance to a double root,
    where two boundary loads coincide: within 64 rounding errors of it the outcome is
    `double_root`. Where the two kinds exchange (equal loads) each keeps its own load
    and derivative, and only the outcome changes.

    **More than two rods**, and where rest angles, fixed forces or a foundation act, the
    load is bracketed by eigenvalues at loads 1 % apart (below a tenth of what turns
    the rods as much as the springs alone do by a thousandth of that), and found by
    Newton's method (`linear/chains.py`), about the equilibrium as it moves with the
    load. Such a search
    passes over a loss of stability that ends again within one interval, and sees no
    damping below 1e-13 of the fastest rate. Where the equilibrium ends, or leaps to
    another, there is no such load beyond. `"flutter_end"` is of two rods under their
    load alone. The code is `double_root` also where Newton's method does not close.

    **Small damping.** As $C \to 0$ the damped q_cr has a limit that depends on the
    ratio c1/c2 and lies below the undamped q_cr for every ratio but one: Ziegler's
    paradox. Any c below 1e-9 gives that limit to rounding; across the ratio the
    derivatives in c grow as 1/c, the second ones as 1/c^2: below c of about 1e-150
    these overflow and come out infinite or NaN, the outcome still `found`, as it
    speaks of the load. Below the smallest normal number, 2.2e-308, damping counts as
    zero; from 1e150 det C overflows, `invalid` or `double_root`. At C = 0 exactly
    (`Viscous(0, 0)`) the column is undamped and so is the load returned, as with
    `damping=None`; but q_cr jumps there and has no derivative in the damping. The one
    returned is zero, and the outcome `undamped` (or `preceded`) says so.

    **Raises:** `ValueError` for friction, for an unknown `kind`, and for
    `"flutter_end"` with a damping law: there the end is no root of a quadratic.

    Source: H. Ziegler, Ingenieur-Archiv 20 (1952) 49-56; O. N. Kirillov,
    Nonconservative Stability Problems of Modern Physics (2013).
    """
    refuse_friction("critical_load", column)
    choice("kind", kind, KINDS)
    if not is_plain(column):
        if kind == "flutter_end":
            raise ValueError(
                "Argument `kind` must be 'flutter' or 'divergence' unless the column "
                "has two rods, and nothing but its load acts on it, but is "
                "'flutter_end'."
            )
        q, frequency, code = first_loss(
            column.system(), jnp.asarray(column.valid()), kind
        )
        return CriticalLoad(q, frequency, code, kind)  # pyright: ignore[reportCallIssue]
    assert isinstance(column, Column)
    p = characteristic(column)
    if kind == "flutter_end" and p.p1 is not None:
        raise ValueError(
            "Argument `kind` must be 'flutter' or 'divergence' for a column with "
            "damping, but is 'flutter_end': take `damping=None`."
        )
    return _first_loss(p, kind)


class _Condition(NamedTuple):
    """A boundary function at one load: itself, two derivatives in q, and omega^2."""

    value: Scalar
    slope: Scalar
    bend: Scalar
    squared: Scalar


def _discriminant(p: Characteristic, q: Scalar) -> _Condition:
    """p2^2 - 4 p0 p4: undamped, the frequencies meet."""
    x, dx, dy = value(p.p2, q), p.p2[1], slope(p.p4, q)
    return _Condition(
        x * x - 4 * p.p0 * value(p.p4, q),
        2 * x * dx - 4 * p.p0 * dy,
        2 * dx * dx - 8 * p.p0 * p.p4[2],
        x / (2 * p.p0),
    )


def _hurwitz(p: Characteristic, q: Scalar) -> _Condition:
    """Hurwitz' determinant over p1^2, r (p2 - p0 r) - p4 with r = p3/p1."""
    assert p.damped is not None
    f, r = p.damped.boundary, value(p.damped.ratio, q)
    # on the boundary r (p2 - p0 r) = p4: whichever of both r subtracts less. Large
    # damping makes p3 a small difference, and the sign of r that of p4
    rest = value(p.p2, q) - p.p0 * r
    size = _size(p.damped.ratio, q)
    lost = _size(p.p4, q) + jnp.abs(r) * (_size(p.p2, q) + p.p0 * size)
    other = rest * size > lost
    squared = jnp.where(other, value(p.p4, q) / jnp.where(other, rest, 1.0), r)
    return _Condition(value(f, q), slope(f, q), 2 * f[2], squared)


def _size(p: tuple[Scalar, ...], q: Scalar) -> Scalar:
    """The sum of the terms' sizes: times eps, the rounding of `value`."""
    return value(tuple(map(jnp.abs, p)), jnp.abs(q))


def _flutter(p: Characteristic, none: Bool[Array, ""] | None, q: Scalar) -> _Condition:
    """The condition of flutter; `none`: lanes that have a damping law and yet C = 0."""
    if none is None:
        return _discriminant(p, q)
    both = zip(_discriminant(p, q), _hurwitz(p, q), strict=True)
    return _Condition(*(jnp.where(none, x, y) for x, y in both))


def _static(p: Characteristic, q: Scalar) -> _Condition:
    """Det K."""
    return _Condition(value(p.p4, q), slope(p.p4, q), 2 * p.p4[2], jnp.zeros_like(q))


@partial(jax.jit, static_argnames="kind")
def _first_loss(p: Characteristic, kind: Kind) -> CriticalLoad:
    """The boundary of this kind, what precedes it, and the code.

    The search is not differentiated: a step of Chebyshev's method on the boundary
    function, exact for a quadratic to second order, carries both derivatives.
    """
    none = None if p.damped is None else p.damped.none
    at, code = _search(lax.stop_gradient(p), none, kind)
    stands = code >= int(CODE.preceded)
    at = jnp.where(stands, at, 0.0)
    condition = _static(p, at) if kind == "divergence" else _flutter(p, none, at)
    rate = jnp.where(stands, condition.slope, 1.0)
    step = condition.value / rate
    q = at - step - condition.bend / (2 * rate) * step * step
    mark = jnp.where(stands, 1.0, jnp.nan)
    if kind == "divergence":
        return CriticalLoad(  # pyright: ignore[reportCallIssue]
            q * mark, jnp.zeros_like(q) * mark, code, kind
        )
    squared = _flutter(p, none, q).squared
    oscillates = squared > 0
    frequency = jnp.sqrt(jnp.where(oscillates, squared, 1.0))
    frequency = jnp.where(oscillates, frequency, 0.0) * mark
    return CriticalLoad(q * mark, frequency, code, kind)  # pyright: ignore[reportCallIssue]


def _search(
    p: Characteristic, none: Bool[Array, ""] | None, kind: Kind
) -> tuple[Scalar, Int[Array, ""]]:
    """The load and its code, from roots of quadratics."""
    zero = jnp.zeros_like(p.p0)
    start = _flutter(p, none, zero)
    f = (start.value, start.slope, start.bend / 2)
    flutter, is_flutter, double = _root(f)
    # a root with omega^2 < 0 is a real pair, +-s
    oscillates = _flutter(p, none, flutter).squared > 0
    is_flutter, double = is_flutter & oscillates, double & oscillates
    divergence, is_divergence, touched = _divergence(p, none)
    load, exists = flutter, is_flutter
    before = is_divergence & (divergence < flutter)
    if kind == "flutter_end":
        load, ends, _ = _root(f, second=True)
        exists &= ends
    elif kind == "divergence":
        load, exists, double = divergence, is_divergence, touched
        before = is_flutter & (flutter < divergence)
    # stable at q = 0, or there is no first loss
    noise = 64 * jnp.finfo(zero.dtype).eps
    conservative = (p.p4[0] > 0) & (p.p2[0] > 0)
    one_frequency = start.value <= noise * p.p2[0] ** 2
    if p.damped is None:
        stable = conservative
    else:
        assert none is not None
        reached = (p.damped.ratio[0] > 0) & p.damped.reached
        stable = conservative & (none | ((p.damped.p1 > 0) & reached))
        one_frequency &= none
    if kind != "divergence":
        double |= one_frequency
    code = jnp.where(before, int(CODE.preceded), int(CODE.found))
    if none is not None and kind == "flutter":
        code = jnp.where(none & ~before, int(CODE.undamped), code)
    code = jnp.where(exists, code, int(CODE.no_load))
    code = jnp.where(double, int(CODE.double_root), code)
    code = jnp.where(stable, code, int(CODE.unstable_at_zero))
    code = jnp.where(p.valid, code, int(CODE.invalid))
    return load, code.astype(jnp.int32)


def _divergence(
    p: Characteristic, none: Bool[Array, ""] | None
) -> tuple[Scalar, Flag, Flag]:
    """Det K = 0, where a real eigenvalue goes right: s' = -p4'/p3, or s^2' = -p4'/p2.

    At the first root p4 falls and p3 (p2) must be positive, else a growing real s
    comes back through zero; then the second root, where p4 rises, is one.
    """

    def weight(q):
        if p.damped is None:
            return value(p.p2, q)
        assert none is not None
        rate = jnp.where(p.damped.p1 > 0, value(p.damped.ratio, q), jnp.nan)
        return jnp.where(none, value(p.p2, q), rate)

    first, exists, double = _root(p.p4)
    second, again, _ = _root(p.p4, second=True)
    here = exists & (weight(first) > 0)
    again = exists & again & (weight(second) < 0)
    return jnp.where(here, first, second), here | again, double


def _root(
    f: tuple[Scalar, Scalar, Scalar], second: bool = False
) -> tuple[Scalar, Flag, Flag]:
    """The first (or second) positive root of f0 + f1 q + f2 q^2 with f0 >= 0.

    Returns the root, whether it is one, and whether both positive roots coincide
    within 64 rounding errors of the discriminant.
    """
    f0, f1, f2 = f
    square, product = f1 * f1, 4 * f0 * f2
    gap = jnp.asarray(square - product)
    noise = 64 * jnp.finfo(gap.dtype).eps * (square + jnp.abs(product))
    double = (jnp.abs(gap) <= noise) & (f1 * f2 < 0)
    side = jnp.sqrt(jnp.maximum(gap, 0.0))
    if second:
        root = jnp.where(f1 < 0, (side - f1) / (2 * f2), -1.0)
    else:  # whichever form does not subtract near-equal numbers
        root = jnp.where(f1 > 0, (f1 + side) / (-2 * f2), 2 * f0 / (side - f1))
    return root, (gap > noise) & (root > 0) & jnp.isfinite(root), double
