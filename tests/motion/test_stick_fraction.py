"""How the stick fraction moves with load and friction, against scipy's event times.

Motions are those of two free rods (`newton_euler`), times below the cut lie between
roots by Brent's method on scipy's own interpolant, and their derivatives are central
differences. Joints are preloaded by the load q, as by default.
"""

import itertools
import math

import jax
import numpy as np
import pytest
from models import accelerations
from newton_euler import Rods, motion
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import ziegler_jax as zj

Q, MU_S, MU_K, C = 2.6, 0.12, 0.1, 0.02
V_SMOOTH, V_STRIBECK = 0.05, 0.3
FROM, TO = 5.0, 25.0  # the fixed span
TOL = 1e-11
HARD = {"rtol": TOL, "atol": TOL, "max_step": 0.06, "dense_output": True}


def smoothed_field(radius, q, mu_k):
    def torque(u):
        fall = (MU_S - mu_k) * math.exp(-((u / V_STRIBECK) ** 2))
        return radius * q * (mu_k + fall) * math.tanh(u / V_SMOOTH) + C * u

    def field(t, y):
        torques = torque(y[2]), torque(y[3] - y[2])
        return [*y[2:], *accelerations(math, q, torques, *y)]

    return field


def rates(solution, ts):
    y = solution(ts)
    return y[2], y[3] - y[2]


def below(found, begin, cut):
    """The time from `begin` on in which each joint's rate is below the cut."""
    fine = np.concatenate([np.linspace(*ab, 8) for ab in itertools.pairwise(found.t)])
    fine, times = np.unique(np.clip(fine, begin, None)), []
    for i, values in enumerate(rates(found.sol, fine)):
        edges = [fine[0], fine[-1]]
        for level in (cut, -cut):
            over = values > level
            for k in np.flatnonzero(over[1:] != over[:-1]):
                edges.append(
                    brentq(
                        lambda t, i=i, level=level: rates(found.sol, t)[i] - level,
                        fine[k], fine[k + 1], xtol=1e-14,
                    )
                )  # fmt: skip
        edges = np.sort(edges)
        inside = np.abs(rates(found.sol, (edges[1:] + edges[:-1]) / 2)[i]) < cut
        times.append((np.diff(edges) * inside).sum())
    return np.array(times)


def smoothed_share(radius, kick):
    """Over the fixed span."""

    def share(q, mu_k):
        field, y0 = smoothed_field(radius, q, mu_k), [0, 0, 0, kick]
        found = solve_ivp(field, (0, TO), y0, "DOP853", **HARD)
        return below(found, FROM, V_SMOOTH) / (TO - FROM)

    return share


def smoothed_cycle(radius, kick):
    """Over a turn of the cycle, from one passage of joint 1 to the next."""

    def rising(t, y):
        return y[0]

    rising.direction = 1
    on_it = []

    def share(q, mu_k):
        field = smoothed_field(radius, q, mu_k)
        y0 = on_it[0] if on_it else [0, 0, 0, kick]
        options = {"rtol": TOL, "atol": TOL}
        late = solve_ivp(field, (0, 200 if on_it else 400), y0, "DOP853", **options).y[
            :, -1
        ]
        turns = solve_ivp(field, (0, 40), late, "DOP853", events=rising, **options)
        *_, before, y0 = turns.y_events[0]
        assert np.abs(before - y0).max() < 1e-9
        period = np.diff(turns.t_events[0])[-1]
        on_it[:] = [y0]
        found = solve_ivp(field, (0, period), y0, "DOP853", **HARD)
        return below(found, 0.0, V_SMOOTH) / period

    return share


def dry_motion(radius, q, mu_k, y0, end):
    """The rods, and their modes with the times at which these begin."""
    lever = radius * q
    law = {"mu_s": (lever * MU_S,) * 2, "mu_k": (lever * mu_k,) * 2}
    rods, u = Rods(q, **law, viscous=(C, C)), (y0[2], y0[3] - y0[2])
    first = rods.bodies.modes(y0, [x == 0 for x in u], np.sign(u).astype(int).tolist())
    states, log = motion(rods, y0, [0.0, end], TOL)
    return rods, [(0.0, first), *((t, m) for t, _, m in log)], states[-1]


def stuck(phases, begin, end):
    """For how long each joint sticks."""
    ends = [*(t for t, _ in phases[1:]), np.inf]
    time = np.zeros(2)
    for (t, modes), after in zip(phases, ends, strict=True):
        inside = max(0.0, min(after, end) - max(t, begin))
        time += inside * (np.array(modes) == 0)
    return time


