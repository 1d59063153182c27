"""numba: Dormand and Prince's 5(4) by hand, one lane after the other under `prange`.

Everything is scalars and small tuples, which LLVM keeps in registers and unrolls, and
`fastmath` is on.
"""

import functools
from math import cos, exp, sin, sqrt, tanh

import numpy as np
from measure import clock
from numba import njit, prange
from scenes import A, B, D

NAME = "numba Dopri5"

A2 = (1 / 5,)
A3 = (3 / 40, 9 / 40)
A4 = (44 / 45, -56 / 15, 32 / 9)
A5 = (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729)
A6 = (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656)
A7 = (35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84)
E = (71 / 57600, 0.0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40)
FAST = {"fastmath": True, "inline": "always"}


@njit(**FAST)
def combine(h, a, k):
    s0 = s1 = s2 = s3 = 0.0
    for j in range(len(a)):
        s0 += a[j] * k[j][0]
        s1 += a[j] * k[j][1]
        s2 += a[j] * k[j][2]
        s3 += a[j] * k[j][3]
    return h * s0, h * s1, h * s2, h * s3


@njit(**FAST)
def moved(y, step):
    return y[0] + step[0], y[1] + step[1], y[2] + step[2], y[3] + step[3]


@functools.cache
def compiled(scene):
    """The scene's solver of all lanes; what the scene does not name is not in it."""
    rubs, drags = scene.friction is not None, scene.damping is not None
    damping = scene.damping or 0.0
    v_smooth, tau_s, tau_k, v_stribeck = scene.friction or (1.0, 0.0, 0.0, 1.0)

    @njit(**FAST)
    def torque(u):
        x = u / v_stribeck
        return (tau_k + (tau_s - tau_k) * exp(-x * x)) * tanh(u / v_smooth)

    @njit(fastmath=True)
    def field(q, y):
        phi1, phi2, w1, w2 = y
        s, c = sin(phi1 - phi2), cos(phi1 - phi2)
        r1 = q * s - 2.0 * phi1 + phi2 - B * s * w2 * w2
        r2 = phi1 - phi2 + B * s * w1 * w1
        if drags:
            r1 -= damping * (2.0 * w1 - w2)
            r2 -= damping * (w2 - w1)
        if rubs:
            t1, t2 = torque(w1), torque(w2 - w1)
            r1 += t2 - t1
            r2 -= t2
        h = B * c
        over = 1.0 / (A * D - h * h)
        return w1, w2, (D * r1 - h * r2) * over, (A * r2 - h * r1) * over

    @njit(fastmath=True)
    def lane(q, y, span, tol):
        t, h = 0.0, 0.01
        k1 = field(q, y)
        while t < span:
            h = min(h, span - t)
            k2 = field(q, moved(y, combine(h, A2, (k1,))))
            k3 = field(q, moved(y, combine(h, A3, (k1, k2))))
            k4 = field(q, moved(y, combine(h, A4, (k1, k2, k3))))
            k5 = field(q, moved(y, combine(h, A5, (k1, k2, k3, k4))))
            k6 = field(q, moved(y, combine(h, A6, (k1, k2, k3, k4, k5))))
            new = moved(y, combine(h, A7, (k1, k2, k3, k4, k5, k6)))
            k7 = field(q, new)
            error = combine(h, E, (k1, k2, k3, k4, k5, k6, k7))
            square = 0.0
            for i in range(4):
                scale = tol + tol * max(abs(y[i]), abs(new[i]))
                square += (error[i] / scale) ** 2
            size = sqrt(0.25 * square)
            if size <= 1.0:
                t, y, k1 = t + h, new, k7
            h *= min(10.0, max(0.2, 0.9 * max(size, 1e-10) ** -0.2))
        return y

    @njit(parallel=True, fastmath=True)
    def lanes(q, start, span, tol, out):
        for i in prange(q.size):
            out[i] = lane(q[i], start, span, tol)

    return lanes


def run(scene, q, start, span, rtol):
    lanes, out = compiled(scene), np.empty((q.size, 4))
    if not lanes.signatures:
        lanes(q[:2], start, 0.1, rtol, out[:2])
    begun = clock()
    lanes(q, start, span, rtol, out)
    return out, clock() - begun
