"""Certified cycles of three rods: closed by free bodies, with true derivatives."""

import free_bodies
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import ziegler_jax as zj

START = zj.State(omega=(0.0, 0.0, 0.3))
RODS = {"lengths": (1.0,) * 3, "masses": 1.0, "springs": 1.0}
BODIES = {"lengths": (1.0,) * 3, "masses": (1.0,) * 3, "springs": (1.0,) * 3}
BENT = {"rest_angles": (0.05, 0.02, 0.0), "gravity": zj.Gravity(0.03, 0.5)}
BENT_BODIES = {"rest_angles": (0.05, 0.02, 0.0), "gravity": (0.03, 0.5)}
TAU, V = 0.02, 0.05


def smooth(q, tau=TAU, **parts):
    law = zj.SmoothCoulomb(tau, pin_radius=1.0, v_smooth=V, load=zj.ConstantLoad(1.0))
    return zj.Chain(q, **RODS, friction=law, **parts)


@pytest.mark.parametrize("displaced", [False, True])
def test_a_certified_cycle_is_closed_by_free_bodies(displaced):
    parts, other = (BENT, BENT_BODIES) if displaced else ({}, {})
    end = zj.settle(smooth(2.0, **parts), START)
    assert end.outcome == zj.CODE.cycle
    bodies = free_bodies.Bodies(2.0, **BODIES, **other, mu_k=(TAU,) * 3)
    ts = np.linspace(0.0, float(end.period), 400)
    states = free_bodies.smoothed(bodies, list(end.final.y), ts, V, 1e-10)
    size = np.abs(states).max()
    # by what the motion had left to go: measured 8.8e-6, bent 6.5e-5
    assert np.abs(states[-1] - states[0]).max() < 3e-4 * size
    rods = np.abs(states[:, :3]).max(0)
    np.testing.assert_allclose(rods, end.rod_amplitude, rtol=1e-3)


@pytest.mark.parametrize("displaced", [False, True])
def test_windows_see_the_period_that_is_certified(displaced):
    chain = smooth(2.0, **(BENT if displaced else {}))
    end = zj.settle(chain, START)
    windows = zj.Windows(transient=400.0)
    watch = zj.settle(
        chain, START, certify=False, windows=windows, observers=(zj.Period(),)
    )
    assert (end.outcome, watch.outcome) == (zj.CODE.cycle, zj.CODE.repeats)
    # measured 3.3e-6, bent 4.2e-7: what the motion has left to go
    np.testing.assert_allclose(watch.period, end.period, rtol=5e-5)


def test_a_cycle_of_sticking_joints_is_closed_by_free_bodies():
    tau = 0.02
    law = zj.SetValuedCoulomb(1.2 * tau, tau, pin_radius=1.0, load=zj.ConstantLoad(1.0))
    end = zj.settle(zj.Chain(2.0, **RODS, friction=law), START, certify=True)
    assert end.outcome == zj.CODE.cycle
    bodies = free_bodies.Bodies(2.0, **BODIES, mu_s=(1.2 * tau,) * 3, mu_k=(tau,) * 3)
    ts = np.linspace(0.0, float(end.period), 50)
    states, log = free_bodies.motion(bodies, list(end.final.y), ts, 1e-10)
    assert log  # joints stick and slip in it
    size = np.abs(states).max()
    assert np.abs(states[-1] - states[0]).max() < 3e-4 * size  # measured 8.9e-5


def test_its_derivatives_are_those_of_differences():
    def numbers(x):
        end = zj.settle(smooth(2.0 + x, TAU * (1 + 2 * x)), START)
        return end.joint_amplitude, end.period

    both, h = jax.jit(lambda x: jax.jvp(numbers, (x,), (1.0,))), 1e-3
    (shown, slopes), (below, _), (above, _) = (both(x) for x in (0.0, -h, h))
    for value, mine, low, high in zip(shown, slopes, below, above, strict=True):
        difference = (high - low) / (2 * h)
        assert np.isfinite(value).all()
        np.testing.assert_allclose(mine, difference, rtol=1e-3)  # measured 6.2e-5


