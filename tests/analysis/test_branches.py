"""A branch of cycles through its fold against shooting in scipy; special points."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from models import UNIFORM, flow
from options import options_of
from scipy.optimize import brentq, fsolve

import ziegler_jax as zj
from ziegler_jax import CODE
from ziegler_jax.analysis.branch_point import (
    TESTS,
    BranchPoint,
    Continuation,
    codes_of,
    other_multipliers,
    products,
)
from ziegler_jax.analysis.continuation import along_arc
from ziegler_jax.analysis.march import Walk

# A column with smoothed friction, whose cycle folds -----------------------------------

TAU, V_SMOOTH = 0.1, 0.1
HIGH = 2.4  # where the branch begins
APART = 0.005  # rates about the fold


def numbers(q):
    """Of the tests' own column: friction alone."""
    return q, TAU, V_SMOOTH, 0.0, 0.0


def on_the_cycle():
    """Where another code's motion passes phi1 = 0 at the highest load."""

    def rising(t, y):
        return y[0]

    rising.direction = 1
    kicked = (0.0, 0.0, 0.0, 1.5)
    return flow(kicked, 150.0, numbers(HIGH), events=rising).y_events[0][-1]


def shot(rate, guess):
    """phi2, w2, period and load of the cycle that passes phi1 = 0 at this rate w1.

    The rate falls all along the branch, also where the load turns back: so the fold is
    no special point of these equations.
    """

    def miss(x):
        phi2, w2, period, q = x
        start = np.array([0.0, phi2, rate, w2])
        return flow(start, period, numbers(q), 1e-12).y[:, -1] - start

    found, _, good, why = fsolve(miss, guess, xtol=1e-11, full_output=True)
    assert good == 1 or np.abs(miss(found)).max() < 1e-10, why
    return found


def map_of(y, period, q, apart=1e-5):
    """The derivative of the motion over a period, from differences."""
    columns = []
    for e in apart * np.eye(4):
        ends = [flow(y + s * e, period, numbers(q), 1e-12).y[:, -1] for s in (1, -1)]
        columns.append((ends[0] - ends[1]) / (2 * apart))
    return np.array(columns).T


@pytest.fixture(scope="module")
def branch():
    """From the load 2.4 down to the fold and up again, as (points, special, ...)."""
    start = on_the_cycle()

    def column(q):
        load = zj.ConstantLoad(1.0)
        law = zj.SmoothCoulomb(TAU, pin_radius=1.0, v_smooth=V_SMOOTH, load=load)
        return zj.uniform_rods(q, friction=law)

    @jax.jit
    def follow(y):
        guess = zj.State((y[0], y[1]), (y[2], y[3]))
        orbit = zj.periodic_orbit(column(HIGH), guess)
        arc = zj.Arc(direction=-1, points=31, error=1.0)  # steps as long as may be
        found = zj.continue_cycle(column, orbit, HIGH, arc=arc, max_special_points=2)
        return found, found.points.multipliers

    found, multipliers = follow(start)
    return start, jax.tree.map(np.asarray, found), np.asarray(multipliers)


def rows(points):
    """w1 and, beside it, phi2, w2, period and load."""
    (_, phi2), (w1, w2) = points.phi.T, points.omega.T
    return w1, np.stack([phi2, w2, points.period, points.parameter], -1)


@pytest.fixture(scope="module")
def shots(branch):
    """Another code's branch: eight cycles by their rates, and three about the fold."""
    start, found, _ = branch
    rates, known = rows(found.points)
    chosen = np.array([0, 4, 6, 9, 13, 19, 21, 23, 25])
    assert (np.diff(rates[chosen][2:]) < 0).all()
    first = 7.0  # its period, about
    path = [shot(rates[0], (start[1], start[3], first, HIGH))]
    for i, j in zip(chosen[1:], chosen[:-1], strict=True):
        # from the one before; the package says only where to look
        path.append(shot(rates[i], path[-1] + known[i] - known[j] + 1e-3))
    at = rows(found.special)[0][0]
    near = [shot(at + by, path[5]) for by in (-APART, 0.0, APART)]
    return chosen, np.array(path), np.array(near)


