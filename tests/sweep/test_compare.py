"""The same points by other methods and laws: differences, and what they are worth."""

import diffrax as dfx
import jax
import jax.numpy as jnp
import matplotlib
import numpy as np
import pytest

import ziegler_jax as zj
from ziegler_jax.results import REGIMES

matplotlib.use("agg")

TOL = 1e-4
BOSH3 = zj.Explicit(dfx.Bosh3.tableau, 3)  # three stages: quick to compile
Q = np.linspace(1.2, 1.5, 24)
FINE = zj.Method(zj.Explicit(), rtol=1e-12)
USUAL = zj.Method(BOSH3, rtol=TOL)


def end(q, method=USUAL):
    """Where a damped column is at t = 20."""
    column = zj.uniform_rods(q, damping=zj.Viscous(0.05, 0.05))
    settled = zj.settle(
        column,
        zj.State(omega=(0.0, 0.2)),
        windows=zj.Windows(transient=0.0, length=20.0, max_windows=1),
        method=method,
        certify=False,
    )
    return {"phi1": settled.final.phi[0], "steps": settled.steps}


@pytest.fixture(scope="module")
def error():
    """Of `end`, by another method, at another tolerance and outside a sweep."""

    def one(q):
        column = zj.uniform_rods(q, damping=zj.Viscous(0.05, 0.05))
        start = zj.State(omega=(0.0, 0.2))
        motion = zj.trajectory(
            column, start, np.array([0, 20.0]), method=zj.Method(rtol=1e-12, atol=1e-12)
        )
        return motion.phi[-1, 0]

    exact = np.asarray(jax.jit(jax.vmap(one))(Q))
    return zj.sweep(end, q=Q, progress=False).phi1.values - exact


@pytest.fixture(scope="module")
def compared():
    variants = {"usual": {}, "finer": {"method": zj.Method(BOSH3, rtol=TOL / 1000)}}
    reference = {"method": FINE}
    return zj.compare(end, variants, reference=reference, q=Q, progress=False)


def test_a_difference_from_a_finer_run_is_the_error_of_each_point(compared, error):
    found = compared.phi1_difference.sel(variant="usual")
    # the reference's own error; measured 2.4e-10 of errors of 3e-4 to 9e-4
    np.testing.assert_allclose(found, error, rtol=3e-9)
    assert (compared.phi1_difference.sel(variant="reference") == 0).all()


def test_quantiles_are_those_of_the_sizes(compared, error):
    found = compared.phi1_difference_quantiles.sel(variant="usual")
    expected = np.quantile(np.abs(error), [0.5, 0.95, 1.0])
    np.testing.assert_allclose(found, expected, rtol=3e-9)  # measured 2.1e-10


def test_errors_fall_with_the_tolerance_and_steps_rise(compared):
    sizes = compared.phi1_difference_quantiles
    usual, finer = sizes.sel(variant="usual"), sizes.sel(variant="finer")
    assert (finer < 0.01 * usual).all()  # measured 9.0e-4 to 1.05e-3
    steps = compared.steps
    assert (steps.sel(variant="finer") > steps.sel(variant="usual")).all()
    assert "steps_difference" not in compared
    assert (compared.seconds_a_point > 0).all()


def test_a_variant_without_arguments_is_the_sweep_of_the_point(compared):
    plain = zj.sweep(end, q=Q, progress=False)
    own = compared.sel(variant="usual")
    assert np.array_equal(plain.phi1, own.phi1)
    assert np.array_equal(plain.steps, own.steps)


def test_a_sample_is_of_the_chosen_points_and_the_same_each_time():
    def run():
        return zj.compare(
            lambda x, y, shift=0.0: {"sum": x + y + shift}, {"b": {"shift": 0.5}},
            where=lambda x, y: x > y, sample=7, x=np.arange(8.0), y=np.arange(5.0),
            progress=False,
        )  # fmt: skip

    ds, again = run(), run()
    known = ds.sum_difference.sel(variant="b").notnull()
    assert int(known.sum()) == 7 and ((ds.x > ds.y) | ~known).all()
    assert (ds.sum_difference.sel(variant="b").values[known.values] == 0.5).all()
    assert "changed" not in ds  # of numbers alone
    assert again["sum"].equals(ds["sum"])


