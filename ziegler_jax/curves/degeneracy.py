r"""What makes a cycle bifurcate, as equations with null vectors (Moore and Spence).

Let $N = \sigma\,\partial y(T)/\partial y_0$ be the derivative of the motion over the
period, or ($\sigma = -1$) over half of it where the cycle is its own mirror image: of
the half map a fold has the multiplier 1, too, and the symmetry breaks at -1.

| kind | equations beside the cycle's own |
|---|---|
| fold | $R_z v = 0$, $v \cdot v = 1$ |
| flip, pitchfork (half map) | $(N + I) v = 0$, $v \cdot v = 1$ |
| torus | $(N - e^{i\theta} I)(v_r + i v_i) = 0$, $|v| = 1$, and its phase |

with $R_z$ the derivative of the closing equations in $z = (\ldots, T)$. The null vector
v, and the angle $\theta$, are unknowns like the cycle's own: the equations are regular
where the bifurcation is the simple one of its kind, cusps included.

Source: G. Moore, A. Spence, SIAM J. Numer. Anal. 17 (1980) 567-576; Y. A. Kuznetsov,
Elements of Applied Bifurcation Theory (2004), section 10.3.
"""

import abc
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..motion.variational import AbstractContact
from ..numerics.numbers import Scalar
from ..steady.jets import Jet

Extra = Float[Array, " e"]  # the unknowns beside the cycle's: null vectors, an angle


class Block(NamedTuple):
    """Equations and their derivatives in x = (z, p), scaled, and the extra unknowns."""

    residual: Float[Array, " e"]
    in_x: Float[Array, "e u"]
    in_extra: Float[Array, "e e"]


class AbstractDegeneracy(eqx.Module):
    """A kind of bifurcation.

    `extra`: how many unknowns it adds for two rods, and equations beside one that ties
    them to the cycle; `vectors`: along how many directions second derivatives are asked
    for. `tests` are of two rods, as curves are; all else is of n, s = 2n.
    """

    extra: ClassVar[int]
    vectors: ClassVar[int]
    contact: eqx.AbstractVar[AbstractContact | None]  # what its motions watch

    @abc.abstractmethod
    def begin(self, closing: Float[Array, "s a"], basis: Float[Array, "a u"]) -> Extra:
        """The extra unknowns at a cycle near a bifurcation.

        **Arguments:** `closing`: the derivative of R in (y0, T, p); `basis`: how these
        move with x.
        """

    @abc.abstractmethod
    def directions(
        self, extra: Extra, basis: Float[Array, "a u"]
    ) -> Float[Array, "k a"]:
        """The null vectors as directions of (y0, T, p)."""

    @abc.abstractmethod
    def block(
        self, jet: Jet, extra: Extra, reference: Extra, basis: Float[Array, "a u"]
    ) -> Block:
        """The equations; `reference`: extra unknowns nearby, which set the phase."""

    @abc.abstractmethod
    def tests(
        self,
        extra: Extra,
        tangent: Float[Array, " n"],
        matrix: Float[Array, "m n"],
        moved: Float[Array, "4 4"],
    ) -> Float[Array, "4"]:
        """What vanishes at a cusp; where another multiplier is 1; -1; and a pair."""


def closing_of(jet: Jet) -> Float[Array, "s a"]:
    """The derivative of R = sigma y(T) - y0 in (y0, T, p)."""
    s = jet.first.shape[0]
    return jet.first.at[:, :s].add(-jnp.eye(s, dtype=jet.first.dtype))


def null_vector(matrix: Float[Array, "n n"]) -> Float[Array, " n"]:
    """The unit vector that a matrix shortens most; zeros where it is not finite."""
    bad = ~jnp.all(jnp.isfinite(matrix))
    _, _, rows = jnp.linalg.svd(jnp.where(bad, jnp.zeros_like(matrix), matrix))
    return jnp.where(bad, jnp.zeros_like(matrix[0]), rows[-1].conj())


