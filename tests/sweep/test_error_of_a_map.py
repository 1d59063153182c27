"""What a map says of its own error, and the options that are set from outside."""

import diffrax as dfx
import jax
import jax.numpy as jnp
import matplotlib
import numpy as np
import pytest

import ziegler_jax as zj
from ziegler_jax.context import Context, current_context, within

pytestmark = pytest.mark.usefixtures("optimised")  # bits, as users get them

matplotlib.use("agg")

TOL = 1e-4
BOSH3 = zj.Explicit(dfx.Bosh3.tableau, 3)  # three stages: quick to compile
SOLVERS = {"Tsit5": zj.Explicit(), "Bosh3": BOSH3}
Q = np.linspace(1.2, 1.5, 24)


def end(q, tol=TOL, atol=TOL):
    """Where a damped column is at t = 20."""
    column = zj.uniform_rods(q, damping=zj.Viscous(0.05, 0.05))
    settled = zj.settle(
        column,
        zj.State(omega=(0.0, 0.2)),
        windows=zj.Windows(transient=0.0, length=20.0, max_windows=1),
        method=zj.Method(rtol=tol, atol=atol, solver=BOSH3),
        certify=False,
    )
    return {"phi1": settled.final.phi[0], "steps": settled.steps}


@pytest.fixture(scope="module")
def exact():
    """By another method, at another tolerance and outside a sweep."""

    def one(q):
        column = zj.uniform_rods(q, damping=zj.Viscous(0.05, 0.05))
        start = zj.State(omega=(0.0, 0.2))
        motion = zj.trajectory(
            column, start, np.array([0, 20.0]), method=zj.Method(rtol=1e-12, atol=1e-12)
        )
        return motion.phi[-1, 0]

    return np.asarray(jax.jit(jax.vmap(one))(Q))


@pytest.fixture(scope="module")
def audited():
    return zj.sweep(end, q=Q, audit=0.5, progress=False)


def test_the_audit_is_the_error(audited, exact):
    """At a hundred times finer tolerance the error is gone, and what is left is it."""
    error = np.abs(audited.phi1.values - exact)
    attrs = audited.phi1.attrs
    assert audited.attrs["audit_points"] == 12
    assert attrs["audit_quantiles"] == [0.5, 0.95, 1.0]
    found = attrs["audit_differences"]
    # a sample of the points, and the finer run's own error: measured to 15 %
    assert found[0] == pytest.approx(np.median(error), rel=0.5)
    assert error.min() < found[0] <= found[1] <= found[2] < 1.1 * error.max()


def test_costs_and_codes_are_not_audited(audited):
    assert "audit_differences" not in audited.steps.attrs
    whole = zj.sweep(lambda q: zj.regime(zj.uniform_rods(q)), q=Q, audit=1.0)
    assert whole.attrs["audit_changed_outcomes"] == 0.0


def test_an_audit_says_where_an_outcome_changed():
    """A coarse method's peak lies beyond an edge, a fine one's does not."""
    windows = zj.Windows(transient=0.0, length=20.0, max_windows=1)

    def point(q, rtol):
        column, start = zj.uniform_rods(q), zj.State(omega=(0.0, 0.3))
        motion = zj.settle(
            column, start, windows=windows, certify=False,
            method=zj.Method(rtol=rtol, atol=rtol),
        )  # fmt: skip
        # at 1e-3 the peaks are 0.1695 and 0.1802, else 0.1543 and 0.1572
        beyond = jnp.where(motion.joint_amplitude[1] > 0.175, 1, 2).astype(jnp.int8)
        return {"side": zj.Variable(beyond, "side", codes=zj.REGIME)}

    ds = zj.sweep(point, q=[2.0, 2.1], rtol=[1e-3, 1e-9], audit=1.0, progress=False)
    assert ds.attrs["audit_changed_at"] == ["q = 2.1, rtol = 0.001"]
    assert ds.attrs["audit_changed_outcomes"] == 0.25


def test_an_audit_changes_no_result(audited):
    plain = zj.sweep(end, q=Q, progress=False)
    assert np.array_equal(plain.phi1, audited.phi1)
    assert np.array_equal(plain.steps, audited.steps)
    assert "audit_points" not in plain.attrs


@pytest.mark.parametrize("share", [0, -0.1, 1.1, True, "all", np.nan])
def test_an_audit_is_a_share(refuses, share):
    refuses(lambda: zj.sweep(end, q=Q, audit=share), "`audit`", "share above 0")


