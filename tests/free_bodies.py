r"""A chain as free bodies that joints hold together: a second formulation of n rods.

Each rod has a centre of mass and an angle of its own, a mass at the tip is a body, too.
Unknown at every instant are the accelerations of all and the forces of the joints,
given by Newton's and Euler's laws of each and the equations of the joints. So the
reactions that friction may rest on are solved for with everything else. Weights act at
centres, air and foundation at Gauss points, the load where it acts: no mass matrix, no
generalised force, no Lagrangian. Friction is set-valued or smoothed; scipy integrates
from event to event.
"""

import itertools
import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

POINTS, WEIGHTS = np.polynomial.legendre.leggauss(3)  # exact for drag and foundation
POINTS, WEIGHTS = (POINTS + 1) / 2, WEIGHTS / 2


def down(size, angle):
    return -size * math.sin(angle), -size * math.cos(angle)


def joints_of(x):
    """Of the rods' angles or rates those of the joints."""
    return [x[0], *(b - a for a, b in zip(x, x[1:], strict=False))]


def _at(row, t):
    """A number that is affine in the torques."""
    return row[0] + sum(a * b for a, b in zip(row[1:], t, strict=True))


def _held(joints, columns):
    """Of joints that stick the torques, affine in those of the others."""
    if len(joints) == 1:
        (row,), (j,) = joints, columns
        rows = [[-a / row[j] for a in row]]
    else:
        dense = np.array(joints)
        rows = (-np.linalg.solve(dense[:, columns], dense)).tolist()
    for row in rows:
        for j in columns:
            row[j] = 0.0
    return rows


