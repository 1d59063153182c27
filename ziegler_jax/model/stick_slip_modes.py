r"""Which joints stick, and which slip where: the modes that agree with the forces.

Of all modes that agree with the law, with $\tau_s$ to be overcome, else with $\tau_k$,
the one in which fewest joints slip; of those the one whose slipping joints are the most
overloaded, and of such as are overloaded alike the first from the base on. Modes agree
where each joint at rest that sticks is held by no more than $\tau_s$, and each that is
to slip would have to be held by more than the least.

There always are some, as for any positive definite inertia; with loads that the modes
decide, as long as the loads' equations have one solution each.
"""

from collections.abc import Mapping, Sequence
from itertools import groupby, product
from typing import NamedTuple

import jax.numpy as jnp

from ..numerics.numbers import Flag, Numbers, Scalar
from ..numerics.series import sum_of

Modes = tuple[int, ...]  # 1, 0 or -1 for each joint, known now


class Holding(NamedTuple):
    """In some modes: the torques that hold the joints which stick, and the most."""

    torques: Numbers
    static: Numbers
    kinetic: Numbers


def with_one_held(n: int) -> list[Modes]:
    """All modes of n joints in which one sticks at least."""
    return [modes for modes in product((0, 1, -1), repeat=n) if 0 in modes]


def modes_number(modes: Sequence[Scalar]) -> Scalar:
    """Modes in one number, that they are not chosen once for each joint: in base 3."""
    number = modes[0]
    for m in modes[1:]:
        number = 3.0 * number + m
    return number


def modes_of(number: Scalar, n: int) -> Numbers:
    """The modes of n joints from their number."""
    modes = []
    for _ in range(n - 1):
        more = jnp.round(number / 3)
        modes.append(number - 3 * more)
        number = more
    return (*reversed([*modes, number]),)


def agreeing(
    holding: Mapping[Modes, Holding],
    given: Sequence[Scalar],
    rest: Sequence[Flag],
    otherwise: float = 0.0,
) -> Scalar:
    """The number of the modes that the sentence above chooses.

    **Arguments:** `holding`: of each of `with_one_held`; `given`: the modes of joints
    that are not at rest; `rest`: which joints are; `otherwise`: the modes of those
    where none agree, as rounding alone can have it.
    """
    n = len(given)
    still = holding[(0,) * n]
    overload = [
        jnp.where(r, abs(t) - most, 0.0)
        for r, t, most in zip(rest, still.torques, still.static, strict=True)
    ]

    def agrees(modes: Modes, level: str) -> Flag:
        every: Flag = True
        for i, m in enumerate(modes):
            beside = holding[*modes[:i], 0, *modes[i + 1 :]]
            torque = beside.torques[i]
            if m == 0:
                fits = rest[i] & (abs(torque) <= beside.static[i])
            else:
                slips = m * torque > getattr(beside, level)[i]
                fits = jnp.where(rest[i], slips, given[i] == m)
            every = every & fits
        return every

    begin = [jnp.where(r, otherwise, g) for r, g in zip(rest, given, strict=True)]
    chosen = modes_number(begin) + 0.0 * sum_of(overload)
    several = sorted(product((0, 1, -1), repeat=n), key=_in_turn)
    still_open: Flag = True
    for level in ("static", "kinetic"):
        for _, alike in groupby(several, key=_slipping):
            unmet, most = still_open, -jnp.inf
            for modes in alike:
                over = sum_of(
                    [0.0, *(x for x, m in zip(overload, modes, strict=True) if m)]
                )
                better = agrees(modes, level) & unmet & (over > most)
                chosen = jnp.where(better, float(modes_number(modes)), chosen)
                most = jnp.where(better, over, most)
                still_open &= jnp.logical_not(better)
    return chosen


def _slipping(modes: Modes) -> int:
    return len(modes) - modes.count(0)


def _in_turn(modes: Modes) -> tuple[int, list[bool]]:
    """Few that slip first, then those near the base."""
    return _slipping(modes), [m == 0 for m in modes]
