"""The forces that the joints transmit, and the friction loop that rests on them.

`column` is a `Column`, `forces` what `column.py` computes of one state: its y, the sine
and cosine of D, the right-hand sides r1, r2 without friction, and `solve`.
"""

from typing import NamedTuple, Protocol

import jax
import jax.numpy as jnp

from ..numerics.elementary import sincos
from ..numerics.materialise import materialise
from ..numerics.numbers import Pair, Scalar, Vector4
from .damping import AbstractDamping


class Rods(Protocol):
    """What of a `Column` the reactions rest on."""

    @property
    def q(self) -> Scalar:
        """The follower load."""
        ...

    @property
    def b(self) -> Scalar:
        """Rod 2's first moment about the knee."""
        ...

    @property
    def m2(self) -> Scalar | None:
        """Rod 2's mass."""
        ...

    @property
    def s1(self) -> Scalar | None:
        """Rod 1's first moment about the base."""
        ...

    @property
    def follower(self) -> Scalar | None:
        """The follower fraction."""
        ...

    @property
    def damping(self) -> AbstractDamping | None:
        """The damping law."""
        ...

    @property
    def tangential(self) -> bool:
        """Whether the load is known to follow rod 2."""
        ...


class Forces(Protocol):
    """What `column.py` computes of one state, without friction."""

    @property
    def y(self) -> Vector4:
        """The state."""
        ...

    @property
    def sin_d(self) -> Scalar:
        """The sine of D."""
        ...

    @property
    def cos_d(self) -> Scalar:
        """The cosine of D."""
        ...

    @property
    def r1(self) -> Scalar:
        """The right-hand side of rod 1."""
        ...

    @property
    def r2(self) -> Scalar:
        """The right-hand side of rod 2."""
        ...

    def solve(self, r1: Scalar, r2: Scalar) -> Pair:
        """Divide by the mass matrix."""
        ...


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


def joint_reactions(column: Rods, forces: Forces) -> Reactions:
    """The reactions of one state, still to be told its accelerations."""
    phi2, w1, w2 = forces.y[1], forces.y[2], forces.y[3]
    s, c = forces.sin_d, forces.cos_d
    assert column.m2 is not None and column.s1 is not None  # the callers saw to it
    # towards the centres of the rods' circles; rod 1 lies at D, rod 2 at 0
    along1, across1 = -w1 * w1 * c, -w1 * w1 * s
    along = column.m2 * along1 - column.b * w2 * w2
    across = column.m2 * across1
    if column.tangential:
        along = along + column.q
    else:
        assert column.follower is not None
        sin_f, cos_f = sincos((1 - column.follower) * phi2)
        along, across = along + column.q * cos_f, across - column.q * sin_f
    joint1 = along + column.s1 * along1, across + column.s1 * across1
    drag = None if column.damping is None else column.damping.drag()
    if drag is not None:  # the joints hold the rods against it
        f1, f2, f3 = drag[0] * w1, drag[1] * w1, drag[2] * w2
        joint1 = joint1[0] - s * (f1 + f2), joint1[1] + c * (f1 + f2) + f3
        along, across = along - s * f2, across + c * f2 + f3
    moments = column.m2 + column.s1, column.m2
    return Reactions((joint1, (along, across)), (s, c), moments, column.b)


def reaction_loads(
    column: Rods, forces: Forces, g1: Scalar, g2: Scalar, steps: int
) -> Pair:
    """N_i = |R_i(N)| under friction torques g_i N_i (see `JointReaction`)."""
    reactions = joint_reactions(column, forces)
    # accelerations without friction, and per unit of N1 and of N2
    free = forces.solve(forces.r1, forces.r2)
    by1, by2 = forces.solve(-g1, 0.0 * g1), forces.solve(g2, -g2)
    slopes = reactions.slope(*by1), reactions.slope(*by2)
    return solve_loads(reactions.at(*free), *slopes, steps)


def solve_loads(
    base: tuple[Pair, Pair],
    p1: tuple[Pair, Pair],
    p2: tuple[Pair, Pair],
    steps: int,
    unique: bool = False,
) -> Pair:
    """Solve N_i = |base_i + p1_i N_1 + p2_i N_2| by Newton; NaN if that fails.

    With `unique` also where the right-hand side is no contraction, so that there may
    be more solutions: where the matrix of the lengths |pj_i| has an eigenvalue of one
    and more.
    """
    tiny = 1e-30  # a reaction of exactly zero has no direction: let its slope be zero

    def magnitude(i, n1, n2):
        along, across = (base[i][k] + p1[i][k] * n1 + p2[i][k] * n2 for k in (0, 1))
        size = jnp.sqrt(along * along + across * across + tiny)
        d1 = (along * p1[i][0] + across * p1[i][1]) / size
        d2 = (along * p2[i][0] + across * p2[i][1]) / size
        return size, d1, d2

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
    n1, n2 = jax.lax.fori_loop(0, steps, lambda i, n: newton(*n), (n1, n2))
    left = jnp.abs(magnitude(0, n1, n2)[0] - n1) + jnp.abs(magnitude(1, n1, n2)[0] - n2)
    solved = left <= 1e-6 * (1 + jnp.abs(n1) + jnp.abs(n2))
    if unique:
        (s11, s21), (s12, s22) = (
            [along * along + across * across for along, across in p] for p in (p1, p2)
        )
        room = (1 - jnp.sqrt(s11)) * (1 - jnp.sqrt(s22))
        solved &= (s11 < 1) & (s22 < 1) & (room * room > s12 * s21)
    return jnp.where(solved, n1, jnp.nan), jnp.where(solved, n2, jnp.nan)
