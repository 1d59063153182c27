r"""Critical loads: where the column loses stability, and how that load moves.

Raised from zero, the load takes the column out of stability where an eigenvalue s
reaches the imaginary axis. On the axis the characteristic polynomial
$p_0 s^4 + p_1 s^3 + p_2(q) s^2 + p_3(q) s + p_4(q)$ leaves one condition on q:

- flutter, undamped: the two frequencies meet, $p_2 = 2 \sqrt{p_0 p_4}$, the
  discriminant $p_2^2 - 4 p_0 p_4$ in $s^2$;
- flutter, damped: a pair $\pm i \omega$, Hurwitz' determinant over $p_1^2$,
  $r (p_2 - p_0 r) - p_4$ with $\omega^2 = r(q) = p_3 / p_1$;
- divergence: s = 0, $p_4 = \det K$.

Each is a quadratic in q, so its roots are known without a search, and the one that an
eigenvalue crosses to the right is the critical load. The determinant over $p_1^2$
depends on the damping through ratios and det C alone: damping may be as small as
floating point allows.
"""

from functools import partial
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax

from ._characteristic import Characteristic, characteristic, slope, value
from ._types import Scalar
from ._variables import Variable
from .column import Column
from .linear import refuse_friction
from .outcome import CRITICAL

Kind = Literal["flutter", "divergence", "flutter_end"]
KINDS = ("flutter", "divergence", "flutter_end")


class CriticalLoad(eqx.Module):
    r"""A critical load.

    `q`: the load $F l/k$; `frequency`: $\omega = |{\rm Im}\, s|$ of the eigenvalue
    that crosses, in $\sqrt{k/(m l^2)}$, 0 for divergence; `outcome`: a code of
    `CRITICAL`.
    """

    q: jax.Array
    frequency: jax.Array
    outcome: jax.Array

    def variables(self) -> dict[str, Variable]:
        """The numbers as a sweep labels them."""
        return {
            "q_cr": Variable(self.q, "critical load", "k/l"),
            "frequency": Variable(
                self.frequency, "frequency at the critical load", "sqrt(k/(m l^2))"
            ),
            "outcome": Variable(
                self.outcome, "how the critical load was found", codes=CRITICAL
            ),
        }


def critical_load(column: Column, kind: Kind = "flutter") -> CriticalLoad:
    r"""The first load from q = 0 up at which the column loses stability.

    **Arguments:**

    - `column`: without friction; its own `q` does not matter.
    - `kind`: `"flutter"`, a pair $\pm i\omega$ leaves the imaginary axis to the right;
        `"divergence"`, a real eigenvalue passes zero to the right;
        `"flutter_end"`, of a column without damping law: the load above q_cr at which
        the two frequencies part again, as growing real s (the end of flutter under a
        pure follower load: divergence without $\det K = 0$), or on the axis.

    **Returns:** `.q`, `.frequency`, `.outcome`. The outcome is `found`; `preceded` if
    the other kind comes at a lower load, and at that load the column is lost already;
    `undamped` (below); `none` if no load crosses such a boundary. For `none`,
    `double_root`, `unstable_at_zero` and `invalid` the numbers and all their
    derivatives are NaN: to mask lanes in a sum that is differentiated, mask their
    parameters.

    **Derivatives:** forward and reverse, first and second, in every leaf, by two
    Newton steps on the boundary function (the implicit function theorem): exact where
    the eigenvalues' own are infinite. They grow as $1/\sqrt{\cdot}$ towards a double
    root, where two boundary loads coincide: within 64 rounding errors of it the
    outcome is `double_root`. Where the two kinds exchange (equal loads) each keeps its
    own load and derivative, and only the outcome changes.

    **Small damping.** As $C \to 0$ the damped q_cr has a limit that depends on the
    ratio c1/c2 and lies below the undamped q_cr for every ratio but one: Ziegler's
    paradox. Any c below 1e-9 gives that limit to rounding; derivatives in c grow as
    1/c across the ratio. At C = 0 exactly (`Viscous(0, 0)`) the column is undamped and
    so is the load returned, as with `damping=None`; but q_cr jumps there and has no
    derivative in the damping. The one returned is zero, and the outcome `undamped`
    (or `preceded`) says so.

    **Raises:** `ValueError` for friction, for an unknown `kind`, and for
    `"flutter_end"` with a damping law: there the end is no root of a quadratic.

    Source: H. Ziegler, Ingenieur-Archiv 20 (1952) 49-56; O. N. Kirillov,
    Nonconservative Stability Problems of Modern Physics (2013).
    """
    refuse_friction("critical_load", column)
    if kind not in KINDS:
        raise ValueError(
            f"Argument `kind` must be one of {', '.join(KINDS)}, but is {kind!r}."
        )
    p = characteristic(column)
    if kind == "flutter_end" and p.p1 is not None:
        raise ValueError(
            "Argument `kind` must be 'flutter' or 'divergence' for a column with "
            "damping, but is 'flutter_end': take `damping=None`."
        )
    return _first_loss(p, kind)


