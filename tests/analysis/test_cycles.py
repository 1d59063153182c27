"""Cycles: multipliers, the birth at q_cr, folds of dry friction, derivatives."""

import jax
import jax.numpy as jnp
import models
import numpy as np
import pytest
from moreau import motion
from scipy.integrate import solve_ivp

import ziegler_jax as zj

UNIFORM, ZIEGLER = models.UNIFORM, (3.0, 1.0, 1.0)
KICK = zj.State(omega=(0.0, 0.3))


def rods(q, c, inertia):
    return zj.Column(q, *inertia, damping=zj.Viscous(c, c))


@jax.jit
@jax.vmap
def viscous(q, c, inertia, phi2, w1, w2, period):
    guess = zj.State((0.0, phi2), (w1, w2))
    tight = zj.Method(rtol=1e-12, atol=1e-12)
    orbit = zj.periodic_orbit(rods(q, c, inertia), guess, period=period, method=tight)
    return orbit, orbit.multipliers


def linear(q, c, inertia):
    """M, C, K of the column, written out."""
    a, b, d = inertia
    mass = np.array([[a, b], [b, d]])
    damping = c * np.array([[2.0, -1.0], [-1.0, 1.0]])
    return mass, damping, np.array([[2 - q, q - 1], [-1.0, 1.0]])


def hopf(c, inertia):
    r"""The birth of the cycle, by the first Lyapunov coefficient, independently.

    q_cr, omega, the eigenvector q with phi1 = 1 and $dA^2/dq$ of |phi1|. The field is
    odd: $\dot z = (\alpha' \delta + i\omega) z + \frac12 \bar p \cdot C(q, q, \bar q)
    z |z|^2$, with the third derivatives C written out here.
    """
    a, b, d = inertia

    def matrix(q):
        mass, damping, stiff = linear(q, c, inertia)
        inverse = np.linalg.inv(mass)
        zero, one = np.zeros((2, 2)), np.eye(2)
        return np.block([[zero, one], [-inverse @ stiff, -inverse @ damping]])

    q0 = float(zj.critical_load(rods(0.0, c, inertia)).q_cr)
    values, right = np.linalg.eig(matrix(q0))
    i = np.argmax(np.real(values) + (np.imag(values) > 0) * 1e-6)
    assert abs(values[i].real) < 1e-12
    u = right[:, i] / right[0, i]
    left = np.linalg.inv(right)[i] * right[0, i]
    change = (matrix(q0 + 1e-3) - matrix(q0 - 1e-3)) / 2e-3  # exact: linear in q
    growth = np.real(left @ change @ u)

    # C(q, q, conj q) / 2 is the coefficient of z^2 conj(z) in the field's cubic part
    x = {1: u, -1: np.conj(u)}

    def product(*factors):
        """The coefficient of z |z|^2 in a product of three linear forms."""
        total = 0
        for signs in ((1, 1, -1), (1, -1, 1), (-1, 1, 1)):
            total += np.prod([f(x[s]) for f, s in zip(factors, signs, strict=True)])
        return total

    def delta(y):
        return y[0] - y[1]

    def rate1(y):
        return y[2]

    def rate2(y):
        return y[3]

    mass, damping, stiff = linear(q0, c, inertia)
    # accelerations of the linear motion: they meet b (cos D - 1) = -b D^2 / 2
    speed = values[i] * u[2:]

    def acceleration(k):
        return lambda y: speed[k] if y is x[1] else np.conj(speed[k])

    bent = [b / 2 * product(delta, delta, acceleration(k)) for k in (1, 0)]
    cubic = np.array(
        [
            -q0 / 6 * product(delta, delta, delta)
            - b * product(delta, rate2, rate2)
            + bent[0],
            b * product(delta, rate1, rate1) + bent[1],
        ]
    )
    coefficient = left @ np.concatenate([[0, 0], np.linalg.solve(mass, cubic)])
    return q0, values[i].imag, u, 4 * -growth / np.real(coefficient)


