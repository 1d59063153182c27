"""What a motion is: each kind by a motion known to be of it; sections."""

import functools

import jax
import numpy as np
import pytest
import xarray as xr
from models import accelerations, flow
from newton_euler import Rods
from newton_euler import motion as moved
from scipy.integrate import solve_ivp
from scipy.spatial import KDTree

import ziegler_jax as zj
from ziegler_jax import CODE

pytestmark = pytest.mark.usefixtures("optimised")  # long runs

# q, tau, v_smooth, c1, c2, kick
SMOOTH = {
    "stuck": (1.2, 0.05, 0.1, 0, 0, 0.2),
    "cycle": (2.6, 0.026, 0.1, 0, 0, 0.3),
    "cycle, viscous": (2.3, 0, 0.01, 0.2, 0.2, 0.3),
    "conservative": (2.0, 0, 0.01, 0, 0, 0.2),
    "conservative, chaotic": (4.0, 0, 0.01, 0, 0, 0.3),
    "slow": (1.0, 0, 0.01, 0.003, 0.003, 0.2),  # it still decays
    "invalid": (2.0, 0, 0.01, -1, 0, 0.2),
    "escaped": (2.0, 0, 0.01, 0, 0, 40.0),
}


@functools.partial(jax.jit, static_argnums=1)
def of_smooth(n, exponents=2):
    load = zj.ConstantLoad(1.0)
    friction = zj.SmoothCoulomb(n[1], pin_radius=1.0, v_smooth=n[2], load=load)
    column = zj.uniform_rods(n[0], friction=friction, damping=zj.Viscous(n[3], n[4]))
    return zj.settle(column, zj.State(omega=(0.0, n[5])), exponents=exponents)


@pytest.fixture(scope="module")
def smooth():
    numbers = np.array(list(SMOOTH.values()), float)
    found = jax.vmap(of_smooth)(numbers)
    return {
        name: jax.tree.map(lambda x, i=i: np.asarray(x)[i], found)
        for i, name in enumerate(SMOOTH)
    }


@pytest.mark.parametrize("name", SMOOTH)
def test_each_motion_is_called_what_it_is(smooth, name):
    assert CODE(int(smooth[name].kind)).name == name.split(",")[0]


def test_exponents_change_nothing_of_what_a_motion_ends_as(smooth):
    numbers = np.array(list(SMOOTH.values()), float)
    without = jax.vmap(functools.partial(of_smooth, exponents=0))(numbers)
    for i, more in enumerate(smooth.values()):
        plain = jax.tree.map(lambda x, i=i: np.asarray(x)[i], without)
        for field, variable in plain.variables().items():
            if field == "steps":
                extra = more.steps - plain.steps
                assert (extra > 0) == (plain.outcome == CODE.unsettled)
            elif field != "undecided":
                # measured 0: the same steps in another program
                np.testing.assert_allclose(
                    getattr(more, field), variable.value, 1e-10, 0, err_msg=field
                )
        assert set(more.variables()) - set(plain.variables()) == {
            "exponents", "errors", "kind",
        }  # fmt: skip
        settled = plain.outcome != CODE.unsettled
        assert np.isnan(more.exponents).all() == settled
        assert more.kind == (plain.outcome if settled else more.undecided)


def test_chaos_without_dissipation_is_no_attractor_but_has_its_exponent(smooth):
    found = smooth["conservative, chaotic"]
    assert found.exponents[0] > 3 * found.errors[0]


def sticking(q, mu_k, omega2=0.3):
    friction = zj.SetValuedCoulomb(4 * mu_k, mu_k, pin_radius=0.1)
    column = zj.uniform_rods(q, friction=friction)
    windows, start = zj.Windows(escape=60.0), zj.State(omega=(0.0, omega2))
    return zj.settle(column, start, windows=windows, exponents=2)


def named(codes):
    return [CODE(int(v)).name for v in np.ravel(codes)]


def bodies(q, mu_k):
    """The same column in another formulation: torques of loads q on pins of 0.1."""
    return Rods(q, (0.4 * mu_k * q,) * 2, (0.1 * mu_k * q,) * 2)


def growth(rods, y, span=90.0, renew=3.0, apart=1e-7):
    """By how many e-foldings a neighbour moves away, brought back again and again."""
    near, total = y + apart * np.array([1.0, 0.0, 0.0, 0.0]), 0.0
    for _ in range(round(span / renew)):
        y, near = (moved(rods, x, [0.0, renew])[0][-1] for x in (y, near))
        size = np.linalg.norm(near - y)
        total, near = total + np.log(size / apart), y + (near - y) * apart / size
    return total