def dry_share(radius, kick, cut=None):
    """Over the fixed span; with a cut each phase is followed once more."""

    def share(q, mu_k):
        y = np.array([0, 0, 0, kick])
        rods, phases, _ = dry_motion(radius, q, mu_k, y, TO)
        if cut is None:
            return stuck(phases, FROM, TO) / (TO - FROM)
        time, ends = np.zeros(2), [*(t for t, _ in phases[1:]), TO]
        for (t, modes), end in zip(phases, ends, strict=True):
            levers = rods.bodies.levers(modes)
            y[2], y[3] = y[2] * (modes[0] != 0), y[3] if modes[1] else y[2]

            def field(t, y, levers=levers):
                return [*y[2:], *rods.bodies.solved(y, levers)[0]]

            found = solve_ivp(field, (t, end), y, "DOP853", **HARD)
            time += below(found, FROM, cut) if end > FROM else 0.0
            y = found.y[:, -1].copy()
        return time / (TO - FROM)

    return share


def dry_cycle(radius, kick):
    """Over a turn, from one landing of joint 2 that moved forwards to the next."""
    on_it = []

    def share(q, mu_k):
        y0, end = (on_it[0], 60.0) if on_it else ([0, 0, 0, kick], 100.0)
        _, phases, last = dry_motion(radius, q, mu_k, y0, end)
        on_it[:] = [last]
        pairs = itertools.pairwise(phases)
        lands = [t for (_, a), (t, b) in pairs if a[1] == 1 and b[1] == 0]
        first, *_, begin, end = lands[-4:]
        assert abs((end - begin) - (begin - first) / (len(lands[-4:]) - 2)) < 1e-7
        return stuck(phases, begin, end) / (end - begin)

    return share


def of_the_package(law, kick, cut, windows, method):
    def share(q, mu_k):
        column = zj.uniform_rods(q, friction=law(mu_k), damping=zj.Viscous(C, C))
        options = {"observers": (zj.StickFraction(cut),), "method": method}
        if windows:
            span = zj.Windows(transient=FROM, length=TO - FROM, max_windows=1)
            options |= {"windows": span, "certify": False}
        end = zj.settle(column, zj.State(omega=(0.0, kick)), **options)
        return end.stick_fraction, (end.stick_fraction, end.outcome)

    both = jax.jit(jax.jacfwd(share, argnums=(0, 1), has_aux=True))
    (by_q, by_mu_k), (value, outcome) = both(Q, MU_K)
    ends = zj.CODE.unsettled if windows else zj.CODE.cycle
    assert int(outcome) == ends
    return value, np.stack([by_q, by_mu_k])


def differences(share, step=5e-4):
    """Central ones, by load and by kinetic friction."""
    moved = []
    for dq, dk in ((step * Q, 0.0), (0.0, step * MU_K)):
        after, before = (share(Q + s * dq, MU_K + s * dk) for s in (1, -1))
        moved.append((after - before) / (2 * (dq + dk)))
    return np.stack(moved)


def smooth(radius):
    options = {"pin_radius": radius, "v_smooth": V_SMOOTH, "v_stribeck": V_STRIBECK}
    return lambda mu_k: zj.SmoothCoulomb(MU_S, mu_k, **options)


def dry(radius):
    return lambda mu_k: zj.SetValuedCoulomb(MU_S, mu_k, pin_radius=radius)


FINE = zj.Method(rtol=1e-8, atol=1e-8)
CASES = {
    "smoothed, a span": (smooth(0.1), 0.3, None, FINE, smoothed_share(0.1, 0.3)),
    "smoothed, a cycle": (
        smooth(0.1), 0.3, None, zj.Method(), smoothed_cycle(0.1, 0.3)
    ),
    "dry, a span": (dry(0.1), 0.3, None, FINE, dry_share(0.1, 0.3)),
    "dry with a cut, a span": (dry(0.1), 0.3, 0.05, FINE, dry_share(0.1, 0.3, 0.05)),
    "dry, a cycle": (dry(0.3), 1.5, None, zj.Method(), dry_cycle(0.3, 1.5)),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_a_stick_fraction_and_its_derivatives_are_those_of_scipys_event_times(name):
    law, kick, cut, method, share = CASES[name]
    value, slopes = of_the_package(law, kick, cut, "span" in name, method)
    exact = share(Q, MU_K)
    assert exact.max() > 0.005
    error = np.abs(value - exact).max()
    right = differences(share)
    off = np.abs(slopes - right).max(1) / np.abs(right).max(1)
    # measured 1.4e-6, of a cycle at the default tolerance
    assert error < 1e-5
    # measured 1.3e-5 (differences); by a step's cubic of the rate 3e-4 of the cycle's,
    # 4e-4 of the smoothed span's
    assert (off < 1e-4).all()