@pytest.fixture(scope="module")
def born():
    """Cycles 1e-4, 1e-3 above q_cr and well above, of both columns and two dampings."""
    lanes, limits = [], []
    for inertia in (UNIFORM, ZIEGLER):
        for c in (0.1, 0.3):
            q0, omega, u, slope = hopf(c, inertia)
            limits.append(slope)
            for above in (1e-4, 1e-3, 0.05):
                size = np.sqrt(slope * above)
                turned = np.real(u * -1j * size)  # phi1 = 0, going up
                lane = (q0 + above, c, inertia, *turned[1:], 2 * np.pi / omega)
                lanes.append(lane)
    arguments = [np.array(x) for x in zip(*lanes, strict=True)]
    arguments[2] = tuple(arguments[2].T)
    return arguments, limits, viscous(*arguments)


def test_the_cycle_is_born_supercritically_with_the_amplitude_of_its_normal_form(born):
    (q, *_), limits, (orbit, _) = born
    assert (orbit.outcome == zj.CODE.found).all()
    squares = np.asarray(orbit.rod_amplitude[:, 0]).reshape(4, 3) ** 2
    ratios = squares[:, :2] / [1e-4, 1e-3]
    limit = ratios[:, 0] + (ratios[:, 0] - ratios[:, 1]) / 9  # linear in the distance
    assert (np.array(limits) > 0).all()
    np.testing.assert_allclose(limit, limits, rtol=1e-4)  # measured 3e-8
    assert np.asarray(orbit.rod_amplitude).min() > 0


def test_without_damping_left_the_amplitudes_square_is_a_fraction_of_the_load():
    """phi1 and phi2 of the limit c -> 0, exact; 40 digits of mpmath give the same."""
    for inertia, exact in (
        (UNIFORM, (3780 / 2363, 77760 / 16541)),
        (ZIEGLER, (19600 / 10441, 63504 / 10441)),
    ):
        _, _, u, slope = hopf(1e-4, inertia)
        # what c adds is of its square
        np.testing.assert_allclose(slope * np.abs(u[:2]) ** 2, exact, rtol=1e-6)


def divergence_and_motion(t, y, q, c, inertia):
    numbers = (q, 0.0, 1.0, c, c, inertia)  # no friction
    return [*models.field(y[:4], *numbers), models.divergence(y[:4], *numbers)]


def test_one_multiplier_is_1_and_their_product_is_that_of_the_divergence(born):
    arguments, _, (orbit, mu) = born
    assert np.abs(mu[:, 0] - 1).max() < 1e-6  # measured 3e-10
    for i in range(len(mu)):
        q, c = arguments[0][i], arguments[1][i]
        inertia = [x[i] for x in arguments[2]]
        y = [float(x[i]) for x in orbit.state.y]
        motion = solve_ivp(
            divergence_and_motion, (0, float(orbit.period[i])), [*y, 0.0],
            args=(q, c, inertia), method="DOP853", rtol=1e-12, atol=1e-12,
        )  # fmt: skip
        end = motion.y[:, -1]
        np.testing.assert_allclose(end[:4], y, rtol=0, atol=1e-7)
        product = np.prod(mu[i]).real
        assert abs(product / np.exp(end[4]) - 1) < 1e-6  # measured 3e-8


def law(tau, tau_k=None):
    return zj.SetValuedCoulomb(tau, tau_k, pin_radius=1.0, load=zj.ConstantLoad(1.0))


# By other codes: collocation (AUTO-07p) and shooting from event to event. Below the
# first of them motions pass the ghost of the two cycles so slowly that they seem to be
# one.
FOLDS = {0.01: 1.28802, 0.03: 1.32807, 0.1: 1.57105, 0.26: 1.86140}
STEP = 1e-4


