"""The friction law: its shape, its limits, what it rests on, what it refuses."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize_scalar

import ziegler_jax as zj


def law(mu_s=0.24, mu_k=0.2, **changes):
    options = {"pin_radius": 1.0, "v_stribeck": 0.1, "v_smooth": 0.01} | changes
    return zj.SmoothCoulomb(mu_s, mu_k, **options)


def lever(friction, u):
    """Torque of joint 1 per unit of load at an array of rates."""
    u = np.asarray(u, float)
    return np.asarray(jax.vmap(lambda u: friction.levers(u, u)[0])(u))


@pytest.mark.parametrize("ratio, digits", [(5, 1.140), (10, 1.177), (50, 1.198)])
def test_the_peak_stays_below_mu_s_as_stated(ratio, digits):
    friction = law(1.2, 1.0, v_stribeck=0.01 * ratio)
    found = lever(friction, np.linspace(0, 0.01 * ratio, 100_001)).max()

    def falls(x):  # x = u / v_smooth
        return -(1 + 0.2 * np.exp(-((x / ratio) ** 2))) * np.tanh(x)

    exact = -minimize_scalar(falls, (0.5, ratio / 2, 1.5 * ratio)).fun
    # 100 001 places miss it by what they are apart; measured 3e-11
    assert abs(found - exact) < 4e-10
    assert exact < 1.2
    assert abs(exact - digits) < 5e-4  # the docstring's; measured 2.9e-4


def test_friction_opposes_either_direction_alike():
    u = np.geomspace(1e-6, 10, 200)
    # measured 2.2e-16: tanh is odd to rounding
    np.testing.assert_allclose(lever(law(), u), -lever(law(), -u), rtol=2e-15)
    assert (lever(law(), u) > 0).all()
    assert lever(law(), [0.0]) == 0


@pytest.mark.parametrize("static", [True, False])
def test_at_rest_it_is_viscous_damping(static):
    """The slope at rest is tau_s / v_smooth."""
    friction = (
        law(0.24, 0.2, pin_radius=0.5)
        if static
        else zj.SmoothCoulomb(0.24, pin_radius=0.5, v_smooth=0.01)
    )
    slope = jax.jvp(lambda u: friction.levers(u, u)[1], (0.0,), (1.0,))[1]
    # measured 1.2e-16
    np.testing.assert_allclose(slope, 0.5 * 0.24 / 0.01, rtol=1e-15)


@pytest.mark.parametrize("v_smooth", [1e-2, 1e-6, 1e-12])
def test_beyond_the_layer_nothing_depends_on_its_width(v_smooth):
    def torque(u, v):
        return law(v_smooth=v).levers(u, u)[1]

    for u in (0.5, -1.0):
        slopes = jax.hessian(torque, (0, 1))(u, v_smooth)
        assert jax.grad(torque, 1)(u, v_smooth) == 0
        assert slopes[0][1] == slopes[1][0] == slopes[1][1] == 0


def test_slopes_are_those_of_the_formula():
    def formula(u, v, w):
        peak = 0.2 + (0.24 - 0.2) * jnp.exp(-((u / w) ** 2))
        return peak * jnp.tanh(u / v)

    def torque(u, v, w):
        return law(v_smooth=v, v_stribeck=w).levers(u, u)[1]

    at = jnp.linspace(-0.04, 0.04, 41), 0.01, 0.1
    every = (0, 1, 2)
    for turn in (jax.jacfwd, jax.jacrev, jax.hessian):
        found, expected = (
            jnp.stack(jax.tree.leaves(jax.vmap(turn(f, every), (0, None, None))(*at)))
            for f in (torque, formula)
        )
        scale = jnp.abs(expected).max(1, keepdims=True)
        # measured 3.6e-14, of a second slope
        np.testing.assert_allclose(found / scale, expected / scale, atol=1e-13)


@pytest.mark.parametrize("v", [1e-140, 1e-150, 1e-300])
@pytest.mark.parametrize("u", [1e-3, 1.0])
def test_however_soon_the_static_part_ends_nothing_of_its_slope_is_left(u, v):
    # the layer is one, of width 1: what is left is the kinetic torque's
    slope = jax.grad(lambda u: law(v_smooth=1.0, v_stribeck=v).levers(u, u)[1])
    # measured 2e-16
    np.testing.assert_allclose(jax.jit(slope)(u), 0.2 / np.cosh(u) ** 2, rtol=1e-15)


def test_fast_sliding_meets_mu_k():
    # exp(-100) and 1 - tanh(100) are beyond the last digit
    # measured 1.1e-16
    np.testing.assert_allclose(lever(law(), [1.0, -1.0]), [0.2, -0.2], rtol=4e-16)


@pytest.mark.parametrize("u", [1e-3, -0.05, 0.7])
def test_it_tends_to_a_stribeck_law_as_v_smooth_vanishes(u):
    expected = np.sign(u) * (0.2 + 0.04 * np.exp(-((u / 0.1) ** 2)))
    found = lever(law(v_smooth=1e-5), [u])[0]
    # tanh(100) is 1; measured 0
    np.testing.assert_allclose(found, expected, rtol=1e-15)


@pytest.mark.parametrize("mu_k", [None, 0.3])
def test_without_a_static_part_one_coefficient_is_left(mu_k):
    friction = zj.SmoothCoulomb(0.3, mu_k, pin_radius=0.1, v_smooth=0.01)
    assert friction.mu_k is None and friction.v_stribeck is None
    u = np.linspace(-1, 1, 101)
    # measured 4.4e-16
    np.testing.assert_allclose(
        lever(friction, u), 0.03 * np.tanh(u / 0.01), rtol=2e-15, atol=0
    )


def test_equal_coefficients_with_a_stribeck_rate_agree_with_one():
    u = np.linspace(-0.3, 0.3, 101)
    one = zj.SmoothCoulomb(0.3, pin_radius=0.1, v_smooth=0.01)
    two = law(0.3, 0.3, pin_radius=0.1)
    # measured 3.3e-16
    np.testing.assert_allclose(lever(two, u), lever(one, u), rtol=1e-15)


def test_one_number_is_the_same_for_both_joints_and_a_pair_is_apart():
    alike, pair = law(), law((0.24, 0.5), (0.2, 0.1), pin_radius=(1.0, 2.0))
    first, second = alike.levers(0.02, 0.02)
    assert first == second == pair.levers(0.02, 9.0)[0]
    other = law(0.5, 0.1, pin_radius=2.0)
    assert pair.levers(9.0, 0.02)[1] == other.levers(0.02, 0.02)[0]


LOADS = {
    "follower": (zj.FollowerLoad(), lambda q, r: np.abs(q) * np.ones(2)),
    "constant": (zj.ConstantLoad(0.7), lambda q, r: np.array([0.7, 0.7])),
    "one a joint": (zj.ConstantLoad((0.7, 1.3)), lambda q, r: np.array([0.7, 1.3])),
    "reaction": (zj.JointReaction(), lambda q, r: np.linalg.norm(r, axis=-1)),
    "preload and reaction": (
        zj.ConstantLoad((0.7, 1.3)) + zj.JointReaction(),
        lambda q, r: np.array([0.7, 1.3]) + np.linalg.norm(r, axis=-1),
    ),
    "reaction and two preloads": (
        zj.ConstantLoad(0.3) + (zj.JointReaction() + zj.ConstantLoad(0.4)),
        lambda q, r: 0.7 + np.linalg.norm(r, axis=-1),
    ),
    "preload and follower": (
        zj.ConstantLoad(0.7) + zj.FollowerLoad(),
        lambda q, r: (0.7 + np.abs(q)) * np.ones(2),
    ),
}


@pytest.mark.parametrize("name", LOADS)
@pytest.mark.parametrize("q", [2.3, -1.1])
def test_each_load_gives_torque_rho_n_mu(name, q):
    """The torque of one joint is its power over its rate when the other does not move.

    Joint 1 alone: w2 = w1. Joint 2 alone: w1 = 0.
    """
    load, normal = LOADS[name]
    friction = law((0.24, 0.3), (0.2, 0.1), pin_radius=(0.4, 0.2), load=load)
    column = zj.uniform_rods(q, friction=friction)
    for joint, rates in enumerate([(0.03, 0.03), (0.0, -0.02)]):
        y = (0.2, -0.3, *rates)
        u = (rates[0], rates[1] - rates[0])[joint]
        mu_s, mu_k, rho = [(0.24, 0.2, 0.4), (0.3, 0.1, 0.2)][joint]
        mu = (mu_k + (mu_s - mu_k) * np.exp(-((u / 0.1) ** 2))) * np.tanh(u / 0.01)
        loads = normal(q, np.asarray(zj.reactions(column, y)))
        torque = zj.power(column, y).friction / u
        # measured 9e-16
        np.testing.assert_allclose(torque, rho * loads[joint] * mu, rtol=4e-15)


GOOD = {"pin_radius": 0.1, "v_stribeck": 0.05, "v_smooth": 0.01}
ONE = {"pin_radius": 0.1, "v_smooth": 0.01}


@pytest.mark.parametrize(
    "call, parts",
    [
        (lambda: law(0.1, 0.2), ("`mu_k`", "0.2", "at most `mu_s`", "0.1")),
        (lambda: law((0.3, 0.1), 0.2), ("`mu_k`", "0.2", "at most `mu_s`", "0.1")),
        (lambda: law((0.3, 0.2), (0.1, 0.4)), ("`mu_k`", "0.4", "at most `mu_s`")),
        (lambda: law(-0.1, -0.2), ("`mu_s`", "-0.1", "nonnegative")),
        (lambda: law((0.2, -0.1), 0.0), ("`mu_s[1]`", "-0.1", "nonnegative")),
        (lambda: law(0.1, -0.2), ("`mu_k`", "-0.2", "nonnegative")),
        (lambda: law(np.nan, 0.1), ("`mu_s`", "nan", "finite")),
        (lambda: law(np.inf, 0.1), ("`mu_s`", "inf", "finite")),
        (lambda: law(pin_radius=-1.0), ("`pin_radius`", "-1", "nonnegative")),
        (lambda: law(v_smooth=0.0), ("`v_smooth`", "0", "positive")),
        (lambda: law(v_smooth=np.nan), ("`v_smooth`", "nan", "positive")),
        (lambda: law(v_stribeck=-0.1), ("`v_stribeck`", "-0.1", "positive")),
        (
            lambda: zj.uniform_rods(friction=law((0.1, 0.2, 0.3), 0.1)),
            ("`mu_s`", "3 numbers", "2 joints"),
        ),
        (lambda: law(np.ones((2, 2)), 0.1), ("`mu_s`", "(2, 2)", "single number")),
        (lambda: law(jnp.ones(1), 0.1), ("`mu_s`", "at least two numbers")),
        (lambda: law(v_smooth=(0.1, 0.1)), ("`v_smooth`", "(2,)", "single number")),
        (lambda: law("dry", 0.1), ("`mu_s`", "dry", "number")),
        (lambda: law(load=1.0), ("`load`", "1.0", "ConstantLoad")),
        (lambda: zj.SmoothCoulomb(0.3, 0.2, **ONE), ("`v_stribeck`", "given")),
        (lambda: zj.SmoothCoulomb(0.3, **GOOD), ("`mu_k`", "given")),
        (lambda: zj.ConstantLoad(-1.0), ("`n`", "-1", "nonnegative")),
        (lambda: zj.ConstantLoad((1.0, np.nan)), ("`n[1]`", "nan", "nonnegative")),
        (
            lambda: zj.JointReaction() + (zj.ConstantLoad(1.0) + zj.JointReaction()),
            ("`second`", "no `JointReaction()`", "once"),
        ),
        (lambda: zj.ConstantLoad(1.0) + 0.2, ("`second`", "0.2", "normal load")),
        (lambda: zj.Viscous(0, 0) + 0.2, ("`second`", "0.2", "damping law")),
        (lambda: zj.JointReaction(0), ("`newton_steps`", "0", "at least 1")),
        (lambda: zj.JointReaction(1.5), ("`newton_steps`", "1.5", "whole")),
    ],
)
def test_a_wrong_number_is_refused_by_name_value_and_rule(refuses, call, parts):
    refuses(call, *parts)


def test_equal_numbers_on_either_side_of_the_rule_are_taken():
    law(0.2, 0.2), law(0.0, 0.0), law(pin_radius=0.0), zj.ConstantLoad(0.0)
