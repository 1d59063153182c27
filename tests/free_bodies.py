r"""A chain as free bodies that joints hold together: a second formulation of n rods.

As `newton_euler` has it for two: each rod has a centre of mass and an angle of its own,
a mass at the tip is a body, too. Unknown at every instant are the accelerations of all
and the forces of the joints, given by Newton's and Euler's laws of each and the
equations of the joints. Weights act at centres, air and foundation at Gauss points, the
load where it acts: no mass matrix, no generalised force, no Lagrangian. Friction is
set-valued or smoothed; scipy integrates from event to event.
"""

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

POINTS, WEIGHTS = np.polynomial.legendre.leggauss(3)  # exact for drag and foundation
POINTS, WEIGHTS = (POINTS + 1) / 2, WEIGHTS / 2


@dataclass(frozen=True)
class Bodies:
    """Numbers of a chain, one a rod or joint; `forces`: (rod, weight, eta, share)."""

    q: float
    lengths: Any
    masses: Any
    springs: Any
    centres: Any = None
    inertias: Any = None
    forces: Any = None
    tip_mass: float = 0.0
    tip_inertia: float = 0.0
    rest_angles: Any = None
    viscous: Any = None
    air: Any = None
    foundation: Any = None
    gravity: tuple = (0.0, 0.0)  # size, direction
    dead_load: tuple = (0.0, 0.0)
    mu_s: Any = None  # torques
    mu_k: Any = None

    @property
    def n(self):
        return len(self.lengths)

    def of(self, name, usual):
        value = getattr(self, name)
        return np.full(self.n, usual) if value is None else np.asarray(value, float)

    def response(self, y):
        """Angular accelerations at zero joint torques, and by each torque, (n, 1 + n).

        Angles turn from z to x. Unknowns: of each rod x, z, angle; of each joint the
        force on the rod beyond it; of the tip's mass x, z and the force on it.
        """
        n = self.n
        long, m = np.asarray(self.lengths), np.asarray(self.masses)
        phi, w = y[:n], y[n:]
        along = np.stack([np.sin(phi), np.cos(phi)], 1)
        across = np.stack([np.cos(phi), -np.sin(phi)], 1)
        s = long / 2 if self.centres is None else np.asarray(self.centres)
        inertia = m * long**2 / 12 if self.inertias is None else np.array(self.inertias)
        inertia = inertia + self.tip_inertia * (np.arange(n) == n - 1)
        size = 5 * n + 4
        matrix, known = np.zeros((size, size)), np.zeros((size, 1 + n))
        joint = lambda i: 3 * n + 2 * i  # noqa: E731
        tip = 5 * n
        forces, moments = np.zeros((n, 2)), np.zeros(n)  # about the centres
        end = np.zeros(2)

        def act(i, share, force):
            forces[i] += force
            moments[i] += (share - s[i]) * across[i] @ force

        def down(angle):
            return -np.array([np.sin(angle), np.cos(angle)])

        pattern = [(n - 1, 1.0, 1.0, 1.0)] if self.forces is None else self.forces
        for k, weight, eta, share in pattern:
            act(k, share * long[k], self.q * weight * down(eta * phi[k]))
        g, direction = self.gravity
        for i in range(n):
            act(i, s[i], g * m[i] * down(direction))
        end += g * self.tip_mass * down(direction)
        end += self.dead_load[0] * down(self.dead_load[1])
        air, w0 = self.of("air", 0.0), self.of("foundation", 0.0)
        base, base_rate = np.zeros(2), np.zeros(2)
        for i in range(n):
            for share, weight in zip(POINTS, WEIGHTS, strict=True):
                at = base + share * long[i] * along[i]
                velocity = base_rate + share * long[i] * w[i] * across[i]
                force = -air[i] * velocity - w0[i] * np.array([at[0], 0.0])
                act(i, share * long[i], weight * long[i] * force)
            base = base + long[i] * along[i]
            base_rate = base_rate + long[i] * w[i] * across[i]
        theta, u = np.diff(phi, prepend=0.0), np.diff(w, prepend=0.0)
        held = self.of("springs", 1.0) * (theta - self.of("rest_angles", 0.0))
        held = held + self.of("viscous", 0.0) * u
        for i in range(n):
            for k in (0, 1):
                row = 3 * i + k
                matrix[row, row] = m[i]
                matrix[row, joint(i) + k] = -1
                beyond = joint(i + 1) + k if i + 1 < n else tip + 2 + k
                matrix[row, beyond] = 1
                known[row, 0] = forces[i, k]
                matrix[3 * i + 2, joint(i) + k] = s[i] * across[i, k]
                matrix[3 * i + 2, beyond] = (long[i] - s[i]) * across[i, k]
                # where the rod begins the one before it ends
                row = 3 * n + 2 * i + k
                matrix[row, 3 * i + k] = 1
                matrix[row, 3 * i + 2] = -s[i] * across[i, k]
                known[row, 0] = -s[i] * along[i, k] * w[i] ** 2
                if i:
                    matrix[row, 3 * i - 3 + k] = -1
                    rest = long[i - 1] - s[i - 1]
                    matrix[row, 3 * i - 1] = -rest * across[i - 1, k]
                    known[row, 0] += -rest * along[i - 1, k] * w[i - 1] ** 2
            matrix[3 * i + 2, 3 * i + 2] = inertia[i]
            known[3 * i + 2, 0] = moments[i] - held[i]
            known[3 * i + 2, 1 + i] = -1
            if i + 1 < n:
                known[3 * i + 2, 0] += held[i + 1]
                known[3 * i + 2, 2 + i] = 1
        for k in (0, 1):
            row, i = tip + k, n - 1
            matrix[row, tip + k], matrix[row, 3 * i + k] = 1, -1
            rest = long[i] - s[i]
            matrix[row, 3 * i + 2] = -rest * across[i, k]
            known[row, 0] = -rest * along[i, k] * w[i] ** 2
            matrix[tip + 2 + k, tip + k] = self.tip_mass
            matrix[tip + 2 + k, tip + 2 + k] = -1
            known[tip + 2 + k, 0] = end[k]
        x = np.linalg.solve(matrix, known)
        return x[2 : 3 * n : 3]

    def solved(self, y, levers, response=None):
        """Angular accelerations and torques; a lever None: the joint sticks."""
        x = self.response(y) if response is None else response
        joints = np.diff(x, axis=0, prepend=np.zeros((1, x.shape[1])))
        t = np.array([0.0 if g is None else g for g in levers])
        stuck = [i for i, g in enumerate(levers) if g is None]
        if stuck:
            left = joints[stuck, 0] + joints[stuck, 1:] @ t
            block = joints[np.ix_(stuck, [1 + i for i in stuck])]
            t[stuck] = -np.linalg.solve(block, left)
        return x[:, 0] + x[:, 1:] @ t, t

    def levers(self, modes):
        pairs = zip(modes, self.mu_k, strict=True)
        return [None if m == 0 else m * mu for m, mu in pairs]

    def modes(self, y, rest, going, freed=None):
        """Modes at a state: as many joints stick as can, as in `newton_euler`."""
        response = self.response(y)
        options = [(-1, 0, 1) if r else (g,) for r, g in zip(rest, going, strict=True)]
        if freed is not None:
            options[freed] = (going[freed],)
        found = []
        for modes in itertools.product(*options):
            _, torques = self.solved(y, self.levers(modes), response)
            fits, over, static = True, 0.0, True
            for i, m in enumerate(modes):
                if m == 0:
                    fits &= abs(torques[i]) <= self.mu_s[i]
                elif rest[i] and i != freed:
                    held = [*modes[:i], 0, *modes[i + 1 :]]
                    torque = m * self.solved(y, self.levers(held), response)[1][i]
                    fits &= torque > self.mu_k[i]
                    static &= torque > self.mu_s[i]
                    over = max(over, torque - self.mu_s[i])
            if fits:
                found.append((static, sum(m == 0 for m in modes), over, modes))
        return max(found)[3]


