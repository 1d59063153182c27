"""SI units: the same physics, in seconds and newton metres."""

import dataclasses
from typing import ClassVar

import equinox as eqx
import jax
import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr
from scipy.integrate import solve_ivp

import ziegler_jax as zj
from ziegler_jax.results import AbstractResult
from ziegler_jax.units.known import PURE
from ziegler_jax.units.known import UNITS as UNITS_IN_SI

matplotlib.use("Agg")
UNITS = zj.SI(m=0.3, l=0.7, k=4.0)
KICK = zj.State(omega=(0.0, 0.4))
EQUAL = {"m1": 0.3, "m2": 0.3, "l1": 0.7, "l2": 0.7}


def rods(force, **parts):
    """Equal rods under a force in newtons, in their own units."""
    return UNITS.scaled(zj.uniform_rods(force, **EQUAL, **parts))


def newtons(t, y, m, l, k, force):  # noqa: E741
    """Two uniform rods with every quantity in SI units."""
    phi1, phi2, w1, w2 = y
    s, c = np.sin(phi1 - phi2), np.cos(phi1 - phi2)
    inertia = m * l**2 * np.array([[4 / 3, c / 2], [c / 2, 1 / 3]])
    torque = [
        force * l * s - 2 * k * phi1 + k * phi2 - m * l**2 / 2 * s * w2**2,
        k * (phi1 - phi2) + m * l**2 / 2 * s * w1**2,
    ]
    return [w1, w2, *np.linalg.solve(inertia, torque)]


def test_a_restored_motion_is_that_of_the_equations_in_si_units():
    seconds, force = np.linspace(0, 3, 31), 12.0
    start = (0, 0, 0, 0.4 / UNITS.time)
    direct = solve_ivp(
        lambda t, y: newtons(t, y, 0.3, 0.7, 4.0, force),
        (0, 3), start, "DOP853", seconds, rtol=1e-11, atol=1e-12,
    )  # fmt: skip
    column = rods(force)
    motion = zj.trajectory(
        column, KICK, seconds / UNITS.time, method=zj.Method(rtol=1e-10, atol=1e-10)
    )
    back = UNITS.restore(motion)
    np.testing.assert_allclose(back.ts, seconds, rtol=1e-14)
    # worst cases 3e-11, 4e-10
    np.testing.assert_allclose(back.phi, direct.y[:2].T, atol=2e-10)
    np.testing.assert_allclose(back.omega, direct.y[2:].T, atol=2e-9)


def test_a_chain_in_si_units_moves_as_its_equations_in_si_units():
    """The chain is free of units: in newtons, kilograms and metres it runs as it is."""
    parts = {
        "lengths": (0.7, 0.4, 0.5), "masses": (0.3, 0.2, 0.1), "tip_mass": 0.05,
        "centres": (0.3, 0.2, 0.25), "inertias": (0.01, 0.004, 0.002), "air": 0.02,
        "springs": (4.0, 3.0, 2.0), "rest_angles": (0.1, 0.0, 0.0), "foundation": 0.3,
        "damping": zj.Viscous(0.01, 0.02, 0.03), "gravity": zj.Gravity(0.5, 0.3),
        "dead_load": zj.DeadLoad(0.4),
    }  # fmt: skip
    chain, seconds = zj.Chain(7.0, **parts), np.linspace(0, 3, 31)
    start, exact = zj.State(omega=(0.0, 0.0, 0.5)), zj.Method(rtol=1e-11, atol=1e-11)
    direct = zj.trajectory(chain, start, seconds, method=exact)
    times = seconds / UNITS.time
    own = UNITS.scaled(chain), UNITS.scaled(start), times
    back = UNITS.restore(zj.trajectory(*own, method=exact))
    assert np.abs(direct.phi).max() > 0.1
    np.testing.assert_allclose(back.phi, direct.phi, atol=1e-11)  # measured 6.3e-13
    # measured 2.0e-11, of 7
    np.testing.assert_allclose(back.omega, direct.omega, atol=3e-10)


