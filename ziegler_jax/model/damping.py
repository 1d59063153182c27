r"""Damping: a matrix C with torques $-C\,\omega$ on the rods."""

from __future__ import annotations

from typing import ClassVar

import jax
import jax.numpy as jnp

from ..numerics.numbers import Numbers, Pair, Scalar
from ..numerics.rules import AbstractRuled, checked, number
from .chain import Rows, Turned, straight

# by its rows; None where rods are known not to be coupled
Matrix = tuple[tuple[Scalar | None, ...], ...]


class AbstractDamping(AbstractRuled):
    r"""A damping law: the matrix C of the rods, which may depend on their rates.

    Quadratic damping, torques $c\,|u_i|\,u_i$ against the joints' rates:

    ```python
    class Quadratic(zj.AbstractDamping):
        rules = {"c": "nonnegative"}
        units = {"c": "m l^2"}
        c: float

        def matrix(self, cos_d, omega):
            u1, u2 = omega[0], omega[1] - omega[0]
            c1, c2 = self.c * abs(u1), self.c * abs(u2)
            return (c1 + c2, -c2), (-c2, c2)

    column = zj.uniform_rods(2.6, damping=Quadratic(0.1))
    ```

    Write its numbers as its own fields. JAX remembers a global, or an attribute of
    another object, as it was when first traced: within one point of a sweep, and
    outside of `sweep` for good.
    `rules` names a rule for each of them: `finite`, `nonnegative`, `positive`; a motion
    with a number that breaks its rule ends as `invalid`. `units` names their units, for
    `SI.scaled` only: `1`, `rad`, another one that it lists, or the powers of m, l, k.
    """

    def matrix(self, cos_d: Scalar, omega: Pair) -> tuple[Pair, Pair]:
        """The rows of C, which a law for two rods alone writes.

        **Arguments:** `cos_d`: the cosine of phi1 - phi2; `omega`: the rods' rates. For
        the linear column they are 1 and (0, 0). Sums and products of the cosine alone,
        where `is_polynomial` says so.
        """
        raise NotImplementedError(
            f"`{type(self).__name__}` has no `matrix` of its own: ask it for `rows`."
        )

    def rows(self, sines: Turned, omega: Numbers) -> Matrix:
        """The rows of C, of any number of rods that the law is for.

        A law for more than two writes these in place of `matrix`; of one for two they
        are its `matrix`.

        **Arguments:** `sines`: sine and cosine of phi_i - phi_j; `omega`: the rods'
        rates.
        """
        return self.matrix(sines[0, 1][1], (omega[0], omega[1]))

    def check(self, rods: int) -> None:
        """Refuse a number of rods that the law is not for.

        **Raises:** `ValueError`.
        """
        law, base = type(self), AbstractDamping
        if law.rows is base.rows and law.matrix is base.matrix:
            raise ValueError(
                "Argument `damping` must have a method `matrix`, of two rods, or `rows`"
                f", of any number, but `{law.__name__}` has neither."
            )
        if rods != 2 and law.rows is base.rows:
            raise ValueError(
                f"Argument `damping` must be a law for {rods} rods, such as `Viscous` "
                "with one number a joint, or one of your own with `rows`, but "
                f"`{law.__name__}` is one for two."
            )

        def given():
            return [
                [*row] for row in self.rows(straight(rods), (jnp.zeros(()),) * rods)
            ]

        sizes = [len(row) for row in jax.eval_shape(given)]
        if sizes != [rods] * rods:
            raise ValueError(
                f"The damping law `{law.__name__}` must give a matrix of {rods} rows "
                f"and columns for {rods} rods, but gives rows of {sizes}."
            )

    def drag(self) -> tuple[Scalar, Scalar, Scalar] | None:
        r"""The drag on the rods from outside, which their joints carry.

        Numbers (f1, f2, f3) of the forces $-f_1 \omega_1$ on rod 1 across it, and
        $-f_2 \omega_1$ across rod 1 and $-f_3 \omega_2$ across rod 2 on rod 2; None
        where all acts between the rods.
        """
        return None

    def __add__(self, other: AbstractDamping) -> Sum:
        """Both at once."""
        return Sum(self, other)


