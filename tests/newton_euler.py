r"""The column as two free bodies that joints hold together: a second formulation.

Each rod has a centre of mass and an angle of its own. Unknown at every instant are the
accelerations of both and the forces of both joints, ten numbers: Newton's and Euler's
laws of each rod, and the four equations of the joints. So the reactions that friction
may rest on are solved for with everything else, the drag of air is summed over points
of the rods, and no mass matrix, no generalised force and no Lagrangian is written down.
Uniform rods, set-valued or smoothed friction; scipy integrates from event to event.
"""

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

POINTS, WEIGHTS = np.polynomial.legendre.leggauss(3)  # exact for a rod's drag
POINTS, WEIGHTS = (POINTS + 1) / 2, WEIGHTS / 2


@dataclass(frozen=True)
class Rods:
    """Numbers of a column; `load`: the normal loads of both joints, None: reactions.

    `preload`: what is added to these.
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

    def response(self, y):
        """x at zero torques and its change by each joint's torque, (10, 3).

        x: accelerations of both centres (x, z), of both angles, the force of the base
        on rod 1, that of rod 1 on rod 2. Angles turn from z to x.
        """
        p1, p2, w1, w2 = y
        l2 = self.l2
        e1, n1 = (np.sin(p1), np.cos(p1)), (np.cos(p1), -np.sin(p1))
        e2, n2 = (np.sin(p2), np.cos(p2)), (np.cos(p2), -np.sin(p2))
        angle = self.follower * p2
        load = -self.q * np.sin(angle), -self.q * np.cos(angle)
        base = self.kappa * p1 + self.viscous[0] * w1
        knee = (p2 - p1) + self.viscous[1] * (w2 - w1)
        matrix, known = np.zeros((10, 10)), np.zeros((10, 3))
        for k in (0, 1):
            # m r'' = sum of forces; rod 1 bears the knee's force backwards
            matrix[k, k], matrix[k, 6 + k], matrix[k, 8 + k] = self.m1, -1, 1
            matrix[2 + k, 2 + k], matrix[2 + k, 8 + k] = self.m2, -1
            known[2 + k, 0] = load[k]
            # moments about the centres: arms of half a rod
            matrix[4, 6 + k] = matrix[4, 8 + k] = n1[k] / 2
            matrix[5, 8 + k] = l2 / 2 * n2[k]
            # the centres' accelerations are those of the joints' circles
            matrix[6 + k, k], matrix[6 + k, 4] = 1, -n1[k] / 2
            matrix[8 + k, 2 + k] = 1
            matrix[8 + k, 4], matrix[8 + k, 5] = -n1[k], -l2 / 2 * n2[k]
            known[6 + k, 0] = -e1[k] / 2 * w1**2
            known[8 + k, 0] = -e1[k] * w1**2 - l2 / 2 * e2[k] * w2**2
        matrix[4, 4], matrix[5, 5] = self.m1 / 12, self.m2 * l2**2 / 12
        known[4] = knee - base, -1, 1
        known[5] = l2 / 2 * (n2[0] * load[0] + n2[1] * load[1]) - knee, 0, -1
        if any(self.air):
            self._drag(known, n1, n2, w1, w2)
        return np.linalg.solve(matrix, known)

    def _drag(self, known, n1, n2, w1, w2):
        n1, n2 = np.array(n1), np.array(n2)
        for share, weight in zip(POINTS, WEIGHTS, strict=True):
            force = -self.air[0] * weight * share * w1 * n1
            known[0:2, 0] += force
            known[4, 0] += (share - 0.5) * n1 @ force
            velocity = w1 * n1 + share * self.l2 * w2 * n2
            force = -self.air[1] * weight * self.l2 * velocity
            known[2:4, 0] += force
            known[5, 0] += (share - 0.5) * self.l2 * n2 @ force

    def solved(self, y, levers, response=None):
        """Accelerations of angles, torques, normal loads.

        `levers`: of each joint what its torque is of its load, or None: it sticks.
        """
        x = (self.response(y) if response is None else response).tolist()
        (a1, b1, c1), (a2, b2, c2) = x[4], x[5]
        # accelerations of the joints, affine in both torques
        rows = (a1, b1, c1), (a2 - a1, b2 - b1, c2 - c1)
        loads, t1, t2 = self.load, 0.0, 0.0
        for _ in range(100):
            before = t1, t2
            n = self._normal(x, t1, t2) if loads is None else loads
            t1, t2 = _torques(rows, levers, n)
            if loads is not None or max(abs(t1 - before[0]), abs(t2 - before[1])) < (
                1e-15
            ):
                break
        else:
            raise ArithmeticError("torques and reactions do not agree")
        n = self._normal(x, t1, t2) if loads is None else loads
        moved = a1 + b1 * t1 + c1 * t2, a2 + b2 * t1 + c2 * t2
        return moved, (t1, t2), n

    def _normal(self, x, t1, t2):
        r = [row[0] + row[1] * t1 + row[2] * t2 for row in x[6:]]
        first, second = self.preload
        return np.hypot(r[0], r[1]) + first, np.hypot(r[2], r[3]) + second

    def levers(self, modes):
        pairs = zip(modes, self.mu_k, strict=True)
        return [None if m == 0 else m * mu for m, mu in pairs]

    def modes(self, y, rest, going, freed=None):
        """Modes at a state: as many joints stick as can.

        `rest`: which joints have no rate; `going`: where the others slip; `freed`: a
        joint that must slip, the way `going` says. A joint at rest that slips was
        beyond its static limit beside the other's mode, or else at least its kinetic.
        """
        response = self.response(y)
        options = [(-1, 0, 1) if r else (g,) for r, g in zip(rest, going, strict=True)]
        if freed is not None:
            options[freed] = (going[freed],)
        found = []
        for modes in itertools.product(*options):
            _, torques, loads = self.solved(y, self.levers(modes), response)
            fits, over, static = True, 0.0, True
            for i, m in enumerate(modes):
                if m == 0:
                    fits &= abs(torques[i]) <= self.mu_s[i] * loads[i]
                elif rest[i] and i != freed:
                    held = list(modes)
                    held[i] = 0
                    at = self.solved(y, self.levers(held), response)
                    torque, load = m * at[1][i], at[2][i]
                    fits &= torque > self.mu_k[i] * load
                    static &= torque > self.mu_s[i] * load
                    over = max(over, torque - self.mu_s[i] * load)
            if fits:
                sticking = sum(m == 0 for m in modes)
                found.append((static, sticking, over, modes))
        return max(found)[3]


def _torques(rows, levers, n):
    """Given by loads where joints slip, such that they do not move where they stick."""
    (a1, b1, c1), (a2, b2, c2) = rows
    g1, g2 = levers
    if g1 is None and g2 is None:
        det = b1 * c2 - c1 * b2
        return (c1 * a2 - c2 * a1) / det, (b2 * a1 - b1 * a2) / det
    if g1 is None:
        t2 = g2 * n[1]
        return -(a1 + c1 * t2) / b1, t2
    if g2 is None:
        t1 = g1 * n[0]
        return t1, -(a2 + b2 * t1) / c2
    return g1 * n[0], g2 * n[1]


def smoothed(rods, y0, ts, v, tol=1e-11):
    """States at the times `ts` under mu_k tanh(u / v), (n, 4)."""

    def field(t, y):
        u = y[2], y[3] - y[2]
        levers = [mu * np.tanh(x / v) for mu, x in zip(rods.mu_k, u, strict=True)]
        return *y[2:], *rods.solved(y, levers)[0]

    span = ts[0], ts[-1]
    found = solve_ivp(field, span, y0, "DOP853", ts, rtol=tol, atol=tol)
    return found.y.T


def motion(rods, y0, ts, tol=1e-11, most=10_000, modes=None):
    """States at the times `ts`, (n, 4), and events (time, joint from 1, modes).

    `modes`: those of the start, where it is not for the state to say.

    scipy looks for events at the ends of steps. So the least values of each guard are
    events too: where one is below zero the step before it is done again up to there.
    Steps are short, as a guard's slope may change its sign twice within a long one.
    """
    ts = np.asarray(ts, float)
    y, t, log, out = np.array(y0, float), ts[0], [], [np.array(y0, float)]
    if modes is None:
        u = y[2], y[3] - y[2]
        modes = rods.modes(y, [x == 0 for x in u], np.sign(u).astype(int).tolist())
    while t < ts[-1]:
        if modes == (0, 0):  # nothing moves
            out += [y] * int((ts > t).sum())
            break
        field, guards, slopes = _watched(rods, modes)
        end = ts[-1]
        while True:
            ahead = ts[(ts > t) & (ts <= end)]
            found = solve_ivp(
                field, (t, end), y, "DOP853", ahead, rtol=tol, atol=tol,
                max_step=0.06, events=[*guards, *slopes],
            )  # fmt: skip
            dips = [
                (at, i)
                for i in (0, 1)
                for at, x in zip(
                    found.t_events[2 + i], found.y_events[2 + i], strict=True
                )
                if guards[i](at, x) < 0
            ]
            if not dips or min(dips)[0] >= end:
                break
            end = min(dips)[0]
        if len(found.t):
            out += list(found.y.T)
        if found.status == 0 and end == ts[-1]:
            break
        i = 0 if found.t_events[0].size else 1
        t, y = found.t_events[i][0], found.y_events[i][0].copy()
        going, freed = list(modes), None
        if modes[i] == 0:
            torque = rods.solved(y, rods.levers(modes))[1][i]
            going[i], freed = int(np.sign(torque)), i
        rest = [m == 0 for m in modes]
        rest[i] = True
        if rest[0]:
            y[2] = 0.0
        if rest[1]:
            y[3] = y[2]
        modes = tuple(rods.modes(y, rest, going, freed))
        log.append((t, i + 1, modes))
        assert len(log) < most, "events do not end"
    return np.array(out), log


def _watched(rods, modes, near=1e-6):
    """In given modes: the field, guards, the guards' slopes, as scipy takes them."""
    levers = rods.levers(modes)

    def field(t, y):
        return np.array([*y[2:], *rods.solved(y, levers)[0]])

    def guard(i):
        def of(t, y):
            if modes[i] != 0:
                return modes[i] * (y[2] if i == 0 else y[3] - y[2])
            _, torques, loads = rods.solved(y, levers)
            return rods.mu_s[i] * loads[i] - abs(torques[i])

        of.terminal, of.direction = True, -1
        return of

    def slope(of):
        def rises(t, y):
            f = field(t, y)
            return (of(t, y + near * f) - of(t, y - near * f)) / (2 * near)

        rises.direction = 1
        return rises

    guards = [guard(i) for i in (0, 1)]
    return field, guards, [slope(of) for of in guards]