@pytest.fixture(scope="module")
def folds():
    """The four folds, neighbours of the third for differences, two of less friction."""

    def fold(tau, start, kick):
        def column(q):
            return zj.uniform_rods(q, friction=law(tau))

        kicked = zj.settle(column(start), zj.State(omega=(0.0, kick)), certify=False)
        guess = jax.lax.stop_gradient(kicked.final)
        orbit = zj.periodic_orbit(column(start), guess)
        arc = zj.Arc(step=0.05)
        found = zj.bifurcation(column, "fold", orbit, start, arc=arc)
        return found.parameter, found

    # with less friction the cycle of 1.95 has lost its symmetry
    tau = np.array([*FOLDS, 0.1 + STEP, 0.1 - STEP, 0.005, 0.0025])
    start = np.where(tau < 0.01, 1.42, 1.95)
    kick = np.where(tau < 0.01, 2.0, 3.0)
    slopes = jax.jit(jax.vmap(jax.value_and_grad(fold, has_aux=True)))
    (value, found), slope = slopes(tau, start, kick)
    return np.asarray(value), found, np.asarray(slope)


def test_dry_friction_folds_the_cycle_where_it_is_known_to(folds):
    value, found, _ = folds
    assert (found.outcome == zj.CODE.found).all()
    # five digits; measured 4e-6
    np.testing.assert_allclose(value[:4], list(FOLDS.values()), rtol=0, atol=2e-5)


def test_as_friction_vanishes_the_fold_tends_to_14_elevenths(folds):
    """There equal torques neither feed nor brake the slow mode of the free column.

    To first order a mode v grows by -(w_1 s_1 + (w_2 - w_1) s_2) / (w M v), with w of
    the adjoint and s the signs of the joints' rates, which agree: it is 0 where w_2 = 0
    in K^T w = omega^2 M w, so that (2 - q) / a = (q - 1) / b.
    """
    q1, q2, q3 = folds[0][[7, 6, 0]]  # tau doubles
    limit = q1 - (q2 - q1) ** 2 / (q3 - 2 * q2 + q1)
    assert abs(limit - 14 / 11) < 1e-3  # measured 4.6e-4


def test_two_multipliers_are_1_at_a_fold_and_sticking_makes_one_zero(folds):
    _, found, _ = folds
    mu = np.asarray(found.cycle.multipliers)[:, 0]
    assert np.abs(mu[:, :2] - 1).max() < 1e-3  # a double root: the root of the error
    assert np.abs(mu[:, 3]).max() < 1e-12
    assert (np.abs(mu[:, 2]) < 0.9).all()  # 0.77 with the least friction


def test_the_fold_moves_with_friction_as_its_derivative_says(folds):
    value, _, slope = folds
    difference = (value[4] - value[5]) / (2 * STEP)
    np.testing.assert_allclose(slope[2], difference, rtol=1e-5)  # measured 2e-7


def test_time_stepping_decays_below_the_fold_of_weak_friction_and_grows_above():
    """From near the two cycles of tau = 0.01; Moreau's scheme knows no events."""
    period, tau = 8.49, (0.01, 0.01)
    for q, grows in ((1.284, False), (1.292, True)):
        state, sizes = (0.0, -0.0009, 0.14, 0.21), []
        for _ in range(3):
            largest = 0.0
            for _ in range(40):
                state = motion(q, tau, state[:2], state[2:], period / 40, 160)
                largest = max(largest, abs(state[0]))
            sizes.append(largest)
            state = motion(q, tau, state[:2], state[2:], 11 * period, 70_000)
        # measured over seven periods: -0.5 to -0.7 % below, 0.2 to 0.5 % above
        assert (np.diff(sizes) > 0).all() if grows else (np.diff(sizes) < 0).all()


# Derivatives of the cycle -------------------------------------------------------------

CHAOS = (3.9, 0.226, 0.0565, 1.0)