def test_a_chain_in_si_units_names_its_masses_and_springs(refuses):
    """A default of 1 would be a kilogram, or a newton metre."""
    lengths = (0.7, 0.7, 0.7)
    for name, other in (("masses", "springs"), ("springs", "masses")):
        chain = zj.Chain(7.0, lengths=lengths, **{other: 2.0})
        refuses(lambda chain=chain: UNITS.scaled(chain), f"`{name}`", "SI", "default")
    own = UNITS.scaled(zj.Chain(7.0, lengths=lengths, masses=0.3, springs=4.0))
    left, y = zj.Chain(7.0 * 0.7 / 4.0, lengths=(1.0,) * 3), (0.1, 0.2, 0.3) * 2
    here, there = (zj.vector_field(0.0, y, c) for c in (own, left))
    np.testing.assert_allclose(here, there, rtol=1e-13)


def test_a_restored_motion_says_that_it_is_in_seconds(refuses):
    column = rods(12.0)
    motion = zj.trajectory(column, KICK, np.linspace(0, 20, 201))
    back = UNITS.restore(motion)
    assert "rad/s" in str(back) and "sqrt" not in str(back)
    ds = back.to_dataset()
    assert ds.ts.units == "s" and ds.omega.units == "rad/s"
    axes = zj.plot.time_history(back)
    assert axes[0].get_xlabel() == "time $t$ (s)"
    drawn = zj.plot.spectrum(back)
    assert drawn.get_xlabel() == "angular frequency (rad s$^{-1}$)"
    own = zj.plot.spectrum(motion)
    ratio = drawn.lines[0].get_xdata() / own.lines[0].get_xdata()
    np.testing.assert_allclose(ratio, 1 / UNITS.time, rtol=1e-12)
    refuses(lambda: UNITS.restore(back), "`result`", "own units", "seconds")
    rest = zj.trajectory(column, zj.State(), np.linspace(0, 20, 201))
    refuses(lambda: zj.plot.spectrum(rest), "`motion`", "at rest")
    refuses(lambda: zj.plot.time_history(3), "`motion`", "`Trajectory`", "3")
    plt.close("all")


def test_the_events_of_a_motion_are_in_seconds_too():
    friction = zj.SetValuedCoulomb(0.02, pin_radius=0.7)
    column = rods(12.0, friction=friction)
    motion = zj.trajectory(column, KICK, np.linspace(0, 20, 5), max_events=40)
    back = UNITS.restore(motion)
    count = int(motion.events.count)
    assert count > 2
    np.testing.assert_allclose(
        back.events.times[:count], motion.events.times[:count] * UNITS.time
    )


def test_a_restored_dataset_names_and_scales_its_units():
    def point(tau, v_smooth):
        load = zj.ConstantLoad(1.0)
        friction = zj.SmoothCoulomb(tau, pin_radius=1.0, v_smooth=v_smooth, load=load)
        column = zj.uniform_rods(q=2.6, friction=friction)
        watch = (zj.Period(), zj.EnergyBalance())
        return zj.settle(
            column,
            KICK,
            windows=zj.Windows(transient=20, length=10, max_windows=2),
            observers=watch,
            certify=False,
        )

    ds = zj.sweep(point, tau=[0.05], v_smooth=[0.05], progress=False)
    si = UNITS.restore(ds)
    scales = {
        "time": (UNITS.time, "s"),
        "period": (UNITS.time, "s"),
        "friction_power": (4.0 / UNITS.time, "W"),
        "rod_amplitude": (1.0, "rad"),
        "tau": (4.0, "N m"),
        "v_smooth": (1 / UNITS.time, "rad/s"),
    }
    for name, (scale, units) in scales.items():
        assert si[name].attrs["units"] == units, name
        np.testing.assert_allclose(si[name].values, scale * ds[name].values, rtol=1e-14)
    assert si.outcome.attrs == ds.outcome.attrs
    assert "not SI" in si.attrs["options_in"]
    assert float(si.period.sel(tau=0.2)[0]) > 0  # by its own new coordinate


@pytest.fixture(scope="module")
def ended():
    column, watch = rods(6.0), (zj.Period(), zj.EnergyBalance())
    short = zj.Windows(transient=5, length=40, max_windows=1)
    return zj.settle(column, KICK, windows=short, observers=watch, certify=False)