def test_a_branch_is_the_one_that_another_code_shoots(branch, shots):
    _, found, _ = branch
    chosen, path, _ = shots
    assert int(found.count) == 31
    known = rows(found.points)[1][chosen]
    # both sides of the fold, and loads that come twice
    q = known[:, 3]
    assert (np.diff(q[:5]) < 0).all() and (np.diff(q[-4:]) > 0).all()
    # measured 9e-11: phi2, w2, period, load
    np.testing.assert_allclose(known, path, rtol=0, atol=1e-9)


def test_the_fold_is_where_another_codes_load_turns_back(branch, shots):
    _, found, _ = branch
    below, at, above = shots[2][:, 3]
    assert found.special.kind[0] == CODE.fold
    fold = found.special.parameter[0]
    assert abs(fold - at) < 1e-10  # measured 2e-13
    # the vertex of the parabola: what is left falls with the square of APART
    slope, bend = (above - below) / (2 * APART), (above - 2 * at + below) / APART**2
    assert bend > 0 and abs(slope / bend) < 3e-4  # measured 6e-5


def test_a_cycle_loses_its_stability_at_the_fold_by_anothers_multipliers(branch, shots):
    _, found, multipliers = branch
    chosen, path, _ = shots
    rates = rows(found.points)[0]
    for k, stable in ((3, True), (7, False)):
        i, (phi2, w2, period, q) = chosen[k], path[k]
        y = np.array([0.0, phi2, rates[i], w2])
        exact = np.linalg.eigvals(map_of(y, period, q))
        exact = exact[np.argsort(-np.abs(exact))]
        mine = multipliers[i][np.argsort(-np.abs(multipliers[i]))]
        # measured 1.5e-8: the differences
        np.testing.assert_allclose(np.abs(mine), np.abs(exact), rtol=0, atol=2e-7)
        assert found.points.stable[i] == stable
        assert (np.abs(exact) > 1 + 1e-3).any() != stable


def birth():
    """Load, 128/45, and frequency where the equilibrium loses its stability."""
    a, b, d = UNIFORM
    inverse = np.linalg.inv([[a, b], [b, d]])
    damping = TAU / V_SMOOTH * np.array([[2.0, -1.0], [-1.0, 1.0]])

    def roots(q):
        stiff = np.array([[2 - q, q - 1], [-1.0, 1.0]])
        lower = np.hstack([-inverse @ stiff, -inverse @ damping])
        return np.linalg.eigvals(np.vstack([np.eye(2, 4, 2), lower]))

    q = brentq(lambda q: roots(q).real.max(), 1.0, 4.0)
    return q, np.abs(roots(q).imag).max()


def test_a_branch_ends_where_the_equilibrium_loses_its_stability(branch):
    """Load and period as functions of the squared amplitude, continued to zero."""
    q, omega = birth()
    points = branch[1].points
    last = slice(26, 31)
    square = points.joint_amplitude[last, 1] ** 2
    for values, exact in ((points.parameter, q), (points.period, 2 * np.pi / omega)):
        # the quartic's own error; measured 2.6e-4 and 8.7e-5
        assert abs(np.polyfit(square, values[last], 4)[-1] - exact) < 1e-3


def hidden(rng, total, product, third):
    """A (4, 4) with multipliers 1, a, b, third, where a + b = total, a b = product."""
    block = jnp.zeros((4, 4)).at[0, 0].set(1.0).at[3, 3].set(third)
    block = block.at[1, 2].set(-product).at[2, 1].set(1.0).at[2, 2].set(total)
    basis = np.eye(4) + 0.3 * rng.standard_normal((4, 4))
    moved = jnp.asarray(basis) @ block @ jnp.asarray(np.linalg.inv(basis))
    return moved, jnp.zeros((4, 5)).at[:, 3].set(basis[:, 0])