def test_a_changed_outcome_is_marked_where_it_is():
    """A coarse method's peak lies beyond an edge, a fine one's does not."""
    windows = zj.Windows(transient=0.0, length=20.0, max_windows=1)

    def point(q, method):
        column, start = zj.uniform_rods(q), zj.State(omega=(0.0, 0.3))
        motion = zj.settle(column, start, windows=windows, certify=False, method=method)
        # at 1e-3 the peaks are 0.1695 and 0.1802, else 0.1543 and 0.1572
        beyond = jnp.where(motion.joint_amplitude[1] > 0.175, 1, 2).astype(jnp.int8)
        return {"side": zj.Variable(beyond, "side", codes=REGIMES)}

    def by(rtol):
        return {"method": zj.Method(rtol=rtol, atol=rtol)}

    ds = zj.compare(
        point, {"coarse": by(1e-3), "fine": by(1e-9)}, reference=by(1e-10),
        q=[2.0, 2.1], progress=False,
    )  # fmt: skip
    assert ds.changed.values.tolist() == [[0, 0], [0, 1], [0, 0]]
    assert ds.changed_share.values.tolist() == [0, 0.5, 0]
    assert "side_difference" not in ds


def settled_by(q, tau, kick, v_smooth, smooth=False):
    """A column under the set-valued law, or the same law smoothed."""
    friction = zj.SetValuedCoulomb(tau, pin_radius=1.0, load=zj.ConstantLoad(1.0))
    column = zj.uniform_rods(
        q, friction=friction.smoothed(v_smooth) if smooth else friction
    )
    return zj.settle(
        column, zj.State(omega=(0.0, kick)), windows=zj.Windows(transient=400.0),
        method=zj.Method(rtol=1e-8, atol=1e-8), certify=False,
    )  # fmt: skip


def laws(i, smooth=False):
    """Three smoothings of a cycle; a kick that only the smoothed law lets grow."""
    v_smooth = jnp.asarray([0.1, 0.03, 0.01, 0.05])[i.astype(int)]
    cycle = i < 3
    q, tau = jnp.where(cycle, 2.6, 1.8), jnp.where(cycle, 0.026, 0.01)
    return settled_by(q, tau, jnp.where(cycle, 0.2, 1e-6), v_smooth, smooth)


def test_smoothing_errs_in_amplitude_and_in_verdict():
    variants = {"smoothed": {"smooth": True}}
    ds = zj.compare(laws, variants, i=np.arange(4.0), progress=False)
    smoothed = ds.sel(variant="smoothed")
    knee = smoothed.joint_amplitude_difference.sel(joint=2).values[:3]
    # by another code, to five digits: smoothed, and set-valued
    known = np.array([0.63443, 0.63214, 0.63133]) - 0.63105
    np.testing.assert_allclose(knee, known, atol=2e-5)
    assert smoothed.rod_amplitude_difference.sel(rod=1).values[:3].max() < 0
    assert smoothed.changed.values.tolist() == [0.0, 0.0, 0.0, 1.0]
    assert ds.outcome.sel(variant="reference").values[3] == zj.CODE.stuck


def other(q, method=None):
    return {"phi2": q} if method is None else {"phi1": q}


@pytest.mark.parametrize(
    "options, parts",
    [
        ({"variants": {}}, ("`variants`", "map names")),
        ({"variants": {"reference": {}}}, ("`variants`", "`reference`")),
        ({"variants": {"a": FINE}}, ("mapping of arguments", "'a'")),
        ({"variants": {"a": {"solver": 1}}}, ("Variant `a`", "solver")),
        ({"variants": {"a": {"q": 1.0}}}, ("Variant `a`", "axes", "`q`")),
        ({"reference": {"q": 1.0}}, ("Variant `reference`", "`q`")),
        ({"sample": 0}, ("`sample`", "at least 1")),
        ({"repeats": 1.5}, ("`repeats`", "at least 1")),
        ({"point": 3}, ("`point`", "function", "3")),
        ({"point": other, "variants": {"a": {"method": 1}}}, ("`a`", "phi2", "phi1")),
    ],
)
def test_misuse_is_named(refuses, options, parts):
    call = {"point": end, "variants": {"a": {}}, **options}
    point, variants = call.pop("point"), call.pop("variants")
    refuses(
        lambda: zj.compare(point, variants, q=Q[:2], progress=False, **call), *parts
    )
