"""Flips, tori and pitchforks against multipliers by another code.

Of columns that a search over random ones came upon.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from near import Near, points
from newton_euler import Rods, motion

import ziegler_jax as zj
from ziegler_jax import CODE
from ziegler_jax.analysis import branch_point

FLIP = {"t1": 0.0956765, "c": (0.0313048, 0.0971598), "eta": 0.710525, "k": 1.128130}
NEAR_FLIP = Near((-2.27950, 2.10147, 4.33986), 7.00939, 3.32033, 0.1696786)
TORUS = {"t1": 0.01106865, "c": (0.0341797, 0.0846998), "eta": 0.755108, "k": 1.476009}
NEAR_TORUS = Near((-2.49356, 2.61513, 4.42651), 5.79735, 3.75515, 0.2388106)


def maker(t1, c, eta, k):
    def make(q, t2):
        load = zj.ConstantLoad(1.0)
        law = zj.SetValuedCoulomb((t1, t2), pin_radius=1.0, load=load)
        parts = {"damping": zj.Viscous(*c), "follower": eta, "kappa": k}
        return zj.uniform_rods(q, friction=law, **parts)

    return make


def map_by_another_code(numbers, q, t2, start, period, apart=1e-5):
    """Where the motion ends after a period, and its derivative, by differences."""
    torques = numbers["t1"], t2
    rods = Rods(
        q, torques, torques, viscous=numbers["c"], follower=numbers["eta"],
        kappa=numbers["k"],
    )  # fmt: skip

    def end(y):
        return motion(rods, y, [0.0, period])[0][-1]

    columns = [
        (end(start + e) - end(start - e)) / (2 * apart) for e in apart * np.eye(4)
    ]
    return end(start), np.array(columns).T


def multipliers_by_another_code(numbers, found, i):
    start = np.array([*found.phi[i], *found.omega[i]])
    where = found.first[i], found.second[i]
    end, moved = map_by_another_code(numbers, *where, start, found.period[i])
    assert np.abs(end - start).max() < 3e-8  # measured 2.7e-9
    return np.linalg.eigvals(moved)


def test_along_a_curve_of_flips_a_multiplier_is_minus_one_and_it_moves_as_it_says():
    values = np.array([0.08, 0.2])

    @jax.jit
    def follow(c1, start):
        def moves(c1):
            numbers = FLIP | {"c": (c1, FLIP["c"][1])}
            course = zj.Course(values=values, second=(0.07, 0.3))
            make = maker(**numbers)
            # where the start moves is no matter of the curve's
            moving = start.parameter + (c1 - lax.stop_gradient(c1))
            begin = eqx.tree_at(lambda s: s.parameter, start, moving)
            curve = zj.bifurcation_curve(
                make, "flip", begin, second=NEAR_FLIP.tau, course=course
            )
            found = curve.points
            cycle = found.phi[:, 1], found.omega[:, 0], found.omega[:, 1], found.period
            return jnp.stack([found.first, *cycle]), curve

        return jax.jvp(moves, (c1,), (jnp.ones_like(c1),), has_aux=True)

    start = np.array([0.0, *NEAR_FLIP.y])
    _, moved = map_by_another_code(
        FLIP, NEAR_FLIP.q, NEAR_FLIP.tau, start, NEAR_FLIP.period
    )
    known = points("flip", NEAR_FLIP, moved)
    c1 = FLIP["c"][0]
    _, slope, curve = follow(c1, known)
    curve = jax.tree.map(np.asarray, curve)
    assert curve.outcome == CODE.found and (curve.points.residual < 1e-10).all()
    for i in range(values.size):
        exact = multipliers_by_another_code(FLIP, curve.points, i)
        # measured 2.5e-6: the differences of the other code
        assert np.abs(exact + 1).min() < 1e-5
    # a second pair of curves crosses: another multiplier passes -1
    meets = curve.special.meeting == CODE.minus
    assert meets.sum() == 1 and 0.25 < curve.special.second[meets][0] < 0.26
    h = 1e-5
    ahead, back = (follow(c1 + d, known)[0] for d in (h, -h))
    difference = (ahead - back) / (2 * h)
    # measured 4.7e-8 of it
    np.testing.assert_allclose(slope, difference, rtol=1e-6)


def test_along_a_curve_of_tori_a_pair_is_on_the_circle():
    @jax.jit
    def follow(start):
        course = zj.Course(values=np.array([0.25, 0.3]), second=(0.22, 0.32))
        make = maker(**TORUS)
        return zj.bifurcation_curve(
            make, "torus", start, second=NEAR_TORUS.tau, course=course
        )

    curve = jax.tree.map(np.asarray, follow(points("torus", NEAR_TORUS)))
    assert curve.ends.tolist() == [CODE.beyond, CODE.beyond]
    for i in range(2):
        exact = multipliers_by_another_code(TORUS, curve.points, i)
        pair = exact[exact.imag > 0.1]
        assert len(pair) == 1
        assert abs(np.abs(pair[0]) - 1) < 2e-6  # measured 1.4e-7


PITCHFORK = {
    "t1": 0.0757443,
    "c": (0.0810274, 0.0295234),
    "eta": 0.824821,
    "k": 1.611417,
}
NEAR_PITCHFORK = Near((-2.806612, 1.343591, 2.711923), 5.332162, 4.067715, 0.2004359)


def test_along_a_curve_of_pitchforks_one_more_multiplier_is_one():
    @jax.jit
    def follow(start):
        course = zj.Course(values=np.array([0.1, 0.3]), second=(0.09, 0.31))
        make = maker(**PITCHFORK)
        return zj.bifurcation_curve(
            make, "pitchfork", start, second=NEAR_PITCHFORK.tau, course=course
        )

    curve = jax.tree.map(np.asarray, follow(points("pitchfork", NEAR_PITCHFORK)))
    found = curve.points
    assert curve.outcome == CODE.found and (found.residual < 1e-10).all()
    for i in range(2):
        exact = multipliers_by_another_code(PITCHFORK, found, i)
        assert np.sort(np.abs(exact - 1))[1] < 1e-6  # measured 1.5e-7
        torques = PITCHFORK["t1"], found.second[i]
        rods = Rods(
            found.first[i], torques, torques, viscous=PITCHFORK["c"],
            follower=PITCHFORK["eta"], kappa=PITCHFORK["k"],
        )  # fmt: skip
        start = np.array([*found.phi[i], *found.omega[i]])
        half = motion(rods, start, [0.0, found.period[i] / 2])[0][-1]
        assert np.abs(half + start).max() < 1e-8  # measured 4.1e-10


@pytest.mark.parametrize(
    "kind, numbers, near",
    [
        ("flip", FLIP, NEAR_FLIP),
        ("torus", TORUS, NEAR_TORUS),
        ("pitchfork", PITCHFORK, NEAR_PITCHFORK),
    ],
)
def test_one_bifurcation_is_where_the_multiplier_says_and_moves_as_it_says(
    kind, numbers, near
):
    """Multipliers by another code; the derivative in a damping by differences."""
    step, q = 1e-5, near.q * (1 - 1e-4)

    @jax.jit
    @jax.vmap
    def search(c1):
        def place(c1):
            make = maker(**numbers | {"c": (c1, numbers["c"][1])})

            def column(q):
                return make(q, near.tau)

            guess = zj.State((0.0, near.y[0]), near.y[1:])
            orbit = zj.periodic_orbit(column(q), guess, period=near.period)
            arc = zj.Arc(direction=1, step=0.02, bounds=(0.9 * q, 1.1 * q))
            found = zj.bifurcation(column, kind, orbit, q, arc=arc)
            numbers_of = jnp.stack(
                [found.parameter, found.period, found.cycle.phi[0, 1]]
            )
            return numbers_of, found

        values, moves, found = jax.jvp(place, (c1,), (jnp.ones_like(c1),), has_aux=True)
        return values, moves, found

    c1 = numbers["c"][0]
    values, moves, found = search(c1 * np.array([1.0, 1 + step, 1 - step]))
    assert (found.outcome == CODE.found).all()
    assert (found.cycle.kind == CODE[kind]).all()
    # of rounded numbers: measured 5.7e-6
    assert abs(values[0, 0] - near.q) < 2e-5
    differences = (values[1] - values[2]) / (2 * step * c1)
    np.testing.assert_allclose(moves[0], differences, rtol=1e-4)  # measured 7e-6
    y = np.array([*found.cycle.phi[0, 0], *found.cycle.omega[0, 0]])
    period = float(found.cycle.period[0, 0])
    q = float(found.parameter[0])
    end, moved = map_by_another_code(numbers, q, near.tau, y, period)
    exact = np.linalg.eigvals(moved)
    assert np.abs(end - y).max() < 1e-8  # measured 1.1e-9
    off_by = {
        "flip": np.abs(exact + 1).min(),
        "torus": np.abs(np.abs(exact[np.argmax(exact.imag)]) - 1),
        "pitchfork": np.sort(np.abs(exact - 1))[1],
    }[kind]
    assert off_by < 1e-5  # measured 5.1e-7


@pytest.fixture(scope="module")
def through():
    """A branch of symmetric cycles through a pitchfork: on half its map, and on all."""
    near, make = NEAR_PITCHFORK, maker(**PITCHFORK)
    q = near.q * (1 - 1e-4)

    def column(q):
        return make(q, near.tau)

    def follow():
        guess = zj.State((0.0, near.y[0]), near.y[1:])
        orbit = zj.periodic_orbit(column(q), guess, period=near.period)
        arc = zj.Arc("both", step=0.02, points=8)
        return zj.continue_cycle(column, orbit, q, arc=arc)

    half = jax.jit(follow)()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(branch_point, "is_odd", lambda system: jnp.asarray(False))
        whole = jax.jit(lambda: follow())()
    return column, half, whole


def test_a_symmetric_branch_goes_straight_on_through_its_pitchfork(through):
    _, branch, _ = through
    assert branch.symmetric and branch.outcome == CODE.found
    kinds = branch.special.kind.tolist()
    assert kinds == [CODE.fold, CODE.pitchfork] + [CODE.ordinary] * 6
    fold, fork = np.asarray(branch.special.parameter[:2])
    q = np.asarray(branch.points.parameter[: branch.count])
    assert (np.diff(q) > 0).all() and q[0] > fold and q[1] < fork < q[-1]
    # another code's map of half a period, seen in the mirror, flips there
    near, i = NEAR_PITCHFORK, kinds.index(CODE.pitchfork)
    y = np.array([*branch.special.phi[i], *branch.special.omega[i]])
    period = float(branch.special.period[i])
    end, moved = map_by_another_code(PITCHFORK, fork, near.tau, y, period / 2)
    assert np.abs(end + y).max() < 1e-8  # measured 4.8e-11
    assert np.abs(np.linalg.eigvals(-moved) + 1).min() < 1e-6  # measured 5.2e-9
    _, moved = map_by_another_code(PITCHFORK, fork, near.tau, y, period)
    exact, mine = np.linalg.eigvals(moved), branch.special.multipliers[i]
    assert np.sort(np.abs(exact - 1))[1] < 1e-6  # measured 1.7e-7
    # measured 1.8e-7: the differences of the other code
    np.testing.assert_allclose(np.sort(mine), np.sort(exact), rtol=0, atol=2e-6)


def test_half_the_map_says_of_a_branch_what_all_of_it_says(through):
    _, branch, whole = through
    assert not whole.symmetric and whole.ends.tolist() == branch.ends.tolist()
    assert (whole.special.kind == branch.special.kind).all()
    # measured 2.0e-9, in an amplitude
    for name in ("parameter", "period", "phi", "omega", "joint_amplitude"):
        of_half, of_all = getattr(branch.points, name), getattr(whole.points, name)
        np.testing.assert_allclose(of_half, of_all, rtol=0, atol=1e-8)
    mine, exact = branch.points.monodromy, whole.points.monodromy
    np.testing.assert_allclose(mine, exact, rtol=0, atol=1e-6)  # 1.1e-7
    fold, fork = np.asarray(branch.special.parameter - whole.special.parameter)[:2]
    # measured 6e-11 and 4.3e-6: all of the map is singular there, and has but the chord
    assert abs(fold) < 1e-9 and abs(fork) < 1e-5
    assert int(branch.steps) < 0.5 * int(whole.steps)  # measured 0.34


def test_both_branches_leave_at_a_pitchfork_on_a_branch(through):
    column, branch, _ = through
    near, shifts = NEAR_PITCHFORK, []

    @jax.jit
    def leave(start):
        return [zj.branch_off(column, "pitchfork", start, side=x) for x in (1, -1)]

    for leaves in leave(branch):
        assert leaves.outcome == CODE.found
        start, (half, end) = by_another_code(PITCHFORK, near, leaves, (0.5, 1.0))
        assert np.abs(end - start).max() < 1e-8  # measured 6.6e-10
        assert np.abs(half + start).max() > 0.02
        shifts.append(start[1] - float(branch.special.phi[1, 1]))
    assert shifts[0] * shifts[1] < 0
    arc = zj.Arc("both", step=0.02, points=4)
    follow = jax.jit(lambda o, q: zj.continue_cycle(column, o, q, arc=arc))
    other = follow(leaves.orbit, leaves.parameter)
    assert other.outcome == CODE.found and not other.symmetric


class Uneven(zj.AbstractDamping):
    """A knee that is damped more the one way than the other."""

    rules = {"c": "nonnegative", "by": "finite"}
    units = {"c": "m l^2", "by": "l"}
    c: float
    by: float

    def matrix(self, cos_d, omega):
        c = self.c * (1 + self.by * omega[1] / (1 + omega[1] ** 2))
        return (self.c + c, -c), (-c, c)


def test_where_the_parameter_breaks_the_symmetry_all_of_the_map_is_followed():
    """From its value 0, where the cycle is its own mirror image."""
    law = zj.SmoothCoulomb(0.1, pin_radius=0.1, v_smooth=0.1)

    def column(by):
        return zj.uniform_rods(2.8, friction=law, damping=Uneven(0.02, by))

    @jax.jit
    def follow():
        near = zj.settle(column(0.0), zj.State(omega=(0.0, 0.6))).final
        orbit = zj.periodic_orbit(column(0.0), near)
        arc = zj.Arc("both", points=4)
        branch = zj.continue_cycle(column, orbit, 0.0, arc=arc)
        last = jax.tree.map(lambda x: x[branch.count - 1], branch.points)
        there = zj.State(tuple(last.phi), tuple(last.omega))
        again = zj.periodic_orbit(column(last.parameter), there, period=last.period)
        return branch, last, again

    branch, last, again = follow()
    assert not branch.symmetric and branch.outcome == CODE.found
    assert last.parameter > 0.1
    # measured 3e-15
    np.testing.assert_allclose(again.state.y, [*last.phi, *last.omega], atol=1e-8)


def off(numbers, kind, near, **options):
    """A cycle of the branch that leaves there, and how it moves with a damping."""

    @jax.jit
    def leave(c1, start):
        make = maker(**numbers | {"c": (c1, numbers["c"][1])})
        return zj.branch_off(lambda q: make(q, near.tau), kind, start, **options)

    _, moved = map_by_another_code(
        numbers, near.q, near.tau, np.array([0.0, *near.y]), near.period
    )
    start = points(kind, near, moved)
    return jax.jvp(lambda c1: leave(c1, start), (numbers["c"][0],), (1.0,))


def by_another_code(numbers, near, found, shares):
    """Where the motion from a cycle's start is after these shares of its period."""
    torques = numbers["t1"], near.tau
    rods = Rods(
        float(found.parameter), torques, torques, viscous=numbers["c"],
        follower=numbers["eta"], kappa=numbers["k"],
    )  # fmt: skip
    start = np.array(found.orbit.state.y)
    times = np.array([0.0, *shares]) * float(found.orbit.period)
    return start, motion(rods, start, times)[0][1:]