def test_a_map_of_three_rods_is_swept_as_any():
    def point(q, tau):
        return zj.settle(smooth(q, tau), START)

    ds = zj.sweep(point, q=[1.0, 2.0], tau=[0.02, 0.05], progress=False)
    assert ds.joint_amplitude.dims == ("q", "tau", "joint")
    assert ds.joint.values.tolist() == [1, 2, 3]
    alone = zj.settle(smooth(2.0), START)
    cell = ds.sel(q=2.0, tau=0.02)
    assert int(cell.outcome) == zj.CODE.cycle
    np.testing.assert_allclose(cell.joint_amplitude, alone.joint_amplitude, rtol=1e-9)


def test_exponents_and_thresholds_take_three_rods():
    rates = zj.lyapunov_exponents(
        smooth(2.0), START, count=2, spans=zj.Spans(transient=400.0, count=10)
    )
    # measured 2.5e-5 and -0.025; with q = 2.1 or twice the spans 8.1e-4 at most
    assert abs(float(rates.exponents[0])) < 5e-3 and float(rates.exponents[1]) < -5e-3
    chain, up = smooth(1.0, 0.05), zj.State(omega=(0.0, 0.0, 1.0))
    kick = zj.critical_kick(chain, up, (0.1, 1.0))
    assert kick.outcome == zj.CODE.found
    below, above = (
        zj.settle(chain, zj.State(omega=(0.0, 0.0, x))).outcome
        for x in (0.9 * kick.threshold, 1.1 * kick.threshold)
    )
    assert below == zj.CODE.stuck and above == zj.CODE.cycle


def test_an_orbit_of_three_rods_closes_by_free_bodies_and_moves_as_it_says():
    section = zj.SectionPlane(level=0.01)
    guess = zj.settle(smooth(2.0, **BENT), START).final

    def numbers(q):
        orbit = zj.periodic_orbit(
            smooth(q, **BENT), guess, section=section, observers=(zj.Mean(),)
        )
        moved = *orbit.rod_amplitude, *orbit.joint_amplitude[1:], orbit.period
        moved = jnp.stack([*moved, orbit.largest_multiplier, *orbit.mean_angle])
        return moved, orbit

    both = jax.jit(lambda q: jax.jvp(numbers, (q,), (1.0,), has_aux=True))
    (value, slope, orbit), h = both(2.0), 1e-4
    assert orbit.outcome == zj.CODE.found and orbit.stable
    bodies = free_bodies.Bodies(2.0, **BODIES, **BENT_BODIES, mu_k=(TAU,) * 3)
    ts = np.linspace(0.0, float(orbit.period), 400)
    y = np.array(orbit.state.y)
    states = free_bodies.smoothed(bodies, list(y), ts, V, 1e-11)
    assert np.abs(states[-1] - states[0]).max() < 1e-8  # measured 8e-11
    # along a direction the turn of the other code moves as the monodromy says
    along = np.array([0.3, -0.2, 0.1, 0.4, 0.2, -0.5])
    ends = [
        free_bodies.smoothed(bodies, list(y + s * 1e-5 * along), ts, V, 1e-11)[-1]
        for s in (1, -1)
    ]
    wanted = (ends[0] - ends[1]) / 2e-5
    assert np.abs(orbit.monodromy @ along - wanted).max() < 1e-5  # measured 6e-7
    (above, _, _), (below, _, _) = both(2.0 + h), both(2.0 - h)
    difference = (above - below) / (2 * h)
    # measured 6e-8 of it
    assert np.abs(slope - difference).max() < 1e-5 * np.abs(difference).max()
    # 400 points see a peak to their distance squared
    rods = np.abs(np.asarray(states)[:, :3]).max(0)
    np.testing.assert_allclose(rods, value[:3], rtol=1e-3)


def test_an_orbit_of_three_sticking_joints_is_the_certified_one():
    law = zj.SetValuedCoulomb(0.024, 0.02, pin_radius=1.0, load=zj.ConstantLoad(1.0))
    chain = zj.Chain(2.0, **RODS, friction=law)
    end = zj.settle(chain, START)
    orbit = zj.periodic_orbit(chain, end.final)
    assert orbit.outcome == zj.CODE.found
    # measured 8e-10, 6e-9, 4e-7
    np.testing.assert_allclose(orbit.period, end.period, rtol=1e-7)
    np.testing.assert_allclose(orbit.joint_amplitude, end.joint_amplitude, rtol=1e-6)
    largest = orbit.largest_multiplier
    np.testing.assert_allclose(largest, end.largest_multiplier, atol=1e-5)