def smoothed(bodies, y0, ts, v, tol=1e-11):
    """States at the times `ts` under mu_k tanh(u / v), (n, 2 n)."""
    n = bodies.n

    def field(t, y):
        u = np.diff(y[n:], prepend=0.0)
        friction = np.zeros(n) if bodies.mu_k is None else np.asarray(bodies.mu_k)
        levers = list(friction * np.tanh(u / v))
        return np.concatenate([y[n:], bodies.solved(y, levers)[0]])

    span = ts[0], ts[-1]
    return solve_ivp(field, span, y0, "DOP853", ts, rtol=tol, atol=tol).y.T


def motion(bodies, y0, ts, tol=1e-11, most=1000):
    """States at the times `ts` and events (time, joint from 1, modes): set-valued.

    Steps are short, and where a guard's least value is below zero the step before is
    done again up to there, as in `newton_euler`.
    """
    n, ts = bodies.n, np.asarray(ts, float)
    y, t, log, out = np.array(y0, float), ts[0], [], [np.array(y0, float)]
    u = np.diff(y[n:], prepend=0.0)
    modes = bodies.modes(y, [x == 0 for x in u], np.sign(u).astype(int).tolist())
    while t < ts[-1] and any(modes):
        field, guards, slopes = _watched(bodies, modes)
        end = ts[-1]
        while True:
            ahead = ts[(ts > t) & (ts <= end)]
            found = solve_ivp(
                field, (t, end), y, "DOP853", ahead, rtol=tol, atol=tol,
                max_step=0.06, events=[*guards, *slopes],
            )  # fmt: skip
            dips = [
                (at, i)
                for i in range(n)
                for at, x in zip(
                    found.t_events[n + i], found.y_events[n + i], strict=True
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
        i = next(i for i in range(n) if found.t_events[i].size)
        t, y = found.t_events[i][0], found.y_events[i][0].copy()
        going, freed = list(modes), None
        if modes[i] == 0:
            torque = bodies.solved(y, bodies.levers(modes))[1][i]
            going[i], freed = int(np.sign(torque)), i
        rest = [m == 0 for m in modes]
        rest[i] = True
        for k in range(n):
            if rest[k]:
                y[n + k] = y[n + k - 1] if k else 0.0
        modes = tuple(bodies.modes(y, rest, going, freed))
        log.append((t, i + 1, modes))
        assert len(log) < most, "events do not end"
    out += [y] * (len(ts) - len(out))
    return np.array(out), log


def _watched(bodies, modes, near=1e-6):
    """In given modes: the field, guards, the guards' slopes, as scipy takes them."""
    levers, n = bodies.levers(modes), bodies.n

    def field(t, y):
        return np.concatenate([y[n:], bodies.solved(y, levers)[0]])

    def guard(i):
        def of(t, y):
            if modes[i] != 0:
                return modes[i] * (y[n + i] - (y[n + i - 1] if i else 0.0))
            return bodies.mu_s[i] - abs(bodies.solved(y, levers)[1][i])

        of.terminal, of.direction = True, -1
        return of

    def slope(of):
        def rises(t, y):
            f = field(t, y)
            return (of(t, y + near * f) - of(t, y - near * f)) / (2 * near)

        rises.direction = 1
        return rises

    guards = [guard(i) for i in range(n)]
    return field, guards, [slope(of) for of in guards]
