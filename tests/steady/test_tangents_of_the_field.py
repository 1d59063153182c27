"""The field's Jacobian, worked out once for all tangents, is that of the field."""

import diffrax as dfx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

import ziegler_jax as zj
from ziegler_jax.model.friction import AbstractRateFriction
from ziegler_jax.model.state import PhasePoint
from ziegler_jax.motion.tangents import push
from ziegler_jax.solvers import Explicit
from ziegler_jax.solvers.tableaus import CALVO7, VERN9
from ziegler_jax.steady.push_along import (
    accelerations_and_slopes,
    push_along,
    tangent_field,
)

Y = (0.3, -0.2, -0.15, 0.25)  # joint 1 turns backwards, joint 2 forwards


class Lawless(AbstractRateFriction):
    """A law of one's own, under a constant load."""

    def load_law(self):
        return zj.ConstantLoad(1.0)

    def rate_cut(self):
        return 0.05


class OfTwoBranches(Lawless):
    """The branch that is left out has no slope where it is left out."""

    def levers(self, u1, u2):
        return tuple(
            0.01 * jnp.where(u > 0, jnp.sqrt(u), -0.5 * u * u) for u in (u1, u2)
        )


class ByALoop(Lawless):
    """A torque with g + g^3 = u, by Newton's method until it stands."""

    def levers(self, u1, u2):
        def solved(u):
            def turn(now):
                g, _ = now
                move = (g + g**3 - u) / (1 + 3 * g * g)
                return g - move, move

            g, _ = lax.while_loop(lambda now: jnp.abs(now[1]) > 1e-14, turn, (u, u))
            return 0.02 * g

        return solved(u1), solved(u2)


def smooth(**law):
    return zj.SmoothCoulomb(
        0.12, 0.1, pin_radius=0.1, v_stribeck=0.05, v_smooth=0.1, **law
    )


LAWS = {
    "none": None,
    "smoothed": smooth(),
    "no Stribeck": zj.SmoothCoulomb(0.1, pin_radius=0.1, v_smooth=0.1),
    "reactions": smooth(load=zj.JointReaction()),
    "two branches": OfTwoBranches(),
    "a loop": ByALoop(),
}


def system_of(friction):
    damping = zj.Viscous(0.02, 0.01)
    return zj.uniform_rods(2.2, damping=damping, friction=friction).system()


def agrees(system):
    y, zero = PhasePoint(map(jnp.asarray, Y)), jnp.asarray(0.0)
    field = jax.jit(lambda y: jnp.stack(system.field(zero, y)))
    jacobian = np.stack(jax.jacfwd(field)(y), axis=-1)
    accelerations, slopes = accelerations_and_slopes(zero, y, system)
    np.testing.assert_allclose(accelerations, field(y)[2:], rtol=1e-13)
    # measured 4e-16 of the largest
    np.testing.assert_allclose(slopes, jacobian[2:], rtol=1e-12, atol=1e-13)
    assert np.isfinite(jacobian).all() and np.abs(jacobian[2:]).min() > 1e-4
    vectors = np.random.default_rng(3).normal(size=(3, 4))
    both = (*y, *map(jnp.asarray, vectors.ravel()))
    images = np.reshape(tangent_field(zero, both, system)[4:], (3, 4))
    np.testing.assert_allclose(images, vectors @ jacobian.T, rtol=1e-12)


@pytest.mark.parametrize("law", LAWS)
def test_the_jacobian_is_that_of_the_field(law):
    agrees(system_of(LAWS[law]))


@pytest.mark.parametrize("modes", [(1.0, -1.0), (-1.0, 1.0)])
def test_so_it_is_in_slip_under_dry_friction(modes):
    dry = zj.SetValuedCoulomb(0.02, pin_radius=1, load=zj.ConstantLoad(1.0))
    agrees(system_of(dry).in_modes(tuple(map(jnp.asarray, modes))))


def test_the_smoothed_curve_has_the_derivatives_of_its_formula():
    """In the rate and in each of its numbers, twice, forward and in reverse."""
    load = zj.ConstantLoad(1.0)

    def torque(x):
        u, mu_s, mu_k, v_stribeck, v_smooth = x
        law = zj.SmoothCoulomb(
            mu_s, mu_k, pin_radius=0.1, v_stribeck=v_stribeck, v_smooth=v_smooth,
            load=load,
        )  # fmt: skip
        return law.torques((2.0, 2.0)).at((u, 0.0 * u))[0]

    def formula(x):
        u, mu_s, mu_k, v_stribeck, v_smooth = x
        bell = jnp.exp(-((u / v_stribeck) ** 2))
        return 0.1 * (mu_k + (mu_s - mu_k) * bell) * jnp.tanh(u / v_smooth)

    for rate in (0.0, 0.013, -0.04):
        x = jnp.asarray([rate, 0.12, 0.1, 0.05, 0.02])
        assert torque(x) == pytest.approx(float(formula(x)), rel=1e-13)
        for derivative in (jax.grad, jax.jacfwd, jax.hessian):
            ours, theirs = derivative(torque)(x), derivative(formula)(x)
            largest = np.abs(theirs).max()
            assert largest > 0
            # measured 1e-15 of the largest
            np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-12 * largest)