class Viscous(AbstractDamping):
    r"""Viscous joints: torques $c_i u_i$ against the joints' rates.

    Of two rods

    $$C = \begin{bmatrix} c_1 + c_2 & -c_2 \\ -c_2 & c_2 \end{bmatrix}$$

    **Arguments:** `c1`, `c2`, and of a longer chain those of the joints beyond, in
    order: in $\sqrt{k m l^2}$, nonnegative. Its leaves are named `c1`, `c2`, `c3`, ...
    where `sensitivity` and its like take names.
    """

    rules: ClassVar = {"c1": "nonnegative", "c2": "nonnegative", "c3_on": "nonnegative"}
    units: ClassVar = dict.fromkeys(rules, "sqrt(k m l^2)")

    c1: Scalar
    c2: Scalar
    c3_on: Numbers = ()

    def __init__(self, c1: Scalar, c2: Scalar, *more: Scalar):
        """Check and keep the coefficients."""
        self.c1, self.c2 = checked(self.rules, c1=c1, c2=c2)
        self.c3_on = tuple(
            number(f"c{i}", c, "nonnegative") for i, c in enumerate(more, 3)
        )

    def check(self, rods: int) -> None:
        """Refuse another number of coefficients than joints (ValueError)."""
        count = 2 + len(self.c3_on)
        if count != rods:
            raise ValueError(
                f"Argument `damping` must have one coefficient for each of {rods} "
                f"joints, but has {count}."
            )

    def rows(self, sines: Turned, omega: Numbers) -> Matrix:
        """The rows of C, three diagonals."""
        del sines
        c, n = (self.c1, self.c2, *self.c3_on), len(omega)
        rows: list[list[Scalar | None]] = [[None] * n for _ in c]
        for i in range(n):
            rows[i][i] = c[i] + c[i + 1] if i + 1 < n else c[i]
            if i + 1 < n:
                rows[i][i + 1] = rows[i + 1][i] = -c[i + 1]
        return tuple(map(tuple, rows))


class Air(AbstractDamping):
    r"""External damping: each point of a rod is dragged by $-e_i v$ a unit of length.

    v is the velocity of the point: on rod 1 $\omega_1 s$ across the rod, on rod 2 the
    sum of the knee's velocity and $\omega_2 s$ across the rod. The drag dissipates
    $\omega^T C \omega = \int_0^1 e_1 v^2 ds + \int_0^{l_2} e_2 v^2 ds$, so

    $$C = \begin{bmatrix} e_1/3 + e_2 l_2 & \tfrac12 e_2 l_2^2 \cos D \\
    \tfrac12 e_2 l_2^2 \cos D & \tfrac13 e_2 l_2^3 \end{bmatrix}$$

    On equal uniform rods $e_1 = e_2$ gives $C = e M$, which only raises q_cr; unequal
    drag destabilises as the joints' damping does.

    **Arguments:** `e1`, `e2` in $\sqrt{k m}/l^2$, nonnegative; `l2`: rod 2's length
    in l, positive, the same as the column's: concrete numbers that differ raise an
        error of `Column`; with traced ones the motion is `invalid`.
    """

    rules: ClassVar = {"e1": "nonnegative", "e2": "nonnegative", "l2": "positive"}
    units: ClassVar = {"e1": "sqrt(k m)/l^2", "e2": "sqrt(k m)/l^2", "l2": "l"}

    e1: Scalar
    e2: Scalar
    l2: Scalar

    def __init__(self, e1: Scalar, e2: Scalar, l2: Scalar = 1.0):
        """Check and keep both coefficients and the length."""
        self.e1, self.e2, self.l2 = checked(self.rules, e1=e1, e2=e2, l2=l2)

    def matrix(self, cos_d: Scalar, omega: Pair) -> tuple[Pair, Pair]:
        """The rows of C; the rods are coupled through the knee's velocity."""
        both = self.e2 * self.l2**2 / 2 * cos_d
        return (
            (self.e1 / 3 + self.e2 * self.l2, both),
            (both, self.e2 * self.l2**3 / 3),
        )

    def drag(self) -> tuple[Scalar, Scalar, Scalar]:
        """Summed over the points of the rods."""
        return self.e1 / 2, self.e2 * self.l2, self.e2 * self.l2**2 / 2