@pytest.mark.parametrize("kind", ["smoothed", "set-valued"])
def test_amplitude_and_period_move_as_their_derivatives_say(kind):
    """In q, mu_s, mu_k and pin radius; refused where a guess in chaos leads nowhere."""

    def column(p):
        load = zj.ConstantLoad(1.0)
        if kind == "set-valued":
            law = zj.SetValuedCoulomb(p[1], p[2], pin_radius=p[3], load=load)
        else:
            law = zj.SmoothCoulomb(
                p[1], p[2], pin_radius=p[3], v_smooth=0.1, v_stribeck=0.5, load=load
            )
        return zj.uniform_rods(p[0], friction=law)

    def numbers(p, y):
        guess = zj.State((y[0], y[1]), (y[2], y[3]))
        orbit = zj.periodic_orbit(column(p), guess)
        size = jnp.concatenate([orbit.rod_amplitude, orbit.joint_amplitude])
        value = jnp.append(size, orbit.period)
        return value, (value, orbit)

    at, step = np.array([2.6, 0.03, 0.026, 1.0]), 1e-5
    around = at * (1 + step * np.concatenate([np.eye(4), -np.eye(4)]))
    settled = jax.jit(lambda p: zj.settle(column(p), KICK, certify=False))(at)
    y = np.hstack([settled.final.phi, settled.final.omega])

    both = jax.jacfwd(numbers, has_aux=True)
    lanes = np.vstack([at, around, CHAOS, at])
    guesses = np.vstack([np.tile(y, (9, 1)), [0.3, -0.2, 1.0, 0.5], np.zeros(4)])
    slope, (value, orbit) = jax.jit(jax.vmap(both))(lanes, guesses)
    assert (orbit.outcome[:9] == zj.CODE.found).all()
    value = np.asarray(value)
    difference = (value[1:5] - value[5:9]).T / (2 * step * at)
    # measured 2.7e-5 (smoothed) and 1.8e-6 (set-valued)
    np.testing.assert_allclose(slope[0], difference, rtol=1e-4, atol=1e-6)
    # at rest nothing comes back; in chaos there is no orbit here, or one that repels
    assert orbit.outcome[10] == zj.CODE.no_return
    found = np.asarray(orbit.outcome) == zj.CODE.found
    assert np.isnan(slope[~found]).all() and np.isfinite(slope[found]).all()
    assert not found[9] or not orbit.stable[9]


# What observers see of one turn -------------------------------------------------------

OBSERVERS = (zj.EnergyBalance(), zj.Mean(), zj.StickFraction())


def rubbed(kind, q):
    load = zj.ConstantLoad(1.0)
    law: zj.SetValuedCoulomb | zj.SmoothCoulomb
    law = zj.SetValuedCoulomb(0.026, pin_radius=1.0, load=load)
    if kind == "smoothed":
        law = zj.SmoothCoulomb(0.1, pin_radius=0.1, v_smooth=0.1)
    return zj.uniform_rods(q, friction=law, damping=zj.Viscous(0.02, 0.02))


@pytest.mark.parametrize("kind, q", [("smoothed", 2.8), ("set-valued", 2.6)])
def test_observers_see_of_an_orbit_what_they_see_of_the_cycle_that_settles(kind, q):
    @jax.jit
    def both():
        start = zj.State(omega=(0.0, 0.6))
        settled = zj.settle(rubbed(kind, q), start, observers=OBSERVERS, certify=True)
        orbit = zj.periodic_orbit(rubbed(kind, q), settled.final, observers=OBSERVERS)
        return settled, orbit

    settled, orbit = both()
    assert settled.outcome == zj.CODE.cycle and orbit.outcome == zj.CODE.found
    mine, its = orbit.variables(), settled.variables()
    for name in ("follower_power", "damping_power", "friction_power"):
        assert mine[name].units == its[name].units == "k sqrt(k/(m l^2))"
        # measured 4.2e-7: the cycle of `settle` closes less
        np.testing.assert_allclose(mine[name].value, its[name].value, rtol=2e-6)
    assert np.abs(orbit.mean_angle - settled.mean_angle).max() < 1e-7  # measured 1.8e-8
    # of steps, and so as coarse as these: measured 2.2e-5
    assert np.abs(orbit.stick_fraction - settled.stick_fraction).max() < 1e-4
    # after a turn the energy is what it was: measured 4.2e-12
    gain = orbit.follower_power - orbit.damping_power - orbit.friction_power
    assert abs(gain) < 1e-10 and orbit.follower_power > 0.01
    assert orbit.to_dataset().friction_power.dims == ()


