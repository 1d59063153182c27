"""Taylor's method for stick and slip: series, step lengths, ends of modes, refusals."""

import dataclasses
import itertools

import diffrax as dfx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from newton_euler import Rods
from newton_euler import motion as newton_euler
from scipy.optimize import brentq

import ziegler_jax as zj
from ziegler_jax.model.damping import AbstractDamping
from ziegler_jax.model.state import PhasePoint
from ziegler_jax.numerics.series import value
from ziegler_jax.results import CODE
from ziegler_jax.solvers.expansion import _log2, allowed, expand

ORDER = 8
MODES = list(itertools.product((-1.0, 0.0, 1.0), repeat=2))
LAW = zj.SetValuedCoulomb(0.3, 0.2, pin_radius=(0.1, 0.2))
COLUMNS = {
    "bare": zj.uniform_rods(2.6, friction=LAW),
    "all": zj.uniform_rods(
        2.2,
        m1=0.7,
        m2=1.3,
        l2=0.8,
        kappa=1.4,
        follower=0.6,
        damping=zj.Sum(zj.Viscous(0.1, 0.2), zj.Air(0.2, 0.1, l2=0.8)),
        friction=LAW,
    ),
}
START = (0.3, -0.2, 0.4, -0.5)


# The motion's series ------------------------------------------------------------------


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_the_logarithm_by_bits_is_within_a_tenth(dtype):
    info = np.finfo(dtype)
    x = np.geomspace(float(info.tiny) * 4, float(info.max) / 4, 1001).astype(dtype)
    apart = np.asarray(_log2(jnp.asarray(x))) - np.log2(x)
    assert -0.0861 < apart.min() < -0.08  # log2(1 + f) - f is at most 0.08607
    assert apart.max() < 1e-4


@jax.jit
def expansion(system, y0):
    return expand(system, y0, ORDER, y0[0])


@jax.jit
def length(motion, tol):
    return allowed(motion.y, tol, tol)


def in_frozen_modes(column, modes):
    modes = tuple(jnp.asarray(m) for m in modes)
    system = column.system().in_modes(modes)
    start = PhasePoint(map(jnp.asarray, START))
    return system, PhasePoint.of(start.phi, system.law.hold(start.omega))


@jax.jit
def truth(system, y0, t):
    """The motion in frozen modes by another method."""
    return dfx.diffeqsolve(
        dfx.ODETerm(lambda t, y, system: system.field(t, y)),
        dfx.Dopri8(),
        0.0,
        t,
        None,
        y0,
        system,
        stepsize_controller=dfx.PIDController(rtol=1e-13, atol=1e-14),
        adjoint=dfx.ForwardMode(),
        max_steps=None,
    ).ys


@pytest.mark.parametrize("name", COLUMNS)
@pytest.mark.parametrize("modes", MODES)
def test_the_series_is_the_motion_to_its_order(name, modes):
    system, y0 = in_frozen_modes(COLUMNS[name], modes)
    motion = expansion(system, y0)

    def error(t):
        exact = (float(x[0]) for x in truth(system, y0, t))
        pairs = zip(motion.y, exact, strict=True)
        return max(abs(float(value(c, t)) - x) for c, x in pairs)

    if modes == (0.0, 0.0):
        assert error(0.1) == 0
        return
    t = 1.6
    while error(t) > 1e-7:
        t /= 2
    assert t > 0.01
    # half the time: 2^9 less, but for the terms behind it (370 to 537)
    assert 300 < error(t) / error(t / 2) < 600


@pytest.mark.parametrize("name", COLUMNS)
@pytest.mark.parametrize("modes", MODES)
def test_what_is_watched_are_rates_and_holding_torques(name, modes):
    system, y0 = in_frozen_modes(COLUMNS[name], modes)
    motion = expansion(system, y0)
    t = 0.02
    y = PhasePoint(value(c, t) for c in motion.y)
    torques = system.friction_torques(y)
    rates = y[2], y[3] - y[2]
    rows = zip(modes, motion.watched, torques, rates, strict=True)
    for m, watched, torque, rate in rows:
        expected = torque if m == 0 else m * rate
        # a torque is known to one order less; worst: 3.5e-14
        assert value(watched, t) == pytest.approx(float(expected), abs=4e-13)


