"""Two studies in which friction is not known, on small grids, and what they rest on."""

import json
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pytest
from scipy.optimize import brentq

import ziegler_jax as zj
from ziegler_jax.results import ONSETS

pytestmark = pytest.mark.usefixtures("optimised")  # long runs

STUDIES = Path(__file__).parents[1] / "examples" / "studies"


@pytest.fixture(scope="module")
def study():
    """Imports a study by its name."""
    sys.path.insert(0, str(STUDIES))
    yield lambda name: __import__(name)
    sys.path.remove(str(STUDIES))


@pytest.fixture(scope="module")
def distribution(study):
    pytest.importorskip("SALib")
    return study("friction_distribution")


@pytest.fixture(scope="module")
def history(study):
    return study("friction_from_history")


def run(module, folder):
    """The figures of a small run, which leaves its picture and its line."""
    module.main(["--small", "--out", str(folder)])
    plt.close("all")
    name = module.__name__
    assert sorted(p.name for p in folder.iterdir()) == [f"{name}.json", f"{name}.png"]
    return json.loads((folder / f"{name}.json").read_text())


def load_of(c, kappa=1.0):
    """q_cr of uniform rods by eigenvalues alone: where one leaves the left half."""

    def abscissa(q):
        mass, damping = [[4 / 3, 1 / 2], [1 / 2, 1 / 3]], [[2 * c, -c], [-c, c]]
        stiffness = np.array([[kappa + 1 - q, q - 1], [-1, 1]])
        right = -np.linalg.solve(mass, np.hstack([stiffness, damping]))
        matrix = np.vstack([np.eye(2, 4, 2), right])
        return np.linalg.eigvals(matrix).real.max()

    return brentq(abscissa, 0.5, 2.4, xtol=1e-12)


def test_the_variance_under_random_damping_is_that_of_eigenvalues(distribution):
    low, high = 0.05, 0.4
    x, weight = np.polynomial.legendre.leggauss(6)  # exact: q_cr^2 is of degree 4
    q = np.array([load_of(low + (high - low) * (1 + t) / 2) for t in x])
    mean = weight @ q / 2
    exact = weight @ (q - mean) ** 2 / 2
    sampled, closed_form = distribution.viscous_variance(4096, low, high)
    np.testing.assert_allclose(closed_form, exact, rtol=1e-9)
    np.testing.assert_allclose(sampled, closed_form, rtol=1e-3)


def test_indices_of_a_sum_are_its_parts(distribution):
    """Springs and damping add up: q_cr = g(kappa) + 6 c^2 / 5."""
    bounds = [[0.7, 1.3], [0.2, 0.6]]

    def point(kappa, c):
        damping = zj.Viscous(c, c)
        return zj.critical_load(zj.uniform_rods(kappa=kappa, damping=damping))

    problem, points = distribution.saltelli(["kappa", "c"], 512, bounds=bounds)
    drawn = distribution.samples(points, ["kappa", "c"])
    found, _ = distribution.indices(problem, zj.sweep(point, **drawn).q_cr.values)
    x, weight = np.polynomial.legendre.leggauss(12)
    parts = []
    for row, (low, high) in enumerate(bounds):
        at = low + (high - low) * (1 + x) / 2
        q = np.array([load_of(*((0.3, t) if row == 0 else (t, 1.0))) for t in at])
        parts.append(weight @ (q - weight @ q / 2) ** 2 / 2)
    share = np.array(parts) / sum(parts)
    np.testing.assert_allclose(found["S1"], share, atol=0.02)
    np.testing.assert_allclose(found["ST"], share, atol=0.02)


def damped_load(how):
    """In place of the onset load, which compiles for long: with little damping."""

    def load(z):
        damping = zj.Viscous(*(1e-3 * jnp.exp(0.2 * x) for x in z[:2]))
        return zj.critical_load(zj.uniform_rods(damping=damping)).q_cr

    def point(z1, z2, z3):
        value, slopes = jax.value_and_grad(load)(jnp.stack([z1, z2, z3]))
        slopes = zj.Variable(slopes, "slopes", dims=("z",))
        outcome = zj.Variable(jnp.int8(zj.CODE.found), "outcome", codes=ONSETS)
        return {"onset_load": value, "slopes": slopes, "outcome": outcome}

    return point