def test_from_a_flip_a_cycle_of_twice_the_period_leaves_and_comes_back_to_it():
    make, near = maker(**FLIP), NEAR_FLIP
    found, _ = off(FLIP, "flip", near)
    assert found.outcome == found.orbit.outcome == CODE.found
    start, (half, end) = by_another_code(FLIP, near, found, (0.5, 1.0))
    assert np.abs(end - start).max() < 1e-8  # measured 1.8e-9
    assert np.abs(half - start).max() > 0.02
    # its branch turns back at the flip, where a multiplier of half its period is -1
    arc = zj.Arc("both", points=8)
    other = jax.jit(
        lambda o, q: zj.continue_cycle(lambda q: make(q, near.tau), o, q, arc=arc)
    )(found.orbit, found.parameter)
    special = jax.tree.map(np.asarray, other.special)
    folds = np.where(special.kind == CODE.fold, special.parameter, np.inf)
    i, q = np.argmin(folds), np.min(folds)
    near_it = zj.State(tuple(special.phi[i]), tuple(special.omega[i]))
    once = jax.jit(lambda q, y, t: zj.periodic_orbit(make(q, near.tau), y, period=t))
    single = once(q, near_it, special.period[i] / 2)
    y = np.array(single.state.y)
    after, moved = map_by_another_code(FLIP, q, near.tau, y, float(single.period))
    assert np.abs(after - y).max() < 1e-8  # measured 1.1e-9
    assert np.abs(np.linalg.eigvals(moved) + 1).min() < 5e-5  # measured 6.4e-6
    ends = other.points.parameter[np.array([0, other.count - 1])]
    assert (ends > q + 1e-4).all()


