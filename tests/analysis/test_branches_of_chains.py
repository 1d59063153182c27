"""A branch of three rods through its fold against shooting on free bodies."""

import free_bodies
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import fsolve

import ziegler_jax as zj
from ziegler_jax import CODE
from ziegler_jax.analysis.branch_point import (
    BranchPoint,
    Continuation,
    circles,
    products,
)

TAU, V = 0.1, 0.1
HIGH = 1.6  # where the branch begins
APART = 0.003  # angles phi2 about the fold


def chain(q, tau=TAU, v=V):
    law = zj.SmoothCoulomb(tau, pin_radius=1.0, v_smooth=v, load=zj.ConstantLoad(1.0))
    return zj.Chain(q, lengths=(1.0,) * 3, masses=1.0, springs=1.0, friction=law)


def orbit_of(tau=TAU):
    kicked = zj.State(omega=(0.0, 0.0, 1.5))
    ended = zj.settle(chain(HIGH, tau), kicked)
    return zj.periodic_orbit(chain(HIGH, tau), ended.final)


def shot(phi2, guess):
    """phi3, the rates, half the period and the load of the cycle through phi1 = 0.

    The other code's own unknowns: the angle phi2 falls along the branch, also where
    the load turns back, so that the fold is no special point of these equations.
    """
    ones = {name: (1.0,) * 3 for name in ("lengths", "masses", "springs")}

    def miss(x):
        phi3, w1, w2, w3, half, q = x
        start = np.array([0.0, phi2, phi3, w1, w2, w3])
        bodies = free_bodies.Bodies(q, **ones, mu_k=(TAU,) * 3)
        return free_bodies.smoothed(bodies, start, (0.0, half), V)[-1] + start

    found, _, good, why = fsolve(miss, guess, xtol=1e-11, full_output=True)
    assert good == 1 or np.abs(miss(found)).max() < 1e-9, why
    return found


def rows(points):
    """phi2 and, beside it, phi3, the rates, half the period and the load."""
    half = points.period / 2
    return points.phi[:, 1], np.column_stack(
        [points.phi[:, 2], points.omega, half, points.parameter]
    )


@pytest.fixture(scope="module")
def branch():
    @jax.jit
    def follow():
        arc = zj.Arc(direction=-1, points=20, error=1.0)
        return zj.continue_cycle(chain, orbit_of(), HIGH, arc=arc, max_special_points=1)

    return jax.tree.map(np.asarray, follow())


def test_a_branch_of_three_rods_is_the_one_that_another_code_shoots(branch):
    assert int(branch.count) == 20 and bool(branch.symmetric)
    phi2, known = rows(branch.points)
    stable = branch.points.stable
    chosen = np.array([2, 8, 17])
    assert stable[chosen[:2]].all() and not stable[chosen[2]]
    for i in chosen:
        away = known[i] * (1 + 1e-4)  # the package says only where to look
        # measured 4.5e-10
        np.testing.assert_allclose(shot(phi2[i], away), known[i], rtol=0, atol=1e-8)


def test_its_fold_is_where_another_codes_load_turns_back(branch):
    assert branch.special.kind[0] == CODE.fold
    (phi2,), (known,) = rows(jax.tree.map(lambda x: x[:1], branch.special))
    away = known * (1 + 1e-4)
    below, at, above = (shot(phi2 + by, away)[-1] for by in (-APART, 0.0, APART))
    fold = branch.special.parameter[0]
    assert abs(fold - at) < 1e-8  # measured 8e-16
    # the vertex of the parabola: what is left falls with the square of APART
    slope, bend = (above - below) / (2 * APART), (above - 2 * at + below) / APART**2
    assert bend > 0 and abs(slope / bend) < 6e-4  # measured 1.5e-4


def test_a_fold_of_three_rods_moves_with_friction_as_its_derivative_says():
    def fold(tau):
        def make(q):
            return chain(q, tau)

        return zj.bifurcation(make, "fold", orbit_of(tau), HIGH).parameter

    both, h = jax.jit(lambda tau: jax.jvp(fold, (tau,), (1.0,))), 1e-3
    (_, slope), (low, _), (high, _) = (both(TAU + x) for x in (0.0, -h, h))
    # measured 1.8e-6
    np.testing.assert_allclose(slope, (high - low) / (2 * h), rtol=2e-5)


def test_a_threshold_of_three_rods_lies_in_its_width_and_moves_as_it_says():
    v = 0.05  # with less damping at rest the column does not flutter from there

    def kick(tau):
        along, fine = zj.State(omega=(0.0, 0.0, 1.0)), zj.Search(halvings=16)
        return zj.critical_kick(chain(1.2, tau, v), along, (0.1, 2.5), search=fine)

    both = jax.jit(lambda tau: jax.jvp(lambda x: kick(x).threshold, (tau,), (1.0,)))
    there, h, tau = jax.jit(kick)(0.1), 1e-3, 0.1
    assert there.outcome == CODE.found
    (at, slope), (low, _), (high, _) = (both(tau + x) for x in (0.0, -h, h))
    # measured 2.4e-4
    np.testing.assert_allclose(slope, (high - low) / (2 * h), rtol=3e-3)

    def end(size):
        start = zj.State(omega=(0.0, 0.0, size))
        return zj.settle(chain(1.2, tau, v), start).outcome

    # the interval's ends, and a hundredth of it more
    ends = jax.jit(jax.vmap(end))(at + jnp.array([-0.51, 0.51]) * there.width)
    assert ends.tolist() == [CODE.stuck, CODE.cycle]


def test_the_tests_are_products_over_five_multipliers(rng):
    pair = 1.1 * np.exp(0.7j)
    values = np.array([pair, pair.conj(), -0.4, 0.3, 0.2])
    exact = np.prod([a * b - 1 for i, a in enumerate(values) for b in values[:i]])
    exact = exact, np.prod(1 + values), np.prod(1 - values)
    np.testing.assert_allclose(products(jnp.asarray(values)), np.real(exact))
    assert circles(jnp.asarray(values))
    assert not circles(jnp.asarray([2.01, 0.5, -0.4, 0.3 + 0.2j, 0.3 - 0.2j]))


def test_a_torus_beside_two_reciprocal_multipliers_is_no_change_that_means_nothing():
    problem = object.__new__(Continuation)
    problem.section, problem.sign = zj.SectionPlane(), 1.0

    def point(size):
        """Multipliers 1, a pair of this size, 1.25, 0.801, 0.3; phi1 is along it."""
        moved = np.diag([1.0, size, size, 1.25, 0.801, 0.3])
        moved[1:3, 1:3] = size * np.array(
            [[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]]
        )
        matrix = jnp.zeros((6, 7)).at[0, 5].set(1.0)
        none = jnp.zeros(0)
        return BranchPoint(none, none, none, jnp.asarray(moved), matrix, none, none)

    changed = jnp.array([False, True, False, False])
    inside, outside, real = point(0.98), point(1.02), point(0.98)
    assert problem.real_changes(changed, inside, outside)[1]
    real = real._replace(moved=jnp.diag(jnp.array([1.0, 0.9, 0.8, 1.25, 0.801, 0.3])))
    assert not problem.real_changes(changed, real, real)[1]
