r"""A plane chain of n rods on springs: what is the same for any n.

With the rods' angles $\phi_i$ from the vertical, their rates $\omega_i$, the joints'
angles $\theta_1 = \phi_1$, $\theta_i = \phi_i - \phi_{i-1}$ and constant moments
$J_{ij} = J_{ji}$,

$$\sum_j J_{ij} \bigl(\cos(\phi_i - \phi_j)\, \dot\omega_j
+ \sin(\phi_i - \phi_j)\, \omega_j^2\bigr)
= Q_i - k_i \theta_i + k_{i+1} \theta_{i+1} - T_i + T_{i+1},$$

with the other forces $Q_i$ and the joints' friction torques $T_i$. All is written out
over scalars: a chain is short, and lanes are many.

A symmetric matrix is given by the rows of its lower triangle: of two rods with the mass
matrix [[a, h], [h, d]], `((a,), (h, d))`.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero

from ..numerics.elementary import sincos
from ..numerics.materialise import materialise
from ..numerics.numbers import Flag, Numbers, Scalar
from ..numerics.series import sum_of

SHORT = 4  # rods of a chain whose forces are cheap enough to be computed anew
Rows = tuple[Numbers, ...]  # of the lower triangle
Turned = Mapping[tuple[int, int], tuple[Scalar, Scalar]]


class Follower(eqx.Module):
    r"""A force that turns with a rod: $w q$ at angle $\eta \phi$ to the vertical."""

    rod: int = eqx.field(static=True)  # which, from 0
    weight: Scalar | None = None  # w; None: 1
    eta: Scalar | None = None  # None: known to be 1, along the rod
    lever: Scalar | None = None  # where on its rod; None: 1


def joint_angles(phi: Sequence[Scalar]) -> Numbers:
    """The turn of each joint, from the rods' angles, rates or accelerations."""
    return phi[0], *(b - a for a, b in zip(phi, phi[1:], strict=False))


def on_rods(torques: Sequence[Scalar]) -> Numbers:
    """The torque that the joints take from each rod, T_i - T_(i+1)."""
    pairs = zip(torques, torques[1:], strict=False)
    return *(a - b for a, b in pairs), torques[-1]


def straight(n: int) -> Turned:
    """Sine and cosine of no angle between any two rods."""
    return {(i, j): (0.0, 1.0) for i in range(n) for j in range(i + 1, n)}


def spread(lengths: Sequence[Scalar], density: Sequence[Scalar]) -> Rows:
    r"""Moments of what is spread evenly along the rods, so much a unit of length.

    $$A_{ij} = \sum_k w_k \int_0^{l_k} r_{ki} r_{kj}\, ds, \qquad
    r_{ki} = l_i \ (i < k),\ s \ (i = k),\ 0 \ (i > k)$$
    """
    n = len(lengths)
    rows = [[0.0 * density[0]] * (i + 1) for i in range(n)]
    for k, (l, w) in enumerate(zip(lengths, density, strict=True)):  # noqa: E741
        for i in range(k + 1):
            for j in range(i + 1):
                if j == k:
                    part = w * l**3 / 3
                elif i == k:
                    part = w * l**2 / 2 * lengths[j]
                else:
                    part = w * l * lengths[i] * lengths[j]
                rows[i][j] = rows[i][j] + part
    return tuple(map(tuple, rows))


def turned(phi: Sequence[Scalar]) -> Turned:
    """Sine and cosine of phi_i - phi_j for i < j.

    Of neighbours by one call each, of others by the theorems of addition.
    """
    n = len(phi)
    known = {(i, i + 1): sincos(phi[i] - phi[i + 1]) for i in range(n - 1)}
    for gap in range(2, n):
        for i in range(n - gap):
            (s1, c1), (s2, c2) = known[i, i + gap - 1], known[i + gap - 1, i + gap]
            known[i, i + gap] = s1 * c2 + c1 * s2, c1 * c2 - s1 * s2
    return known


class Factored(NamedTuple):
    """A mass matrix from whose tip on each rod was let go, or welded to its joint."""

    rows: Rows  # of each rod: what couples it to those before
    shares: Rows  # over its own inertia
    inverse: Numbers  # one over that


def factored(mass: Rows, stuck: Sequence[Flag] | None = None) -> Factored:
    """The mass matrix, ready to be divided by.

    **Arguments:** `stuck`: which joints are held; None: none is.
    """
    stuck = [False] * len(mass) if stuck is None else stuck
    rows, n = [list(row) for row in mass], len(mass)
    shares: list[Numbers] = [()] * n
    inverse = [rows[0][0]] * n
    for k in reversed(range(n)):
        *row, own = rows[k]
        inverse[k] = 1 / own
        shares[k] = tuple(h * inverse[k] for h in row)
        for i in range(k):
            for j in range(i + 1):
                joined, free = rows[i][j], rows[i][j] - shares[k][i] * row[j]
                if i == k - 1:
                    joined = joined + (2 * row[j] + own if j == i else row[j])
                rows[i][j] = _either(stuck[k], joined, free)
    return Factored(tuple(tuple(row[:-1]) for row in rows), tuple(shares), (*inverse,))