@dataclass(frozen=True)
class Bodies:
    """Numbers of a chain, one a rod or joint; `forces`: (rod, weight, eta, share).

    `load`: the joints' normal loads, None: what they transmit; `preload`: what is added
    to that.
    """

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
    mu_s: Any = None  # torques, of each unit of load
    mu_k: Any = None
    load: Any = 1.0
    preload: Any = 0.0

    @property
    def n(self):
        return len(self.lengths)

    def of(self, name, usual):
        value = getattr(self, name)
        return np.broadcast_to(usual if value is None else value, self.n).astype(float)

    @cached_property
    def still(self):
        """What no motion changes: of the equations, and where the others go."""
        n, tip = self.n, 5 * self.n
        long, m = np.asarray(self.lengths, float), np.asarray(self.masses, float)
        s = long / 2 if self.centres is None else np.asarray(self.centres, float)
        inertia = self.of("inertias", m * long**2 / 12)
        inertia = inertia + self.tip_inertia * (np.arange(n) == n - 1)
        size, rods, way = tip + 4, 3 * np.arange(n)[:, None], np.arange(2)
        matrix, known = np.zeros((size, size)), np.zeros((size, 1 + n))
        place, angle, joint = rods + way, rods + 2, 3 * n + rods * 2 // 3 + way
        beyond = np.vstack([joint[1:], tip + 2 + way])  # what a rod's end bears
        # m r'' = sum of forces; each rod bears the next one's force backwards
        matrix[place, place] = m[:, None]
        matrix[place, joint], matrix[place, beyond] = -1, 1
        matrix[angle, angle] = inertia[:, None]
        known[angle[:, 0], 1 + np.arange(n)] = -1
        known[angle[:-1, 0], 2 + np.arange(n - 1)] = 1
        # where a rod begins the one before it ends, and at the last one's end the tip
        matrix[joint, place] = 1
        matrix[joint[1:], place[:-1]] = -1
        matrix[tip + way, tip + way], matrix[tip + way, place[-1]] = 1, -1
        matrix[tip + 2 + way, tip + way] = self.tip_mass
        matrix[tip + 2 + way, tip + 2 + way] = -1
        after = np.vstack([joint[1:], tip + way])
        turned = ((angle, joint), (angle, beyond), (joint, angle), (after, angle))
        flat = np.concatenate([np.ravel(i * size + j) for i, j in turned])
        rows = [*place.ravel(), *angle[:, 0], *joint.ravel(), *(tip + way)]
        rows += [*(tip + 2 + way)]
        return *(x.tolist() for x in (long, m, s)), matrix, known, flat, rows

    def response(self, y):
        """The unknowns at zero joint torques, and by each torque, (5 n + 4, 1 + n).

        Accelerations of each rod's x, z, angle, which turns from z to x; of each joint
        the force on the rod beyond it; of the tip's mass x, z and the force on it.
        """
        n, (long, _, s, matrix, known, flat, rows) = self.n, self.still
        matrix, known = matrix.copy(), known.copy()
        phi, w = [float(x) for x in y[:n]], [float(x) for x in y[n:]]
        along = [(math.sin(x), math.cos(x)) for x in phi]
        across = [(c, -s) for s, c in along]
        arm = [s[i] * a for i in range(n) for a in across[i]]
        rest = [(long[i] - s[i]) * a for i in range(n) for a in across[i]]
        matrix.ravel()[flat] = [*arm, *rest, *(-a for a in arm), *(-a for a in rest)]
        forces, moments, end = self.acting(along, across, phi, w)
        inward = [a * w[i] * w[i] for i in range(n) for a in along[i]]
        begins = [-s[i // 2] * a for i, a in enumerate(inward)] + [0.0, 0.0]
        for i, a in enumerate(inward):
            begins[i + 2] -= (long[i // 2] - s[i // 2]) * a
        known[rows, 0] = [*(x for f in forces for x in f), *moments, *begins, *end]
        return np.linalg.solve(matrix, known)

    def acting(self, along, across, phi, w):
        """Forces on the rods, their moments about the centres, the force on the tip."""
        n, (long, m, s, *_) = self.n, self.still
        twist = [
            k * (x - rest) + c * u
            for k, rest, c, x, u in zip(
                *self.joint_laws, joints_of(phi), joints_of(w), strict=True
            )
        ]
        forces = [[0.0, 0.0] for _ in range(n)]
        moments = [b - a for a, b in zip(twist, [*twist[1:], 0.0], strict=True)]
        end = [0.0, 0.0]

        def act(i, place, x, z):
            forces[i][0] += x
            forces[i][1] += z
            moments[i] += (place - s[i]) * (across[i][0] * x + across[i][1] * z)

        pattern = [(n - 1, 1.0, 1.0, 1.0)] if self.forces is None else self.forces
        for k, weight, eta, share in pattern:
            act(k, share * long[k], *down(self.q * weight, eta * phi[k]))
        g, direction = self.gravity
        if g:
            for i in range(n):
                act(i, s[i], *down(g * m[i], direction))
        for size, angle in ((g * self.tip_mass, direction), self.dead_load):
            end = [a + b for a, b in zip(end, down(size, angle), strict=True)]
        air, springs = self.spread
        x0 = vx0 = vz0 = 0.0
        for i in range(n if any(air) or any(springs) else 0):
            (ax, _), (cx, cz), span = along[i], across[i], long[i]
            for share, weight in zip(POINTS, WEIGHTS, strict=True):
                place = share * span
                vx, vz = vx0 + place * w[i] * cx, vz0 + place * w[i] * cz
                x = -air[i] * vx - springs[i] * (x0 + place * ax)
                act(i, place, weight * span * x, -weight * span * air[i] * vz)
            x0, vx0, vz0 = (
                x0 + span * ax,
                vx0 + span * w[i] * cx,
                vz0 + span * w[i] * cz,
            )
        return forces, moments, end

    @cached_property
    def joint_laws(self):
        names = (("springs", 1.0), ("rest_angles", 0.0), ("viscous", 0.0))
        return [self.of(*name).tolist() for name in names]

    @cached_property
    def spread(self):
        return [self.of(name, 0.0).tolist() for name in ("air", "foundation")]

    def solved(self, y, levers, response=None):
        """Accelerations of angles, torques, normal loads.

        `levers`: of each joint what its torque is of its load, or None: it sticks.
        """
        x = (self.response(y) if response is None else response).tolist()
        n, rods = self.n, x[2 : 3 * self.n : 3]
        slip, loads = [g or 0.0 for g in levers], self.load
        stuck = [i for i, g in enumerate(levers) if g is None]
        held = []
        if stuck:  # torques such that these do not move, by what the others do
            joints = [
                [a - (rods[i - 1][j] if i else 0.0) for j, a in enumerate(rods[i])]
                for i in stuck
            ]
            held = _held(joints, [1 + i for i in stuck])
        t = [0.0] * n
        for _ in range(100):
            before = t
            normal = self._normal(x, t) if loads is None else self.loads
            t = [g * load for g, load in zip(slip, normal, strict=True)]
            for i, row in zip(stuck, [_at(row, t) for row in held], strict=True):
                t[i] = row
            off = max(abs(a - b) for a, b in zip(t, before, strict=True))
            if loads is not None or off < 1e-15:
                break
        else:
            raise ArithmeticError("torques and reactions do not agree")
        normal = self._normal(x, t) if loads is None else self.loads
        return [_at(row, t) for row in rods], t, normal

    @cached_property
    def loads(self):
        return self.of("load", 1.0).tolist()

    def _normal(self, x, t):
        r, added = [_at(row, t) for row in x[3 * self.n : 5 * self.n]], self.preloads
        pairs = zip(r[::2], r[1::2], added, strict=True)
        return [math.hypot(a, b) + preload for a, b, preload in pairs]

    @cached_property
    def preloads(self):
        return self.of("preload", 0.0).tolist()

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
                    held = [*modes[:i], 0, *modes[i + 1 :]]
                    at = self.solved(y, self.levers(held), response)
                    torque, load = m * at[1][i], at[2][i]
                    fits &= torque > self.mu_k[i] * load
                    static &= torque > self.mu_s[i] * load
                    over = max(over, torque - self.mu_s[i] * load)
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


def motion(bodies, y0, ts, tol=1e-11, most=10_000, modes=None):
    """States at the times `ts`, (n, 2 n), and events (time, joint from 1, modes).

    `modes`: those of the start, where it is not for the state to say.

    scipy looks for events at the ends of steps. So the least values of each guard are
    events too: where one is below zero the step before it is done again up to there.
    Steps are short, as a guard's slope may change its sign twice within a long one.
    """
    n, ts = bodies.n, np.asarray(ts, float)
    y, t, log, out = np.array(y0, float), ts[0], [], [np.array(y0, float)]
    u = np.diff(y[n:], prepend=0.0)
    if modes is None:
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
            _, torques, loads = bodies.solved(y, levers)
            return bodies.mu_s[i] * loads[i] - abs(torques[i])

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