class Fold(AbstractDegeneracy):
    """Two cycles meet."""

    extra: ClassVar[int] = 4
    vectors: ClassVar[int] = 1
    contact: AbstractContact | None = None

    def begin(self, closing, basis):
        """The null vector of R_z."""
        return null_vector(closing @ basis[:, : closing.shape[0]])

    def directions(self, extra, basis):
        """A direction in z."""
        return (basis[:, : extra.size] @ extra)[None]

    def block(self, jet, extra, reference, basis):
        """R_z v = 0 and |v| = 1."""
        del reference
        matrix = closing_of(jet) @ basis[:, : extra.size]
        return _with_length(matrix, jet.second[0] @ basis, extra)

    def tests(self, extra, tangent, matrix, moved):
        """At a cusp the curve's tangent is v itself: both parameters stand still.

        They move across w . R_p, where w annuls R_z from the left: in the form adj(R_z)
        v it goes along with v without a jump of its sign.
        """
        left = _adjugate(matrix[:4, :4]).T @ extra
        normal = left @ matrix[:4, 4:6]
        across = tangent[5] * normal[0] - tangent[4] * normal[1]
        cusp = across / jnp.sqrt(normal @ normal)
        b2, _, b0 = characteristic_cubic(moved)
        return jnp.concatenate([cusp[None], _others(b2 + 1, -b0)])


class Flip(AbstractDegeneracy):
    """A multiplier of N is -1: the period doubles, or a half map's symmetry breaks."""

    extra: ClassVar[int] = 4
    vectors: ClassVar[int] = 1
    contact: AbstractContact | None = None

    def begin(self, closing, basis):
        """The null vector of N + I."""
        del basis
        s = closing.shape[0]
        return null_vector(closing[:, :s] + 2 * jnp.eye(s, dtype=closing.dtype))

    def directions(self, extra, basis):
        """A direction of the start."""
        rows = jnp.zeros((1, basis.shape[0]), extra.dtype)
        return rows.at[0, : extra.size].set(extra)

    def block(self, jet, extra, reference, basis):
        """(N + I) v = 0 and |v| = 1."""
        del reference
        s = extra.size
        matrix = jet.first[:, :s] + jnp.eye(s, dtype=extra.dtype)
        return _with_length(matrix, jet.second[0] @ basis, extra)

    def tests(self, extra, tangent, matrix, moved):
        """Such curves have no cusps."""
        del extra, tangent, matrix
        b2, _, b0 = characteristic_cubic(moved)
        return jnp.concatenate([jnp.ones_like(b0)[None], _others(b2 - 1, b0)])


class Torus(AbstractDegeneracy):
    """A complex pair of multipliers of N passes the unit circle (Neimark-Sacker)."""

    extra: ClassVar[int] = 9
    vectors: ClassVar[int] = 2
    contact: AbstractContact | None = None

    def begin(self, closing, basis):
        """The complex multiplier nearest to the circle, its vector and its angle."""
        del basis
        s = closing.shape[0]
        eye = jnp.eye(s, dtype=closing.dtype)
        matrix = closing[:, :s] + eye
        bad = ~jnp.all(jnp.isfinite(matrix))
        values = jnp.linalg.eigvals(jnp.where(bad, eye, matrix))
        off = jnp.where(values.imag > 1e-6, jnp.abs(jnp.abs(values) - 1), jnp.inf)
        value = values[jnp.argmin(off)]
        moved, one = (part.astype(value.dtype) for part in (matrix, eye))
        vector = null_vector(moved - value * one)
        angle = jnp.angle(value)
        return jnp.concatenate([vector.real, vector.imag, angle[None]])

    def directions(self, extra, basis):
        """Two directions of the start."""
        rows, s = jnp.zeros((2, basis.shape[0]), extra.dtype), extra.size // 2
        return rows.at[:, :s].set(extra[:-1].reshape(2, s))

    def block(self, jet, extra, reference, basis):
        """(N - exp(i theta) I) v = 0, |v| = 1, and the phase of v."""
        (real, imag), angle = extra[:-1].reshape(2, -1), extra[-1]
        c, s = jnp.cos(angle), jnp.sin(angle)
        n, eye = jet.first[:, : real.size], jnp.eye(real.size, dtype=extra.dtype)
        matrix = jnp.block([[n - c * eye, s * eye], [-s * eye, n - c * eye]])
        turned = jnp.concatenate([s * real + c * imag, s * imag - c * real])
        ref_real, ref_imag = reference[:-1].reshape(2, -1)
        phase = jnp.concatenate([-ref_imag, ref_real])
        vector = extra[:-1]
        length = (vector @ vector - 1) / 2
        zero = jnp.zeros(1, extra.dtype)
        rows = [
            jnp.concatenate([matrix, turned[:, None]], axis=1),
            jnp.concatenate([vector, zero])[None],
            jnp.concatenate([phase, zero])[None],
        ]
        residual = jnp.stack([length, phase @ vector])
        in_x = jnp.concatenate([jet.second[0] @ basis, jet.second[1] @ basis])
        return Block(
            jnp.concatenate([matrix @ vector, residual]),
            jnp.concatenate([in_x, jnp.zeros((2, basis.shape[1]), extra.dtype)]),
            jnp.concatenate(rows),
        )

    def tests(self, extra, tangent, matrix, moved):
        """Of the third multiplier; a pair that meets on the real axis."""
        del tangent, matrix
        b0 = characteristic_cubic(moved)[2]
        return jnp.stack([jnp.ones_like(b0), 1 + b0, 1 - b0, jnp.sin(extra[-1])])


