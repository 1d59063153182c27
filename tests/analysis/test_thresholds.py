"""Critical kicks and onset loads: closed forms, scaling laws, and plain motions."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import ziegler_jax as zj
from ziegler_jax.analysis.manifold import carried
from ziegler_jax.motion.options import Method
from ziegler_jax.solvers import Explicit

# Where the flutter cycle folds, mu_s = mu_k, equal constant torques: by other codes.
FOLDS = {0.01: 1.28802, 0.03: 1.32807, 0.1: 1.57105, 0.26: 1.86140}


def dry(q, tau):
    """Set-valued friction with the constant torque tau in both joints."""
    law = zj.SetValuedCoulomb(tau, pin_radius=1.0, load=zj.ConstantLoad(1.0))
    return zj.uniform_rods(q, friction=law)


def smooth(q, tau):
    law = zj.SmoothCoulomb(
        tau, pin_radius=1.0, v_smooth=0.01, load=zj.ConstantLoad(1.0)
    )
    return zj.uniform_rods(q, friction=law)


def kick_of(q, tau1, tau2, eta, w1, span, escape, rtol):
    """One program for all scenes with set-valued friction."""
    law = zj.SetValuedCoulomb((tau1, tau2), pin_radius=1.0, load=zj.ConstantLoad(1.0))
    return zj.critical_kick(
        zj.uniform_rods(q, follower=eta, friction=law),
        zj.State(omega=(w1, 1.0)),
        (0.0, span * tau1),
        search=zj.Search(scan=4, halvings=14),
        windows=zj.Windows(escape=escape),
        method=zj.Method(rtol=rtol, atol=1e-3 * rtol),
    )


compiled_kicks = jax.jit(jax.vmap(kick_of))


def kicks(q, tau, span=40.0, escape=np.pi, rtol=1e-6, eta=1.0, w1=0.0, stiff=0.0):
    """Critical kicks at two loads, one torque."""
    numbers = (tau, tau + stiff, eta, w1, span, escape, rtol)
    return compiled_kicks(np.asarray(q), *(np.full(2, x) for x in numbers))


def test_the_critical_kick_collapses_over_the_torque():
    """Small motions with Coulomb friction are homogeneous in (state, torque).

    What is left is the geometry's cubic terms: the square of the torque. The verdict
    is scaled too: beyond 40 times the torque a motion has moved.
    """
    taus = np.array([0.0002, 0.01, 0.02, 0.04])
    scaled = []
    for tau in taus:
        found = kicks([1.8, 2.0], tau, span=16.0, escape=40 * tau)
        assert (found.outcome == zj.CODE.found).all()
        scaled.append(np.asarray(found.threshold) / tau)
    departure = np.array(scaled[1:]) / scaled[0] - 1
    assert (np.abs(departure[0]) < 1e-3).all()  # 2e-4 at q = 2
    # four times as much at twice the torque: 4.1
    np.testing.assert_allclose(departure[2] / departure[1], 4.0, rtol=0.1)


def saddle(q, tau):
    """The rate from which a column that is stiff in joint 2 overturns.

    Under a dead load it is one pendulum of the inertia I = a + 2 b + d, and joint 1
    slips: I phi'' = 2 q sin(phi) - phi - tau, which must not vanish before the saddle.
    """
    inertia = 4 / 3 + 1 + 1 / 3
    top = tau / (2 * q - 1)
    for _ in range(20):
        top -= (2 * q * np.sin(top) - top - tau) / (2 * q * np.cos(top) - 1)
    work = top**2 / 2 - 2 * q * (1 - np.cos(top)) + tau * top
    return np.sqrt(2 * work / inertia)


@pytest.mark.parametrize("tau", [0.001, 0.05])
def test_a_dead_load_overturns_beyond_the_energy_of_the_saddle(tau):
    q = np.array([0.8, 1.2])
    found = kicks(q, tau, span=2.0, escape=0.5, rtol=1e-8, eta=0.0, w1=1.0, stiff=100.0)
    assert (found.outcome == zj.CODE.found).all()
    error = np.abs(found.threshold - saddle(q, tau)) / found.width
    assert (error < 0.6).all()  # in the last interval: 0.5 and the steps' errors
    if tau < 0.01:
        linear = tau / np.sqrt(8 / 3 * (2 * q - 1))
        np.testing.assert_allclose(found.threshold, linear, rtol=1e-4)  # 3e-5


def test_the_ends_of_the_last_interval_stick_and_flutter():
    """Against plain motions that are followed for 1500 time units."""
    loads, tau = np.array([1.8, 2.4]), 0.02
    found = kicks(loads, tau)
    middle, width = found.threshold, found.width

    def plain(q, omega2):
        start = zj.State(omega=(0.0, omega2))
        return zj.settle(
            dry(q, tau),
            start,
            windows=zj.Windows(transient=1500.0, agreement=1e-3),
            certify=False,
        )

    ends = np.ravel([middle - width, middle + width])
    ran = zj.sweep(plain, q=loads, omega2=ends, progress=False)
    for i in range(2):
        assert ran.outcome[i, i] == zj.CODE.stuck
        assert ran.outcome[i, i + 2] == zj.CODE.repeats


def test_a_higher_load_needs_less_of_a_kick():
    found = kicks([2.0, 2.2], 0.03)
    assert (found.outcome == zj.CODE.found).all()
    assert found.threshold[1] < found.threshold[0]


def load_of(tau, kick):
    return zj.flutter_onset(
        lambda q: dry(q, tau),
        zj.State(omega=(0.0, kick)),
        (1.0, 2.4),
        search=zj.Search(halvings=9),
        # beside the fold a motion stays undecided to t = 40 000 as it does to 8000
        windows=zj.Windows(max_windows=200),
    )


def test_no_kick_sets_off_flutter_below_the_fold_of_the_cycle():
    found = zj.sweep(
        load_of,
        tau=list(FOLDS),
        kick=[0.8, 2.0],
        lanes=zj.Lanes(batch_size=8),
        progress=False,
    )
    known = np.array(list(FOLDS.values()))[:, None]
    above = found.threshold + found.width / 2 - known
    assert found.threshold.notnull().sum() >= 6
    assert (above > -5e-4).where(found.threshold.notnull(), True).all()
    # 0.02 and 0.0001 above at the two smaller torques
    assert (np.nanmin(above, axis=1)[:2] < 0.03).all()


def test_flutter_onset_and_critical_kick_are_one_curve():
    """The kick at which q is the onset is the critical kick at q."""
    onset = zj.sweep(
        load_of, tau=[0.03], kick=[0.4], lanes=zj.Lanes(batch_size=8), progress=False
    )
    q, width = onset.threshold.item(), onset.width.item()
    found = kicks([q - width, q + width], 0.03)
    high, low = found.threshold
    assert low < 0.4 < high < low * 1.1


def test_smoothing_moves_the_critical_kick_and_less_so_the_sharper_it_is():
    """v_smooth = 0.01 is a third of this torque: its viscous part feeds flutter."""

    def point(v_smooth):
        law = zj.SmoothCoulomb(
            0.03, pin_radius=1.0, v_smooth=v_smooth, load=zj.ConstantLoad(1.0)
        )
        return zj.critical_kick(
            zj.uniform_rods(2.2, friction=law),
            zj.State(omega=(0, 1)),
            (0, 1),
            search=zj.Search(scan=4),
        )

    v = [0.001, 0.003, 0.01]
    found = zj.sweep(point, v_smooth=v, lanes=zj.Lanes(batch_size=4), progress=False)
    exact = kicks([2.2, 2.2], 0.03).threshold[0]
    error = np.abs(found.threshold.values - exact)
    assert (error[:-1] < 0.5 * error[1:]).all()  # 0.0055, 0.015, 0.043


def wavy(x):
    """Load 1.2 at x = 0, 2.2 at 1/2, 1.2 again at 1: flutter in the middle only."""
    law = zj.SmoothCoulomb(
        0.05, pin_radius=1.0, v_smooth=0.05, load=zj.ConstantLoad(1.0)
    )
    return zj.uniform_rods(1.2 + jnp.sin(jnp.pi * x) ** 2, friction=law)


QUICK = {"search": zj.Search(4, 5), "method": zj.Method(rtol=1e-4, atol=1e-5)}


def test_a_verdict_that_changes_twice_is_noticed_under_a_plain_vmap():
    """Also: an onset that falls, none from either side, no verdict, bad brackets.

    And only where the verdict changes once has the onset a derivative.
    """
    low = jnp.array([0.0, 0.5, 0.0, 0.4, 1.0, 0.0, 0.1, 0.0])
    high = jnp.array([1.0, 1.0, 0.1, 0.6, 0.5, 0.6, jnp.nan, 0.5])
    length = jnp.full(8, 40.0).at[5].set(0.2)  # no time to settle in

    @jax.jit
    @jax.vmap
    def search(low, high, length):
        # at x = 0.75 a motion at 1e-4 is certain at t = 815 by one program's rounding,
        # by another's not yet at 1600
        windows = zj.Windows(length=length, max_windows=80)

        def onset(kick):
            start = zj.State(omega=(0.0, kick))
            quick = QUICK | {"search": zj.Search(4, 9)}  # fine enough for derivatives
            found = zj.flutter_onset(wavy, start, (low, high), windows=windows, **quick)
            return found.threshold, found

        return jax.jvp(onset, (0.8,), (1.0,), has_aux=True)[1:]

    slope, found = search(low, high, length)
    code = zj.CODE
    assert found.outcome.tolist() == [
        code.repeated,
        code.found,
        code.rests,
        code.moves,
        code.invalid,
        code.undecided,
        code.invalid,
        code.found,
    ]
    assert found.changes.tolist() == [2, 1, 0, 0, 0, 0, 0, 1]
    assert found.obstacle[5] == zj.CODE.unsettled
    assert found.undecided[5] > 0 and (found.undecided[:4] == 0).all()
    np.testing.assert_array_equal(found.rises[jnp.array([0, 1, 7])], [1, -1, 1])
    assert np.isnan(found.rises[2:7]).all()
    # one onset, seen from both sides of a symmetric hill
    both = (found.threshold[0] + found.threshold[1]).item()
    assert abs(both - 1) <= found.width[:2].sum() / 2
    assert np.isnan(found.threshold[2:7]).all() and np.isnan(found.width[2:7]).all()
    np.testing.assert_allclose(found.width[:2], [1 / 2048, 0.5 / 2048], rtol=1e-12)
    assert np.isnan(slope).tolist() == (found.outcome != code.found).tolist()
    assert slope[7] < 0  # a harder kick, a lower load
    np.testing.assert_allclose(slope[1], -slope[7], rtol=0.02)


@pytest.mark.parametrize("friction", ["set-valued", "smoothed"])
def test_a_threshold_moves_as_its_derivative_says(friction):
    """In load (or kick), mu_s, mu_k and pin radius; differences of the thresholds."""
    fine = zj.Search(scan=4, halvings=24)

    def critical(p):
        law = zj.SetValuedCoulomb(
            p[1], p[2], pin_radius=p[3], load=zj.ConstantLoad(1.0)
        )
        column = zj.uniform_rods(p[0], friction=law)
        kick = zj.State(omega=(0.0, 1.0))
        found = zj.critical_kick(column, kick, (0.0, 0.4), search=fine)
        return found.threshold, found.outcome

    def onset(p):
        law = zj.SmoothCoulomb(
            p[1], p[2], pin_radius=p[3], v_smooth=0.03, v_stribeck=0.3,
            load=zj.ConstantLoad(1.0),
        )  # fmt: skip
        found = zj.flutter_onset(
            lambda q: zj.uniform_rods(q, friction=law),
            zj.State(omega=(0.0, p[0])),
            (1.8, 2.6),
            search=fine,
        )
        return found.threshold, found.outcome

    value, at = {
        "set-valued": (critical, [2.0, 0.02, 0.018, 1.0]),
        "smoothed": (onset, [0.186, 0.03, 0.027, 1.0]),
    }[friction]
    at, step = np.array(at), 1e-4
    around = at * (1 + step * np.concatenate([np.eye(4), -np.eye(4)]))
    both = jax.jit(jax.vmap(jax.value_and_grad(value, has_aux=True)))
    (ends, outcomes), slopes = both(np.vstack([around, at]))
    assert (outcomes == zj.CODE.found).all()
    slope, difference = slopes[8], (ends[:4] - ends[4:8]) / (2 * step * at)
    # the steps' errors (1e-6) differ from motion to motion: measured 8e-4, and 5e-5
    # at 1e-9, of the kick
    np.testing.assert_allclose(slope, difference, rtol=5e-3)


def test_by_a_cycle_that_hardly_repels_a_derivative_is_right_or_none():
    """Of an onset load in mu_k of both joints, kick and kappa.

    The unstable cycle lies near its fold: the tangents grow slowly, and along the flow
    mostly.
    """

    def onset(p, halvings):
        law = zj.SetValuedCoulomb((0.1992, 0.2068), (p[0], p[1]), pin_radius=0.05)
        found = zj.flutter_onset(
            lambda q: zj.uniform_rods(q, friction=law, kappa=p[3]),
            zj.State(omega=(0.0, p[2])),
            (1.2, 1.7),
            search=zj.Search(scan=2, halvings=halvings),
        )
        return found.threshold, found.outcome

    at, step = np.array([0.1693, 0.1758, 0.3, 1.0]), 1e-3
    around = at * (1 + step * np.concatenate([np.eye(4), -np.eye(4)]))
    ends, _ = jax.jit(jax.vmap(lambda p: onset(p, 20)))(around)
    difference = (ends[:4] - ends[4:]) / (2 * step)
    for halvings, none in (9, True), (13, False):
        value = jax.value_and_grad(lambda p, n=halvings: onset(p, n), has_aux=True)
        (_, outcome), slope = jax.jit(value)(at)
        assert outcome == zj.CODE.found
        assert np.isnan(slope).tolist() == [none] * 4
        # measured 8e-4, of 0.8; with the parts along the flow 0.4 in the wide interval
        off = np.abs(slope * at - difference).max()
        assert none or off < 3e-3


def test_any_line_crosses_the_border_where_the_lines_of_load_and_kick_do():
    """Where load and kick grow together: a point of the border, and how it moves.

    The border is the critical kick K(q). On the line (q, kick) = (1.6, 0) + s (cos a,
    sin a), s sin a = K(1.6 + s cos a), so that with K'
    ds/da (sin a - K' cos a) = -s (cos a + K' sin a).
    """
    fine = zj.Search(scan=4, halvings=22)
    along = slanted(fine)

    def critical(q):
        found = zj.critical_kick(
            dry(q, 0.03), zj.State(omega=(0.0, 1.0)), (0.0, 0.8), search=fine
        )
        return found.threshold, found.outcome

    angle = 0.6
    (s, ended), turned = jax.jit(jax.value_and_grad(along, has_aux=True))(angle)
    q = 1.6 + s * np.cos(angle)
    (kick, other), slope = jax.jit(jax.value_and_grad(critical, has_aux=True))(q)
    assert ended == other == zj.CODE.found
    # measured 1.6e-7, and 2e-6 of the derivative
    np.testing.assert_allclose(s * np.sin(angle), kick, rtol=1e-6)
    expected = -s * (np.cos(angle) + slope * np.sin(angle))
    expected /= np.sin(angle) - slope * np.cos(angle)
    np.testing.assert_allclose(turned, expected, rtol=1e-4)


def slanted(search):
    """A threshold of load and kick together; where the line's zero is changes none."""

    def along(angle, zero=0.0):
        def cell(x):
            s = x - zero
            kick = zj.State(omega=(0.0, s * jnp.sin(angle)))
            return dry(1.6 + s * jnp.cos(angle), 0.03), kick

        found = zj.threshold(cell, (zero + 0.05, zero + 0.8), search=search)
        return found.threshold - zero, found.outcome

    return along


