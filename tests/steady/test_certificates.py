"""Certified cycles: against scipy, by their derivatives, and what is refused."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from models import floquet

import ziegler_jax as zj
from ziegler_jax.__main__ import KICK, point
from ziegler_jax.steady import certified, contraction
from ziegler_jax.steady.certified import CertifiedMotion
from ziegler_jax.steady.oddness import is_odd

TAU, V = 0.026, 0.05


def column(q, tau=TAU, v=V):
    law = zj.SmoothCoulomb(tau, pin_radius=1, v_smooth=v, load=zj.ConstantLoad(1))
    return zj.uniform_rods(q, friction=law)


def settled(q, tau=TAU, **options):
    return zj.settle(column(q, tau), zj.State(omega=(0.0, 0.3)), **options)


@pytest.fixture(scope="module")
def cycle():
    return jax.jit(settled)(2.6)


@jax.jit
def orbit_near(q, tau, start):
    return zj.periodic_orbit(column(q, tau), start)


def test_a_certified_cycle_has_scipys_period_multiplier_and_amplitude(cycle):
    orbit = orbit_near(2.6, TAU, cycle.final)
    y0 = np.array([float(x) for x in orbit.state.y])
    period, multipliers = floquet(y0, (2.6, TAU, V, 0.0, 0.0))
    assert cycle.outcome == zj.CODE.cycle and cycle.returns == 1
    # measured: 1e-7, 1e-5, 1.8e-6: the verifying shot's steps at 1e-8
    assert cycle.period == pytest.approx(period, rel=1e-6)
    others = np.sort(np.abs(multipliers))[::-1]
    assert cycle.largest_multiplier == pytest.approx(others[1], rel=1e-4)
    assert cycle.joint_amplitude == pytest.approx(
        np.asarray(orbit.joint_amplitude), rel=5e-6
    )


def test_derivatives_of_a_certified_cycle_are_those_of_its_fixed_point(cycle):
    """Differences of orbits that close to 1e-11: their error is 1e-7."""
    h, way, at = 1e-4, np.array([1.0, 0.01]), np.array([2.6, TAU])

    def numbers(of):
        return jnp.stack([*of.rod_amplitude, of.joint_amplitude[1], of.period])

    def certified(q, tau):
        return numbers(settled(q, tau, method=zj.Method(rtol=1e-9)))

    _, moved = jax.jit(lambda x, v: jax.jvp(certified, x, v))(tuple(at), tuple(way))
    above, below = (numbers(orbit_near(*(at + s * way), cycle.final)) for s in (h, -h))
    differences = (above - below) / (2 * h)
    np.testing.assert_allclose(moved, differences, rtol=1e-6)


def test_a_half_turn_and_a_whole_one_give_the_same_cycle(cycle):
    """`Mean` needs a whole one: its shots are twice as long."""
    whole = jax.jit(lambda q: settled(q, observers=(zj.Mean(),)))(2.6)
    assert whole.period == pytest.approx(float(cycle.period), rel=1e-6)
    assert whole.rod_amplitude == pytest.approx(
        np.asarray(cycle.rod_amplitude), rel=3e-6
    )
    assert np.abs(whole.mean_angle).max() < 1e-6  # measured: 2e-8
    multiplier = float(cycle.largest_multiplier)
    assert whole.largest_multiplier == pytest.approx(multiplier, rel=1e-3)


def test_set_valued_cycles_are_certified_where_asked_for():
    law = zj.SetValuedCoulomb(0.01, pin_radius=1, load=zj.ConstantLoad(1.0))

    def both(q):
        here = zj.uniform_rods(q, friction=law)
        found = zj.settle(here, zj.State(omega=(0.0, 0.5)), certify=True)
        return found, zj.periodic_orbit(here, found.final)

    found, orbit = jax.jit(both)(2.0)
    assert found.outcome == zj.CODE.cycle
    assert found.period == pytest.approx(float(orbit.period), rel=1e-6)
    assert found.joint_amplitude == pytest.approx(
        np.asarray(orbit.joint_amplitude), rel=1e-5
    )


class Lopsided(zj.AbstractRateFriction):
    """Friction that holds one way more than the other."""

    share: float

    rules = {"share": "finite"}

    def levers(self, u1, u2):
        return tuple(0.02 * (jnp.tanh(u / 0.05) + self.share) for u in (u1, u2))

    def load_law(self):
        return zj.ConstantLoad(1.0)

    def rate_cut(self):
        return 0.05


def test_oddness_is_seen_by_evaluating_the_law():
    even = zj.uniform_rods(2.0, friction=Lopsided(0.0))
    uneven = zj.uniform_rods(2.0, friction=Lopsided(0.1))
    assert is_odd(even.system()) and not is_odd(uneven.system())
    assert is_odd(column(2.0).system()) and is_odd(zj.uniform_rods(2.0).system())
    law = zj.SetValuedCoulomb(0.01, pin_radius=1)
    assert is_odd(zj.uniform_rods(2.0, friction=law).system())


def test_what_grows_from_below_the_cut_is_not_at_rest():
    """q = 2.6 without friction flutters from a kick of 1e-8, at first below 1e-6."""
    here = zj.uniform_rods(2.6, damping=zj.Viscous(0.001, 0.001))
    start = zj.State(omega=(0.0, 1e-8))
    result = jax.jit(lambda: zj.settle(here, start))()
    assert result.outcome != zj.CODE.rest


def test_what_falls_first_and_then_grows_below_the_cut_is_not_at_rest():
    """The fall of the kick itself hides the growth: it does not count."""
    law = zj.SmoothCoulomb(
        (0.04, 0.02), pin_radius=1.0, v_smooth=0.02, load=zj.ConstantLoad(1.0)
    )
    damping = zj.Viscous(0.01, 0.01)
    slow = zj.point_masses(q=2.6, friction=law, damping=damping, kappa=1.3)
    kick = zj.State(omega=(0.01, 0.02))  # of the cut's size
    ts = np.linspace(0, 500, 1001)
    phi = np.abs(zj.trajectory(slow, kick, ts).phi).max(axis=1)
    assert phi[:50].max() < 0.03 and phi[-100:].max() > 0.4
    found = jax.jit(lambda: zj.settle(slow, kick))()
    assert found.outcome == zj.CODE.cycle


def test_what_cannot_be_certified_is_refused():
    start = zj.State(omega=KICK)
    with pytest.raises(ValueError, match="`certify` must be False or None with"):
        zj.settle(column(2.6), start, method=zj.Method(zj.Rosenbrock()), certify=True)
    with pytest.raises(ValueError, match="`agreement` of `windows` must be None"):
        zj.settle(column(2.6), start, windows=zj.Windows(agreement=1e-3))


@pytest.mark.parametrize("radius", [0.0, 0.9, 1.1, 1.9])
def test_a_closed_orbit_is_certified_where_its_return_map_contracts(radius):
    start, windows = zj.State(omega=KICK), zj.Windows()
    motion = CertifiedMotion(column(2.6), start, "settle", windows, (), zj.Method())
    now = motion.begin()
    slope = jnp.diag(jnp.asarray([radius, radius / 2, 0.0]))
    attempt = now.attempt._replace(
        verified=jnp.asarray(True), slope=slope, first_slope=slope
    )
    after = motion._judged(now._replace(attempt=attempt))
    assert after.candidate.there == (radius < 1)
    assert after.unstable == (radius > 1)


# ---- the algebra of three numbers


@pytest.mark.parametrize("seed", range(6))
def test_the_algebra_of_return_maps_is_numpys(seed):
    source = np.random.default_rng(seed)
    a = source.normal(size=(3, 3))
    a *= source.uniform(0.2, 0.98) / np.abs(np.linalg.eigvals(a)).max()
    if seed == 0:  # a joint sticks: rank one
        a = np.outer(a[0], a[1])
        a *= 0.5 / np.abs(np.linalg.eigvals(a)).max()
    radius = np.abs(np.linalg.eigvals(a)).max()
    # a power's constant remains: 2^-24 of its logarithm
    assert contraction.spectral_radius(jnp.asarray(a)) == pytest.approx(
        radius, rel=2e-6
    )
    r = source.normal(size=3)
    move = contraction.fixed_point_move(jnp.asarray(a), jnp.asarray(r))
    np.testing.assert_allclose(move, np.linalg.solve(np.eye(3) - a, r), rtol=1e-9)
    p = np.asarray(contraction.contraction_norm(jnp.asarray(a), radius))
    root = np.linalg.cholesky(p).T
    size = np.linalg.norm(root @ a @ np.linalg.inv(root), 2)
    bound = float(contraction.contraction_rate(jnp.asarray(p), radius))
    assert size <= bound * (1 + 1e-9) and bound < 1
    assert contraction.contracts(jnp.asarray(p), jnp.asarray(a))
    assert not contraction.contracts(jnp.asarray(p), jnp.asarray(a / size * 1.01))


def test_every_attempt_begins_with_a_shot_of_its_own(monkeypatch):
    """The one before has left its shot at its end: that is none of the next."""
    spent, attempts = [0], 0

    def watched(motion):
        nonlocal attempts
        now = motion.begin()
        advance = [jax.jit(phase.advance) for phase in motion.phases]
        while now.running:
            attempts += bool(now.shoots & (now.shot.steps < 0))
            now = advance[int(now.shoots)](now, jnp.int32(256))
            spent.append(int(now.spent))
        return now

    monkeypatch.setattr(CertifiedMotion, "follow", watched)
    found = point(1.6206896551724137, 0.16, 0.16)
    assert found.outcome == zj.CODE.cycle and attempts > 1
    assert (np.diff(spent) >= 0).all(), spent


def test_how_often_a_batch_is_looked_at_moves_no_ending(monkeypatch):
    """Where returns come faster than looks, as of rods that turn over."""
    q, eta, kappa = (
        np.array(x) for x in ([2.9, 3.4, 3.1], [0.9, 0.9, 0.8], [1, 1.6, 0.9])
    )

    def ended(every):
        monkeypatch.setattr(certified, "STEPS_AT_ONCE", every)

        @jax.jit
        @jax.vmap
        def point(q, eta, kappa):
            damping = zj.Viscous(0.02, 0.002)
            column = zj.uniform_rods(q, damping=damping, follower=eta, kappa=kappa)
            windows, start = zj.Windows(escape=60.0), zj.State(omega=(0.0, 2.9))
            return zj.settle(column, start, windows=windows)

        return point(q, eta, kappa)

    usual, seldom = ended(8), ended(64)
    assert (usual.outcome == zj.CODE.cycle).all()
    for name in ("outcome", "time", "returns"):
        np.testing.assert_array_equal(getattr(usual, name), getattr(seldom, name))
