"""The long-run motion: known amplitudes, every outcome, derivatives, refusals."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from models import flow
from options import options_of

import ziegler_jax as zj
from ziegler_jax import CODE

# Largest |phi2 - phi1| and |phi1| at q = 2.6, tau = 0.026 against v_smooth, by another
# code.
KNOWN = [(0.3, 0.64249, 0.6631), (0.1, 0.63443, 0.6664), (0.03, 0.63214, 0.6728)]
KNOWN += [(0.01, 0.63133, 0.6760), (0.003, 0.63112, 0.6782)]


def test_the_cycles_amplitudes_are_the_known_ones():
    @jax.jit
    @jax.vmap
    def point(v_smooth):
        friction = zj.SmoothCoulomb(
            0.026, pin_radius=1.0, v_smooth=v_smooth, load=zj.ConstantLoad(1.0)
        )
        return zj.settle(
            zj.uniform_rods(2.6, friction=friction),
            zj.State(omega=(0.0, 0.3)),
            windows=zj.Windows(transient=300.0, agreement=1e-5),
            method=zj.Method(rtol=1e-8, atol=1e-8),
            certify=False,
        )

    v_smooth, knee, rod = np.array(KNOWN).T
    found = point(v_smooth)
    assert (np.asarray(found.outcome) == CODE.repeats).all()
    # the known ones have five digits, and four; measured 3.4e-6
    assert np.abs(found.joint_amplitude[:, 1] - knee).max() < 1e-5
    assert np.abs(found.rod_amplitude[:, 0] - rod).max() < 1e-4


# Every outcome ------------------------------------------------------------------------

USUAL = {
    "q": 2.6, "mu_s": 0.02, "mu_k": 0.02, "kick": 0.3, "rtol": 1e-6,
    "agreement": 1e-3, "escape": np.pi, "kappa": 1.0, "v_smooth": 0.05,
}  # fmt: skip
LANES = {
    "repeats": {},
    "stuck": {"q": 1.0},
    "unsettled": {"agreement": 1e-15, "rtol": 1e-8},
    "escaped": {"escape": 0.4},
    "budget_spent": {"rtol": 1e-11},
    # the rate's change of sign is a jump that no step resolves to 1e-16
    "step_vanished": {"rtol": 1e-16, "v_smooth": 1e-15},
    "not_finite": {"kick": 1e200},
    "invalid": {"mu_k": 0.03},
    "invalid: kappa": {"kappa": -1.0},
    "invalid: q": {"q": np.nan},
    "invalid: kick": {"kick": np.inf},
}
OBSERVERS = (zj.Mean(), zj.Period(), zj.StickFraction(), zj.EnergyBalance())


def lane(q, mu_s, mu_k, kick, rtol, agreement, escape, kappa, v_smooth):
    friction = zj.SmoothCoulomb(
        mu_s, mu_k, pin_radius=0.4, v_stribeck=0.5, v_smooth=v_smooth
    )
    return zj.settle(
        zj.uniform_rods(q, kappa=kappa, friction=friction),
        zj.State((0.0, 0.01), (0.0, kick)),
        windows=zj.Windows(
            transient=100.0,
            length=20.0,
            max_windows=4,
            agreement=agreement,
            escape=escape,
        ),
        observers=OBSERVERS,
        method=zj.Method(rtol=rtol, atol=rtol, max_steps=10_000),
        certify=False,
    )


@pytest.fixture(scope="module")
def lanes():
    """All lanes of the table in one batch."""
    rows = [USUAL | changes for changes in LANES.values()]
    columns = {name: np.array([row[name] for row in rows]) for name in USUAL}
    run = jax.jit(jax.vmap(lambda numbers: lane(**numbers)))
    return dict(zip(LANES, _apart(run(columns), len(rows)), strict=True))


def _apart(batch, count):
    return [jax.tree.map(lambda x, i=i: np.asarray(x)[i], batch) for i in range(count)]


@pytest.mark.parametrize("name", LANES)
def test_each_outcome_is_reached(lanes, name):
    assert CODE(int(lanes[name].outcome)).name == name.split(":")[0]


@pytest.mark.parametrize("name", LANES)
def test_numbers_are_nan_where_the_lane_failed_and_only_there(lanes, name):
    found = lanes[name]
    failed = name.split(":")[0] not in ("repeats", "stuck", "unsettled")
    numbers = {key: value.value for key, value in found.variables().items()}
    for key in ("rod_amplitude", "joint_amplitude", "mean_angle", "stick_fraction"):
        assert np.isnan(numbers[key]).all() == failed, key
    for key in ("follower_power", "friction_power", "energy_imbalance"):
        assert np.isnan(numbers[key]) == failed, key
    # one window is enough to see a stuck column: then there is no drift
    assert np.isnan(numbers["drift"]) == (failed or found.windows == 1)
    if name != "stuck":  # which may or may not swing while it creeps
        assert np.isnan(numbers["period"]) == failed


def test_effort_and_time_tell_where_a_lane_ended(lanes):
    assert lanes["budget_spent"].steps == 10_000
    assert lanes["invalid"].steps == 0 and lanes["invalid"].time == 0
    assert lanes["repeats"].time == 100 + 20 * lanes["repeats"].windows
    assert lanes["repeats"].windows >= 2 and lanes["repeats"].drift <= 1e-3
    assert lanes["unsettled"].windows == 4 and lanes["unsettled"].time == 180
    assert lanes["escaped"].time < 100
    assert np.abs(lanes["escaped"].final.phi).max() > 0.4


def test_without_friction_a_column_comes_to_rest():
    @jax.jit
    def settled():
        column = zj.uniform_rods(0.5, damping=zj.Viscous(1.0, 1.0))
        return zj.settle(
            column,
            zj.State(omega=(0.0, 0.3)),
            windows=zj.Windows(transient=50.0, length=5.0),
            method=zj.Method(atol=1e-9),
            certify=False,
        )

    found = settled()
    assert int(found.outcome) == CODE.rest
    # every rate is below the cut of 1e-6, and angles decay as slowly; measured 1.7e-6
    assert np.asarray(found.rod_amplitude).max() < 5e-6


def test_what_was_not_observed_is_named(lanes):
    bare = lanes["repeats"]
    with pytest.raises(AttributeError) as caught:
        _ = bare.lyapunov_exponent
    sentence = str(caught.value)
    names = "rod_amplitude", "mean_angle", "period", "friction_power"
    for part in ("`lyapunov_exponent`", *names):
        assert part in sentence


# Derivatives --------------------------------------------------------------------------


def test_forward_derivatives_pass_through():
    """Against central differences of the same function."""

    def amplitude(q):
        friction = zj.SmoothCoulomb(
            0.026, pin_radius=1.0, v_smooth=0.3, load=zj.ConstantLoad(1.0)
        )
        found = zj.settle(
            zj.uniform_rods(q, friction=friction),
            zj.State(omega=(0.0, 0.3)),
            windows=zj.Windows(transient=300.0, length=20.0, agreement=1e-6),
            method=zj.Method(rtol=1e-9, atol=1e-9),
            certify=False,
        )
        return jnp.concatenate([found.rod_amplitude, found.joint_amplitude])

    q, h = np.float64(2.6), 1e-4
    ends, slopes = jax.jit(
        jax.vmap(lambda q: jax.jvp(amplitude, (q,), (jnp.ones_like(q),)))
    )(np.array([q - h, q, q + h]))
    expected = (ends[2] - ends[0]) / (2 * h)
    # measured 9.6e-5: what is left of the transient counts more in a derivative
    assert np.abs(slopes[1] / expected - 1).max() < 3e-4


# What is refused ----------------------------------------------------------------------

COLUMN, KICK = zj.uniform_rods(1.0), zj.State(omega=(0.0, 0.1))
settle = functools.partial(zj.settle, COLUMN, KICK)
trajectory = functools.partial(zj.trajectory, COLUMN, KICK)


@pytest.mark.parametrize(
    "call, parts",
    [
        (lambda: zj.settle(1.0, KICK, certify=False), ("`column`", "1.0", "`Column`")),
        (
            lambda: zj.settle(COLUMN, (0.0, 0.1), certify=False),
            ("`start`", "0.1", "`State`"),
        ),
        (
            lambda: settle(method=zj.Method(rtol=0.0), certify=False),
            ("`rtol`", "0", "positive"),
        ),
        (
            lambda: settle(method=zj.Method(rtol=-1e-6), certify=False),
            ("`rtol`", "-1e-06", "positive"),
        ),
        (
            lambda: settle(method=zj.Method(atol=np.nan), certify=False),
            ("`atol`", "nan", "positive"),
        ),
        (
            lambda: settle(windows=zj.Windows(transient=-1.0), certify=False),
            ("`transient`", "-1", "nonnegative"),
        ),
        (
            lambda: settle(windows=zj.Windows(length=0.0), certify=False),
            ("`length`", "0", "positive"),
        ),
        (
            lambda: settle(windows=zj.Windows(agreement=0.0), certify=False),
            ("`agreement`", "0", "positive"),
        ),
        (
            lambda: settle(windows=zj.Windows(max_windows=0), certify=False),
            ("`max_windows`", "0", "at least 1"),
        ),
        (
            lambda: settle(windows=zj.Windows(max_windows=2.5), certify=False),
            ("`max_windows`", "2.5", "whole"),
        ),
        (
            lambda: settle(method=zj.Method(max_steps=0), certify=False),
            ("`max_steps`", "0", "at least 1"),
        ),
        (
            lambda: settle(method=zj.Method(max_steps=True), certify=False),
            ("`max_steps`", "True", "whole"),
        ),
        (
            lambda: settle(windows=zj.Windows(escape=0.0), certify=False),
            ("`escape`", "0", "positive"),
        ),
        (
            lambda: settle(windows=zj.Windows(rate_cut=-1.0), certify=False),
            ("`rate_cut`", "-1", "positive"),
        ),
        (
            lambda: settle(observers=(1,), certify=False),
            ("`observers`", "1", "StickFraction()"),
        ),
        (
            lambda: settle(observers=(zj.Period,), certify=False),
            ("`observers`", "Period"),
        ),
        (
            lambda: settle(observers=(zj.Mean(),) * 2, certify=False),
            ("`observers`", "mean", "once"),
        ),
        (
            lambda: settle(observers=(zj.StickFraction(),), certify=False),
            ("`rate_cut`", "None"),
        ),
        (lambda: zj.StickFraction(0.0), ("`rate_cut`", "0", "positive")),
        (lambda: trajectory(0.0), ("`ts`", "()", "two times")),
        (lambda: trajectory([1.0]), ("`ts`", "(1,)", "two times")),
        (lambda: trajectory([0.0, 1.0, 1.0]), ("`ts`", "increase")),
        (lambda: trajectory([0.0, np.nan]), ("`ts`", "increase")),
        (
            lambda: trajectory([0.0, 1.0], method=zj.Method(rtol=0.0)),
            ("`rtol`", "0", "positive"),
        ),
    ],
)
def test_a_wrong_argument_is_refused_by_name_value_and_rule(refuses, call, parts):
    refuses(call, *parts)


def _slow(kick, **more):
    """physics of the smoothed law at rest: viscous damping that makes it flutter."""
    law = zj.SmoothCoulomb(
        0.1, pin_radius=0.1, v_smooth=0.05, load=zj.ConstantLoad(1.0)
    )
    column = zj.uniform_rods(1.8, friction=law)
    return zj.settle(column, zj.State(omega=(0.0, kick)), **more, certify=False)


def test_a_slow_motion_that_grows_is_not_stuck():
    """v_smooth = 5 tau: the smoothed column flutters from rest (Ziegler's paradox)."""
    found = zj.sweep(_slow, kick=[1e-4, 1e-2], progress=False)
    assert (found.outcome == zj.CODE.repeats).all()
    # the cycle that another code ends on, which starts beyond it, after 1000 time units
    kicked = flow((0, 0, 0, 1.5), 1000.0, (1.8, 0.01, 0.05, 0, 0), 1e-8).y[:, -1]
    ts = np.linspace(0.0, 10.0, 4001)  # more than a period
    turn = flow(kicked, 10.0, (1.8, 0.01, 0.05, 0, 0), t_eval=ts).y
    largest = np.abs(turn[1] - turn[0]).max()
    # windows agree to 1e-3; measured 1.2e-4 of 0.519
    knee = found.joint_amplitude.sel(joint=2)
    np.testing.assert_allclose(knee, largest, rtol=0, atol=1e-3)


OPTIONS = {
    "transient": 5.0, "length": 5.0, "agreement": 1e-3, "escape": np.pi,
    "rate_cut": 1e-3, "rtol": 1e-4, "atol": 1e-4,
}  # fmt: skip


def test_a_traced_option_that_breaks_its_rule_is_invalid():
    def point(**numbers):
        column, start = zj.uniform_rods(1.0), zj.State(omega=(0.0, 0.3))
        options = options_of(zj.settle, max_windows=2, **numbers)
        return zj.settle(column, start, **options, certify=False)

    axes = {name: [-1.0, right] for name, right in OPTIONS.items()}
    found = zj.sweep(point, axes=axes, progress=False)
    # every option right, or any number of them wrong: one batch of 128 lanes
    wrong = np.ones((2,) * len(OPTIONS), bool)
    wrong[(-1,) * len(OPTIONS)] = False
    np.testing.assert_array_equal(found.outcome == zj.CODE.invalid, wrong)
    assert (np.isnan(found.rod_amplitude).all("rod").values == wrong).all()


def test_the_noise_of_steps_at_rest_is_no_cycle():
    """Of these lanes, all at rest at 1e-8 rad, three once passed for cycles."""

    def point(q, rho):
        friction = zj.SmoothCoulomb(
            0.3, 0.2, pin_radius=rho, v_smooth=0.01, v_stribeck=0.1
        )
        column = zj.uniform_rods(q=q, m2=0.5, kappa=1.5, friction=friction)
        return zj.settle(column, zj.State(omega=(0.0, 0.3)), certify=False)

    ds = zj.sweep(
        point, q=np.linspace(1.1, 1.5, 8), rho=np.linspace(0.1, 0.2, 8), progress=False
    )
    assert float(ds.joint_amplitude.max()) < 1e-6
    assert (ds.outcome == int(CODE.stuck)).all()


def test_traced_invalid_numbers_end_a_trajectory_as_invalid():
    def column(mu):
        friction = zj.SmoothCoulomb(mu, pin_radius=0.1, v_smooth=0.1)
        return zj.uniform_rods(2.0, friction=friction)

    kick = zj.State(omega=(0.0, 0.3))
    run = jax.jit(
        lambda mu, ts: zj.trajectory(
            column(mu), kick, ts, method=zj.Method(rtol=1e-4, atol=1e-4)
        )
    )
    ts = np.linspace(0.0, 2.0, 3)
    assert int(run(0.1, ts).outcome) == CODE.complete
    for bad in (np.nan, -1.0):
        found = run(bad, ts)
        assert int(found.outcome) == CODE.invalid
        assert np.isnan(found.phi).all() and int(found.steps) == 0
        assert int(run(0.1, np.array([0.0, 2.0, bad])).outcome) == CODE.invalid