def test_where_a_line_begins_changes_no_derivative():
    zeros = jnp.array([0.0, -0.3538, 1000.0])
    along = slanted(zj.Search(scan=4, halvings=12))
    each = jax.vmap(jax.value_and_grad(along, has_aux=True), in_axes=(None, 0))
    (values, outcomes), slopes = jax.jit(each)(0.6, zeros)
    assert (outcomes == zj.CODE.found).all()
    assert abs(values[1] + zeros[1]) < 1e-3  # the threshold is near the second's zero
    np.testing.assert_allclose(slopes, slopes[0], rtol=1e-9)  # measured 1e-12


def test_an_interval_is_too_wide_for_a_derivative_by_what_changes_in_it():
    """The kick, by 3e-3 of itself, wherever the line begins; a load that hardly moves
    vouches for none."""

    def along(tau, zero, share):
        def cell(x):
            s = x - zero
            return dry(1.8 + share * s, tau), zj.State(omega=(0.0, s))

        search = zj.Search(scan=4, halvings=8)
        found = zj.threshold(cell, (zero, zero + 0.8), search=search)
        return found.threshold - zero, found

    each = jax.vmap(jax.value_and_grad(along, has_aux=True), in_axes=(None, 0, 0))
    lines = jnp.array([0.0, 0.0, 1000.0]), jnp.array([0.0, 1e-9, 0.0])
    (values, found), slopes = jax.jit(each)(0.03, *lines)
    assert (found.outcome == zj.CODE.found).all()
    assert (found.width / values > 2e-3).all()
    assert np.isnan(slopes).all()