def test_the_tests_are_the_products_over_the_multipliers(rng):
    for total, product, third in rng.standard_normal((20, 3)):
        a, b = np.roots([1, -total, product])
        c = third
        exact = (a * b - 1) * (a * c - 1) * (b * c - 1)
        exact = exact, (1 + a) * (1 + b) * (1 + c), (1 - a) * (1 - b) * (1 - c)
        moved, matrix = hidden(rng, total, product, third)
        section = zj.SectionPlane()
        found = products(other_multipliers(section, moved, matrix))
        # measured 7e-15
        np.testing.assert_allclose(found, np.real(exact), rtol=0, atol=1e-12)


class KnownBranch(Continuation):
    """A straight branch from 0 to 1 whose multipliers are linear in the parameter."""

    def __init__(self, path, rate):
        self.path, self.rate = path, rate
        self.first = jnp.array([0.0, 1.0, 0.0, 1.0, 0.0])
        self.scale = jnp.ones(5)
        self.arc = zj.Arc(direction=1, step=1.2, points=40, bounds=(-1.0, 1.0))
        self.rods, self.along = 2, 4
        self.section, self.method = zj.SectionPlane(), zj.Method(max_steps=1000)
        self.failure = jnp.asarray(0)

    def correct(self, x0, row, left):
        """The predicted point: the branch has no bends."""
        at = self.path[:, 0] + self.path[:, 1] * x0[4]
        moved, matrix = hidden(np.random.default_rng(1), *at)
        matrix = self.rate * matrix
        others = other_multipliers(self.section, moved, matrix)
        tangent = jnp.zeros(5).at[4].set(jnp.where(row[4] < 0, -1.0, 1.0))
        tests = jnp.stack([tangent[4], *products(others)])
        ends = moved, matrix, tests, jnp.zeros(())
        point = BranchPoint(x0, tangent, jnp.zeros(3), *ends)
        return point, jnp.asarray(True), jnp.asarray(1), left


@pytest.mark.parametrize("rate", [1.0, -1.0])
def test_special_points_are_found_where_multipliers_pass_the_unit_circle(rate):
    """The first step goes past all of them, whichever way it passes the section."""
    # sum, product of a pair, the third: at the start, and by how much they grow
    paths = {
        "a complex pair at 0.3, the third at -1 at 0.75": [(1, 0), (0.7, 1), (0.5, -2)],
        "2 and 1/2 are no torus": [(2.5, 0), (0.7, 0.5), (0.3, 0)],
        "reciprocal at 0.16, one is 1 at 0.5": [
            (2.01, -0.06),
            (0.98 * 1.03, -0.98 * 0.06),
            (0.3, 0),
        ],
        "one is -1 at 0.25, where the other is 0.2": [(-0.7, -0.4), (-0.1, -0.4)]
        + [(0.1, 0)],
    }

    @jax.jit
    @jax.vmap
    def follow(path):
        end = Walk(KnownBranch(path, rate), 3, (True,) * 4, False).follow()
        return codes_of(end.kind, TESTS), end.special.x[:, 4]

    kind, place = follow(np.array(list(paths.values()), float))
    torus, flip, pitchfork = CODE.torus, CODE.flip, CODE.pitchfork
    none = CODE.ordinary
    assert kind.tolist() == [
        [torus, flip, none],
        [none, none, none],
        [pitchfork, none, none],
        [flip, none, none],
    ]
    known = [0.3, 0.75, 0.5, 0.25]
    found = [place[0, 0], place[0, 1], place[2, 0], place[3, 0]]
    np.testing.assert_allclose(found, known, rtol=0, atol=1e-8)


def test_both_ways_from_a_cycle_stand_in_one_row_along_the_arc():
    path = np.array([(1, 0), (0.7, 1), (0.5, -2)], float)
    problem = KnownBranch(path, 1.0)
    problem.arc = zj.Arc("both", step=0.15, points=40, bounds=(-0.5, 1.0))

    def walk(direction):
        return Walk(problem.heading(direction), 3, (True,) * 4, False).follow()

    ways = jax.vmap(walk)(jnp.array([-1.0, 1.0]))
    row, (behind, ahead) = along_arc(ways), ways.filled
    places, count = row.points.x[:, 4], behind + ahead - 1
    assert behind > 4 and ahead > 7 and places.shape == (79,)
    assert np.isfinite(places[:count]).all() and np.isnan(places[count:]).all()
    assert (np.diff(places[:count]) > 0).all() and places[behind - 1] == 0
    assert places[0] < -0.5 and places[count - 1] > 1
    found = [CODE.pitchfork, CODE.torus, CODE.flip]
    assert codes_of(row.kind, TESTS).tolist() == found + [CODE.ordinary] * 3
    # measured 1.6e-15
    np.testing.assert_allclose(row.special.x[:3, 4], [-0.25, 0.3, 0.75], atol=1e-8)


