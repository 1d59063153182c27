"""Dry friction: certified by default, with tangents on Taylor's steps."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from newton_euler import Rods, motion

import ziegler_jax as zj
from ziegler_jax.model.state import PhasePoint
from ziegler_jax.motion.observation import Observation
from ziegler_jax.solvers.along import along_to, expand_along
from ziegler_jax.solvers.expansion import expand
from ziegler_jax.steady.shots import attempt_at, blank_attempt, shot_motion, start_of

ARM = 0.05
# q, mu_s, mu_k: a joint that sticks twice a turn; none; another stable cycle near by,
# whose orbit the first shots find
CELLS = ((2.0, 0.2, 0.2), (2.6, 0.1, 0.04), (3.625, 0.2938, 0.05))


def column(q, mu_s, mu_k):
    law = zj.SetValuedCoulomb(mu_s, mu_k, pin_radius=ARM)
    return zj.uniform_rods(q, friction=law)


@pytest.fixture(scope="module")
def settled():
    """Certificates, and the orbits that they are of."""
    return certified(CELLS)


def certified(cells):
    def point(q, mu_s, mu_k):
        here = column(q, mu_s, mu_k)
        end = zj.settle(here, zj.State(omega=(0.0, 0.3)))
        return end, zj.periodic_orbit(here, end.final)

    return jax.jit(jax.vmap(point))(*np.transpose(cells))


def returned(rods, y, span):
    """Where the motion from y passes the section next, by the other code."""
    y = motion(rods, y, [0.0, span], tol=1e-12)[0][-1]
    u = y[2], y[3] - y[2]
    bodies = rods.bodies
    modes = bodies.modes(y, [x == 0 for x in u], np.sign(u).astype(int).tolist())
    slope = np.array([*y[2:], *bodies.solved(y, bodies.levers(modes))[0]])
    return (y - y[0] / slope[0] * slope)[1:]


def test_multipliers_are_those_of_two_free_bodies(settled):
    """Those of certificates and of orbits, against differences of their returns."""
    found, orbits = settled
    assert (found.outcome == zj.CODE.cycle).all()
    assert (orbits.outcome == zj.CODE.found).all()
    off = []
    for i, cell in enumerate(CELLS):
        values = by_differences(cell, orbits, i, 3e-5)
        own = np.sort(np.abs(np.asarray(orbits.multipliers[i])))[::-1]
        off.append(np.abs(own[1:] - values).max())
        off.append(abs(float(found.largest_multiplier[i]) - values[0]))
    assert max(off) < 1e-6, off  # measured 5e-7: of the differences


def by_differences(cell, orbits, i, h):
    """Moduli of the multipliers of an orbit, by the other code's returns, falling."""
    q, mu_s, mu_k = cell
    rods = Rods(q, (mu_s,) * 2, (mu_k,) * 2, (ARM * q,) * 2)
    y, period = np.array([x[i] for x in orbits.state.y]), float(orbits.period[i])
    ahead, back = (
        [returned(rods, y + s * h * e, period) for e in np.eye(4)[1:]] for s in (1, -1)
    )
    slope = (np.array(ahead) - np.array(back)).T / (2 * h)
    return np.sort(np.abs(np.linalg.eigvals(slope)))[::-1]


def test_multipliers_of_200_columns_are_those_of_two_free_bodies():
    """By the nearer of two differences; one motion of the other code chatters."""
    source = np.random.default_rng(29)
    mu_s, share = source.uniform(0.02, 0.3, 280), source.uniform(0.4, 1.0, 280)
    cells = np.stack([source.uniform(1.6, 3.6, 280), mu_s, share * mu_s], axis=1)
    found, orbits = certified(cells)
    closed = (found.outcome == zj.CODE.cycle) & (orbits.outcome == zj.CODE.found)
    # the orbit of the certificate, and none beside it
    closed &= np.abs(orbits.period / found.period - 1) < 1e-6
    off, chattering = [], 0
    for i in np.flatnonzero(closed)[:201]:
        try:
            each = [by_differences(cells[i], orbits, i, h)[0] for h in (3e-5, 1e-5)]
        except AssertionError:
            chattering += 1
            continue
        off.append(np.abs(float(found.largest_multiplier[i]) - each).min())
    assert len(off) >= 200 and chattering <= 1
    assert max(off) < 1e-6  # measured 3.8e-7


def lanes(count, seed):
    """Columns and states in modes of slip and of stick, with a vector each."""
    rng = np.random.default_rng(seed)
    y, v = rng.normal(size=(2, 4, count))
    modes = rng.integers(-1, 2, (2, count)).astype(float)
    rates = np.where(modes == 0, 0.0, modes * np.abs(y[2:]))
    y[2:] = np.cumsum(rates, axis=0)
    return rng.uniform(1, 4, count), y, modes, v