def test_a_settled_motion_comes_back_in_seconds(ended):
    si, ds = UNITS.restore(ended), UNITS.restore(ended).to_dataset()
    assert float(si.period) == pytest.approx(
        float(ended.period) * UNITS.time, rel=1e-14
    )
    assert ds.period.attrs["units"] == "s" and ds.period == si.period
    assert si.rod_amplitude[1] == ds.rod_amplitude.sel(rod=2) == ended.rod_amplitude[1]
    assert ds.follower_power.attrs["units"] == "W"
    assert int(si.outcome) == int(ds.outcome) == zj.CODE.unsettled
    assert "unsettled" in ds.outcome.attrs["flag_meanings"]
    assert si.attributes() == ds.attrs and "not SI" in ds.attrs["options_in"]


def test_a_period_has_its_frequency_beside_it(ended):
    """Of a result, of its dataset and of a sweep's; not of what has no period."""
    si = UNITS.restore(ended)
    for hertz in (
        si.frequency,
        si.to_dataset().frequency,
        UNITS.restore(ended.to_dataset()).frequency,
    ):
        assert float(hertz) * float(ended.period) * UNITS.time == pytest.approx(
            1, rel=1e-14
        )
    about = si.to_dataset().frequency.attrs
    assert about["units"] == "Hz" and "frequency" in about["long_name"]
    assert "frequency" not in ended.to_dataset()
    critical = UNITS.restore(zj.critical_load(rods_in_own_units()))
    assert critical.to_dataset().frequency.attrs["units"] == "rad/s"


def rods_in_own_units():
    return zj.uniform_rods(1.0, l2=0.5)


def test_a_restored_result_prints_its_numbers_in_si_and_what_its_codes_mean(ended):
    rows = repr(UNITS.restore(ended)).splitlines()
    assert rows[0] == "Settled in SI units"
    own = [row.split("=")[0].strip() for row in repr(ended).splitlines()[1:]]
    printed = dict(row.split(" = ") for row in rows[1:])
    printed = {name.strip(): text for name, text in printed.items()}
    assert set(printed) == {*own, "frequency"}
    seconds = float(ended.time) * UNITS.time
    assert printed["time"].endswith(" s")
    assert float(printed["time"].split()[0]) == pytest.approx(seconds, rel=1e-5)
    assert printed["frequency"].endswith(" Hz")
    assert printed["outcome"] == f"unsettled: {zj.CODE.unsettled.sentence}"
    load = repr(UNITS.restore(zj.critical_load(rods_in_own_units())))
    assert " N\n" in load and f"found: {zj.CODE.found.sentence}" in load


def test_lanes_of_a_result_are_dimensions_after_restoring():
    load = jax.vmap(lambda l2: zj.critical_load(zj.uniform_rods(l2=l2)))
    found = load(np.array([0.5, 1.0]))
    si = UNITS.restore(found)
    assert si.to_dataset().q_cr.dims == ("lane_1",)
    np.testing.assert_array_equal(si.q_cr, found.q_cr * UNITS.force)


def test_masses_are_in_kilograms_and_lengths_in_metres():
    bodies = {"m1": 0.9, "m2": 0.6, "l1": 0.7, "l2": 1.4}
    column = UNITS.scaled(zj.point_masses(q=12.0, **bodies))
    direct = zj.point_masses(3, 2, q=2.1, l2=2.0)  # by hand: 0.9/0.3, 12 * 0.7/4
    assert_same(column, direct)
    ziegler = zj.point_masses(0.6, 0.3, l1=0.7, l2=0.7)
    assert_same(UNITS.scaled(ziegler), zj.point_masses(2, 1))
    uniform = UNITS.scaled(zj.uniform_rods(12.0, **bodies))
    assert_same(uniform, zj.uniform_rods(2.1, m1=3, m2=2, l2=2.0))
    # by hand: m l^2 = 0.147 kg m^2, m l = 0.21 kg m
    numbers = {"a": 0.294, "b": 0.0735, "d": 0.147, "m2": 0.6, "s1": 0.105, "l2": 1.4}
    own = UNITS.scaled(zj.Column(12.0, **numbers, kappa=0.8, l1=0.7))
    assert_same(own, zj.Column(2.1, 2, 0.5, 1, 0.8, m2=2, s1=0.5, l2=2))


