"""scipy's `solve_ivp`, called for each lane; one contestant for each of its methods."""

import math
import types

import numpy as np
from measure import clock
from scenes import accelerations
from scipy.integrate import solve_ivp

NAME, LANES = "scipy", 8
_MATH = types.SimpleNamespace(sin=math.sin, cos=math.cos, exp=math.exp, tanh=math.tanh)


def field(t, y, scene, q):
    """Of Python floats: for four states faster than NumPy's arrays."""
    phi1, phi2, w1, w2 = y.tolist()
    return w1, w2, *accelerations(_MATH, scene, q, phi1, phi2, w1, w2)


def run(scene, q, start, span, rtol, method="RK45"):
    states = np.empty((q.size, 4))
    begun = clock()
    for i, load in enumerate(q.tolist()):
        solution = solve_ivp(
            field, (0.0, span), start, method, args=(scene, load), rtol=rtol, atol=rtol,
            t_eval=(span,),
        )  # fmt: skip
        states[i] = solution.y[:, -1] if solution.success else np.nan
    return states, clock() - begun
