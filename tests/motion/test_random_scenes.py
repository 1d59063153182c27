"""Whole scenes and starts at random: every lane ends, and what it says is true.

The default run draws a few hundred lanes. `pytest -n 0 --hypothesis-profile=full
tests/motion/test_random_scenes.py` draws 10 000 for each test and method. That found
amplitudes of infinity and NaN where an angle hardly moves; see `test_observers`.
"""

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import ziegler_jax as zj
from ziegler_jax import CODE

pytestmark = pytest.mark.usefixtures("optimised")  # bits, as users get them

LANES, MAX_STEPS = 32, 20_000
SOLVERS = {"explicit": zj.Explicit(), "stiff": zj.Rosenbrock()}


def decades(low, high):
    """10^x: every order of magnitude alike."""
    return st.floats(low, high).map(lambda x: 10.0**x)


def sometimes(other, strategy):
    return st.one_of(st.just(other), strategy, strategy)


ANGLE = sometimes(0.0, st.floats(-3.0, 3.0))
RATE = sometimes(0.0, st.floats(-2.0, 2.0))
SCENES = st.fixed_dictionaries(
    {
        "q": sometimes(0.0, st.floats(-1.0, 12.0)),
        "m2": decades(-2, 2),
        "kappa": sometimes(0.0, decades(-3, 2)),
        "eta": sometimes(1.0, st.floats(-1.0, 2.0)),
        "c": sometimes(0.0, decades(-6, 2)),
        "mu_s": sometimes(0.0, decades(-6, 1)),
        "drop": st.floats(0.0, 1.1),  # mu_k / mu_s; above 1 it breaks the rule
        "v_smooth": decades(-7, 0),
        "v_stribeck": decades(-3, 1),
        "phi": st.tuples(ANGLE, ANGLE),
        "omega": st.tuples(RATE, RATE),
    }
)


def settled(scene, tol, solver, span=6.0):
    mu_s = scene["mu_s"]
    friction = zj.SmoothCoulomb(
        mu_s,
        mu_s * scene["drop"],
        pin_radius=1.0,
        v_stribeck=scene["v_stribeck"],
        v_smooth=scene["v_smooth"],
        load=zj.ConstantLoad(1.0),
    )
    column = zj.uniform_rods(
        scene["q"],
        m2=scene["m2"],
        kappa=scene["kappa"],
        follower=scene["eta"],
        damping=zj.Viscous(scene["c"], scene["c"]),
        friction=friction,
    )
    return zj.settle(
        column,
        zj.State(scene["phi"], scene["omega"]),
        windows=zj.Windows(transient=0.0, length=span, max_windows=1, escape=1e3),
        method=zj.Method(rtol=tol, atol=tol, max_steps=MAX_STEPS, solver=solver),
        observers=(zj.EnergyBalance(),),
        certify=False,
    )


@pytest.fixture(scope="module", params=SOLVERS)
def run(request):
    """Lanes at one tolerance, which is an argument: one program a method."""
    solver = SOLVERS[request.param]
    lanes = jax.vmap(lambda scene, tol: settled(scene, tol, solver), in_axes=(0, None))
    return jax.jit(lanes)


def stacked(scenes):
    return jax.tree.map(lambda *x: np.array(x, float), *scenes)


def same(a, b):
    for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        np.testing.assert_array_equal(x, y)


def balances(batch, found, tol):
    """The energy that each step misses is bounded by its tolerance."""
    good = np.asarray(found.outcome) >= CODE.unsettled
    numbers = np.concatenate([found.rod_amplitude, found.joint_amplitude], -1)
    energies = np.asarray(found.energy_imbalance) * 6.0
    inertia = 4 / 3 + 2 * batch["m2"] + batch["kappa"]
    top = 1 + np.abs(np.nan_to_num(numbers)).max(-1)
    scale = inertia * top**2 * np.asarray(found.steps)
    assert (np.abs(energies[good]) <= 50 * tol * scale[good]).all()


@given(scenes=st.lists(SCENES, min_size=LANES, max_size=LANES))
def test_every_lane_ends_and_tells_the_truth(run, scenes):
    batch = stacked(scenes)
    found = run(batch, 1e-6)
    outcome = np.asarray(found.outcome)
    assert (outcome != CODE.not_computed).all()
    broken = batch["drop"] * batch["mu_s"] > batch["mu_s"]
    np.testing.assert_array_equal(outcome == CODE.invalid, broken)
    assert (np.asarray(found.steps) <= MAX_STEPS).all()

    # finite results, or NaN and an outcome that says why
    failed = outcome < CODE.unsettled
    numbers = np.concatenate([found.rod_amplitude, found.joint_amplitude], -1)
    np.testing.assert_array_equal(np.isnan(numbers).any(-1), failed)
    np.testing.assert_array_equal(np.isnan(numbers).all(-1), failed)

    balances(batch, found, 1e-6)

    # other batch mates in another order change nothing, to the last bit
    order = np.random.default_rng(0).permutation(LANES)
    order[:4] = order[4]
    mixed = run(jax.tree.map(lambda x: x[order], batch), 1e-6)
    same(mixed, jax.tree.map(lambda x: x[order], found))


@given(scenes=st.lists(SCENES, min_size=LANES, max_size=LANES))
def test_errors_fall_with_the_tolerance(run, scenes):
    batch = stacked(scenes)
    ends, ended = [], True
    for tol in (1e-4, 1e-6, 1e-8, 1e-10):
        found = run(batch, tol)
        balances(batch, found, tol)
        ends.append(np.stack(found.final.y, -1))
        ended = ended & (np.asarray(found.outcome) >= CODE.unsettled)
    errors = [np.abs(end - ends[-1]).max(-1)[ended] for end in ends[:-1]]
    # rounding is no error of a method
    means = [np.log10(e + 1e-12).mean() for e in errors if e.size]
    for coarse, fine in zip(means[:-1], means[1:], strict=True):
        # over the lanes: one may be lucky at a coarse tolerance
        assert fine <= coarse + 0.1
    # measured: from 2.5 decades on, of the four that the tolerance falls by
    assert not means or means[0] < -7 or means[0] - means[-1] > 1.5