def test_stick_slip_has_chaos_and_cycles_of_many_passages():
    """Each kind is that of the motion that two free bodies go on with."""
    q, mu_k = (x.ravel() for x in np.meshgrid([3.2, 4.0], [0.05, 0.145, 0.25]))
    found = jax.jit(jax.vmap(sticking))(q, mu_k)
    names = named(found.kind)
    assert set(names) == {"cycle", "chaotic", "stuck"}
    final = np.hstack([np.transpose(found.final.phi), np.transpose(found.final.omega)])
    for i, name in enumerate(names):
        rods, y = bodies(q[i], mu_k[i]), final[i]
        if name == "stuck":
            ends, log = moved(rods, (0.0, 0.0, 0.0, 0.3), [0.0, 500.0])
            assert log[-1][2] == (0, 0)
            assert np.abs(ends[-1] - y).max() < 5e-7  # measured 2.4e-8
        elif name == "cycle":
            period, count = float(found.period[i]), int(found.returns[i])
            y = moved(rods, y, [0.0, 60 * period])[0][-1]  # a cycle is named from afar
            ts = np.linspace(0.0, period, 60 * count + 1)
            turn = moved(rods, y, ts)[0]
            assert np.abs(turn[-1] - y).max() < 5e-5  # measured 7.9e-6
            up = (turn[:-1, 0] < 0) & (turn[1:, 0] >= 0)
            assert up.sum() == count
            for k in range(2, count + 1):  # nor is it a shorter one
                assert np.abs(turn[:: 60 * count // k][1] - y).max() > 1e-2
        else:
            assert growth(rods, y) > 2.0  # measured 5 to 12; none on a cycle
    assert found.returns.max() > 1
    ds = zj.sweep(sticking, q=[4.0], mu_k=[0.145], progress=False)
    assert named(ds.kind) == ["chaotic"]
    about = ds.kind.attrs
    place = about["flag_meanings"].split().index("chaotic")
    assert about["flag_values"][place] == CODE.chaotic


def test_a_motion_that_lingers_by_an_unstable_cycle_is_none():
    """Of these chaotic motions one in twenty comes back thrice to within 1e-5."""
    starts = 0.3 * (1 + 1e-9 * np.arange(40))
    ds = zj.sweep(
        sticking, q=[4.0], mu_k=[0.14, 0.145, 0.1475], omega2=starts, progress=False
    )
    assert set(named(ds.kind)) == {"chaotic"}
    assert (ds.exponents[..., 0] > 3 * ds.errors[..., 0]).all()


# Slow ones: q, tau, kick, v_smooth. Followed on by certificates at 1e-9, the first and
# the last come to rest, at t = 7713 and 13 475, the others to cycles at 839 to 3733
SLOW = [
    (1.25081894529, 0.00200663507522, 0.757550593789, 0.00141551788974),
    (2.12472171640, 0.00113224768115, 0.544487902560, 0.00013586032899),
    (2.27723715322, 0.08711856099567, 0.000401655588, 0.12125104227345),
    (2.25664997475, 0.00136783823038, 0.315294020450, 0.00035576542655),
    (1.74086982657, 0.01469897756082, 0.085703795540, 0.06221423007768),
    (1.74173969423, 0.03340203879131, 1.65354269e-06, 0.15802236611933),
    (1.75112523563, 0.12195994869854, 0.052355651134, 0.49172979095751),
    (1.24213646175, 0.00118846558729, 0.978154825681, 0.00085333079218),
]


def test_slow_motions_are_neither_stuck_before_they_are_nor_quasi_periodic():
    def point(q, tau, kick, smooth):
        load = zj.ConstantLoad(1.0)
        law = zj.SmoothCoulomb(tau, pin_radius=1.0, v_smooth=smooth, load=load)
        column, start = zj.uniform_rods(q, friction=law), zj.State(omega=(0.0, kick))
        windows = zj.settle(column, start, certify=False)
        named = zj.settle(column, start, exponents=2)
        return {"kind": named.kind, "windows": windows.outcome}

    names = "q", "tau", "kick", "smooth"
    axes = {
        name: xr.DataArray(numbers, dims="scene")
        for name, numbers in zip(names, np.transpose(SLOW), strict=True)
    }
    ds = zj.sweep(point, axes=axes, progress=False)
    assert set(named(ds.kind)) <= {"slow", "growing", "lasting", "aperiodic", "cycle"}
    assert set(named(ds.windows)) <= {"unsettled", "repeats"}


TORUS = {"q": 2.71, "c": (0.0109, 0.0181), "eta": 0.7054, "k": 0.5986, "kick": 2.76}


def sections_of_the_torus(count):
    """Passages phi1 = 0 rising after a transient, by scipy."""
    numbers = {"kappa": TORUS["k"], "follower": TORUS["eta"]}

    def field(_, y):
        torques = TORUS["c"][0] * y[2], TORUS["c"][1] * (y[3] - y[2])
        return [*y[2:], *accelerations(np, TORUS["q"], torques, *y, **numbers)]

    def rising(_, y):
        return y[0]

    rising.direction = 1
    end = 1000.0 + 8.0 * count
    found = solve_ivp(
        field, (0, end), (0, 0, 0, TORUS["kick"]), "DOP853", events=rising, rtol=1e-8
    )
    settled = found.t_events[0] > 1000.0
    points = found.y_events[0][settled, 1:]
    assert len(points) >= count
    return points[:count]


def test_a_motion_on_a_torus_is_quasi_periodic():
    """Its sections fill a curve: six times as many are some six times as near.

    On a cycle they would be one, in a cloud 2.4 times as near.
    """

    @jax.jit
    def of():
        damping = zj.Viscous(*TORUS["c"])
        column = zj.uniform_rods(
            TORUS["q"], damping=damping, follower=TORUS["eta"], kappa=TORUS["k"]
        )
        windows, start = zj.Windows(escape=30.0), zj.State(omega=(0.0, TORUS["kick"]))
        return zj.settle(column, start, windows=windows, exponents=2)

    assert of().kind == CODE.quasi_periodic
    points = sections_of_the_torus(600)
    nearest = [
        np.median(KDTree(some).query(some, 2)[0][:, 1])
        for some in (points[:100], points)
    ]
    # measured 9.4, as the gaps of a rotation have lengths of their own, and 2.7e-3
    assert 4 < nearest[0] / nearest[1] < 20 and nearest[1] > 1e-4


# Sections -----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def section():
    friction = zj.SmoothCoulomb(
        0.026, pin_radius=1.0, v_smooth=0.1, load=zj.ConstantLoad(1.0)
    )
    column = zj.uniform_rods(2.6, friction=friction)

    @jax.jit
    def of(column, start):
        return zj.poincare(column, start, points=20, transient=0.0, max_time=60.0)

    return of(column, zj.State(omega=(0.0, 0.3)))


def test_passages_are_where_another_code_finds_them(section):
    def rising(t, y):
        return y[0] if t > 0 else -1.0

    rising.direction = 1
    numbers = (2.6, 0.026, 0.1, 0, 0)
    found = flow((0, 0, 0, 0.3), 60.0, numbers, 1e-11, events=rising)
    count = int(section.count)
    times, points = found.t_events[0], found.y_events[0]
    times, points = times[times > 1e-9], points[times > 1e-9]  # it starts on the plane
    assert count == len(times) and section.outcome == CODE.complete
    y = np.hstack([section.phi, section.omega])
    # measured 6.3e-9, 1.0e-9 and 3.3e-7: what quintics leave of angles, cubics of rates
    assert np.abs(section.times[:count] - times).max() < 6e-8
    assert np.abs(y[:count, :2] - points[:, :2]).max() < 1e-8
    assert np.abs(y[:count] - points).max() < 3e-6
    assert np.isnan(y[count:]).all() and np.isnan(section.times[count:]).all()


def test_what_breaks_a_rule_is_named(refuses):
    column, start = zj.uniform_rods(1.0), zj.State()
    refuses(
        lambda: zj.poincare(column, start, section=zj.SectionPlane("phi3")),
        "`coordinate`", "2 rods", "phi3",
    )  # fmt: skip
    refuses(lambda: zj.poincare(column, start, section=1), "`section`", "1")
    refuses(lambda: zj.poincare(column, start, points=0), "`points`", "0")
    for bad in (-1, 5, 1.5, 2.0, True, "2", np.array([1, 2])):
        refuses(
            lambda bad=bad: zj.settle(column, start, exponents=bad),
            "`exponents`", "from 0 to 4", repr(bad),
        )  # fmt: skip
    refuses(
        lambda: zj.settle(column, start, exponents=2, certify=False),
        "`exponents`", "certify=False", "2",
    )  # fmt: skip
    stiff = zj.Method(zj.Rosenbrock())
    refuses(
        lambda: zj.settle(column, start, exponents=2, method=stiff),
        "`exponents` must be 0", "Rosenbrock", "2",
    )  # fmt: skip