def bending(q):
    """A column whose branch bends fast between q = 1.9 and its fold."""
    law = zj.SmoothCoulomb(0.1, pin_radius=0.1, v_smooth=0.1)
    return zj.uniform_rods(q, friction=law, damping=zj.Viscous(0.02, 0.02))


def test_lines_through_a_branchs_points_pass_through_stable_cycles_of_a_sweep():
    @jax.jit
    def follow():
        settled = zj.settle(bending(2.8), zj.State(omega=(0.0, 0.6)))
        orbit = zj.periodic_orbit(bending(2.8), settled.final)
        return zj.continue_cycle(bending, orbit, 2.8, arc=zj.Arc(direction=-1))

    branch = follow()
    points = branch.points
    kinds = np.asarray(branch.special.kind)
    # the fold alone: where the branch is born, at the other end, nothing folds
    assert kinds.tolist() == [CODE.fold] + [CODE.ordinary] * 3
    assert branch.outcome == zj.CODE.collapsed
    q, stable = np.asarray(points.parameter), np.asarray(points.stable)
    turn = int(np.nanargmin(q))
    last = int(branch.count) - 2
    assert stable[: turn - 1].all() and not stable[turn + 1 : last].any()
    loads = np.linspace(1.56, 2.78, 25)

    def settled(q):
        start = zj.State(omega=(0.0, 1.2))
        return zj.settle(bending(q), start, method=zj.Method(rtol=1e-9))

    ds = zj.sweep(settled, q=loads, progress=False)
    assert ds.outcome.isin([zj.CODE.cycle, zj.CODE.repeats]).all()
    upper = slice(turn, None, -1)
    drawn = np.stack(
        [
            np.interp(loads, q[upper], np.asarray(points.joint_amplitude)[upper, joint])
            for joint in range(2)
        ],
        axis=1,
    )
    # measured 9.8e-5, by steps of 0.045 in q at most
    assert np.abs(drawn - ds.joint_amplitude.values).max() < 1e-4


# Loads and periods at three folds of one branch by AUTO-07p's collocation
# (`tests/reference/auto_branch.py`): smoothed friction 0.1 at 0.05, damping 0.002.
AUTO_FOLDS = [(1.612026339, 8.2639965678), (1.6510286132, 8.2696279843)]
AUTO_FOLDS += [(1.6247482283, 8.3501537175)]


def folding(q):
    load = zj.ConstantLoad(1.0)
    law = zj.SmoothCoulomb(0.1, pin_radius=1.0, v_smooth=0.05, load=load)
    return zj.uniform_rods(q, friction=law, damping=zj.Viscous(0.002, 0.002))


def test_a_branch_passes_the_three_folds_that_auto_finds():
    @jax.jit
    def follow():
        near = zj.settle(folding(1.8), zj.State(omega=(0.0, 1.2)), certify=False)
        orbit = zj.periodic_orbit(folding(1.8), near.final)
        arc = zj.Arc(direction=-1, bounds=(1.5, 1.85))
        return zj.continue_cycle(folding, orbit, 1.8, arc=arc).special

    special = follow()
    assert special.kind.tolist() == [CODE.fold] * 3 + [CODE.ordinary]
    mine = np.stack([special.parameter, special.period], axis=1)[:3]
    # measured 1.5e-9, in a period; the loads agree to all digits that AUTO prints
    np.testing.assert_allclose(mine, AUTO_FOLDS, rtol=0, atol=1e-8)