def solved(tolerance, solver=None):
    with within(Context(tolerance=tolerance, solver=solver)):
        return zj.sweep(end, q=Q, progress=False)


@pytest.fixture(scope="module")
def inside():
    """Tolerances that the scene is given, by `atol`."""
    return zj.sweep(end, tol=[1e-6], atol=[1e-6, 1e-5], q=Q, progress=False).sel(
        tol=1e-6
    )


def test_an_override_is_what_the_scene_could_have_said(audited, inside):
    """From outside as from inside, in pool threads and after another one before."""
    outside = solved(1e-6)
    assert (inside.steps.sel(atol=1e-6) == outside.steps).all()
    # numbers here, constants there: equal to rounding; measured 0
    np.testing.assert_allclose(inside.phi1.sel(atol=1e-6), outside.phi1, rtol=1e-9)
    again = zj.sweep(end, q=Q, progress=False)
    assert np.array_equal(again.phi1, audited.phi1)
    assert current_context() == Context()


def test_atol_keeps_its_ratio_to_rtol_and_tracers_obey(inside):
    with within(Context(tolerance=1e-6)):
        scaled = zj.sweep(end, tol=[1e-3], atol=[1e-2], q=Q, progress=False)
    # 1e-2 (1e-6 / 1e-3) is 1e-5 to rounding; measured 2e-15
    found = scaled.phi1.squeeze(("tol", "atol"))
    np.testing.assert_allclose(found, inside.phi1.sel(atol=1e-5), rtol=1e-9)


@pytest.fixture(scope="module")
def precise():
    return zj.work_precision(
        end,
        tolerances=(1e-3, 1e-6),
        solvers=SOLVERS,
        reference=zj.Method(SOLVERS["Tsit5"], rtol=1e-12),
        sample=16,
        repeats=1,
        q=Q,
    )


def test_errors_fall_with_the_tolerance(precise, exact):
    error = precise.phi1_error.sel(quantile=0.5)
    # measured below 2e-3
    assert (error.values[:, 1:] < 0.05 * error.values[:, :-1]).all()
    assert (precise.steps.values[:, 1:] > precise.steps.values[:, :-1]).all()
    assert (precise.seconds_a_point > 0).all()
    assert (precise.phi1_error.diff("quantile") >= 0).all()
    assert list(precise.solver.values) == ["Tsit5", "Bosh3"]


def test_the_errors_are_those_of_the_sampled_points(precise, exact):
    """All points bound a sample's quantiles."""
    with within(Context(tolerance=1e-6, solver=BOSH3)):
        plain = zj.sweep(end, q=Q, progress=False)
    error = np.abs(plain.phi1.values - exact)
    found = precise.phi1_error.sel(solver="Bosh3", rtol=1e-6)
    # the reference's own error is 1e-12
    assert error.min() - 1e-11 < found.sel(quantile=0.5) < error.max() + 1e-11
    assert found.sel(quantile=1.0) <= error.max() + 1e-11


def test_the_picture_has_a_line_a_solver(precise):
    ax = zj.plot.work_precision(precise, "phi1")
    lines = {line.get_label(): line for line in ax.get_lines()}
    assert set(lines) == {"Tsit5", "Bosh3"}
    drawn = np.sort(lines["Tsit5"].get_ydata())
    wanted = precise.phi1_error.sel(solver="Tsit5", quantile=0.5).values
    np.testing.assert_array_equal(drawn, np.sort(wanted))
    assert (ax.get_xscale(), ax.get_yscale()) == ("log", "log")


@pytest.mark.parametrize(
    "options, parts",
    [
        ({"tolerances": []}, ("`tolerances`", "positive")),
        ({"tolerances": [1e-3, -1]}, ("`tolerances`", "positive")),
        ({"sample": 0}, ("`sample`", "at least 1")),
        ({"repeats": 1.5}, ("`repeats`", "at least 1")),
        ({"solvers": zj.Explicit()}, ("`solvers`", "map names")),
        ({"reference": zj.Method(rtol=1e-9)}, ("`reference`", "solver", "1e-09")),
    ],
    ids=str,
)
def test_misuse_is_named(refuses, options, parts):
    refuses(lambda: zj.work_precision(end, q=Q, **options), *parts)


def test_the_picture_names_what_is_not_there(refuses, precise):
    refuses(lambda: zj.plot.work_precision(precise, "phi2"), "`variable`", "phi2_error")
