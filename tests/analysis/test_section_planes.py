"""Cycles and their branches are the same whatever plane they are found on."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

import ziegler_jax as zj

KICK = zj.State(omega=(0.0, 0.3))
COORDINATES = ("phi1", "phi2", "omega1", "omega2")
LEVELS = np.array([0.0, 0.1, -0.05])


def rubbing(kind, q, tau):
    load = zj.ConstantLoad(1.0)
    law: zj.SetValuedCoulomb | zj.SmoothCoulomb
    law = zj.SetValuedCoulomb(tau, pin_radius=1.0, load=load)
    if kind == "smoothed":
        law = zj.SmoothCoulomb(tau, pin_radius=1.0, v_smooth=0.1, load=load)
    return zj.uniform_rods(q, friction=law)


def orbit_on(kind, plane, q, guess):
    return zj.periodic_orbit(rubbing(kind, q, 0.026), guess, section=plane)


@pytest.fixture(scope="module", params=["smoothed", "set-valued"])
def settled(request):
    """The kind of friction, and a state by the cycle."""
    column = rubbing(request.param, 2.6, 0.026)
    return request.param, jax.jit(
        lambda: zj.settle(column, KICK, certify=False).final
    )()


def test_period_and_multipliers_are_the_same_whatever_the_section(settled):
    kind, state = settled
    sizes, mu = [], []
    # every coordinate once, and every plane with one of the two kinds of friction
    ways = itertools.cycle((True, False) if kind == "smoothed" else (False, True))
    planes = [*zip(COORDINATES, ways, strict=False)]
    for coordinate, rising in planes:

        @jax.jit
        @jax.vmap
        def cycles(level, coordinate=coordinate, rising=rising):
            plane = zj.SectionPlane(coordinate, level, rising)
            return orbit_on(kind, plane, 2.6, state)

        orbit = cycles(LEVELS)
        assert (orbit.outcome == zj.CODE.found).all(), (coordinate, rising)
        y = np.hstack([np.transpose(orbit.state.phi), np.transpose(orbit.state.omega)])
        np.testing.assert_array_equal(y[:, COORDINATES.index(coordinate)], LEVELS)
        size = np.hstack([orbit.rod_amplitude, orbit.joint_amplitude])
        sizes.append(np.column_stack([orbit.period, size]))
        mu.append(orbit.multipliers)
    sizes, mu = np.concatenate(sizes), np.concatenate(mu)
    # period and amplitudes; measured 5.5e-11
    one = np.broadcast_to(sizes[0], sizes.shape)
    np.testing.assert_allclose(sizes, one, rtol=0, atol=5e-10)
    # measured 6.2e-9: of a motion from where Newton's method made its last step
    np.testing.assert_allclose(mu, np.broadcast_to(mu[0], mu.shape), rtol=0, atol=6e-8)


def test_period_and_amplitude_move_alike_whatever_the_section(settled):
    """With the load."""
    kind, state = settled

    def slopes(plane):
        def numbers(q):
            orbit = orbit_on(kind, plane, q, state)
            return jnp.append(orbit.rod_amplitude, orbit.period)

        return jax.jit(jax.jacfwd(numbers))(2.6)

    known = slopes(zj.SectionPlane())
    other = slopes(zj.SectionPlane("omega2", 0.1, rising=False))
    # measured 3.4e-9 (smoothed) and 3.5e-11
    np.testing.assert_allclose(other, known, rtol=0, atol=3e-8)


def test_a_branch_is_the_same_whatever_the_section():
    """Period over load through the fold; the knee's amplitude tells points apart."""

    def column(q):
        return rubbing("smoothed", q, 0.1)

    start = zj.State(omega=(0.0, 1.5))
    kicked = jax.jit(lambda: zj.settle(column(1.75), start, certify=False).final)()
    arc = zj.Arc(direction=-1, step=0.02, points=50, error=1.0)

    def branch(plane):
        @jax.jit
        def follow():
            orbit = zj.periodic_orbit(column(1.75), kicked, section=plane)
            return zj.continue_cycle(column, orbit, 1.75, arc=arc, max_special_points=1)

        found = follow()
        assert found.outcome == zj.CODE.found
        assert found.special.kind[0] == zj.CODE.fold
        parts = found.points, found.special
        return [(x.joint_amplitude[:, 1], x.parameter, x.period) for x in parts]

    planes = zj.SectionPlane(), zj.SectionPlane("omega2", 0.1, rising=False)
    known, other = map(branch, planes)
    fold, its_fold = np.array(known[1]), np.array(other[1])
    assert np.abs(its_fold - fold).max() < 1e-12  # measured 1.1e-13
    knee, *curve = np.array(known[0])[:, ::-1]
    curve = make_interp_spline(knee, np.array(curve), k=9, axis=1)
    at, *points = np.array(other[0])
    here = (at >= knee[0]) & (at <= knee[-1])
    assert here.sum() > 20 and (at[here] < fold[0]).any()
    error = np.abs(np.array(points) - curve(at))[:, here]
    assert error.max() < 6e-9  # the splines' own; measured 6.6e-10