def test_a_step_errs_by_about_its_tolerance():
    rng = np.random.default_rng(3)
    slips = jnp.asarray(1.0), jnp.asarray(-1.0)
    system = COLUMNS["all"].system().in_modes(slips)
    shares = []
    for tol in (1e-5, 1e-8, 1e-11):
        for _ in range(20):
            y0 = PhasePoint(map(jnp.asarray, rng.normal(size=4) * 0.5))
            motion = expansion(system, y0)
            h = length(motion, tol)
            exact = truth(system, y0, h)
            rows = zip(motion.y, exact, y0, strict=True)
            shares.append(
                max(
                    abs(value(c, h) - float(x[0])) / (tol * (1 + abs(y)))
                    for c, x, y in rows
                )
            )
    assert np.median(shares) < 0.5  # measured: 0.058
    assert max(shares) < 5.0  # 2.3


# Whole motions ------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Scene:
    q: float
    tau: float
    ratio: float
    start: tuple


def random_scenes(count):
    rng = np.random.default_rng(11)
    return [
        Scene(
            rng.uniform(0, 3),
            rng.uniform(0.01, 0.3),
            rng.uniform(1, 2),
            tuple(rng.normal(size=4) * 0.4),
        )
        for _ in range(count)
    ]


def test_a_runge_kutta_method_sees_the_same_motion_and_events():
    ts = jnp.linspace(0.0, 15.0, 31)

    @jax.jit
    def both(q, tau, ratio, start):
        law = zj.SetValuedCoulomb(
            tau, tau / ratio, pin_radius=1.0, load=zj.ConstantLoad(1.0)
        )
        column = zj.uniform_rods(q, friction=law)
        scene = column, zj.State(start[:2], start[2:]), ts
        return [
            zj.trajectory(
                *scene, method=zj.Method(rtol=1e-10, atol=1e-10, solver=solver)
            )
            for solver in (zj.Taylor(), zj.Explicit())
        ]

    events = 0
    for scene in random_scenes(25):
        one, other = both(scene.q, scene.tau, scene.ratio, scene.start)
        assert CODE(int(one.outcome)) is CODE(int(other.outcome))
        count = int(one.events.count)
        assert count == int(other.events.count), scene
        events += count
        for field in ("joints", "modes"):
            np.testing.assert_array_equal(
                getattr(one.events, field), getattr(other.events, field)
            )
        # measured: 5.4e-9 and 7.9e-10
        np.testing.assert_allclose(
            one.events.times, other.events.times, rtol=0, atol=6e-8
        )
        np.testing.assert_allclose(one.phi, other.phi, rtol=0, atol=1e-8)
    assert events > 100


def held_torque(t, order=2):
    """What holds joint 2, or its rate (order 3), while the rods turn as one.

    I phi'' + 0.8 phi' + phi + tau = 0 with I = 4/3 + 1 + 1/3, phi = 0 and phi' = 1 at
    first; the knee turns rod 2, of inertia 1/2 + 1/3 about the base.
    """
    inertia, tau = 8 / 3, 0.001
    s = (-0.8 + 1j * np.sqrt(4 * inertia - 0.64)) / (2 * inertia)
    # phi + tau = Re(c e^{st}) is tau, its rate 1
    c = tau - 1j * (1 - tau * s.real) / s.imag
    return -5 / 6 * (c * s**order * np.exp(s * t)).real, (c * np.exp(s * t)).real - tau