def assert_same(column, other):
    for x, y in zip(jax.tree.leaves(column), jax.tree.leaves(other), strict=True):
        np.testing.assert_allclose(x, y, rtol=1e-15)


def test_each_joint_has_its_own_pin_and_its_own_transition():
    radii, v = (0.02, 0.1), 0.004
    joints = UNITS.joint_friction(0.12, 0.10, pin_radius=radii, transition_velocity=v)
    assert UNITS.transition_rate(radii, v) == pytest.approx((0.2, 0.04), rel=1e-14)
    law, cut = UNITS.scaled(joints), zj.StickFraction(UNITS.transition_rate(radii, v))
    rates = UNITS.scaled(cut).rate_cut
    assert rates == pytest.approx((0.2 * UNITS.time, 0.04 * UNITS.time), rel=1e-14)
    halves = law.levers(1.25 * rates[0], 1.25 * rates[1])
    # 0.11 R/l each: the middle of its own fall, less the tanh's 1.3e-8 (joint 1)
    expected = [0.11 * radius / 0.7 for radius in radii]
    np.testing.assert_allclose(halves, expected, rtol=1e-6)
    column = rods(12.0, friction=joints)
    short = {"windows": zj.Windows(max_windows=1)}
    both = zj.settle(
        column, KICK, observers=(zj.StickFraction(rates),), **short, certify=False
    )
    for joint, rate in enumerate(rates):
        one = zj.settle(
            column, KICK, observers=(zj.StickFraction(rate),), **short, certify=False
        )
        assert both.stick_fraction[joint] == one.stick_fraction[joint] > 0


def test_a_joint_of_a_multibody_program_falls_between_its_transition_velocities():
    radius, v = 0.02, 0.004
    law = UNITS.joint_friction(0.12, 0.10, pin_radius=radius, transition_velocity=v)
    rate = UNITS.transition_rate(radius, v)
    assert rate == pytest.approx(0.2, rel=1e-14)  # rad/s
    assert UNITS.scaled(law).v_stribeck == pytest.approx(
        1.25 / np.log(2) ** 0.5 * 0.2 * UNITS.time, rel=1e-14
    )

    def mu(times):
        return float(law.levers(times * rate, 0.0)[0]) / float(law.pin_radius)

    # the middle of the fall, less the tanh's 1.3e-8
    assert mu(1.25) == pytest.approx(0.11, abs=1e-7)
    assert mu(4.0) == pytest.approx(0.10, abs=2e-5)  # 1.6e-5 of the fall is left
    peak = max(mu(x) for x in np.linspace(0.01, 1, 200))
    assert 0.117 < peak < 0.12  # 0.1177
    assert isinstance(law.load, zj.JointReaction)


def test_a_pin_radius_without_its_unit_leaves_the_torque_open_by_a_thousand():
    """Adams' default is one unit of length, and 0.1 units a second at its surface."""
    metres = UNITS.joint_friction(0.1, 0.1, pin_radius=1.0, transition_velocity=0.1)
    millimetres = UNITS.joint_friction(
        0.1, 0.1, pin_radius=1e-3, transition_velocity=1e-4
    )
    assert metres.pin_radius / millimetres.pin_radius == pytest.approx(1000)
    assert metres.v_stribeck == pytest.approx(millimetres.v_stribeck)


def test_time_histories_have_seconds_on_their_axes():
    motion = zj.trajectory(rods(10.0), KICK, np.linspace(0, 5, 6))
    history, phase = zj.plot.time_history(motion, units=UNITS)
    assert history.get_xlabel() == "time $t$ (s)"
    np.testing.assert_allclose(
        history.lines[0].get_xdata(), motion.ts * UNITS.time, rtol=1e-14
    )
    assert "s$^{-1}$" in phase.get_ylabel()


