r"""The series of a motion in frozen modes, and how far it may be trusted.

A step is as long as the last two terms of the series allow: each may come to a few
tolerances, and what is left out is then within about one.
"""

import math
from collections.abc import Sequence
from functools import reduce
from typing import NamedTuple, cast

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from ..model.chain import Rows, accelerated, holding_torques, joint_angles, on_rods
from ..model.state import PhasePoint
from ..model.system import System
from ..numerics.materialise import materialise
from ..numerics.numbers import Numbers, Scalar
from ..numerics.series import Series, cauchy

LAST_TERMS = 6.0  # tolerances that each of the last two terms may come to

Coefficients = list[Scalar]  # by order


class Expansion(NamedTuple):
    """The series of a motion in frozen modes: lists of coefficients."""

    y: tuple[Coefficients, ...]
    accelerations: tuple[Coefficients, ...]
    # of each joint: its rate in its direction where it slides, its torque where not
    watched: tuple[Coefficients, ...]


def expand(system: System, y: PhasePoint, order: int, token: Scalar) -> Expansion:
    """The series of the motion from y, in the modes of the system's friction."""
    law, n = system.law, len(y.phi)
    w = [Series(token, known=(x,)) for x in y.omega]
    phi = [rate.integral(x) for rate, x in zip(w, y.phi, strict=True)]
    a = [rate.derivative() for rate in w]
    # the forces of each order rest on the motion up to that order
    balance = system.balance(PhasePoint(cast(Numbers, (*phi, *w))))
    varying = [x for row in (*balance.mass, balance.right) for x in row]
    varying = [x for x in varying if isinstance(x, Series)]
    for x in varying:
        x.ready(0)
    mass = tuple(tuple(_coefficient(x, 0) for x in row) for row in balance.mass)
    parts = materialise(token, law.factored, mass)
    watched = tuple([] for _ in w)
    for k in range(order + 1):
        holds, rates = (0.0,) * n, joint_angles([rate[k] for rate in w])
        if k < order:
            for x in varying:
                x.ready(k)

            def driven(k=k):
                """The forces of this order, but for the accelerations of this order."""
                left = [_coefficient(x, k) for x in balance.right]
                if k == 0:
                    slipping = on_rods(law.slipping)
                    return [x - t for x, t in zip(left, slipping, strict=True)]
                return _without_earlier(balance.mass, a, left, k)

            left = materialise(token, driven)

            def move(k=k, left=left):
                each = accelerated(parts, left, law.stuck)
                return tuple(x / (k + 1) for x in each)

            for rate, new in zip(w, materialise(token, move), strict=True):
                rate.append(new)
            holds = holding_torques(mass, left, [x[k] for x in a])
        for row, m, u, t in zip(watched, law.modes, rates, holds, strict=True):
            row.append(jnp.where(m == 0, t, m * u))
    states = tuple([x[k] for k in range(order + 1)] for x in (*phi, *w))
    return Expansion(states, tuple([x[k] for k in range(order)] for x in a), watched)


def _coefficient(x: Series | Scalar, k: int) -> Scalar:
    """The k-th of a series; of a number itself the first."""
    return x[k] if isinstance(x, Series) else x


def _without_earlier(
    mass: Rows, a: Sequence[Series], left: list[Scalar], k: int
) -> list[Scalar]:
    """Forces without what the mass matrix makes of accelerations of lower orders."""
    for i, total in enumerate(left):
        for j, x in enumerate(a):
            moment = mass[max(i, j)][min(i, j)]
            if isinstance(moment, Series):
                total = total - cauchy(moment, x, k, 1)
        left[i] = total
    return left


def allowed(y: Sequence[Coefficients], rtol: Scalar, atol: Scalar) -> Scalar:
    """How long a step may be by the last two terms of its series."""
    order = len(y[0]) - 1
    # one digit would do, and a float32's reciprocal is cheap
    scales = [jnp.minimum(atol + rtol * jnp.abs(c[0]), 1e37) for c in y]
    weights = [(1 / x.astype(jnp.float32)).astype(x.dtype) for x in scales]
    shortest = None
    for k in (order - 1, order):
        sizes = [jnp.abs(c[k]) * w for c, w in zip(y, weights, strict=True)]
        worst = reduce(jnp.maximum, sizes)
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
