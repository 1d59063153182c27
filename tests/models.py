"""The column in plain NumPy: field, divergence, Jacobian, for scipy's integrators.

Uniform rods where nothing else is said; viscous joints and friction tau tanh(u / v) in
both of them. Not the package's code; tests, benchmarks and figures share it.
"""

import numpy as np
from scipy.integrate import solve_ivp

A, B, D = UNIFORM = 4 / 3, 1 / 2, 1 / 3


def accelerations(
    m, q, torques, phi1, phi2, w1, w2, inertia=UNIFORM, kappa=1.0, follower=1.0
):
    """(w1', w2') under the joints' torques, or None; sine and cosine are those of `m`.

    a w1' + b cosD w2' + b sinD w2^2 + (kappa + 1) phi1 - phi2
                                         = q sin(phi1 - eta phi2) - T1 + T2
    b cosD w1' + d w2' - b sinD w1^2 - phi1 + phi2
                                         = q sin((1 - eta) phi2) - T2,  D = phi1 - phi2
    """
    a, b, d = inertia
    s, c = m.sin(phi1 - phi2), m.cos(phi1 - phi2)
    if follower == 1.0:
        push1, push2 = q * s, 0.0
    else:
        push1 = q * m.sin(phi1 - follower * phi2)
        push2 = q * m.sin((1.0 - follower) * phi2)
    r1 = push1 - (kappa + 1.0) * phi1 + phi2 - b * s * w2 * w2
    r2 = push2 + phi1 - phi2 + b * s * w1 * w1
    if torques is not None:
        r1, r2 = r1 - torques[0] + torques[1], r2 - torques[1]
    h = b * c
    # not a d - h h: nothing cancels beside the constants
    det = (a * d - b * b) + (b * s) * (b * s)
    return (d * r1 - h * r2) / det, (a * r2 - h * r1) / det


def field(y, q, tau, v, c1, c2, inertia=UNIFORM):
    _, _, w1, w2 = y
    t1 = tau * np.tanh(w1 / v) + c1 * w1
    t2 = tau * np.tanh((w2 - w1) / v) + c2 * (w2 - w1)
    return np.array([w1, w2, *accelerations(np, q, (t1, t2), *y, inertia)])


def divergence(y, q, tau, v, c1, c2, inertia=UNIFORM):
    """-tr(M^-1 C) - d/dt ln det M with the slopes of friction in C."""
    p1, p2, w1, w2 = y
    a, b, d = inertia
    s, c = np.sin(p1 - p2), np.cos(p1 - p2)
    h = b * c
    det = a * d - h * h
    k1 = c1 + tau / v / np.cosh(w1 / v) ** 2
    k2 = c2 + tau / v / np.cosh((w2 - w1) / v) ** 2
    loss = (d * (k1 + k2) + 2 * h * k2 + a * k2) / det
    return -loss - 2 * h * b * s * (w1 - w2) / det


def jacobian(y, *numbers, step=1e-6):
    """Central differences."""
    columns = []
    for e in np.eye(4):
        ahead, back = (field(y + d * step * e, *numbers) for d in (1, -1))
        columns.append((ahead - back) / (2 * step))
    return np.array(columns).T


def flow(y0, span, numbers, tol=1e-10, **more):
    return solve_ivp(
        lambda t, y: field(y, *numbers), (0, span), y0,
        method="DOP853", rtol=tol, atol=tol, **more,
    )  # fmt: skip


def mean_divergence(y0, start, end, numbers, tol=1e-9):
    def both(t, y):
        return np.append(field(y[:4], *numbers), divergence(y[:4], *numbers))

    found = solve_ivp(
        both, (0, end), np.append(y0, 0.0),
        method="DOP853", rtol=tol, atol=tol, t_eval=[start, end],
    )  # fmt: skip
    return np.diff(found.y[4])[0] / (end - start)


def floquet(y0, numbers):
    """Period and multipliers of the cycle near y0: one more turn, with its tangents."""

    def rising(t, y):
        return y[0]

    rising.direction = 1
    turns = flow(y0, 40.0, numbers, events=rising)
    points, times = turns.y_events[0], turns.t_events[0]
    assert np.abs(points[-1] - points[-2]).max() < 1e-6
    period = times[-1] - times[-2]

    def both(t, x):
        jac = jacobian(x[:4], *numbers)
        return np.append(field(x[:4], *numbers), jac @ x[4:].reshape(4, 4))

    begin = np.append(points[-1], np.eye(4))
    end = solve_ivp(both, (0, period), begin, method="DOP853", rtol=1e-9, atol=1e-9)
    multipliers = np.linalg.eigvals(end.y[4:, -1].reshape(4, 4))
    return period, multipliers[np.argsort(-np.abs(multipliers))]


def benettin(y0, numbers, transient, span, blocks, apart=1e-7, renew=2.0):
    """The largest exponent from two neighbours, brought together again and again."""
    y = flow(y0, transient, numbers, 1e-9).y[:, -1]
    near = y + apart * np.array([0.5, 0.5, 0.5, 0.5])
    rates = []
    for _ in range(int(span / renew)):
        y = flow(y, renew, numbers, 1e-10).y[:, -1]
        near = flow(near, renew, numbers, 1e-10).y[:, -1]
        size = np.linalg.norm(near - y)
        rates.append(np.log(size / apart) / renew)
        near = y + (near - y) * apart / size
    rates = np.reshape(rates, (blocks, -1)).mean(axis=1)
    return rates.mean(), rates.std(ddof=1) / np.sqrt(blocks)