def test_all_that_a_joints_friction_is_made_of_is_in_si_units():
    """The smoothed rate in rad/s, the load in newtons."""
    law = UNITS.scaled(joint(v_smooth=2.0, load=zj.ConstantLoad(5.0)))
    assert law.v_smooth == pytest.approx(2.0 * UNITS.time, rel=1e-15)
    assert law.load.n == pytest.approx(5.0 * 0.7 / 4.0, rel=1e-15)
    assert law.pin_radius == pytest.approx(0.1 / 0.7, rel=1e-15)


def joint(**changes):
    options = {"pin_radius": 0.1, "transition_velocity": 0.1} | changes
    return UNITS.joint_friction(0.2, 0.1, **options)


@pytest.mark.parametrize(
    "misuse, sentence",
    [
        (lambda: zj.SI(m=1, l=0, k=1), "`l` must be finite and positive, but is 0"),
        (lambda: UNITS.restore(3.0), "`result` must be a `Trajectory`"),
        (
            lambda: UNITS.restore(xr.Dataset({"x": ((), 1.0, {"units": "furlong"})})),
            "`x` of the result must be in one of .* but is in furlong",
        ),
        (
            lambda: UNITS.transition_rate(0.0, 0.1),
            "`pin_radius` must be finite and positive, but is 0",
        ),
        (lambda: rods("26 N"), "`q` must be a number, but is '26 N'"),
        (lambda: zj.point_masses(m1=1, m2="1 kg", l1=1, l2=1), "`m2` must be a number"),
        (
            lambda: zj.uniform_rods(1.0, m1=1, m2=1, l1=1, l2=-1),
            "`l2` must be finite and positive",
        ),
        (
            lambda: zj.uniform_rods(1.0, m1=1, l1=1, l2=1),
            "`m2` must be given where `l1` is",
        ),
        (
            lambda: zj.uniform_rods(1.0, **EQUAL, damping=zj.Air(0.1, 0.1)),
            "`l2` of `Air` must be the column's, 0.7, but is 1",
        ),
        (
            lambda: UNITS.scaled(zj.uniform_rods(1.0)),
            "`value` must have `l1`, .*, but has none",
        ),
        (lambda: UNITS.scaled(rods(1.0)), "`value` must have `l1`"),  # scaled twice
        (
            lambda: UNITS.scaled(zj.uniform_rods(1.0, **EQUAL | {"l1": 0.8})),
            "`value` must have a rod 1 .*, 0.7 m, but has `l1` = 0.8",
        ),
        (lambda: UNITS.scaled(3.0), "`value` must be a column, .* but is float"),
        (lambda: UNITS.scaled(UNITS), "`value` must be a column, .* but is SI"),
        (
            lambda: UNITS.scaled(zj.critical_load(zj.uniform_rods())),
            "`value` must be a column, .* but is CriticalLoad",
        ),
        (lambda: UNITS.transition_rate("a", 0.1), "`pin_radius` must be a number"),
        (lambda: joint(pin_radius=None), "`pin_radius` must be a number, but is None"),
        (lambda: joint(pin_radius=(1,)), "`pin_radius` must be at least two numbers"),
        (lambda: joint(pin_radius=(0.1, 0)), r"`pin_radius\[1\]` must be .* positive"),
        (
            lambda: joint(transition_velocity=[]),
            "`transition_velocity` must be at least two",
        ),
    ],
)
def test_misuse_is_named(misuse, sentence):
    with pytest.raises(ValueError, match=sentence):
        misuse()


