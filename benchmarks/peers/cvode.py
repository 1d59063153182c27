"""CVODE (BDF, dense Newton) by scikit-sundae, one trajectory after the other.

The right-hand side and its Jacobian are compiled by numba where it is installed, so
that what is measured is mostly CVODE and its wrapper.

    pip install scikit-sundae numba
"""

import math

import numpy as np
from measure import clock

try:
    from numba import njit
except ImportError:

    def njit(function):
        return function


NAME, LANES = "CVODE", 8
A, B, D = 4 / 3, 1 / 2, 1 / 3  # two uniform rods


@njit
def torque(u, tau_s, tau_k, v_stribeck, v_smooth):
    """A joint's, and its derivative by the rate u."""
    x, rise = u / v_stribeck, math.tanh(u / v_smooth)
    more = (tau_s - tau_k) * math.exp(-x * x)
    slope = (tau_k + more) * (1 - rise * rise) / v_smooth
    return (tau_k + more) * rise, slope - 2 * x / v_stribeck * more * rise


@njit
def field(y, dy, q, tau_s, tau_k, v_stribeck, v_smooth):
    s, c = math.sin(y[0] - y[1]), math.cos(y[0] - y[1])
    f1, _ = torque(y[2], tau_s, tau_k, v_stribeck, v_smooth)
    f2, _ = torque(y[3] - y[2], tau_s, tau_k, v_stribeck, v_smooth)
    r1 = q * s - 2 * y[0] + y[1] - B * s * y[3] ** 2 - f1 + f2
    r2 = y[0] - y[1] + B * s * y[2] ** 2 - f2
    det = A * D - (B * c) ** 2
    dy[0], dy[1] = y[2], y[3]
    dy[2] = (D * r1 - B * c * r2) / det
    dy[3] = (A * r2 - B * c * r1) / det


@njit
def jacobian(y, dy, matrix, q, tau_s, tau_k, v_stribeck, v_smooth):
    s, c = math.sin(y[0] - y[1]), math.cos(y[0] - y[1])
    det = A * D - (B * c) ** 2
    _, k1 = torque(y[2], tau_s, tau_k, v_stribeck, v_smooth)
    _, k2 = torque(y[3] - y[2], tau_s, tau_k, v_stribeck, v_smooth)
    # derivatives of r1 and r2 by phi1, phi2, omega1, omega2
    r1 = (
        q * c - 2 - B * c * y[3] ** 2,
        -q * c + 1 + B * c * y[3] ** 2,
        -k1 - k2,
        k2 - 2 * B * s * y[3],
    )
    r2 = (1 + B * c * y[2] ** 2, -1 - B * c * y[2] ** 2, k2 + 2 * B * s * y[2], -k2)
    h = B * c
    for j in range(4):
        matrix[0, j] = 1.0 if j == 2 else 0.0
        matrix[1, j] = 1.0 if j == 3 else 0.0
        matrix[2, j] = (D * r1[j] - h * r2[j]) / det
        matrix[3, j] = (A * r2[j] - h * r1[j]) / det
    # the mass matrix turns with D: M' = [[0, -B s], [-B s, 0]]
    w1, w2 = B * s * dy[3], B * s * dy[2]
    g1, g2 = (D * w1 - h * w2) / det, (A * w2 - h * w1) / det
    matrix[2, 0] += g1
    matrix[2, 1] -= g1
    matrix[3, 0] += g2
    matrix[3, 1] -= g2


def run(scene, q, start, span, rtol):
    """As the other peers' `run`."""
    from sksundae.cvode import CVODE

    law = scene.friction

    def rhs(t, y, dy, load):
        field(y, dy, load, law.tau_s, law.tau_k, law.v_stribeck, law.v_smooth)

    def jac(t, y, dy, matrix, load):
        numbers = law.tau_s, law.tau_k, law.v_stribeck, law.v_smooth
        jacobian(y, dy, matrix, load, *numbers)

    options = {"rtol": rtol, "atol": rtol, "max_num_steps": 10_000_000}
    ends, begun = np.full((q.size, 4), np.nan), clock()
    for i, load in enumerate(q.tolist()):
        solver = CVODE(rhs, jacfn=jac, userdata=load, **options)
        solution = solver.solve(np.array([0.0, span]), np.array(start, float))
        if solution.success:
            ends[i] = solution.y[-1]
    return ends, clock() - begun