def test_a_small_run_of_the_distribution_ends_in_its_figures(
    distribution, tmp_path, monkeypatch
):
    """Little damping counts by its ratio alone: both joints have half of the variance.

    Rest is certain at q = 0.5, flutter at q = 3 with little friction: without it rest
    is unstable from 2.5417 on.
    """
    monkeypatch.setattr(distribution, "onset_of", damped_load)
    line = run(distribution, tmp_path)
    assert line["lanes"] == 4 * 3 * 4 and line["onsets"] == 2 * 5 + 1
    # c^2 is neglected, measured below the four digits of the line
    np.testing.assert_allclose(line["shares_by_derivatives"], [0.5, 0.5, 0], atol=1e-3)
    np.testing.assert_allclose(line["onset_at_mean_friction"], 74 / 45, rtol=1e-3)
    ds = distribution.probability([0.5, 3.0], [0.1], 8)
    np.testing.assert_array_equal(ds.probability.values.ravel(), [0, 1])


def test_the_onset_load_of_the_study_can_be_traced_with_its_derivatives(distribution):
    """Its values: `tests/analysis/test_thresholds.py`."""
    point = distribution.onset_of(distribution.COARSE)
    shapes = jax.eval_shape(lambda z: point(*z)["slopes"].value, jnp.zeros(3))
    assert shapes.shape == (3,)


def test_derivatives_of_a_history_are_its_differences(history):
    """Through 27 events, at two places; measured 2e-9 of the largest of each number."""
    nearby = history.TRUE * np.array([1.03, 0.97, 1.0, 1.05, 1.0])
    for at in (history.TRUE, nearby):
        slopes, motion = history.measured(at)
        assert motion.events.count > 25
        steps = 1e-5 * np.diag(at)
        ends = [[history.measured(at + s * d)[1].phi for s in (1, -1)] for d in steps]
        differences = np.stack([(up - down) / 2e-5 for up, down in ends], axis=-1)
        relative = np.asarray(slopes) * at
        for i in range(5):
            largest = np.abs(relative[..., i]).max()
            error = np.abs(relative - differences)[..., i].max()
            assert error < 2e-8 * largest


def test_coefficients_and_radius_cannot_be_told_apart(history):
    """Only their products can: one eigenvalue is zero, measured 1e-16 of the largest.

    The next one is 4e-5: all else can be told.
    """
    for at in (history.TRUE, history.TRUE * np.array([1, 1, 1, 2, 0.5])):
        matrix = history.fisher(history.measured(at)[0], at, 0.005)
        values, vectors = np.linalg.eigh(matrix)
        assert abs(values[0]) < 1e-14 * values[-1] and values[1] > 1e-6 * values[-1]
        along = np.array([1, 1, -1, 0, 0]) / np.sqrt(3)
        np.testing.assert_allclose(abs(vectors[:, 0] @ along), 1, rtol=1e-10)


def test_fits_spread_as_far_as_the_bound_and_have_no_bias(history, tmp_path):
    """240 of them: a spread's own deviation is 4.6 %, a mean's 6.5 % of the bound.

    Measured 1.00 to 1.04 and 0.017 of the bound; the 2000 of the kept line 0.98 to 1.03
    and 0.014.
    """
    line = run(history, tmp_path)
    spread, bias = (np.array(line[f"{x}_over_bound"]) for x in ("spread", "bias"))
    assert np.all(np.abs(spread - 1) < 0.15) and np.all(np.abs(bias) < 0.2)
    # measured 0.4 %
    np.testing.assert_allclose(line["standard_error_over_bound"], 1, rtol=0.1)


def test_the_kept_line_holds_what_the_study_claims():
    """Of the two kept results; not computed anew."""
    line = json.loads((STUDIES / "friction_from_history.json").read_text())
    assert line["histories"] == 2000
    assert np.all(np.abs(np.array(line["spread_over_bound"]) - 1) < 0.1)
    assert np.all(np.abs(line["bias_over_bound"]) < 0.1)