def test_laws_starts_and_bounds_in_si_are_those_of_the_equations_in_si():
    """A pin radius in m, damping in N m s/rad, rates in rad/s, windows in s."""
    m, l, k, force = 0.1, 0.2, 0.5, 6.5  # noqa: E741
    units = zj.SI(m, l, k)
    c, radius, mu, v = 2e-4, 0.004, 0.15, 0.3

    def direct(t, y):
        slope = newtons(t, y, m, l, k, force)
        joints = y[2], y[3] - y[2]
        one, two = (
            mu * radius * force * np.tanh(u / v) + c * u for u in joints
        )  # N m: both pins carry F
        s = np.cos(y[0] - y[1])
        inertia = m * l**2 * np.array([[4 / 3, s / 2], [s / 2, 1 / 3]])
        more = np.linalg.solve(inertia, [-one + two, -two])
        return [*slope[:2], *(slope[2:] + more)]

    seconds = np.linspace(0, 2, 21)
    truth = solve_ivp(
        direct, (0, 2), (0, 0, 0, 2.0), "DOP853", seconds, rtol=1e-11, atol=1e-12
    )
    friction = zj.SmoothCoulomb(mu, pin_radius=radius, v_smooth=v)
    parts = {"friction": friction, "damping": zj.Viscous(c, c)}
    column = units.scaled(zj.uniform_rods(force, m1=m, m2=m, l1=l, l2=l, **parts))
    start = units.scaled(zj.State(omega=(0, 2.0)))
    motion = units.restore(zj.trajectory(column, start, seconds / units.time))
    # worst cases 1.3e-8, 1.5e-7: the motion's own tolerance
    np.testing.assert_allclose(motion.phi, truth.y[:2].T, atol=1e-7)
    np.testing.assert_allclose(motion.omega, truth.y[2:].T, atol=1e-6)
    windows = units.scaled(zj.Windows(transient=4.0, rate_cut=0.1, max_windows=3))
    assert windows.transient * units.time == pytest.approx(4.0, rel=1e-15)
    assert windows.rate_cut == pytest.approx(0.1 * units.time, rel=1e-15)
    dry = units.scaled(zj.SetValuedCoulomb(mu, pin_radius=(radius, 2 * radius)))
    assert dry.pin_radius == (radius / l, 2 * radius / l)
    load = units.scaled(zj.ConstantLoad(5.0))
    assert load.n == pytest.approx(5.0 * l / k, rel=1e-15)


T, F, C = (0.3 * 0.49 / 4) ** 0.5, 4 / 0.7, (4 * 0.3 * 0.49) ** 0.5  # by hand
PINS = {"pin_radius": (0.07, 0.14)}
SCALED = {
    "start": (zj.State((1, 2), (3, 4)), zj.State((1, 2), (3 * T, 4 * T))),
    "viscous": (zj.Viscous(1, 2), zj.Viscous(1 / C, 2 / C)),
    # 1 N s/m^2 on a rod of 0.7 m, whose torque is 1/3 0.7^3 N m s
    "air": (zj.Air(1, 2, 1.4), zj.Air(0.343 / C, 0.686 / C, 2)),
    "sum": (
        zj.Sum(zj.Viscous(1, 2), zj.Air(1, 2, 1.4)),
        zj.Sum(zj.Viscous(1 / C, 2 / C), zj.Air(0.343 / C, 0.686 / C, 2)),
    ),
    "smooth": (
        zj.SmoothCoulomb(0.2, 0.1, **PINS, v_smooth=1, v_stribeck=(2, 3)),
        zj.SmoothCoulomb(
            0.2, 0.1, pin_radius=(0.1, 0.2), v_smooth=T, v_stribeck=(2 * T, 3 * T)
        ),
    ),
    "set-valued": (
        zj.SetValuedCoulomb(0.2, **PINS, load=zj.ConstantLoad((1, 2))),
        zj.SetValuedCoulomb(
            0.2, pin_radius=(0.1, 0.2), load=zj.ConstantLoad((1 / F, 2 / F))
        ),
    ),
    "follower load": (zj.FollowerLoad(), zj.FollowerLoad()),
    "reaction": (zj.JointReaction(5), zj.JointReaction(5)),
    "preload and reaction": (
        zj.ConstantLoad(2) + zj.JointReaction(),
        zj.ConstantLoad(2 / F) + zj.JointReaction(),
    ),
    "windows": (
        zj.Windows(1, 2, 3, 4, 5, 6),
        zj.Windows(1 / T, 2 / T, 3, 4, 5, 6 * T),
    ),
    "spans": (zj.Spans(1, 2, 3, 4), zj.Spans(1 / T, 2 / T, 3, 4)),
    "method": (zj.Method(zj.Taylor(), 1e-5, 1e-6, 9),) * 2,
    "directions": (zj.Directions("both"),) * 2,
    "search": (zj.Search(3, 4),) * 2,
    "arc": (zj.Arc(bounds=(1, 2)),) * 2,
    "course": (zj.Course(first=(1, 2)),) * 2,
    "angle": (zj.SectionPlane("phi2", 1), zj.SectionPlane("phi2", 1)),
    "rate": (zj.SectionPlane("omega2", 1, False), zj.SectionPlane("omega2", T, False)),
    "cut": (zj.StickFraction((1, 2)), zj.StickFraction((T, 2 * T))),
    "no cut": (zj.StickFraction(), zj.StickFraction()),
}


