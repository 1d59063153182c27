"""Lyapunov exponents: eigenvalues, divergence, multipliers, chaos; stick and slip."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from models import benettin, floquet, mean_divergence
from newton_euler import Rods
from newton_euler import motion as free_bodies

import ziegler_jax as zj
from ziegler_jax import CODE
from ziegler_jax.motion.tangents import HADAMARD

# Smooth columns: q, tau, v_smooth, c1, c2, start (4), transient, length --------------

BLOCKS = 12
SMOOTH = {
    "linear": (1.5, 0, 1, 0.05, 0.02, 0, 0, 0, 0, 100, 20),
    "creep": (1.2, 0.01, 0.3, 0, 0, 0, 0, 0, 0, 100, 20),
    "free": (2.0, 0, 1, 0, 0, 0, 0, 0, 0.2, 200, 40),
    "viscous": (2.3, 0, 1, 0.2, 0.2, 0, 0, 0, 0.3, 300, 20),
    "friction": (2.6, 0.026, 0.1, 0, 0, 0, 0, 0, 0.3, 100, 20),
}
CHAOS = {
    "chaos": (4.0, 0, 1, 0, 0, 0, 0, 0, 0.3, 200, 200),
    "chaos again": (4.0, 0, 1, 0, 0, 0, 0, 0, 0.2, 300, 200),
}


@jax.jit
@jax.vmap
def of_smooth(n):
    load = zj.ConstantLoad(1.0)
    friction = zj.SmoothCoulomb(n[1], pin_radius=1.0, v_smooth=n[2], load=load)
    column = zj.uniform_rods(n[0], friction=friction, damping=zj.Viscous(n[3], n[4]))
    start = zj.State((n[5], n[6]), (n[7], n[8]))
    return zj.lyapunov_exponents(
        column,
        start,
        spans=zj.Spans(transient=n[9], length=n[10], count=BLOCKS, escape=1000.0),
    )


def measured(scenes):
    """Exponents, errors and the last state of each."""
    found = of_smooth(np.array(list(scenes.values()), float))
    assert (np.asarray(found.outcome) == CODE.complete).all()
    rates, errors = np.asarray(found.exponents), np.asarray(found.errors)
    final = np.hstack([np.transpose(found.final.phi), np.transpose(found.final.omega)])
    return dict(zip(scenes, zip(rates, errors, final, strict=True), strict=True))


@pytest.fixture(scope="module")
def smooth():
    return measured(SMOOTH)


@pytest.fixture(scope="module")
def chaos():
    return measured(CHAOS)


def test_at_rest_they_are_the_real_parts_of_the_eigenvalues(smooth):
    for name in ("linear", "creep"):
        q, tau, v, c1, c2 = SMOOTH[name][:5]
        damping = zj.Viscous(c1 + tau / v, c2 + tau / v)
        roots = zj.spectrum(zj.uniform_rods(q, damping=damping))
        exact = np.sort(np.asarray(roots).real)[::-1]
        rates, errors, _ = smooth[name]
        # vectors of a pair turn: the ends of the time T contribute, measured 0.56 / T
        assert (np.abs(rates - exact) < 3 * errors + 1 / (BLOCKS * 20)).all()
        # measured 2.9e-6
        pairs = rates.reshape(2, 2).sum(axis=1)
        np.testing.assert_allclose(pairs, exact.reshape(2, 2).sum(axis=1), atol=2e-5)


def test_their_sum_is_the_mean_divergence(smooth):
    for name in ("viscous", "friction"):
        numbers, start = SMOOTH[name][:5], SMOOTH[name][5:9]
        begin, block = SMOOTH[name][9:]
        mean = mean_divergence(start, begin, begin + BLOCKS * block, numbers)
        # measured 2.2e-8
        np.testing.assert_allclose(smooth[name][0].sum(), mean, rtol=3e-7)


def sum_to_zero_in_pairs(rates, errors, _):
    # the flow keeps det M dphi domega: what is left is ln det M over the time, and
    # the steps' error; measured 2.8e-4
    assert abs(rates.sum()) < 1e-3
    # and runs backward in time as forward
    assert abs(rates[0] + rates[3]) < 3 * np.hypot(errors[0], errors[3])
    assert abs(rates[1] + rates[2]) < 3 * np.hypot(errors[1], errors[2])


def test_without_dissipation_they_sum_to_zero_and_are_symmetric(smooth):
    sum_to_zero_in_pairs(*smooth["free"])


def test_without_dissipation_they_sum_to_zero_in_chaos_too(chaos):
    for found in chaos.values():
        sum_to_zero_in_pairs(*found)


def test_a_cycle_has_a_zero_one_and_the_rate_of_its_multiplier(smooth):
    for name in ("viscous", "friction"):
        rates, errors, final = smooth[name]
        period, multipliers = floquet(final, SMOOTH[name][:5])
        assert abs(multipliers[0] - 1) < 1e-7  # measured 1.7e-9
        exact = np.log(np.abs(multipliers)) / period
        # measured 1.7e-3 and 5e-4 (viscous), 9e-5 and 6e-5 (friction)
        assert (np.abs(rates[:2] - exact[:2]) < 3 * errors[:2] + 1e-4).all()
        assert abs(rates[0]) < 0.01 and errors[:2].max() < 0.01


def test_chaos_has_one_largest_exponent_whoever_computes_it(chaos):
    rates, errors = np.array([found[:2] for found in chaos.values()])[:, :, 0].T
    # at least 4.4 errors: 0.053 +- 0.012 (jax 0.12), 0.091 +- 0.010 (jax 0.10)
    assert (rates > 3 * errors).all()
    assert abs(rates[0] - rates[1]) < 3 * np.hypot(*errors)
    numbers, start = CHAOS["chaos"][:5], np.array(CHAOS["chaos"][5:9], float)
    # measured 0.112 +- 0.018 against 0.091 +- 0.010 and 0.098 +- 0.008
    other, its_error = benettin(start, numbers, 200.0, 800.0, 10)
    assert abs(other - rates.mean()) < 3 * np.hypot(its_error, np.hypot(*errors) / 2)


# Set-valued friction: q, tau_s, tau_k, start (4), transient, length -------------------

APART = 1e-6
SETS = {
    "sticks, mu_s = mu_k": (2.6, 0.15, 0.15, 0.2, 0.1, 0.3, -0.4, 0, 9.0),
    "sticks, mu_s > mu_k": (2.6, 0.05, 0.02, 0.2, 0.1, 0.3, -0.4, 0, 9.0),
    "reverses": (3.5, 0.02, 0.02, 0.5, -0.4, 0.3, -0.4, 0, 0.8),
    "sticks often": (3.9, 0.22, 0.055, 0.3, 0.1, 0.5, -0.4, 0, 6.0),
}
CYCLE = (2.6, 0.026, 0.026, 0, 0, 0, 0.3, 100, 25)
STICK_SLIP_CHAOS = {
    "chaos": (3.9, 0.226, 0.0565, 0, 0, 0, 0.3, 200, 50),
    "chaos again": (3.9, 0.226, 0.0565, 0, 0, 0, 0.5, 400, 50),
}


@jax.jit
@jax.vmap
def of_set_valued(n):
    friction = zj.SetValuedCoulomb(
        n[1], n[2], pin_radius=1.0, load=zj.ConstantLoad(1.0)
    )
    start = zj.State((n[3], n[4]), (n[5], n[6]))
    return zj.lyapunov_exponents(
        zj.uniform_rods(n[0], friction=friction),
        start,
        spans=zj.Spans(transient=n[7], length=n[8], count=BLOCKS, escape=100.0),
        method=zj.Method(rtol=n[9], atol=n[9]),
    )


def moved(lane, i, by):
    lane = list(lane)
    lane[3 + i] += by
    return lane


@pytest.fixture(scope="module")
def set_valued():
    lanes = [[*CYCLE, 1e-8]]
    for lane in SETS.values():
        lane = [*lane[:8], lane[8] / BLOCKS, 1e-12]
        lanes.append(lane)
        lanes += [moved(lane, i, s * APART) for i in range(4) for s in (1, -1)]
    found = of_set_valued(np.array(lanes))
    assert (np.asarray(found.outcome) == CODE.complete).all()
    return found


def test_growth_through_events_is_that_of_neighbours(set_valued):
    """D H = Q R, with D the map's derivative: the tangents grew by R's diagonal."""
    lost = []
    y = np.hstack(
        [np.transpose(set_valued.final.phi), np.transpose(set_valued.final.omega)]
    )
    for k, (name, lane) in enumerate(SETS.items()):
        first = 1 + 9 * k
        mates = y[first + 1 : first + 9].reshape(4, 2, 4)
        derivative = (mates[:, 0] - mates[:, 1]).T / (2 * APART)
        expected = np.abs(np.diag(np.linalg.qr(derivative @ np.transpose(HADAMARD))[1]))
        found = np.exp(np.asarray(set_valued.exponents)[first] * lane[8])
        np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-4, err_msg=name)
        lost.append(found[3] == 0)
    assert any(lost) and not all(lost)  # scenes that stick, and one that only slips


def moved_by_another(lane, directions):
    """The state after a span, and the derivative of that along directions."""
    q, static, kinetic, *start, span = lane
    rods, y = Rods(q, (static,) * 2, (kinetic,) * 2), np.array(start, float)

    def resting(y):
        """What a joint at rest has left of a rate is rounding."""
        p1, p2, w1, w2 = y
        w1 = 0.0 if abs(w1) < 1e-9 else w1
        return np.array([p1, p2, w1, w1 if abs(w2 - w1) < 1e-9 else w2])

    def end(y):
        return resting(free_bodies(rods, resting(y), [0.0, span], 1e-12)[0][-1])

    ends = [end(y + s * APART * v) for v in directions for s in (1, -1)]
    along = np.reshape(ends, (-1, 2, 4))
    return end(y), (along[:, 0] - along[:, 1]).T / (2 * APART)


@pytest.mark.parametrize("name", ["sticks, mu_s > mu_k", "sticks often"])
def test_growth_through_release_and_arrest_is_that_of_two_free_bodies(set_valued, name):
    """mu_s > mu_k, by neighbours in another formulation, event by event."""
    lane, first = SETS[name], 1 + 9 * list(SETS).index(name)
    *numbers, _, span = lane
    end, derivative = moved_by_another([*numbers, span], np.array(HADAMARD))
    final = [*set_valued.final.phi, *set_valued.final.omega]
    there = np.array([x[first] for x in final])
    assert np.abs(there - end).max() < 5e-11  # measured 5e-12
    expected = np.abs(np.diag(np.linalg.qr(derivative)[1]))
    found = np.exp(np.asarray(set_valued.exponents)[first] * span)
    # measured 1e-8
    np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-7)


def test_stick_slip_chaos_grows_as_the_neighbours_of_two_free_bodies_do():
    """Block by block, with the neighbours drawn together at the end of each."""
    q, static, kinetic, *_ = STICK_SLIP_CHAOS["chaos"]
    start = SETS["sticks often"][3:7]
    block, blocks = 3.5, BLOCKS
    lane = (q, static, kinetic, *start, 0.0, block, 1e-12)
    found = of_set_valued(np.array([lane]))
    y, directions, rates = np.array(start, float), np.array(HADAMARD)[:2], []
    for _ in range(blocks):
        y, moved = moved_by_another((q, static, kinetic, *y, block), directions)
        basis, grown = np.linalg.qr(moved)
        directions = basis.T
        rates.append(np.log(np.abs(np.diag(grown))) / block)
    exact = np.mean(rates, axis=0)
    assert exact[0] > 0
    # measured 1e-8 of 0.027 and -0.031
    np.testing.assert_allclose(found.exponents[0, :2], exact, rtol=0, atol=1e-7)


def test_a_stick_slip_cycle_has_a_zero_one_and_loses_a_dimension(set_valued):
    rates, errors = set_valued.exponents[0], set_valued.errors[0]
    assert abs(rates[0]) < 3 * errors[0] + 1e-3
    assert rates[1] < -0.1 and rates[3] == -np.inf


def test_stick_slip_chaos_has_one_largest_exponent_whatever_the_start():
    found = of_set_valued(np.array([[*x, 1e-8] for x in STICK_SLIP_CHAOS.values()]))
    rates, errors = found.exponents[:, :2].T, found.errors[:, :2].T
    assert (np.asarray(found.outcome) == CODE.complete).all()
    assert (rates[0] > 5 * errors[0]).all()
    assert abs(rates[0, 0] - rates[0, 1]) < 3 * np.hypot(*errors[0])
    assert (np.abs(rates[1]) < 3 * errors[1] + 1e-3).all()
    assert (found.exponents[:, 3] == -np.inf).all()


def test_what_breaks_a_rule_is_named(refuses):
    column, start = zj.uniform_rods(1.0), zj.State()

    def of(**options):
        return zj.lyapunov_exponents(column, start, **options)

    refuses(lambda: of(count=5), "`count`", "at most 4", "5")
    refuses(lambda: of(spans=zj.Spans(count=1)), "`count`", "at least 2", "1")
    refuses(lambda: of(spans=zj.Spans(length=0.0)), "`length`", "positive", "0")
    refuses(
        lambda: of(spans=zj.Spans(transient=-1.0)), "`transient`", "nonnegative", "-1"
    )


def test_numbers_that_break_a_rule_when_traced_end_the_lane():
    lane = jnp.array(SMOOTH["free"], float).at[3].set(-1.0)
    found = of_smooth(lane[None])
    assert found.outcome[0] == CODE.invalid
    assert np.isnan(found.exponents).all()