def test_from_a_pitchfork_two_cycles_leave_that_are_each_others_mirror_image():
    near = NEAR_PITCHFORK
    both = [off(PITCHFORK, "pitchfork", near, side=side) for side in (1, -1)]
    (one, moves), (other, _) = both
    assert one.outcome == other.outcome == CODE.found
    # no derivative says how far from the crossing it lies
    assert np.isnan([moves.parameter, moves.orbit.period, *moves.orbit.state.y]).all()
    for leaves in (one, other):
        start, (half, end) = by_another_code(PITCHFORK, near, leaves, (0.5, 1.0))
        assert np.abs(end - start).max() < 1e-8  # measured 6.6e-10
        assert np.abs(half + start).max() > 0.02
    column = maker(**PITCHFORK)(one.parameter, near.tau)
    again = zj.periodic_orbit(column, other.orbit.state, period=other.orbit.period)
    # measured 8e-12, and 2e-13
    np.testing.assert_allclose(again.period, one.orbit.period, rtol=1e-10)
    assert abs(again.state.y[3] - one.orbit.state.y[3]) > 0.02
    # its image passes the section downwards: half a turn later it passes upwards
    image = zj.SectionPlane(rising=False)
    down = zj.periodic_orbit(column, again.state, section=image)
    np.testing.assert_allclose(
        -np.array(down.state.y[1:]), one.orbit.state.y[1:], rtol=1e-10
    )


