"""The forces that the joints of two rods transmit, and the loop of loads they close."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp

from ..numerics.materialise import materialise
from ..numerics.numbers import Pair, Scalar
from .loads import Reaction


class Bodies(NamedTuple):
    """What the reactions of two rods rest on."""

    m2: Scalar  # rod 2's mass
    s1: Scalar  # rod 1's first moment about the base
    b: Scalar  # rod 2's first moment about the knee


class Reactions(NamedTuple):
    """Both joints' reactions in rod 2's frame: (along, across), affine in a1 and a2."""

    still: tuple[Pair, Pair]  # without accelerations
    turned: Pair  # sine and cosine of D: across rod 1 is where a1 acts
    moments: Pair  # of rod 1 and what hangs on its end, about the joint: by a1
    b: Scalar  # and of rod 2 about the knee: by a2

    def slope(self, a1: Scalar, a2: Scalar) -> tuple[Pair, Pair]:
        """What accelerations add to the reactions."""
        s, c = self.turned
        pulls = [m * a1 for m in self.moments]
        first, second = ((-x * s, x * c + self.b * a2) for x in pulls)
        return first, second

    def at(self, a1: Scalar, a2: Scalar) -> tuple[Pair, Pair]:
        """The reactions under these accelerations."""
        pairs = zip(self.still, self.slope(a1, a2), strict=True)
        first, second = ((x + dx, y + dy) for (x, y), (dx, dy) in pairs)
        return first, second


def reactions_of(
    bodies: Bodies,
    rates: Sequence[Scalar],
    turned: Pair,
    pull: tuple[Scalar, Scalar | None],
    drag: tuple[Scalar, Scalar, Scalar] | None,
) -> Reactions:
    """The reactions of one state, still to be told its accelerations.

    **Arguments:** `turned`: sine and cosine of D; `pull`: the load along rod 2 and
    across it; `drag`: of the damping law.
    """
    (m2, s1, b), (w1, w2), (s, c) = bodies, rates, turned
    # towards the centres of the rods' circles; rod 1 lies at D, rod 2 at 0
    along1, across1 = -w1 * w1 * c, -w1 * w1 * s
    along, across = m2 * along1 - b * w2 * w2 + pull[0], m2 * across1
    if pull[1] is not None:
        across = across + pull[1]
    joint1 = along + s1 * along1, across + s1 * across1
    if drag is not None:  # the joints hold the rods against it
        f1, f2, f3 = drag[0] * w1, drag[1] * w1, drag[2] * w2
        joint1 = joint1[0] - s * (f1 + f2), joint1[1] + c * (f1 + f2) + f3
        along, across = along - s * f2, across + c * f2 + f3
    return Reactions((joint1, (along, across)), (s, c), (m2 + s1, m2), b)


def solve_loads(
    base: tuple[Pair, Pair],
    slopes: Sequence[tuple[Pair, Pair]],
    load: Reaction,
    unique: bool = False,
) -> Pair:
    """Solve N_i = |base_i + p1_i N_1 + p2_i N_2| + n_i by Newton; NaN if that fails.

    **Arguments:** `load`: the number of Newton's steps and the preload n, if any.

    With `unique` also where the right-hand side is no contraction, so that there may
    be more solutions: where the matrix of the lengths |pj_i| has an eigenvalue of one
    and more.
    """
    p1, p2 = slopes
    tiny = 1e-30  # a reaction of exactly zero has no direction: let its slope be zero

    def magnitude(i, n1, n2):
        along, across = (base[i][k] + p1[i][k] * n1 + p2[i][k] * n2 for k in (0, 1))
        size = jnp.sqrt(along * along + across * across + tiny)
        normal = size if load.preload is None else size + load.preload[i]
        d1 = (along * p1[i][0] + across * p1[i][1]) / size
        d2 = (along * p2[i][0] + across * p2[i][1]) / size
        return normal, d1, d2

    def newton(n1, n2):
        f1, d11, d12 = magnitude(0, n1, n2)
        f2, d21, d22 = magnitude(1, n1, n2)
        e1, e2 = f1 - n1, f2 - n2
        det = (1 - d11) * (1 - d22) - d12 * d21
        return (
            n1 + ((1 - d22) * e1 + d12 * e2) / det,
            n2 + (d21 * e1 + (1 - d11) * e2) / det,
        )

    at = base[0][0]  # a step fused into the next would be computed for each of its uses
    n1, n2 = materialise(
        at, lambda: (magnitude(0, 0.0, 0.0)[0], magnitude(1, 0.0, 0.0)[0])
    )
    n1, n2 = jax.lax.fori_loop(0, load.steps, lambda i, n: newton(*n), (n1, n2))
    left = jnp.abs(magnitude(0, n1, n2)[0] - n1) + jnp.abs(magnitude(1, n1, n2)[0] - n2)
    solved = left <= 1e-6 * (1 + jnp.abs(n1) + jnp.abs(n2))
    if unique:
        (s11, s21), (s12, s22) = (
            [along * along + across * across for along, across in p] for p in (p1, p2)
        )
        room = (1 - jnp.sqrt(s11)) * (1 - jnp.sqrt(s22))
        solved &= (s11 < 1) & (s22 < 1) & (room * room > s12 * s21)
    return jnp.where(solved, n1, jnp.nan), jnp.where(solved, n2, jnp.nan)