class _Boundary(NamedTuple):
    """A root of a boundary function: q, omega^2 there, and whether it is one."""

    q: Scalar
    squared: Scalar
    exists: Scalar
    double: Scalar


@partial(jax.jit, static_argnames="kind")
def _first_loss(p: Characteristic, kind: Kind) -> CriticalLoad:
    """The boundary of this kind, what precedes it, and the code."""
    none = None  # lanes that have a damping law and yet C = 0
    if p.p1 is None or p.p3 is None:
        flutter = _undamped_flutter(p)
    else:
        none = (p.p1 == 0) & (p.p3[0] == 0) & (p.p3[1] == 0)
        flutter = _damped_flutter(p)
        undamped = _undamped_flutter(p)
        flutter = jax.tree.map(lambda x, y: jnp.where(none, x, y), undamped, flutter)
    divergence = _divergence(p, none)
    if kind == "divergence":
        mine, other = divergence, flutter
    else:
        mine, other = flutter, divergence
    before = other.exists & (other.q < mine.q)
    if kind == "flutter_end":
        mine = _flutter_end(p, flutter)
    code = jnp.where(before, int(CRITICAL.preceded), int(CRITICAL.found))
    if none is not None and kind == "flutter":
        code = jnp.where(none & ~before, int(CRITICAL.undamped), code)
    code = jnp.where(mine.exists, code, int(CRITICAL.none))
    code = jnp.where(mine.double, int(CRITICAL.double_root), code)
    stable = _stable_at_zero(p, none)
    code = jnp.where(stable, code, int(CRITICAL.unstable_at_zero))
    code = jnp.where(p.valid, code, int(CRITICAL.invalid)).astype(jnp.int32)
    mark = jnp.where(code >= int(CRITICAL.preceded), 1.0, jnp.nan)
    squared = jnp.where(mine.squared > 0, mine.squared, 1.0)
    frequency = jnp.where(mine.squared > 0, jnp.sqrt(squared), 0.0)
    return CriticalLoad(mine.q * mark, frequency * mark, code)


def _undamped_flutter(p: Characteristic, end: bool = False) -> _Boundary:
    """The frequencies meet: p2 = 2 sqrt(p0 p4), with omega^2 = p2 / (2 p0)."""
    p0, (b0, b1), (c0, c1, c2) = p.p0, p.p2, p.p4
    f = (b0 * b0 - 4 * p0 * c0, 2 * (b0 * b1 - 2 * p0 * c1), b1 * b1 - 4 * p0 * c2)
    root, exists, double = _quadratic(f, end)
    # G(0) >= 0 for symmetric M and K: zero means one frequency for both modes
    noise = 64 * jnp.finfo(f[0].dtype).eps * b0 * b0
    double |= lax.stop_gradient((f[0] <= noise) & (f[2] != 0))
    at = lax.stop_gradient(jnp.where(exists | double, root, 0.0))
    p2, p4 = lax.stop_gradient((value(p.p2, at), value(p.p4, at)))
    # the eigenvalues that meet must be imaginary; at the end they may be real
    sign = jnp.where(p2 < 0, -1.0, 1.0)
    good = (p4 > 0) if end else (p4 > 0) & (p2 > 0)
    exists, double = exists & good, double & good

    def boundary(q):
        inside = p0 * value(p.p4, q)
        side = jnp.sqrt(jnp.where(inside > 0, inside, 1.0))
        return (
            value(p.p2, q) - 2 * sign * side,
            slope(p.p2, q) - sign * p0 * slope(p.p4, q) / side,
        )

    q = _implicit(boundary, at, exists)
    return _Boundary(q, value(p.p2, q) / (2 * p0), exists, double)


def _flutter_end(p: Characteristic, flutter: _Boundary) -> _Boundary:
    """The other root of the discriminant, if flutter began at the first."""
    end = _undamped_flutter(p, end=True)
    return end._replace(exists=end.exists & flutter.exists)