def test_the_series_of_a_difference_is_the_difference_of_series():
    """Of the state and of the load; in a batch of lanes as of one alone."""
    q, y, modes, v = lanes(12, 1)
    dq, h, s = 0.7, 1e-5, 0.3

    def along(q, y, modes, v):
        system = column(q, 0.2, 0.1).system()
        moves = jax.tree.map(lambda _: None, system)
        _, moves = jax.jvp(lambda q: column(q, 0.2, 0.1).system(), (q,), (dq,))
        moves = jax.tree.map(lambda x: jnp.asarray(x)[None], moves)
        here = system.in_modes((modes[0], modes[1]))
        motion, (one,) = expand_along(
            here, PhasePoint(y), 8, y[0], [PhasePoint(v)], moves
        )
        return jnp.stack(along_to(one, s))

    def end(q, y, modes):
        here = column(q, 0.2, 0.1).system().in_modes((modes[0], modes[1]))
        series = expand(here, PhasePoint(y), 8, y[0]).y
        return jnp.stack([jnp.polyval(jnp.stack(c[::-1]), s) for c in series])

    found = jax.jit(jax.vmap(along, (0, 1, 1, 1)))(q, y, modes, v)
    ends = jax.jit(jax.vmap(end, (0, 1, 1)))
    ahead, back = (ends(q + d * dq, y + d * v, modes) for d in (h, -h))
    difference = (ahead - back) / (2 * h)
    scale = np.abs(difference).max(axis=1, keepdims=True)
    assert (np.abs(found - difference) / scale).max() < 1e-8  # measured 3e-10
    alone = [jax.jit(along)(q[i], y[:, i], modes[:, i], v[:, i]) for i in range(3)]
    np.testing.assert_allclose(found[:3], alone, rtol=1e-12)


@pytest.mark.parametrize("i", range(len(CELLS)))
def test_tangents_on_taylors_steps_are_those_of_an_explicit_method(settled, i):
    _, orbits = settled
    system = column(*CELLS[i]).system()
    x = jnp.stack([x[i] for x in orbits.state.y])[1:]
    attempt = attempt_at(blank_attempt(x[0]), x, orbits.period[i], x[0] * 0 + 1)

    def tangents(solver):
        method = zj.Method(solver, 1e-9, 1e-9).at_most(100_000)
        shot = shot_motion(system, start_of(attempt), attempt, method, Observation(()))
        run = jax.jit(lambda: shot.advance(shot.begin()))()
        return np.array(run.folded.tangents)

    other = tangents(zj.Explicit())
    assert np.abs(tangents(zj.Taylor()) - other).max() < 1e-7  # measured 7e-9


def test_exponents_on_taylors_steps_are_the_multipliers_of_the_cycle(settled):
    """And minus infinity for the rate that sticking takes."""
    found, orbits = settled
    here = column(*CELLS[0])
    start = zj.State(*(tuple(x[0] for x in half) for half in (
        orbits.state.phi, orbits.state.omega)))  # fmt: skip
    period = float(orbits.period[0])
    spans = zj.Spans(transient=20 * period, length=10 * period, count=4)
    result = zj.lyapunov_exponents(here, start, count=4, spans=spans)
    multipliers = np.sort(np.abs(np.asarray(orbits.multipliers[0])))[::-1]
    expected = np.log(multipliers[:3]) / period
    # measured 3e-7: of the tolerance of 1e-8
    np.testing.assert_allclose(result.exponents[:3], expected, atol=3e-6)
    assert result.exponents[3] == -np.inf


def test_what_passes_an_unstable_cycle_beside_one_that_sticks_is_not_certified():
    """Its returns follow the linear map of the one that sticks, 2.5 % away.

    Another code follows it on to a torus: amplitudes of 0.98 to 1.2 in place of 1.006.
    """
    cell, start = (3.53125, 0.09, 0.04), zj.State(omega=(0.0, 0.3))
    end = jax.jit(lambda: zj.settle(column(*cell), start))()
    assert end.outcome == zj.CODE.unsettled
    rods = Rods(cell[0], (cell[1],) * 2, (cell[2],) * 2, (ARM * cell[0],) * 2)
    ts = np.linspace(0.0, 60.0, 2001)
    y = motion(rods, [*map(float, end.final.y)], ts, tol=1e-9)[0]
    swings = np.abs(y[:, 1] - y[:, 0]).reshape(3, 667).max(axis=1)
    assert np.ptp(swings) > 0.01 * swings.max()


def test_by_default_dry_friction_is_certified_where_it_has_series(settled):
    assert settled[0].outcome.tolist() == [zj.CODE.cycle] * len(CELLS)
    law = zj.SetValuedCoulomb(0.1, pin_radius=ARM, load=zj.JointReaction())
    short = zj.Windows(transient=0.0, length=20.0, max_windows=1)
    end = zj.settle(
        zj.uniform_rods(2.0, friction=law), zj.State(omega=(0.0, 0.3)), windows=short
    )
    assert "windows" in end.variables() and "period" not in end.variables()