def test_bad_arguments_of_a_crossing_are_named(refuses):
    make, there = maker(**FLIP), points("flip", NEAR_FLIP)

    def leave(make=lambda q: make(q, 0.2), kind="flip", start=there, **options):
        return zj.branch_off(make, kind, start, **options)

    refuses(lambda: leave(make=3), "`make_column`", "3")
    refuses(lambda: leave(kind="fold"), "`kind`", "fold")
    refuses(lambda: leave(start=zj.State()), "`start`", "`CyclePoints`", "State")
    many = jax.tree.map(lambda x: jnp.stack([x, x]), there)
    refuses(lambda: leave(start=many), "`start`", "one branch", "(2,)")
    refuses(lambda: leave(side=0), "`side`", "0")
    refuses(lambda: leave(side=True), "`side`", "True")
    refuses(lambda: leave(side=np.array([1, -1])), "`side`", "array([ 1, -1])")
    refuses(lambda: jax.jit(lambda s: leave(side=s))(1), "`side`", "Tracer")
    refuses(lambda: leave(distance=-0.5), "`distance`", "-0.5")
    refuses(
        lambda: leave(method=zj.Method(zj.Rosenbrock())), "`solver`", "`branch_off`"
    )


def test_where_nothing_leaves_no_cycle_is_said_to():
    """At an ordinary cycle, whose double is a cycle of twice the period, too."""
    near = NEAR_PITCHFORK
    found, _ = off(PITCHFORK, "flip", near)
    assert found.outcome == CODE.no_start
    assert np.isnan([found.parameter, found.orbit.period]).all()
    make = maker(**PITCHFORK)

    @jax.jit
    def leave(start):
        return zj.branch_off(lambda q: make(q, near.tau), "pitchfork", start)

    assert leave(points("fold", near)).outcome == CODE.no_start
    assert leave(points("pitchfork", near)).outcome == CODE.invalid  # no multipliers
    # a cycle beside the pitchfork that is no mirror image of itself
    found, _ = off(PITCHFORK, "pitchfork", near, distance=1e-3)
    assert found.outcome == CODE.found
    there = Near(
        tuple(map(float, found.orbit.state.y[1:])), float(found.orbit.period),
        float(found.parameter), near.tau,
    )  # fmt: skip
    again = leave(points("pitchfork", there, found.orbit.monodromy))
    assert again.outcome == CODE.no_start
    assert np.isnan([again.parameter, again.orbit.period]).all()