class ModesChange(AbstractDegeneracy):
    """Another sequence of stick and slip: a number of the motion passes zero."""

    extra: ClassVar[int] = 0
    vectors: ClassVar[int] = 0
    contact: AbstractContact | None = None

    def begin(self, closing, basis):
        """No unknowns of its own."""
        del basis
        return jnp.zeros(0, closing.dtype)

    def directions(self, extra, basis):
        """None."""
        return jnp.zeros((0, basis.shape[0]), extra.dtype)

    def block(self, jet, extra, reference, basis):
        """The number that the motion watches."""
        del reference
        assert self.contact is not None and jet.contact
        value, moves = map(jnp.asarray, jet.contact)
        nothing = jnp.zeros((1, 0), extra.dtype)
        return Block(value[None], (moves @ basis)[None], nothing)

    def tests(self, extra, tangent, matrix, moved):
        """Of all multipliers: where bifurcations of cycles end on it."""
        del extra, tangent, matrix
        b2, b1, b0 = characteristic_cubic(moved)
        # a pair whose product is 1 is complex where its sum, b0 - b2, is less than 2
        torus = b0 * b0 - b2 * b0 + b1 - 1
        pair = jnp.where(jnp.abs(b0 - b2) < 2, torus, jnp.nan)
        minus, one = 1 - b2 + b1 - b0, 1 + b2 + b1 + b0
        return jnp.stack([jnp.ones_like(one), one, minus, pair])


def characteristic_cubic(moved: Float[Array, "4 4"]) -> tuple[Scalar, Scalar, Scalar]:
    """b2, b1, b0 of the cubic whose roots are the multipliers other than 1."""
    square = moved @ moved
    t1, t2, t3 = jnp.trace(moved), jnp.trace(square), jnp.trace(square @ moved)
    e2 = (t1 * t1 - t2) / 2
    e3 = (t1**3 - 3 * t1 * t2 + 2 * t3) / 6
    b2 = 1 - t1
    b1 = e2 + b2
    return b2, b1, b1 - e3


def _others(c1: Scalar, c0: Scalar) -> Float[Array, "3"]:
    """Of the multipliers with lambda^2 + c1 lambda + c0 = 0: at 1, at -1, a pair."""
    pair = jnp.where(jnp.abs(c1) < 2, c0 - 1, jnp.nan)  # else they are real
    return jnp.stack([1 + c1 + c0, 1 - c1 + c0, pair])


def _adjugate(matrix: Float[Array, "4 4"]) -> Float[Array, "4 4"]:
    """By the characteristic polynomial: it needs no inverse."""
    square = matrix @ matrix
    cube = square @ matrix
    t1, t2, t3 = jnp.trace(matrix), jnp.trace(square), jnp.trace(cube)
    c2 = (t1 * t1 - t2) / 2
    c3 = (t1**3 - 3 * t1 * t2 + 2 * t3) / 6
    eye = jnp.eye(4, dtype=matrix.dtype)
    return c3 * eye - c2 * matrix + t1 * square - cube


def _with_length(
    matrix: Float[Array, "4 4"], in_x: Float[Array, "4 6"], vector: Extra
) -> Block:
    """The equations B v = 0 and |v| = 1."""
    length = (vector @ vector - 1) / 2
    zero = jnp.zeros((1, in_x.shape[1]), vector.dtype)
    return Block(
        jnp.concatenate([matrix @ vector, length[None]]),
        jnp.concatenate([in_x, zero]),
        jnp.concatenate([matrix, vector[None]]),
    )