def is_definite(moments: Sequence[Scalar], n: int) -> Flag:
    """Whether a symmetric matrix, its lower triangle row by row, is positive definite.

    By the pivots of elimination; one that is left by rounding alone is none.
    """
    numbers, good = iter(moments), True
    rows = [[next(numbers) for _ in range(i + 1)] for i in range(n)]
    diagonal = [row[-1] for row in rows]
    for k in reversed(range(n)):
        *row, own = rows[k]
        good &= (own > 1e-14 * diagonal[k]) & (diagonal[k] > 0)
        shares = [x / _either(own > 0, own, 1.0) for x in row]
        for i in range(k):
            for j in range(i + 1):
                rows[i][j] = rows[i][j] - shares[i] * row[j]
    return good


def _either(flag: Flag, new: Scalar, old: Scalar) -> Scalar:
    """`new` where the flag is set, else `old`; of one that is known nothing is left."""
    if isinstance(flag, bool | np.bool_):
        return new if flag else old
    return jnp.where(flag, new, old)


def accelerated(
    parts: Factored,
    right: Sequence[Scalar],
    stuck: Sequence[Flag] | None = None,
    token: Scalar | None = None,
) -> Numbers:
    """The rods' accelerations under these forces, from the base on.

    **Arguments:** `stuck`: as of `factored`; `token`: a traced number of the lane, by
    which each acceleration that others need is kept (see `materialise`).
    """
    n, r, x = len(right), list(right), []
    stuck = [False] * n if stuck is None else stuck
    for k in reversed(range(n)):
        for i in range(k):
            joined = r[i] + r[k] if i == k - 1 else r[i]
            r[i] = _either(stuck[k], joined, r[i] - parts.shares[k][i] * r[k])
    for k in range(n):

        def one(k=k):
            left = r[k]
            for h, other in zip(parts.rows[k], x, strict=True):
                left = left - h * other
            return _either(
                stuck[k], x[-1] if k else 0.0 * r[0], left * parts.inverse[k]
            )

        if token is None or k == n - 1:
            x.append(one())
        else:
            x.append(materialise(token, one))
    return tuple(x)


@jax.custom_jvp
def solved(mass: Rows, right: Numbers) -> Numbers:
    """The accelerations of a chain whose joints all move, M x = r."""
    return accelerated(factored(mass), right, token=right[0])


@partial(solved.defjvp, symbolic_zeros=True)
def _solved_jvp(primals, tangents):
    """M dx = dr - dM x: with the solution x, not with a quotient's derivative."""
    (mass, right), (dmass, dright) = primals, tangents
    parts = factored(mass)
    x = accelerated(parts, right, token=right[0])

    def forces():
        left = []
        for i, dr in enumerate(dright):
            terms = [] if isinstance(dr, SymbolicZero) else [dr]
            for j, xj in enumerate(x):
                dm = dmass[max(i, j)][min(i, j)]
                if not isinstance(dm, SymbolicZero):
                    terms.append(dm * -xj)
            left.append(sum_of(terms) if terms else jnp.zeros_like(x[i]))
        return left

    if len(mass) > SHORT:
        # each acceleration would come with all forces, and the other ones, once more
        left = materialise(right[0], forces)
        return x, accelerated(parts, left, token=right[0])
    return x, accelerated(parts, forces())


def welded(rest: Sequence[Flag], rates: Sequence[Scalar]) -> Numbers:
    """The rods' rates, with those of joints at rest exactly zero."""
    after: list[Scalar] = []
    for still, rate in zip(rest, rates, strict=True):
        after.append(_either(still, after[-1] if after else 0.0 * rate, rate))
    return tuple(after)


def moved(mass: Rows, x: Sequence[Scalar]) -> Numbers:
    """M x: the momenta of rates, the forces of accelerations."""
    n = range(len(x))
    return tuple(sum_of([mass[max(i, j)][min(i, j)] * x[j] for j in n]) for i in n)


def holding_torques(
    mass: Rows, right: Sequence[Scalar], x: Sequence[Scalar]
) -> Numbers:
    """The remainder of forces over accelerations, summed from the tip to each joint.

    That is the torque that holds a joint which sticks, and the whole torque in one that
    slips.
    """
    sums, carried = [], None
    for r, inertia in reversed(list(zip(right, moved(mass, x), strict=True))):
        left = r - inertia
        carried = left if carried is None else left + carried
        sums.append(carried)
    return tuple(reversed(sums))
