"""The scenes that all contestants solve: same equations, starts and spans.

    a w1' + b cosD w2' + b sinD w2^2 + 2 phi1 - phi2 = q sinD - T1 + T2 - c (2 w1 - w2)
    b cosD w1' + d w2' - b sinD w1^2 - phi1 + phi2   =        - T2      - c (w2 - w1)

with D = phi1 - phi2, two uniform rods, and in each joint, whose rate is u,

    T = (tau_k + (tau_s - tau_k) exp(-(u / v_stribeck)^2)) tanh(u / v_smooth).
"""

import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "tests"))
import models

A, B, D = models.A, models.B, models.D
START = (0.0, 0.0, 0.0, 0.2)
LANES = 4096


class Friction(NamedTuple):
    """Constant torques of both joints, and the rates of their law."""

    v_smooth: float
    tau_s: float = 0.012
    tau_k: float = 0.010
    v_stribeck: float = 0.05


class Scene(NamedTuple):
    """What is solved: loads between `low` and `high`, to the time `span`."""

    name: str
    low: float
    high: float
    span: float
    damping: float | None = None
    friction: Friction | None = None
    stiff: bool = False

    def loads(self, lanes):
        """`lanes` neighbouring loads."""
        return np.linspace(self.low, self.high, lanes)


SCENES = {
    scene.name: scene
    for scene in (
        # q_cr = 2.5417: beyond it motions separate, so the span is short
        Scene("frictionless", 2.0, 3.0, 30.0),
        Scene("viscous", 1.2, 2.4, 100.0, damping=0.05),
        Scene("smooth", 2.0, 2.5, 100.0, friction=Friction(1e-2)),
        Scene("stiff_1e-3", 2.0, 2.5, 20.0, friction=Friction(1e-3), stiff=True),
        Scene("stiff_1e-4", 2.0, 2.5, 20.0, friction=Friction(1e-4), stiff=True),
        Scene("stiff_1e-5", 2.0, 2.5, 20.0, friction=Friction(1e-5), stiff=True),
    )
}


def accelerations(m, scene, q, phi1, phi2, w1, w2):
    """(w1', w2'), with the functions of the module `m` (numpy, jax.numpy, heyoka)."""
    torques = None
    if scene.damping is not None:
        torques = scene.damping * w1, scene.damping * (w2 - w1)
    if scene.friction is not None:
        law = scene.friction

        def torque(u):
            x = u / law.v_stribeck
            size = law.tau_k + (law.tau_s - law.tau_k) * m.exp(-x * x)
            return size * m.tanh(u / law.v_smooth)

        torques = torque(w1), torque(w2 - w1)
    return models.accelerations(m, q, torques, phi1, phi2, w1, w2)
