"""Columns of two uniform rods, and of two point masses."""

from typing import TypedDict, Unpack

from ..numerics.numbers import (
    Scalar,
    check_options,
    positive,
)
from .column import Column
from .damping import AbstractDamping
from .friction import AbstractFriction

PARTS = ("kappa", "follower", "damping", "friction")  # of any column


class Parts(TypedDict, total=False):
    """Those parts; what is left out is the column's own default."""

    kappa: Scalar
    follower: Scalar
    damping: AbstractDamping | None
    friction: AbstractFriction | None


def uniform_rods(
    q: Scalar = 0.0,
    *,
    m1: Scalar = 1.0,
    m2: Scalar = 1.0,
    l2: Scalar = 1.0,
    **parts: Unpack[Parts],
) -> Column:
    r"""Two uniform rods, as in "Modeling stability of Ziegler column ...".

    $a = m_1/3 + m_2,\ b = m_2 l_2/2,\ d = m_2 l_2^2/3$: with equal rods
    (the default) 4/3, 1/2, 1/3.

    **Arguments:**

    - `q`: the follower load.
    - `m1`, `m2`: the rods' masses in the reference mass m; `l2`: rod 2's length in l.
    - `parts`: `kappa`, `follower`, `damping`, `friction` of `Column`.
    """
    check_options("uniform_rods", parts, ("m1", "m2", "l2", *PARTS))
    m1, m2, l2 = positive(m1=m1, m2=m2, l2=l2)
    a, b, d = m1 / 3 + m2, m2 * l2 / 2, m2 * l2**2 / 3
    return Column(q, a, b, d, m2=m2, s1=m1 / 2, l2=l2, **parts)


def point_masses(
    m1: Scalar = 2.0,
    m2: Scalar = 1.0,
    q: Scalar = 0.0,
    *,
    l2: Scalar = 1.0,
    **parts: Unpack[Parts],
) -> Column:
    r"""Massless rods, m1 at the knee and m2 at the tip: Ziegler's are 2 and 1.

    $a = m_1 + m_2,\ b = m_2 l_2,\ d = m_2 l_2^2$. The knee's mass counts as rod 1's:
    joint 2 carries the tip mass alone.

    **Arguments:** `m1`, `m2` in the reference mass m, `l2` in l; else as
    `uniform_rods`. Source: H. Ziegler, Ingenieur-Archiv 20 (1952) 49-56.
    """
    check_options("point_masses", parts, ("m1", "m2", "l2", *PARTS))
    m1, m2, l2 = positive(m1=m1, m2=m2, l2=l2)
    return Column(q, m1 + m2, m2 * l2, m2 * l2**2, m2=m2, s1=m1, l2=l2, **parts)
