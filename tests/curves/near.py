"""Cycles near bifurcations, rounded: Newton's method starts there."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

import ziegler_jax as zj
from ziegler_jax import CODE


class Near(NamedTuple):
    """A cycle near a bifurcation: phi2, omega1, omega2 at phi1 = 0, T, q, torque."""

    y: tuple[float, float, float]
    period: float
    q: float
    tau: float


def points(kind, near, monodromy=None):
    """As a branch has its special points."""
    unknown = jnp.full((1, 2), jnp.nan)
    moved = np.full((4, 4), np.nan) if monodromy is None else monodromy
    return zj.CyclePoints(
        parameter=jnp.array([near.q]),
        phi=jnp.array([[0.0, near.y[0]]]),
        omega=jnp.array([near.y[1:]]),
        period=jnp.array([near.period]),
        rod_amplitude=unknown,
        joint_amplitude=unknown,
        monodromy=jnp.asarray(moved)[None],
        kind=jnp.array([CODE[kind]]),
    )


def dry(q, tau, **parts):
    law = zj.SetValuedCoulomb(tau, pin_radius=1.0, load=zj.ConstantLoad(1.0))
    return zj.uniform_rods(q, friction=law, **parts)
