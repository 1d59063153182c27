"""Long continuations of motions in C++, with smoothed or dry friction: `judge.cpp`."""

import ctypes
from pathlib import Path

import numpy as np

from peers.cpp import OPTIONS, built

SOURCE = Path(__file__).with_name("judge.cpp")


def follow(columns, states, spans, lasts, tol):
    """Amplitudes (n, 3) over the last part of each span, and the states at the end.

    **Arguments:** `columns` (n, 5): q, tau_s, tau_k, v_stribeck, v_smooth (0: dry
    friction); `states` (n, 4); `spans`, `lasts` (n,).
    """
    columns, states, spans, lasts = (
        np.array(x, dtype=float, order="C") for x in (columns, states, spans, lasts)
    )
    amplitudes = np.zeros((len(columns), 3))
    pointer = ctypes.POINTER(ctypes.c_double)

    def at(x):
        return x.ctypes.data_as(pointer)

    built(SOURCE, (*OPTIONS, "-O2")).follow(
        ctypes.c_long(len(columns)), at(columns), at(states), at(spans), at(lasts),
        ctypes.c_double(tol), at(amplitudes),
    )  # fmt: skip
    return amplitudes, states
