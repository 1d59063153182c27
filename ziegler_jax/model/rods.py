"""Columns of two uniform rods and of two point masses, and chains of the literature."""

from __future__ import annotations

from typing import NamedTuple, TypedDict, Unpack

import jax.numpy as jnp
import numpy as np

from ..numerics.numbers import Joints, Scalar, is_concrete
from ..numerics.rules import check_options, number, positive
from .chain_of_rods import MOST_RODS, Chain
from .column import Column
from .damping import AbstractDamping
from .forces import DeadLoad, FollowerForces, Forces, Gravity
from .friction import AbstractFriction

BODIES = ("m1", "m2", "l1", "l2")
TIP = ("tip_mass", "tip_inertia")
COMMON = ("damping", "friction", "forces", "rest_angles")
COMMON += ("dead_load", "gravity", "foundation")
PARTS = ("kappa", "follower", *COMMON, *TIP)  # of any column
NUMBERS = ("kappa", "follower", "rest_angles", "foundation", *TIP)  # of these


class CommonParts(TypedDict, total=False):
    """Parts of columns and chains alike."""

    damping: AbstractDamping | None
    friction: AbstractFriction | None
    rest_angles: Joints | None
    dead_load: DeadLoad | None
    gravity: Gravity | None
    foundation: Joints | None
    forces: Forces | None


class ColumnParts(CommonParts, total=False):
    """Of a column; what is left out is its own default."""

    kappa: Scalar
    follower: Scalar


class Parts(ColumnParts, total=False):
    """The same, and what is fixed to its tip."""

    tip_mass: Scalar | None
    tip_inertia: Scalar | None


class ChainParts(CommonParts, total=False):
    """Of a chain of the literature."""

    air: Joints | None
    tip_inertia: Scalar | None


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
    - `parts`: `kappa`, `follower`, `damping`, `friction`, `rest_angles`, `dead_load`,
        `gravity`, `foundation`, `forces` of `Column`; `tip_mass` and `tip_inertia`, a
        mass at the tip and its rotary inertia, in m and m l^2.

    **Raises:** `ValueError` where a concrete number breaks its rule, and for a mass or
    length that is left out beside `l1`.
    """
    check_options("uniform_rods", parts, (*BODIES, *PARTS))
    m1, m2, l2 = _bodies(l1, m1=(m1, 1.0), m2=(m2, 1.0), l2=(l2, 1.0))
    a, b, d = m1 / 3 + m2, m2 * l2 / 2, m2 * l2**2 / 3
    return _made(q, l1, Bodies(a, b, d, m2, m1 / 2, l2), **parts)


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
    return _made(q, l1, Bodies(m1 + m2, m2 * l2, m2 * l2**2, m2, m1, l2), **parts)


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


def _made(
    q: Scalar,
    l1: Scalar | None,
    bodies: Bodies,
    tip_mass: Scalar | None = None,
    tip_inertia: Scalar | None = None,
    **parts: Unpack[ColumnParts],
) -> Column:
    """The column; with a rod 1 of length l1 where that is given."""
    a, b, d, m2, s1, l2 = bodies
    if tip_mass is not None:
        hung = _nonnegative(tip_mass=tip_mass)
        a, b, d, m2 = a + hung, b + hung * l2, d + hung * l2**2, m2 + hung
    if tip_inertia is not None:
        d = d + _nonnegative(tip_inertia=tip_inertia)
    if l1 is not None:
        (l1,) = positive(l1=l1)
        a, b, s1 = a * l1**2, b * l1, s1 * l1
    return Column(q, a, b, d, m2=m2, s1=s1, l2=l2, l1=l1, **parts)


def _nonnegative(**value: Scalar) -> Scalar:
    """One number; NaN for a traced one that is negative, so that a lane is invalid."""
    ((name, x),) = value.items()
    x = number(name, x, "nonnegative")
    return x if is_concrete(x) else jnp.where(x >= 0, x, jnp.nan)


def beck(n: int, q: Scalar = 0.0, **parts: Unpack[ChainParts]) -> Chain:
    r"""Beck's column in n equal uniform rods: a cantilever under a tip load along it.

    Lengths in L, masses in $\rho A L$, springs in $E I / L$: rods of 1/n with springs
    of n, and $q = P L^2 / (E I)$. As n grows the critical load tends to 20.0509536,
    with an error of about 20/n (10.1668 at 2, 14.9932 at 4).

    **Arguments:** `n`: rods, 2 to 16; `q`: the load; `parts`: of `Chain`.

    **Raises:** `ValueError` as `Chain`, and for an n that is no whole number.

    Source: M. Beck, ZAMP 3 (1952) 225-228.
    """
    return _literature("beck", n, q, parts)


def pflueger(
    n: int, mass_ratio: Scalar, q: Scalar = 0.0, **parts: Unpack[ChainParts]
) -> Chain:
    r"""Pflueger's column: Beck's with a mass at its tip.

    **Arguments:** `mass_ratio`: of that mass to $\rho A L$; else as `beck`.

    **Raises:** as `beck`.

    Source: A. Pflueger, Ingenieur-Archiv 23 (1955) 191.
    """
    return _literature("pflueger", n, q, parts, tip_mass=mass_ratio)


def leipholz(n: int, q: Scalar = 0.0, **parts: Unpack[ChainParts]) -> Chain:
    r"""Leipholz' column: a cantilever under a follower load spread evenly along it.

    $q = p L^3 / (E I)$ with p a unit of length, on each rod in its middle; as n grows
    its critical load tends to 40.05.

    **Arguments:** as `beck`.

    **Raises:** as `beck`.

    Source: H. H. E. Leipholz, Ingenieur-Archiv 32 (1963) 214-224.
    """
    count = _rods(n)
    spread = FollowerForces((1 / count,) * count, at=0.5)
    return _literature("leipholz", n, q, parts, spread)


def _rods(n: int) -> int:
    whole = isinstance(n, int | np.integer) and not isinstance(n, bool)
    if not whole or not 2 <= n <= MOST_RODS:
        raise ValueError(
            f"Argument `n` must be a whole number from 2 to {MOST_RODS}, but is {n!r}."
        )
    return int(n)


def _literature(
    name: str,
    n: int,
    q: Scalar,
    parts: ChainParts,
    pattern: FollowerForces | None = None,
    tip_mass: Scalar | None = None,
) -> Chain:
    """A cantilever of unit length, mass and bending stiffness in n equal rods."""
    check_options(name, parts, (*COMMON, "air", "tip_inertia"))
    count, forces = _rods(n), parts.get("forces")
    if pattern is not None and forces is not None:
        forces = (pattern, *(forces if isinstance(forces, tuple) else (forces,)))
    return Chain(
        q,
        lengths=(1 / count,) * count,
        masses=1 / count,
        springs=float(count),
        tip_mass=tip_mass,
        **{**parts, "forces": pattern if forces is None else forces},
    )
