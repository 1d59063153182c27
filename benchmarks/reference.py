"""What the errors are held against: heyoka at the limit of double precision.

A second run from starts moved by 1e-9 tells how much a lane magnifies: lanes whose end
moves by more than `CHAOTIC` times the start are left out, as no code can place them. A
third, scipy's DOP853 (LSODA where stiff) at 1e-13 on a few lanes, is another code's
word for the same numbers.
"""

from typing import NamedTuple

import numpy as np
from peers import per_trajectory, taylor

FINEST = 1e-16
SHIFT, CHAOTIC = 1e-9, 1e3
CHECKED = 3


class Reference(NamedTuple):
    """Final states, which lanes count, and how far two codes are apart."""

    states: np.ndarray
    keep: np.ndarray
    magnification: np.ndarray
    codes_apart: float


def reference(scene, q, start):
    states, _ = taylor.run(scene, q, start, scene.span, FINEST)
    moved = np.add(start, (SHIFT, SHIFT, SHIFT, -SHIFT))
    apart = np.abs(taylor.run(scene, q, moved, scene.span, FINEST)[0] - states)
    magnification = apart.max(axis=1) / SHIFT
    keep = np.isfinite(magnification) & (magnification < CHAOTIC)
    few = np.flatnonzero(keep)[:: max(1, keep.sum() // CHECKED)][:CHECKED]
    method = "LSODA" if scene.stiff else "DOP853"
    other, _ = per_trajectory.run(scene, q[few], start, scene.span, 1e-13, method)
    codes_apart = float(np.abs(other - states[few]).max())
    return Reference(states, keep, magnification, codes_apart)