class Rates(zj.AbstractObserver):
    """Integrals of 1, of each joint's rate, and of its square."""

    name = "rates"

    def integrand(self, system, y):
        return 1.0 + 0.0 * y[0], y[2], y[3] - y[2], y[2] ** 2, (y[3] - y[2]) ** 2

    def init(self, system, t, y):
        return (0.0 * y[0],) * 5

    def step(self, system, state, step):
        return tuple(a + b for a, b in zip(state, step.integrals, strict=True))

    def result(self, system, state, span, y):
        return {
            "whole": zj.Variable(state[0], "the turn"),
            "shift": zj.Variable(jnp.stack(state[1:3]), "angle", "rad", ("joint",)),
            "square": zj.Variable(jnp.stack(state[3:]) / span, "mean", "1", ("joint",)),
        }


def test_of_an_unstable_orbit_exactly_one_turn_is_observed():
    """No motion settles there."""

    @jax.jit
    def found_by(method):
        load = zj.ConstantLoad(1.0)
        law = zj.SmoothCoulomb(0.1, pin_radius=1.0, v_smooth=0.05, load=load)
        column = zj.uniform_rods(
            1.6335246694, friction=law, damping=zj.Viscous(0.002, 0.002)
        )
        start = zj.State((0.0, -0.13764246), (0.4872878, 0.90124433))
        observers = (Rates(), zj.EnergyBalance(), zj.Period())
        return zj.periodic_orbit(column, start, observers=observers, method=method)

    def found(budget):
        return found_by(zj.Method(max_steps=budget))

    orbit = found(100_000)
    assert orbit.outcome == zj.CODE.found and not orbit.stable
    np.testing.assert_allclose(orbit.whole, orbit.period, rtol=1e-12)
    assert np.abs(orbit.shift).max() < 1e-9  # measured 6.2e-11
    # what viscous joints lose: to the last bits, of the same stages
    lost = 0.002 * orbit.square.sum()
    np.testing.assert_allclose(orbit.damping_power, lost, rtol=1e-12)
    gain = orbit.follower_power - orbit.damping_power - orbit.friction_power
    assert abs(gain) < 1e-10  # measured 6.3e-12
    enough = int(orbit.steps) + 1
    assert found(enough).outcome == zj.CODE.found
    spent = found(enough - 2)
    assert spent.outcome == zj.CODE.not_integrated
    assert np.isnan([spent.whole, spent.period, spent.follower_power]).all()


def test_what_no_orbit_can_be_watched_by_is_refused(refuses):
    class Named(Rates):
        def result(self, system, state, span, y):
            return {"period": zj.Variable(span, "again")}

    def watch(observers):
        column = rubbed("smoothed", 2.8)
        return lambda: zj.periodic_orbit(column, KICK, observers=observers)

    refuses(watch((zj.Growth(),)), "`observers`", "`Growth()`", "`periodic_orbit`")
    refuses(watch((3,)), "`observers`", "3")
    refuses(watch((Named(),)), "`rates`", "the result's own", "`period`")


def test_by_taylors_steps_an_orbit_is_the_explicit_ones_with_its_derivatives():
    def numbers(solver):
        def at(q):
            law = zj.SetValuedCoulomb(0.2, 0.1, pin_radius=0.05)
            guess = zj.State((0.0, 0.3), (0.3, 0.1))
            method = zj.Method(solver, rtol=1e-12)
            orbit = zj.periodic_orbit(
                zj.uniform_rods(q, friction=law), guess, method=method
            )
            return jnp.stack([*orbit.rod_amplitude, orbit.joint_amplitude[1]])

        q = jnp.asarray(2.6)
        return jax.jit(lambda q: jax.jvp(at, (q,), (jnp.ones_like(q),)))(q)

    explicit, taylor = numbers(zj.Explicit()), numbers(zj.Taylor())
    for one, two in zip(explicit, taylor, strict=True):
        assert np.abs(two / one - 1).max() < 1e-10  # measured 2e-12