@pytest.mark.parametrize("name", SCALED)
def test_every_value_is_scaled_by_the_units_of_its_numbers(name):
    given, expected = SCALED[name]
    scaled = UNITS.scaled(given)
    assert jax.tree.structure(scaled) == jax.tree.structure(expected)
    for x, y in zip(jax.tree.leaves(scaled), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(x, y, rtol=1e-14)
    # by the inverse units all of it comes back
    back = zj.SI(1 / 0.3, 1 / 0.7, 1 / 4.0).scaled(scaled)
    for x, y in zip(jax.tree.leaves(back), jax.tree.leaves(given), strict=True):
        np.testing.assert_allclose(x, y, rtol=1e-14)


def test_all_values_of_the_library_with_numbers_have_units():
    """But results, what a sweep is given, what runs, and methods, of pure numbers."""
    others = {"SI", "Lanes", "Store", "Program", "StickingSet", "System"}
    others |= {"Rosenbrock", "Taylor", "Explicit"}
    for name in zj.__all__:
        kind = getattr(zj, name)
        if not (isinstance(kind, type) and issubclass(kind, eqx.Module)):
            continue
        if issubclass(kind, AbstractResult) or name in others:
            continue
        units = getattr(kind, "units", {})
        numbers = {
            f.name
            for f in dataclasses.fields(kind)
            if "Scalar" in str(f.type) or "float" in str(f.type).lower()
        }
        assert isinstance(units, property) or numbers <= set(units), name
        if not isinstance(units, property):
            assert set(units.values()) <= {*UNITS_IN_SI, *PURE}, name


class Cubic(zj.AbstractDamping):
    """Torques c |u|^2 u of the rods, with and without its unit."""

    c: float

    def matrix(self, cos_d, omega):
        return (self.c * omega[0] ** 2, 0.0), (0.0, self.c * omega[1] ** 2)


class Measured(Cubic):
    units: ClassVar = {"c": (1.5, 3, -0.5)}  # k sqrt(m l^2/k)^3


class Furlong(Cubic):
    units: ClassVar = {"c": "furlong"}


def test_a_law_of_ones_own_says_its_units(refuses):
    law = UNITS.scaled(Measured(1))  # N m s^3, a whole number is one too
    assert law.c == pytest.approx(1 / (4 * T**3), rel=1e-14)
    column = rods(1.0, damping=zj.Sum(Measured(2.0), zj.Viscous(0, 0)))
    assert column.damping.first.c == pytest.approx(2 / (4 * T**3), rel=1e-14)
    for c in (1, 1.0, np.float64(1), jax.numpy.ones(())):
        refuses(
            lambda c=c: UNITS.scaled(Cubic(c)),
            "`value`", "`c` of `Cubic` has none", 'units = {"c": "1"}', "k/l",
        )  # fmt: skip
    refuses(lambda: UNITS.scaled(Furlong(1.0)), "`c` of `Furlong`", "'furlong'", "k/l")


@pytest.mark.parametrize(
    "question",
    [
        lambda c: zj.settle(c, KICK),
        lambda c: zj.trajectory(c, KICK, [0.0, 1.0]),
        lambda c: zj.vector_field(0.0, KICK.y, c),
        lambda c: zj.energy(c, KICK),
        lambda c: zj.power(c, KICK),
        lambda c: zj.reactions(c, KICK),
        lambda c: zj.spectrum(c),
        lambda c: zj.critical_load(c),
        lambda c: zj.tangent_column(c),
        lambda c: zj.is_stiff(c, 1e-6),
        lambda c: zj.threshold(lambda s: (c, KICK), (1.0, 2.0)),
        lambda c: zj.critical_kick(c, KICK, (0.0, 1.0)),
        lambda c: zj.flutter_onset(lambda q: c, KICK, (1.0, 2.0)),
        lambda c: zj.lyapunov_exponents(c, KICK),
    ],
)
def test_a_column_in_si_units_is_asked_nothing(question, refuses):
    given = zj.uniform_rods(12.0, **EQUAL)
    refuses(lambda: question(given), "`column`", "`l1` = 0.7", "si.scaled(column)")


def test_a_set_of_sticking_states_is_in_the_columns_own_units(refuses):
    dry = zj.uniform_rods(
        1.0, **EQUAL, friction=zj.SetValuedCoulomb(0.1, pin_radius=0.1)
    )
    refuses(lambda: zj.sticking_set(dry), "`column`", "`l1` = 0.7")


def test_a_column_in_si_units_has_no_sensitivities(refuses):
    """Its numbers are traced where it is refused."""
    given = zj.uniform_rods(12.0, **EQUAL)
    refuses(lambda: zj.sensitivity(given), "`l1` = a traced number", "si.scaled")


def test_a_traced_length_that_is_not_the_units_makes_the_column_invalid():
    def end(l1):
        column = zj.uniform_rods(12.0, **EQUAL | {"l1": l1})
        motion = zj.trajectory(UNITS.scaled(column), KICK, [0.0, 1.0])
        return motion.outcome, motion.phi[-1]

    (right, wrong), phi = jax.jit(jax.vmap(end))(np.array([0.7, 0.8]))
    assert (right, wrong) == (zj.CODE.complete, zj.CODE.invalid)
    assert np.isfinite(phi[0]).all() and np.isnan(phi[1]).all()


def test_scaled_values_are_differentiated():
    """q = F l/k, and the rest by their powers of m, l and k."""

    def numbers(m, l, k):  # noqa: E741
        units = zj.SI(m, l, k)
        given = zj.uniform_rods(
            12.0, m1=0.3, m2=0.3, l1=l, l2=0.7, damping=zj.Viscous(1.0, 1.0)
        )
        column, start = units.scaled(given), units.scaled(KICK)
        windows = units.scaled(zj.Windows(transient=2.0))
        return column.q, column.d, column.damping.c1, start.omega[1], windows.transient

    at = (0.3, 0.7, 4.0)
    slopes = jax.jit(jax.jacfwd(numbers, (0, 1, 2)))(*map(jax.numpy.asarray, at))
    powers = (
        (0, 1, -1),
        (-1, -2, 0),
        (-0.5, -1, -0.5),
        (0.5, 1, -0.5),
        (-0.5, -1, 0.5),
    )
    for value, slope, power in zip(numbers(*at), slopes, powers, strict=True):
        expected = [p * value / x for p, x in zip(power, at, strict=True)]
        np.testing.assert_allclose(slope, expected, rtol=1e-13, atol=1e-15)


def test_loads_come_back_in_newtons_also_in_a_sweep():
    def point(q, kappa):
        return zj.critical_load(zj.uniform_rods(q, kappa=kappa))

    ds = zj.sweep(point, q=[1.0, 2.0], kappa=[1.0, 3.0], progress=False)
    si = UNITS.restore(ds)
    newton = 4.0 / 0.7
    np.testing.assert_allclose(si.q, newton * ds.q, rtol=1e-14)
    np.testing.assert_allclose(si.q_cr.values, newton * ds.q_cr.values, rtol=1e-14)
    assert si.q.attrs["units"] == si.q_cr.attrs["units"] == "N"
    assert ds.q.attrs["units"] == ds.q_cr.attrs["units"] == "k/l"
    assert si.q.attrs["symbol"] == "$F$"
    assert si.q_cr.attrs["long_name"] == "critical load"