@pytest.mark.parametrize("tol, depth", [(1e-9, 1e-7), (1e-9, 1e-9), (1e-11, 1e-10)])
def test_a_torque_that_hardly_passes_its_limit_sets_its_joint_free(tol, depth):
    """Whatever the output times: joint 2's torque has its peak at t = 1.394."""
    top = brentq(lambda t: held_torque(t, 3)[0], 1.0, 2.0)
    peak = held_torque(top)[0]
    most = peak - depth
    freed = brentq(lambda t: held_torque(t)[0] - most, 1.0, top)
    angle = held_torque(freed)[1]
    rate = (held_torque(freed + 1e-6)[1] - held_torque(freed - 1e-6)[1]) / 2e-6
    # from there on by another code: joint 2 slips, below its limit
    rods = Rods(0.5, (0.001, most), (0.001, 0.3 * most), viscous=(0.8, 0.0))
    other, log = newton_euler(
        rods, (angle, angle, rate, rate), [freed, 3.0], modes=(1, 1)
    )

    @jax.jit
    def motion(k):
        ts = jnp.stack([0.0 * k, 0.05 + 0.11 * k, 3.0 + 0.0 * k])
        law = zj.SetValuedCoulomb(
            (0.001, most),
            (0.001, 0.3 * most),
            pin_radius=1.0,
            load=zj.ConstantLoad(1.0),
        )
        column = zj.uniform_rods(0.5, damping=zj.Viscous(0.8, 0.0), friction=law)
        start = zj.State(omega=(1.0, 1.0))
        return zj.trajectory(column, start, ts, method=zj.Method(rtol=tol, atol=tol))

    for k in range(6):
        found = motion(float(k))
        # the start, joint 2 set free, and what follows
        count = int(found.events.count)
        assert count == 2 + len(log)
        np.testing.assert_array_equal(found.events.joints[2:count], [x[1] for x in log])
        # measured 5.8e-7
        assert abs(float(found.events.times[1]) - freed) < 6e-6
        end = np.hstack([found.phi[-1], found.omega[-1]])
        # measured 3.1e-8, where the depth is the tolerance
        np.testing.assert_allclose(end, other[-1], rtol=0, atol=3e-7)


def test_the_method_is_in_the_record():
    ds = zj.sweep(settled, q=[2.0, 2.6], progress=False)
    assert ds.attrs["solver"] == "Taylor8"


def settled(q, **options):
    return settled_column(zj.uniform_rods(q, friction=LAW), **options)


def settled_column(column, **options):
    windows = zj.Windows(transient=5.0, length=5.0, max_windows=1)
    return zj.settle(
        column, zj.State(omega=(0.0, 0.3)), windows=windows, **options, certify=False
    )


class Squared(AbstractDamping):
    """What no power series is known of."""

    def matrix(self, cos_d, omega):
        return (0.1 * jnp.asarray(cos_d) ** 2, 0.0), (0.0, 0.1)

    def valid(self):
        return True


def test_a_damping_law_of_ones_own_is_left_to_another_method():
    column = zj.uniform_rods(2.0, friction=LAW, damping=Squared())
    found = settled_column(column)
    assert found.attributes()["solver"] == "Tsit5"
    assert CODE(int(found.outcome)) in (CODE.unsettled, CODE.stuck)
    with pytest.raises(ValueError, match="a damping law or forces of one.s own"):
        settled_column(column, method=zj.Method(zj.Taylor()))


@pytest.mark.parametrize("rate", [1e20, 1e100, 1e200])
def test_rates_beyond_all_bounds_are_failures(rate):
    column = zj.uniform_rods(2.0, friction=LAW)
    found = zj.settle(
        column,
        zj.State(omega=(0.0, rate)),
        windows=zj.Windows(max_windows=1, escape=1e300),
        method=zj.Method(max_steps=10_000),
        certify=False,
    )
    failures = CODE.not_finite, CODE.step_vanished, CODE.chattering
    assert CODE(int(found.outcome)) in failures
    assert np.isnan(found.drift) and np.isnan(found.rod_amplitude).all()


@pytest.mark.parametrize("order", [2, 8.0, True, "8"])
def test_an_order_is_a_whole_number(order):
    with pytest.raises(ValueError, match="`order` of `Taylor` must be a whole number"):
        zj.Taylor(order)


SMOOTH = zj.SmoothCoulomb(0.1, pin_radius=0.1, v_smooth=0.01)
REACTION = zj.SetValuedCoulomb(0.1, pin_radius=0.1, load=zj.JointReaction())


@pytest.mark.parametrize("friction", [None, SMOOTH, REACTION])
def test_it_is_refused_where_it_has_no_series(friction):
    column = zj.uniform_rods(2.0, friction=friction)
    with pytest.raises(ValueError, match="`solver` may be `Taylor"):
        zj.settle(
            column, zj.State(), method=zj.Method(solver=zj.Taylor()), certify=False
        )


def test_it_is_refused_where_sections_are_asked_for():
    column = zj.uniform_rods(2.0, friction=LAW)
    rule = r"`Explicit\(...\)` or None in `poincare`, but is `Taylor8`"
    with pytest.raises(ValueError, match=f"`solver` must be an explicit .*{rule}"):
        zj.poincare(column, zj.State(omega=(0.0, 0.2)), method=zj.Method(zj.Taylor()))