METHODS = {
    "Tsit5": Explicit(),
    "Dopri8": Explicit(dfx.Dopri8()),
    "Vern9": Explicit(*VERN9),  # y1 is none of its stages
    "Calvo7": Explicit(*CALVO7),
}


@pytest.mark.parametrize("method", METHODS)
def test_a_step_in_turns_is_the_step_written_out(method):
    """Alone and in a batch: end, images, error, slopes and integrals."""
    solver = METHODS[method]
    vectors = np.random.default_rng(4).normal(size=(3, 4))
    vectors = tuple(PhasePoint(map(jnp.asarray, v)) for v in vectors)
    t0, t1, y = jnp.asarray(0.0), jnp.asarray(0.3), PhasePoint(map(jnp.asarray, Y))

    def system_at(q):
        return zj.uniform_rods(q, friction=smooth()).system()

    def power(t, y):
        return (y[2] * y[3], y[0] ** 2)

    def in_turns(q):
        return push_along(solver, system_at(q), t0, t1, y, vectors, power)

    def written_out(q):
        system = system_at(q)
        first, end, error, last = push(solver, system, t0, t1, y, vectors)
        *_, integrals, _ = solver.advance(system.field, t0, t1, y, first[0], power)
        whole = [sum(images, tuple(y)) for y, images in (end, last)]
        return whole[0], error[0], whole[1], integrals

    loads = jnp.asarray([1.5, 2.2, 3.0])
    one, other = jax.jit(in_turns), jax.jit(written_out)
    for q in loads:
        for ours, theirs in zip(one(q), other(q), strict=True):
            assert np.abs(theirs).max() > 0
            # measured 4e-15 of the largest, of the error 3e-16 of the state
            np.testing.assert_allclose(ours, theirs, rtol=1e-12, atol=3e-14)
    batch = jax.jit(jax.vmap(in_turns))(loads)
    alone = [one(q) for q in loads]
    together = jax.tree.map(lambda *x: jnp.stack(x), *alone)
    for a, b in zip(jax.tree.leaves(batch), jax.tree.leaves(together), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-14)


def test_an_integrand_of_an_array_keeps_its_lane():
    """Three numbers of three lanes: no shape tells them apart."""
    vectors = (PhasePoint(map(jnp.asarray, (0.0, 1.0, 0.0, 0.0))),)
    y = PhasePoint(map(jnp.asarray, Y))

    def together(t, y):
        return (jnp.stack(y[1:]),)

    def integrals(q):
        system = zj.uniform_rods(q, friction=smooth()).system()
        t0, t1 = 0.0 * q, 0.3 + 0.0 * q
        step = push_along(Explicit(), system, t0, t1, y, vectors, together)
        return step[-1]

    loads = jnp.asarray([1.5, 2.2, 3.0])
    batch = jax.jit(jax.vmap(integrals))(loads)
    alone = jax.tree.map(lambda *x: jnp.stack(x), *map(jax.jit(integrals), loads))
    assert np.ptp(alone[0], axis=0).max() > 1e-4
    np.testing.assert_allclose(batch, alone, rtol=1e-12)  # measured 2e-15


def test_a_tableau_without_an_error_estimate_finds_none():
    """Of four numbers, not of the two that its rows of zeros would leave."""
    below = [[0.5], [0.0, 0.5], [0.0, 0.0, 1.0]]
    classic = dfx.ButcherTableau(
        a_lower=tuple(map(np.asarray, below)),
        b_sol=np.asarray([1 / 6, 1 / 3, 1 / 3, 1 / 6]),
        b_error=np.zeros(4),
        c=np.asarray([0.5, 0.5, 1.0]),
    )
    vectors = (PhasePoint(map(jnp.asarray, (0.0, 1.0, 0.0, 0.0))),)
    y, system = PhasePoint(map(jnp.asarray, Y)), zj.uniform_rods(2.2).system()
    step = push_along(
        Explicit(classic, 4), system, jnp.asarray(0.0), jnp.asarray(0.1), y, vectors
    )
    np.testing.assert_array_equal(step[1], np.zeros(4))


def test_a_step_in_turns_has_the_derivative_of_its_numbers():
    vectors = (PhasePoint(map(jnp.asarray, (0.0, 1.0, 0.0, 0.0))),)
    y = PhasePoint(map(jnp.asarray, Y))

    @jax.jit
    def tip(q):
        system = zj.uniform_rods(q, friction=smooth()).system()
        both, *_ = push_along(Explicit(), system, 0.0 * q, 0.2 + 0.0 * q, y, vectors)
        return jnp.stack(both)

    q, h = jnp.asarray(2.2), 1e-5
    central = (tip(q + h) - tip(q - h)) / (2 * h)
    alone, lanes = jax.jit(jax.jacfwd(tip)), jax.jit(jax.vmap(jax.jacfwd(tip)))
    for slope in (alone(q), lanes(q[None])[0]):
        # measured 2e-11
        np.testing.assert_allclose(slope, central, atol=1e-9)
