"""Every motion ends: windows lost in rounding, and the steps of a whole search."""

import jax
import numpy as np
import pytest

import ziegler_jax as zj
from ziegler_jax import CODE
from ziegler_jax.analysis import periodic_orbit

KICK = zj.State(omega=(0.0, 0.2))
UNIT = float(np.spacing(1100.0))  # of rounding at the transient's end
QUICK = zj.Method(rtol=1e-4, atol=1e-4)


def rubbing(q=2.0):
    friction = zj.SmoothCoulomb(0.1, pin_radius=0.1, v_smooth=0.1)
    return zj.uniform_rods(q=q, friction=friction)


def sliding(q=2.6):
    law = zj.SetValuedCoulomb(0.026, pin_radius=1.0, load=zj.ConstantLoad(1.0))
    return zj.uniform_rods(q, friction=law)


@pytest.fixture(scope="module")
def near():
    """A state close to the cycle of `sliding`."""
    return jax.jit(
        lambda: zj.settle(sliding(), zj.State(omega=(0.0, 0.3)), certify=False).final
    )()


@jax.jit
def search_by(method, start):
    """One program for all budgets: they come in with the method."""
    return zj.periodic_orbit(sliding(), start, method=method)


def search(start, budget):
    """A cycle, from a start and within a budget of steps."""
    return search_by(zj.Method(max_steps=budget), start)


@pytest.fixture(scope="module")
def cycle(near):
    return search(near, 1_000_000)


def test_a_sweep_whose_windows_are_lost_in_rounding_ends():
    def point(length, q):
        windows = zj.Windows(transient=5.0, length=length, max_windows=4)
        return zj.settle(rubbing(q), KICK, windows=windows, method=QUICK, certify=False)

    found = zj.sweep(point, length=[1e-300, 1e-15, 1.0], q=[2.0], progress=False)
    assert found.outcome.values[:2].ravel().tolist() == [CODE.invalid] * 2
    assert found.outcome.values[2] > CODE.escaped
    assert (found.steps.values[:2] == 0).all()


@pytest.mark.parametrize(
    "call",
    [
        lambda x: zj.settle(
            rubbing(), KICK, windows=zj.Windows(length=x), certify=False
        ),
        lambda x: zj.lyapunov_exponents(rubbing(), KICK, spans=zj.Spans(length=x)),
    ],
    ids=["settle", "lyapunov_exponents"],
)
def test_a_window_that_rounding_would_lose_is_refused(refuses, call):
    refuses(lambda: call(1e-300), "`length`", "1e-300", "rounding", "longer")
    assert jax.jit(lambda x: call(x).outcome)(1e-300) == CODE.invalid


def test_windows_that_rounding_lengthens_end_unsettled():
    """83 units of rounding each: the end comes before the last window."""

    @jax.jit
    def point(length):
        windows = zj.Windows(1100.0, length, max_windows=400, agreement=1e-30)
        return zj.settle(
            zj.uniform_rods(1.0), KICK, windows=windows, method=QUICK, certify=False
        )

    found = point(83 * UNIT)
    assert int(found.outcome) == CODE.unsettled
    # measured 399
    assert 390 <= int(found.windows) <= 400


# The steps of a search ----------------------------------------------------------------


def test_a_search_counts_the_steps_of_all_its_motions(near, cycle):
    whole = cycle
    assert int(whole.outcome) == CODE.found
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(periodic_orbit, "MOST_TRIES", 1)
        once = jax.jit(lambda y: zj.periodic_orbit(sliding(), y))(near)
    assert int(whole.iterations) > 1
    # the first return and one period; each further period takes about as many steps
    assert int(whole.steps) > int(once.steps) > 0
    # what is enough is enough, to the step; and one less is not
    enough = int(whole.steps) + 1
    same = search(near, enough)
    assert int(same.outcome) == CODE.found
    np.testing.assert_array_equal(same.period, whole.period)
    spent = search(near, enough - 2)
    assert int(spent.outcome) == CODE.not_integrated
    assert int(spent.steps) == enough - 2 and np.isnan(spent.period)


@jax.jit
def far_off(method, period):
    """From a guess in which each shot alone takes 10 000 steps."""
    start = zj.State((0.0, 1.5), (2.0, -3.0))
    return zj.periodic_orbit(sliding(), start, period=period, method=method)


@pytest.mark.parametrize("budget", [1, 3000])
def test_a_search_of_many_long_motions_ends_within_its_budget(budget):
    found = far_off(zj.Method(max_steps=budget), 500.0)
    assert int(found.outcome) == CODE.not_integrated
    assert int(found.steps) == budget


def test_a_first_return_spends_from_the_same_budget():
    found = search(KICK, 20)
    assert int(found.outcome) == CODE.not_integrated
    assert int(found.steps) == 20


def test_a_branch_ends_within_its_budget(cycle):
    @jax.jit
    def branch_by(method):
        arc = zj.Arc(step=0.05, points=5)
        return zj.continue_cycle(sliding, cycle, 2.6, arc=arc, method=method)

    def branch(budget):
        return branch_by(zj.Method(max_steps=budget))

    whole = branch(1_000_000)
    assert int(whole.outcome) == CODE.found and int(whole.count) == 5
    half = int(whole.steps) // 2
    part = branch(half)
    assert int(part.outcome) == CODE.not_integrated
    assert 0 < int(part.count) < 5 and int(part.steps) <= half
    fine = {"rtol": 1e-9, "atol": 1e-9, "max_steps": half}
    fold = zj.bifurcation(
        sliding, "fold", cycle, 2.6, arc=zj.Arc(step=0.05), method=zj.Method(**fine)
    )
    assert int(fold.outcome) == CODE.not_integrated
    assert int(fold.steps) <= half and np.isnan(fold.parameter)
    named = {**fine, "step": 0.05, "bounds": "-inf to inf", "points": 200}
    assert named.items() <= fold.attributes().items()


def test_results_of_searches_name_their_options(near):
    method = zj.Method(rtol=1e-8, atol=1e-10, max_steps=5000)

    def point(q):
        return zj.periodic_orbit(sliding(q), near, method=method)

    found = zj.sweep(point, q=[2.6], progress=False)
    assert found.attrs["rtol"] == 1e-8 and found.attrs["atol"] == 1e-10
    assert found.attrs["solver"] == "Tsit5" and found.attrs["max_steps"] == 5000
    assert found.steps.item() > 0

    load = zj.sweep(lambda q: zj.critical_load(zj.uniform_rods(q)), q=[0.0])
    assert load.attrs["kind"] == "flutter"
    few = zj.Method(max_steps=9)
    result = jax.eval_shape(lambda: zj.lyapunov_exponents(sliding(), KICK, method=few))
    assert result.attributes()["max_steps"] == 9