def _damped_flutter(p: Characteristic) -> _Boundary:
    """Hurwitz' determinant over p1^2, r (p2 - p0 r) - p4, with omega^2 = r."""
    assert p.p1 is not None and p.p3 is not None
    p0 = p.p0
    # unit p1 before dividing: derivatives of p3/p1 square p1, and underflow
    scale = lax.stop_gradient(1 / jnp.where(p.p1 > 0, p.p1, 1.0))
    p1 = jnp.where(p.p1 > 0, p.p1 * scale, 1.0)
    r = (p.p3[0] * scale / p1, p.p3[1] * scale / p1)
    rest = (p.p2[0] - p0 * r[0], p.p2[1] - p0 * r[1])
    f = (
        r[0] * rest[0] - p.p4[0],
        r[0] * rest[1] + r[1] * rest[0] - p.p4[1],
        r[1] * rest[1] - p.p4[2],
    )
    root, exists, double = _quadratic(f)
    at = lax.stop_gradient(jnp.where(exists | double, root, 0.0))
    good = value(r, at) > 0  # else the roots are a real pair, +-sqrt(-r)
    exists, double = exists & good, double & good

    def boundary(q):
        left, right = value(r, q), value(rest, q)
        return (
            left * right - value(p.p4, q),
            r[1] * right + left * rest[1] - slope(p.p4, q),
        )

    q = _implicit(boundary, at, exists)
    return _Boundary(q, value(r, q), exists, double)


def _divergence(p: Characteristic, none: Any) -> _Boundary:
    """Det K = 0, where a real eigenvalue goes right: s' = -p4'/p3, or s^2' = -p4'/p2.

    At the first root p4 falls and p3 (p2) must be positive, else a growing real s
    comes back through zero; then the second root, where p4 rises, is one.
    """

    def weight(q):
        if p.p3 is None:
            return value(p.p2, q)
        return jnp.where(none, value(p.p2, q), value(p.p3, q))

    first, exists, double = _quadratic(p.p4)
    second, again, _ = _quadratic(p.p4, end=True)
    here = exists & (weight(first) > 0)
    again = exists & again & (weight(second) < 0)
    at = jnp.where(here, first, second)
    exists = here | again
    at = lax.stop_gradient(jnp.where(exists, at, 0.0))
    q = _implicit(lambda q: (value(p.p4, q), slope(p.p4, q)), at, exists)
    return _Boundary(q, jnp.zeros_like(q), exists, double)


def _stable_at_zero(p: Characteristic, none: Any) -> Any:
    """Hurwitz at q = 0. Without damping: both stiffnesses positive."""
    conservative = (p.p4[0] > 0) & (p.p2[0] > 0)
    if p.p1 is None or p.p3 is None:
        return conservative
    r = p.p3[0] / jnp.where(p.p1 > 0, p.p1, 1.0)
    # zero here is a mode that the damping does not reach
    noise = 64 * jnp.finfo(r.dtype).eps * r * p.p2[0]
    damped = (p.p1 > 0) & (r > 0) & (r * (p.p2[0] - p.p0 * r) - p.p4[0] > noise)
    return conservative & (none | damped)


def _quadratic(f: tuple[Scalar, Scalar, Scalar], end: bool = False) -> tuple[Any, ...]:
    """The first (or second) positive root of f0 + f1 q + f2 q^2 with f0 >= 0.

    Returns the root, whether it is one, and whether both positive roots coincide
    within 64 rounding errors of the discriminant.
    """
    f0, f1, f2 = lax.stop_gradient(f)
    square, product = f1 * f1, 4 * f0 * f2
    gap = square - product
    noise = 64 * jnp.finfo(gap.dtype).eps * (square + jnp.abs(product))
    double = (jnp.abs(gap) <= noise) & (f1 * f2 < 0)
    side = jnp.sqrt(jnp.maximum(gap, 0.0))
    if end:
        root = jnp.where(f1 < 0, (side - f1) / (2 * f2), -1.0)
    else:  # whichever form does not subtract near-equal numbers
        root = jnp.where(f1 > 0, (f1 + side) / (-2 * f2), 2 * f0 / (side - f1))
    return root, (gap > noise) & (root > 0) & jnp.isfinite(root), double


def _implicit(boundary: Any, at: Scalar, exists: Any) -> Any:
    """Two Newton steps from a root known to rounding, whose own gradient is stopped.

    They polish the value; the first makes the first derivative that of the implicit
    function theorem, the second the second derivative.
    """
    q = at
    for _ in range(2):
        error, rate = boundary(q)
        q = q - error / jnp.where(exists, rate, 1.0)
    return q
