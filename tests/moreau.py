r"""Moreau's time stepping: an independent second code for set-valued friction.

Implicit midpoint for the smooth part, so that it adds no growth of its own,

$$M(\phi_m)(\omega^+ - \omega) = h\,(r(\phi_m, \omega_m) - B^T T), \qquad
\phi^+ = \phi + h\omega_m,$$

with $\omega_m = (\omega + \omega^+)/2$, $\phi_m = \phi + h\omega_m/2$, and the friction
torques by projection on the box $|T_i| \le \tau_i$: $T_i$ brings the rate $u_i^+$ to
zero if it can. Uniform rods, $\eta = \kappa = 1$, $\mu_s = \mu_k$.
"""

import math
from types import SimpleNamespace

# what `step` needs of plain numbers; of arrays `numpy` or `jax.numpy` has it
NUMBERS = SimpleNamespace(
    sin=math.sin, cos=math.cos, clip=lambda x, low, high: max(low, min(high, x))
)


def step(q, tau, h, y, torques, xp=NUMBERS, sweeps=4, projections=12):
    """The state after h, and the torques, from those of the step before."""
    (p1, p2, w1, w2), (t1, t2) = y, torques
    v1, v2 = w1, w2
    for _ in range(sweeps):
        m1, m2 = (w1 + v1) / 2, (w2 + v2) / 2
        a1, a2 = p1 + h * m1 / 2, p2 + h * m2 / 2
        s, c = xp.sin(a1 - a2), xp.cos(a1 - a2)
        r1 = q * s - 2 * a1 + a2 - s * m2 * m2 / 2
        r2 = a1 - a2 + s * m1 * m1 / 2
        g = c / 2
        inverse = 1 / (4 / 9 - g * g)
        f1 = w1 + h * (r1 / 3 - g * r2) * inverse
        f2 = w2 + h * (4 / 3 * r2 - g * r1) * inverse
        w11, w12 = inverse / 3, -(1 / 3 + g) * inverse
        w22 = (4 / 3 + 2 * g + 1 / 3) * inverse
        u1, u2 = f1, f2 - f1
        for _ in range(projections):
            t1 = xp.clip((u1 / h - w12 * t2) / w11, -tau[0], tau[0])
            t2 = xp.clip((u2 / h - w12 * t1) / w22, -tau[1], tau[1])
        v1 = u1 - h * (w11 * t1 + w12 * t2)
        v2 = v1 + u2 - h * (w12 * t1 + w22 * t2)
    return (p1 + h * (w1 + v1) / 2, p2 + h * (w2 + v2) / 2, v1, v2), (t1, t2)


def motion(q, tau, phi, omega, span, steps):
    """The state after `span`."""
    y, torques = (*phi, *omega), (0.0, 0.0)
    for _ in range(steps):
        y, torques = step(q, tau, span / steps, y, torques)
    return y