def test_second_derivatives_of_a_threshold_are_refused(refuses):
    method = Method(Explicit(), 1e-6, 1e-6, 1000)

    def threshold(q):
        def scene(kick):
            return smooth(q, 0.05), zj.State(omega=(0.0, kick))

        return carried(scene, jnp.array(0.3), 1e-3, True, 40.0, 100.0, method)

    twice = jax.grad(jax.grad(threshold))
    refuses(lambda: jax.make_jaxpr(twice)(2.0), "first derivatives only")


def test_bad_arguments_are_named(refuses):
    start, column = zj.State(omega=(0, 1)), smooth(2.0, 0.05)

    def kick(column=column, direction=start, bracket=(0, 1), **options):
        return zj.critical_kick(column, direction, bracket, **options)

    def onset(make=lambda q: smooth(q, 0.05), begin=start, bracket=(1, 2), **options):
        return zj.flutter_onset(make, begin, bracket, **options)

    def line(cell=lambda q: (smooth(q, 0.05), start), bracket=(1, 2), **options):
        return zj.threshold(cell, bracket, **options)

    refuses(lambda: line(cell=column), "`cell`", "function of one number")
    refuses(lambda: line(cell=lambda: column), "`cell`", "one number")
    refuses(lambda: line(cell=lambda q: column), "`cell`", "a column and a start")
    refuses(lambda: line(cell=lambda q: (start, column)), "`cell`", "a column and a")
    refuses(lambda: line(cell=lambda q: (column, 0.3)), "`cell`", "0.3")
    refuses(lambda: line(bracket=(1, 1)), "`bracket`", "(1, 1)")
    refuses(lambda: line(search=3), "`search`", "3")
    refuses(lambda: kick(column=2.0), "`column`", "2.0")
    refuses(lambda: kick(direction=(0, 1)), "`direction`", "`State`")
    refuses(lambda: kick(direction=zj.State()), "`direction`", "zero")
    refuses(lambda: kick(bracket=(1, 0)), "`bracket`", "(1, 0)")
    refuses(lambda: kick(bracket=1.0), "`bracket`", "1.0")
    refuses(lambda: kick(search=zj.Search(scan=0)), "`scan`", "0")
    refuses(lambda: kick(search=zj.Search(halvings=2.5)), "`halvings`", "2.5")
    refuses(lambda: kick(windows=zj.Windows(length=-1)), "`length`", "-1")
    refuses(lambda: onset(make=column), "`make_column`", "function")
    refuses(lambda: onset(make=lambda q: q), "`make_column`", "`Column`")
    refuses(lambda: onset(begin=None), "`start`", "None")
    taylor, layer = zj.Method(zj.Taylor(8)), smooth(2.0, 0.05)
    refuses(lambda: line(lambda q: (layer, start), method=taylor), "`solver`")
    refuses(lambda: kick(layer, method=taylor), "`solver`", "`SetValuedCoulomb`")
    refuses(lambda: onset(lambda q: layer, method=taylor), "`solver`", "Taylor8")


@pytest.mark.parametrize(
    "question, words",
    [
        (lambda c, y: zj.threshold(lambda s: (c, y), (1, 2)), "threshold: the number"),
        (lambda c, y: zj.critical_kick(c, y, (0, 1)), "critical kick, as a multiple"),
        (lambda c, y: zj.flutter_onset(lambda q: c, y, (1, 2)), "onset: the parameter"),
    ],
)
def test_a_threshold_is_named_in_a_dataset_by_what_was_searched(question, words):
    start = zj.State(omega=(0, 0.3))
    program = zj.Program(lambda q: question(smooth(q, 0.05), start))
    assert program.variables["threshold"].long_name.startswith(words)
