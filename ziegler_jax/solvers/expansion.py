r"""The series of a motion in frozen modes, and how far it may be trusted.

A step is as long as the last two terms of the series allow: each may come to a few
tolerances, and what is left out is then within about one.
"""

import math
from typing import NamedTuple, cast

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from ..model.column import Column, joint_balance
from ..model.set_valued import Dynamics, FrozenCoulomb
from ..numerics.materialise import materialise
from ..numerics.numbers import Pair, Scalar, Vector4
from ..numerics.series import Series, cauchy

LAST_TERMS = 6.0  # tolerances that each of the last two terms may come to

Coefficients = list[Scalar]  # by order


class Motion(NamedTuple):
    """The series of a motion in frozen modes: lists of coefficients."""

    y: tuple[Coefficients, Coefficients, Coefficients, Coefficients]
    accelerations: tuple[Coefficients, Coefficients]
    # of each joint: its rate in its direction where it slides, its torque where not
    watched: tuple[Coefficients, Coefficients]


def expand(column: Column, y: Vector4, order: int, at: Scalar) -> Motion:
    """The series of the motion from y, in the modes of the column's friction."""
    w1, w2 = Series(at, known=(y[2],)), Series(at, known=(y[3],))
    phi1, phi2 = w1.integral(y[0]), w2.integral(y[1])
    a1, a2 = w1.derivative(), w2.derivative()
    law = cast(FrozenCoulomb, column.friction)
    assert law.modes is not None
    # the forces of each order rest on the motion up to that order
    forces = joint_balance(column, cast(Vector4, (phi1, phi2, w1, w2)))
    h, r1, r2 = cast("tuple[Series, ...]", (forces.h, forces.r1, forces.r2))
    for x in (h, r1, r2):
        x.ready(0)
    still = Dynamics(forces.a, h[0], forces.d, r1[0], r2[0])
    inverse_inertia = materialise(at, law.inverse_inertia, still)
    watched: tuple[Coefficients, Coefficients] = [], []
    for k in range(order + 1):
        constraint: Pair = (0.0, 0.0)
        rates = w1[k], w2[k] - w1[k]
        if k < order:
            for x in (h, r1, r2):
                x.ready(k)

            def driven(k=k):
                """The forces of this order, but for the accelerations of this order."""
                if k > 0:
                    return r1[k] - cauchy(h, a2, k, 1), r2[k] - cauchy(h, a1, k, 1)
                (m1, m2), (k1, k2) = cast(Pair, law.modes), law.kinetic
                return r1[0] - m1 * k1 + m2 * k2, r2[0] - m2 * k2

            left1, left2 = materialise(at, driven)
            now = still._replace(r1=left1, r2=left2)

            def move(k=k, now=now):
                accelerations = law.accelerations_under(now, 0.0, 0.0, inverse_inertia)
                return tuple(a / (k + 1) for a in accelerations)

            for w, new in zip((w1, w2), materialise(at, move), strict=True):
                w.append(new)
            constraint = law.constraint_torques(now, a1[k], a2[k])
        rows = zip(watched, law.modes, rates, constraint, strict=True)
        for row, m, u, torque in rows:
            row.append(jnp.where(m == 0, torque, m * u))
    states = tuple([x[k] for k in range(order + 1)] for x in (phi1, phi2, w1, w2))
    rates = tuple([x[k] for k in range(order)] for x in (a1, a2))
    return Motion(states, rates, watched)  # pyright: ignore


def allowed(motion: Motion, rtol: Scalar, atol: Scalar) -> Scalar:
    """How long a step may be by the last two terms of its series."""
    order = len(motion.y[0]) - 1
    # one digit would do, and a float32's reciprocal is cheap
    scales = [jnp.minimum(atol + rtol * jnp.abs(c[0]), 1e37) for c in motion.y]
    weights = [(1 / x.astype(jnp.float32)).astype(x.dtype) for x in scales]
    shortest = None
    for k in (order - 1, order):
        sizes = [jnp.abs(c[k]) * w for c, w in zip(motion.y, weights, strict=True)]
        worst = jnp.maximum(jnp.maximum(*sizes[:2]), jnp.maximum(*sizes[2:]))
        # of what is not finite nothing follows
        h = (math.log2(LAST_TERMS) - _log2(lax.stop_gradient(worst))) / k + 0.0 * worst
        shortest = h if shortest is None else jnp.minimum(shortest, h)
    assert shortest is not None
    # seven digits are plenty, and XLA vectorises float32's exp
    h = jnp.exp(math.log(2) * shortest.astype(jnp.float32))
    return lax.stop_gradient(h.astype(shortest.dtype))


def _log2(x: Float[Array, ""]) -> Float[Array, ""]:
    """Within 0.09, by a float's bits: the line through the powers of two on each side.

    However large the number is, which float32's log could not say.
    """
    info = jnp.finfo(x.dtype)
    whole = jnp.int64 if info.bits == 64 else jnp.int32
    bits = lax.bitcast_convert_type(x, whole).astype(x.dtype)
    return bits * 2.0**-info.nmant + (info.minexp - 1)