class Sum(AbstractDamping):
    """Two damping laws at once: `Viscous(0.01, 0.01) + Air(0.1, 0.1)` is one as well.

    **Arguments:** `first`, `second`: damping laws; their matrices add.
    """

    first: AbstractDamping
    second: AbstractDamping

    def __init__(self, first: AbstractDamping, second: AbstractDamping):
        """Keep both laws."""
        for name, law in (("first", first), ("second", second)):
            if not isinstance(law, AbstractDamping):
                raise ValueError(
                    f"Argument `{name}` must be a damping law, but is {law!r}."
                )
        self.first, self.second = first, second

    def check(self, rods: int) -> None:
        """Refuse what either law refuses (ValueError)."""
        self.first.check(rods)
        self.second.check(rods)

    def rows(self, sines: Turned, omega: Numbers) -> Matrix:
        """The rows of the sum."""
        both = self.first.rows(sines, omega), self.second.rows(sines, omega)
        return tuple(
            tuple(_sum(x, y) for x, y in zip(*rows, strict=True))
            for rows in zip(*both, strict=True)
        )

    def drag(self) -> tuple[Scalar, Scalar, Scalar] | None:
        """The sum of both."""
        parts = [d for d in (self.first.drag(), self.second.drag()) if d is not None]
        if len(parts) < 2:
            return parts[0] if parts else None
        (a1, a2, a3), (b1, b2, b3) = parts
        return a1 + b1, a2 + b2, a3 + b3


def _sum(x: Scalar | None, y: Scalar | None) -> Scalar | None:
    if x is None or y is None:
        return y if x is None else x
    return x + y


class Drag(AbstractDamping):
    r"""External damping of any number of rods: $C_{ij} = A_{ij} \cos(\phi_i - \phi_j)$.

    What `air` of a `Chain` runs as, with the moments A of the drag along the rods.
    """

    moments: Rows

    def rows(self, sines: Turned, omega: Numbers) -> Matrix:
        """The rows of C."""
        n = range(len(omega))
        return tuple(
            tuple(
                self.moments[i][i]
                if i == j
                else self.moments[max(i, j)][min(i, j)] * sines[min(i, j), max(i, j)][1]
                for j in n
            )
            for i in n
        )


def at_rest(law: AbstractDamping) -> tuple[Pair, Pair]:
    """C of two rods that stand upright and still."""
    (c11, c12), (c21, c22) = (
        tuple(0.0 if x is None else x for x in row)
        for row in law.rows(straight(2), (0.0, 0.0))
    )
    return (c11, c12), (c21, c22)


def joint_matrix(law: AbstractDamping) -> tuple[Scalar, Scalar, Scalar, Scalar]:
    r"""C at D = 0 in the joints' rates $\omega_1, \omega_2 - \omega_1$, row by row.

    diag(c1, c2) for `Viscous`: however small, c1 is not lost beside c2.
    """
    if isinstance(law, Viscous):
        return law.c1, 0.0, 0.0, law.c2
    if isinstance(law, Sum):
        parts = zip(joint_matrix(law.first), joint_matrix(law.second), strict=True)
        g11, g12, g21, g22 = (x + y for x, y in parts)
        return g11, g12, g21, g22
    (c11, c12), (c21, c22) = at_rest(law)
    return (c11 + c12) + (c21 + c22), c12 + c22, c21 + c22, c22


def is_polynomial(law: AbstractDamping | None) -> bool:
    """Whether the law can be given a power series for the cosine."""
    if isinstance(law, Sum):
        return is_polynomial(law.first) and is_polynomial(law.second)
    return law is None or isinstance(law, Viscous | Air | Drag)


def lengths(law: AbstractDamping | None) -> list[Scalar]:
    """The lengths of rod 2 that a law was given."""
    if isinstance(law, Sum):
        return lengths(law.first) + lengths(law.second)
    return [law.l2] if isinstance(law, Air) else []
