"""The column as two bodies that joints hold together: `free_bodies` of two rods."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import free_bodies


@dataclass(frozen=True)
class Rods:
    """Numbers of a column of uniform rods.

    `load`: the normal loads of both joints, None: reactions; `preload`: what is added
    to these.
    """

    q: float
    mu_s: Any = (0.0, 0.0)
    mu_k: Any = (0.0, 0.0)
    load: Any = (1.0, 1.0)
    follower: float = 1.0
    kappa: float = 1.0
    m1: float = 1.0
    m2: float = 1.0
    l2: float = 1.0
    viscous: tuple = (0.0, 0.0)
    air: tuple = (0.0, 0.0)
    preload: tuple = (0.0, 0.0)

    @cached_property
    def bodies(self):
        """The same as a chain."""
        return free_bodies.Bodies(
            self.q,
            lengths=(1.0, self.l2),
            masses=(self.m1, self.m2),
            springs=(self.kappa, 1.0),
            forces=[(1, 1.0, self.follower, 1.0)],
            viscous=self.viscous,
            air=self.air,
            mu_s=self.mu_s,
            mu_k=self.mu_k,
            load=self.load,
            preload=self.preload,
        )


def smoothed(rods, y0, ts, v, tol=1e-11):
    """States at the times `ts` under mu_k tanh(u / v), (n, 4)."""
    return free_bodies.smoothed(rods.bodies, y0, ts, v, tol)


def motion(rods, y0, ts, tol=1e-11, most=10_000, modes=None):
    """States at the times `ts`, (n, 4), and events (time, joint from 1, modes)."""
    return free_bodies.motion(rods.bodies, y0, ts, tol, most, modes)
