"""`is_stiff`: the rule, where it can be asked, and what a sweep gains by it."""

import jax
import numpy as np
import pytest

import ziegler_jax as zj
from ziegler_jax import CODE

KICK = zj.State(omega=(0.0, 0.3))
AXES = {"v_smooth": [1e-6, 1e-4, 1e-2, 1e-1], "mu": [0.0, 0.1, 0.4]}


def column(v_smooth, mu=0.2, q=2.0):
    friction = zj.SmoothCoulomb(
        mu, pin_radius=0.1, v_smooth=v_smooth, load=zj.ConstantLoad(1.0)
    )
    return zj.uniform_rods(q, friction=friction)


def by_hand(v_smooth, mu, rtol):
    """The rule with the column's matrices, linearised by `linearise`."""
    tangent = zj.tangent_column(column(v_smooth, mu=mu))
    mass, damping, stiffness = zj.linearise(tangent)
    decay = np.trace(np.linalg.solve(mass, damping))
    rate = np.linalg.norm(np.linalg.solve(mass, stiffness)) ** 0.5
    return decay * rtol**0.2 / rate


@pytest.mark.parametrize("rtol", [1e-4, 1e-10])
def test_the_rule_is_that_of_the_jacobian_at_rest(rtol):
    border = by_hand(1.0, 1.0, rtol)  # v_smooth at mu = 1
    assert zj.is_stiff(column(0.99 * border, 1.0), rtol)
    assert not zj.is_stiff(column(1.01 * border, 1.0), rtol)


def test_uniform_rods_decay_at_108_sevenths_torques_a_smoothing_rate():
    """tr(M^-1 [[2, -1], [-1, 1]]) = (2 d + 2 b + a) / (a d - b^2) = 3 / (7 / 36)."""
    mass, damping, _ = zj.linearise(zj.tangent_column(column(1.0, mu=1.0)))
    decay = np.trace(np.linalg.solve(mass, damping))
    assert abs(decay / 0.1 - 108 / 7) < 1e-12  # measured 2e-15


def test_known_traced_and_batched_numbers_give_one_answer():
    """Known ones do so in Python, even inside a trace."""
    v, mu = (m.ravel() for m in np.meshgrid(*AXES.values(), indexing="ij"))
    known = np.array(
        [bool(zj.is_stiff(column(*one), 1e-6)) for one in zip(v, mu, strict=True)]
    )
    expected = [by_hand(*one, 1e-6) > 1 for one in zip(v, mu, strict=True)]
    np.testing.assert_array_equal(known, expected)
    assert known.any() and not known.all()

    def ask(v, mu, rtol=1e-6):
        return zj.is_stiff(column(v, mu), rtol)

    np.testing.assert_array_equal(jax.jit(jax.vmap(ask))(v, mu), known)
    tolerances = np.full(v.size, 1e-6)
    np.testing.assert_array_equal(jax.vmap(ask)(v, mu, tolerances), known)

    pulled = zj.SmoothCoulomb(0.2, pin_radius=0.1, v_smooth=1e-6)  # by the load itself

    @jax.jit
    def chosen_in_python(x):
        both = column(1e-6), zj.uniform_rods(2.0, friction=pulled)
        return x if all(zj.is_stiff(c, 1e-6) for c in both) else -x

    assert chosen_in_python(1.0) == 1.0


def test_set_valued_friction_is_not_stiff():
    def held(mu):
        friction = zj.SetValuedCoulomb(mu, pin_radius=0.1)
        damping = zj.Viscous(1e6, 1e6)
        return zj.uniform_rods(2.0, friction=friction, damping=damping)

    def smoothed(mu):
        return zj.uniform_rods(2.0, damping=zj.Viscous(1e6, 1e6))

    for make, stiff in ((held, False), (smoothed, True)):
        assert bool(zj.is_stiff(make(0.3), 1e-6)) == stiff
        assert bool(jax.jit(lambda mu, m=make: zj.is_stiff(m(mu), 1e-6))(0.3)) == stiff


def test_32_bits_give_the_answer_of_64():
    """At a margin that 32 bits do not tell from none."""
    border = by_hand(1.0, 1.0, 1e-6)
    with jax.enable_x64(False):
        assert zj.is_stiff(column((1 - 1e-12) * border, 1.0), 1e-6)
        assert not zj.is_stiff(column((1 + 1e-12) * border, 1.0), 1e-6)


def test_numbers_that_are_nan_are_not_stiff():
    assert not jax.jit(lambda v: zj.is_stiff(column(v), 1e-6))(np.nan)


def test_wrong_arguments_are_named(refuses):
    refuses(lambda: zj.is_stiff(3.0, 1e-6), "`column`", "`Column`", "3.0")
    refuses(lambda: zj.is_stiff(column(1e-3), 0.0), "`rtol`", "positive", "0")


def settled(solver):
    def point(v_smooth, mu):
        return zj.settle(
            column(v_smooth, mu),
            KICK,
            windows=zj.Windows(transient=5.0, length=5.0, max_windows=1),
            method=zj.Method(solver=solver, max_steps=2000),
            certify=False,
        )

    return point


def test_two_sweeps_by_the_mask_fill_each_other_up_and_take_fewer_steps():
    def sweep(point, where=None):
        return zj.sweep(point, where=where, progress=False, **AXES)

    with_explicit, with_rosenbrock = settled(zj.Explicit()), settled(zj.Rosenbrock())
    asked = sweep(lambda v_smooth, mu: zj.is_stiff(column(v_smooth, mu), 1e-6))
    stiff = asked["value"] == 1
    assert stiff.any() and not stiff.all()
    thin = sweep(with_rosenbrock, lambda **_: stiff.values)
    wide = sweep(with_explicit, lambda **_: ~stiff.values)
    for part, mine in ((thin, stiff), (wide, ~stiff)):
        np.testing.assert_array_equal(part.outcome != CODE.not_computed, mine)
    both = thin.where(stiff, wide)
    assert both.outcome.attrs == thin.outcome.attrs
    assert (both.outcome >= CODE.unsettled).all()
    assert np.isfinite(both.rod_amplitude).all()
    explicit, rosenbrock = sweep(with_explicit), sweep(with_rosenbrock)
    assert (explicit.outcome == CODE.budget_spent).any()
    # measured 1680 against 7536 (three lanes cut off at 2000) and 1770
    assert both.steps.sum() < 0.3 * explicit.steps.sum()
    assert both.steps.sum() < rosenbrock.steps.sum()
    # a lane is that of the sweep of its method alone, to the last bit
    for part, alone, mine in ((thin, rosenbrock, stiff), (wide, explicit, ~stiff)):
        for name in ("steps", "rod_amplitude"):
            assert (part[name] == alone[name]).where(mine, True).all(), name
