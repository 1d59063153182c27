"""The main job: where the column flutters, over the load and both frictions.

`python -m ziegler_jax` kicks the column of two uniform rods once at every (q, mu_s,
mu_k) with mu_k <= mu_s and follows it until its motion has settled.
"""

import argparse
import os
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import xarray as xr

import ziegler_jax as zj

# ---- the scene and how it is settled: everything that the map depends on
PIN_RADIUS = 0.05
KICK = (0.0, 0.3)
V_STRIBECK = 0.1
# At rest the smoothed law is viscous damping tau_s / v_smooth. With v_smooth = tau_s / 5
# that is 5 at every point: above what would make the smoothed column flutter from rest.
DAMPING_AT_REST = 5.0
SETTLE = {
    "transient": 100.0,
    "window": 40.0,
    "max_windows": 10,
    "rtol_settle": 1e-3,
    "observers": (zj.StickFraction(),),
}
Q_RANGE, MU_RANGE, MU_EXACT = (1.0, 4.0), (0.02, 0.4), (0.1, 0.12)
Q_VALUES, MU_VALUES = 129, 40
POINTS = Q_VALUES * MU_VALUES * (MU_VALUES + 1) // 2
FEWEST, MOST = 20, 10_000_000  # four values of mu and two of q; about 2 GB
STORE, PICTURE = "bifurcation_map.zarr", "bifurcation_map.png"


def point(q, mu_s, mu_k):
    """Settle one column: N = q, v_smooth = tau_s / 5."""
    friction = zj.SmoothCoulomb(
        mu_s,
        mu_k,
        pin_radius=PIN_RADIUS,
        v_stribeck=V_STRIBECK,
        v_smooth=mu_s * PIN_RADIUS * q / DAMPING_AT_REST,
    )
    column = zj.uniform_rods(q=q, friction=friction)
    return zj.settle(column, zj.State(omega=KICK), **SETTLE)


def grid(points: int) -> tuple[np.ndarray, np.ndarray]:
    """The values of q and of mu (static and kinetic) of a map of about `points` points.

    Both axes keep their range and their proportion; mu is evenly spaced between its
    ends, 0.10 and 0.12, which it always contains.
    """
    count = max(4, round(MU_VALUES * (points / POINTS) ** (1 / 3)))
    pairs = count * (count + 1) // 2
    marks = [MU_RANGE[0], *MU_EXACT, MU_RANGE[1]]
    share = np.diff(marks) / (marks[-1] - marks[0])
    parts = np.maximum(1, np.round(share * (count - 1)).astype(int))
    parts[-1] = count - 1 - parts[:-1].sum()
    mu = [np.linspace(a, b, n + 1)[1:] for a, b, n in zip(marks, marks[1:], parts)]
    q = np.linspace(*Q_RANGE, max(2, round(points / pairs)))
    return q, np.concatenate([[MU_RANGE[0]], *mu])


def compute(points: int = POINTS) -> xr.Dataset:
    """The map as a dataset over (q, mu_s, mu_k)."""
    q, mu = grid(points)
    return zj.sweep(
        point, where=lambda mu_s, mu_k, q: mu_k <= mu_s, q=q, mu_s=mu, mu_k=mu
    )