def test_one_call_follows_a_branch_both_ways_through_all_its_folds():
    """From the unstable cycle between the first two folds of AUTO's branch."""

    @jax.jit
    def follow(start, q):
        orbit = zj.periodic_orbit(folding(q), start)
        return zj.continue_cycle(
            folding, orbit, q, arc=zj.Arc("both", bounds=(1.5, 1.85))
        )

    at = 1.6335246694
    branch = follow(zj.State((0.0, -0.13764246), (0.4872878, 0.90124433)), at)
    assert branch.outcome == CODE.beyond and branch.symmetric
    assert branch.ends.tolist() == [CODE.beyond] * 2
    folds = branch.special.kind == CODE.fold
    assert folds.sum() == 3
    mine = np.stack([branch.special.parameter, branch.special.period], axis=1)[folds]
    # measured 3.4e-9, in a period
    np.testing.assert_allclose(mine, AUTO_FOLDS, rtol=0, atol=1e-8)
    # from end to end without a gap: each neighbour within a step on the arc
    count = int(branch.count)
    q, period = (np.asarray(x) for x in (branch.points.parameter, branch.points.period))
    assert np.isfinite(q[:count]).all() and np.isnan(q[count:]).all()
    assert np.abs(np.diff(q[:count])).max() <= 0.1 * at * (1 + 1e-6)
    assert np.abs(np.diff(period[:count])).max() <= 0.1 * period[0] * (1 + 1e-2)
    turns = np.diff(np.sign(np.diff(q[:count]))) != 0
    assert turns.sum() == 3
    assert q[0] > 1.85 > q[1] and q[count - 1] > 1.85 > q[count - 2]


def test_bad_arguments_are_named(refuses):
    def make(q):
        return zj.uniform_rods(q, damping=zj.Viscous(0.1, 0.1))

    guess = zj.State(omega=(0.0, 0.3))
    # its numbers are not asked for
    known = jax.eval_shape(lambda: zj.periodic_orbit(make(2.0), guess))

    def follow(make=make, orbit=known, parameter=2.0, **fields):
        def call():
            options = options_of(zj.continue_cycle, **fields)
            return zj.continue_cycle(make, orbit, parameter, **options)

        return call

    def fold(**fields):
        return lambda: zj.bifurcation(
            make, "fold", known, 2.0, **options_of(zj.bifurcation, **fields)
        )

    def orbit(guess=guess, **fields):
        return lambda: zj.periodic_orbit(
            make(2.0), guess, **options_of(zj.periodic_orbit, **fields)
        )

    two = np.array([1.0, 2.0])
    refuses(follow(make=make(2.0)), "`make_column`", "function of one number")
    refuses(follow(make=lambda q: q), "`make_column`", "must return a `Column`")
    refuses(follow(orbit=(0, 0.3)), "`orbit`", "`PeriodicOrbit`", "(0, 0.3)")
    refuses(follow(parameter=two), "`parameter`", "single number", "(2,)")
    refuses(follow(parameter=jnp.ones(2)), "`parameter`", "single number", "(2,)")
    refuses(follow(bounds=(3.0, 1.0)), "`bounds`", "increase", "(3.0, 1.0)")
    refuses(
        follow(bounds=(2.1, 3.0)), "`bounds`", "hold `parameter`", "(2.1, 3.0)", "2.0"
    )
    refuses(follow(bounds=1.0), "`bounds`", "two numbers", "1.0")
    refuses(follow(direction=0), "`direction`", '1, -1 or "both"', "0")
    refuses(fold(direction="both"), "`direction`", "1 or -1", "to a bifurcation")
    refuses(follow(step=-0.1), "`step`", "positive", "-0.1")
    refuses(follow(points=0), "`points`", "at least 1", "0")
    refuses(follow(arc=0.1), "`arc`", "`Arc`", "0.1")
    refuses(follow(max_special_points=0), "`max_special_points`", "at least 1", "0")
    refuses(fold(points=0), "`points`", "at least 1", "0")
    refuses(fold(bounds=(3.0, 1.0)), "`bounds`", "increase")
    refuses(orbit(returns=1.5), "`returns`", "whole number", "1.5")
    refuses(orbit(period=-1.0), "`period`", "positive", "-1")
    refuses(orbit(guess=(0, 1)), "`guess`", "`State`")
