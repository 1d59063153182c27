"""Columns of two uniform rods, and of two point masses."""

from __future__ import annotations

from typing import NamedTuple, TypedDict, Unpack

from ..numerics.numbers import Scalar
from ..numerics.rules import check_options, positive
from .column import Column
from .damping import AbstractDamping
from .friction import AbstractFriction

BODIES = ("m1", "m2", "l1", "l2")
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
    m1: Scalar | None = None,
    m2: Scalar | None = None,
    l1: Scalar | None = None,
    l2: Scalar | None = None,
    **parts: Unpack[Parts],
) -> Column:
    r"""Two uniform rods, as in "Modeling stability of Ziegler column ...".

    $a = m_1/3 + m_2,\ b = m_2 l_2/2,\ d = m_2 l_2^2/3$: with equal rods
    (the default) 4/3, 1/2, 1/3.

    **Arguments:**

    - `q`: the follower load.
    - `m1`, `m2`: the rods' masses in the reference mass m; `l2`: rod 2's length in l.
        None is 1.
    - `l1`: rod 1's length in m, of a column in SI units: then q is in N, the masses
        are in kg and l2 is in m, all three are given, and `SI.scaled` takes the column
        (see `Column`).
    - `parts`: `kappa`, `follower`, `damping`, `friction` of `Column`.

    **Raises:** `ValueError` where a concrete number breaks its rule, and for a mass or
    length that is left out beside `l1`.
    """
    check_options("uniform_rods", parts, (*BODIES, *PARTS))
    m1, m2, l2 = _bodies(l1, m1=(m1, 1.0), m2=(m2, 1.0), l2=(l2, 1.0))
    a, b, d = m1 / 3 + m2, m2 * l2 / 2, m2 * l2**2 / 3
    return _made(q, l1, Bodies(a, b, d, m2, m1 / 2, l2), parts)


def point_masses(
    m1: Scalar | None = None,
    m2: Scalar | None = None,
    q: Scalar = 0.0,
    *,
    l1: Scalar | None = None,
    l2: Scalar | None = None,
    **parts: Unpack[Parts],
) -> Column:
    r"""Massless rods, m1 at the knee and m2 at the tip: Ziegler's are 2 and 1.

    $a = m_1 + m_2,\ b = m_2 l_2,\ d = m_2 l_2^2$. The knee's mass counts as rod 1's:
    joint 2 carries the tip mass alone.

    **Arguments:** `m1`, `m2` in the reference mass m, `l2` in l; else as
    `uniform_rods`. Source: H. Ziegler, Ingenieur-Archiv 20 (1952) 49-56.

    **Raises:** as `uniform_rods`.
    """
    check_options("point_masses", parts, (*BODIES, *PARTS))
    m1, m2, l2 = _bodies(l1, m1=(m1, 2.0), m2=(m2, 1.0), l2=(l2, 1.0))
    return _made(q, l1, Bodies(m1 + m2, m2 * l2, m2 * l2**2, m2, m1, l2), parts)


class Bodies(NamedTuple):
    """Inertia and lengths where rod 1 has the length 1, as `Column` calls them."""

    a: Scalar
    b: Scalar
    d: Scalar
    m2: Scalar
    s1: Scalar
    l2: Scalar


def _bodies(l1: Scalar | None, **given: tuple[Scalar | None, float]) -> list[Scalar]:
    """Masses and lengths, each with its default.

    **Raises:** `ValueError` for one that is left out beside `l1`: a default of 1 would
    be a kilogram or a metre.
    """
    for name, (value, _) in given.items():
        if value is None and l1 is not None:
            raise ValueError(
                f"Argument `{name}` must be given where `l1` is, as in SI units "
                "nothing has a default, but is None."
            )
    return positive(**{n: usual if x is None else x for n, (x, usual) in given.items()})


def _made(q: Scalar, l1: Scalar | None, bodies: Bodies, parts: Parts) -> Column:
    """The column; with a rod 1 of length l1 where that is given."""
    a, b, d, m2, s1, l2 = bodies
    if l1 is not None:
        (l1,) = positive(l1=l1)
        a, b, s1 = a * l1**2, b * l1, s1 * l1
    return Column(q, a, b, d, m2=m2, s1=s1, l2=l2, l1=l1, **parts)
