"""Curves of bifurcations against other codes' figures, multipliers and stick fractions.

What `NEAR` has is where to look, rounded: Newton's method starts there.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from newton_euler import Rods, motion

import ziegler_jax as zj
from ziegler_jax import CURVE, MEETING, ORBIT, SPECIAL
from ziegler_jax.curves.degeneracy import Flip, Fold, Torus
from ziegler_jax.curves.fill import Knots, evenly
from ziegler_jax.curves.jets import Jet

pytestmark = pytest.mark.usefixtures("unoptimised")


class Near(NamedTuple):
    """A cycle near a bifurcation: phi2, omega1, omega2 at phi1 = 0, T, q, torque."""

    y: tuple[float, float, float]
    period: float
    q: float
    tau: float


def points(kind, near, monodromy=None):
    """As a branch has its special points."""
    unknown = jnp.full((1, 2), jnp.nan)
    moved = np.full((4, 4), np.nan) if monodromy is None else monodromy
    return zj.CyclePoints(
        parameter=jnp.array([near.q]),
        phi=jnp.array([[0.0, near.y[0]]]),
        omega=jnp.array([near.y[1:]]),
        period=jnp.array([near.period]),
        rod_amplitude=unknown,
        joint_amplitude=unknown,
        monodromy=jnp.asarray(moved)[None],
        kind=jnp.array([SPECIAL[kind]]),
        settings=(("section", "phi1 rising"),),
    )


# Folds, equal constant torques --------------------------------------------------------

FOLDS = {
    "lowest": Near((-0.0079, 0.2286, 0.4051), 8.4959, 1.3281, 0.03),
    "its upper part": Near((-0.0486, 0.4830, 1.0331), 8.3428, 1.5710, 0.1),
    "another cycle": Near((-0.2433, 0.5440, 0.5440), 8.7495, 1.8614, 0.26),
}
# by another code, to five digits; at 0.06 the lowest one is about to end
TAU = np.array([0.01, 0.03, 0.06, 0.1, 0.26])
KNOWN = {
    "lowest": [1.28802, 1.32807, None, None, None],
    "its upper part": [None, None, None, 1.57105, None],
    "another cycle": [None, None, None, 1.61206, 1.86140],
}


def dry(q, tau):
    law = zj.SetValuedCoulomb(tau, pin_radius=1.0, load=zj.ConstantLoad(1.0))
    return zj.uniform_rods(q, friction=law)


@pytest.fixture(scope="module")
def folds(unoptimised):
    """The three curves of folds."""

    @jax.jit
    def follow(start, tau):
        course = zj.Course(values=TAU, second=(0.0025, 0.3))
        return zj.bifurcation_curve(dry, "fold", start, second=tau, course=course)

    return {
        name: jax.tree.map(np.asarray, follow(points("fold", near), near.tau))
        for name, near in FOLDS.items()
    }


@pytest.mark.slow
@pytest.mark.parametrize("name", FOLDS)
def test_folds_of_dry_friction_are_another_codes(folds, name):
    found = folds[name].points
    for q, residual, known in zip(
        found.first, found.residual, KNOWN[name], strict=True
    ):
        if known is not None:
            assert abs(q - known) < 1e-5  # measured 4.4e-6: their last digit
            assert residual < 1e-10
    # what a curve does not come to is NaN, and says so
    there = np.isfinite(found.first)
    assert (there == (found.outcome == ORBIT.found)).all() and not there.all()


@pytest.mark.slow
def test_curves_of_folds_end_at_their_bounds_and_where_the_cycle_grazes(folds):
    ends = {name: curve.ends.tolist() for name, curve in folds.items()}
    assert ends == {
        "lowest": [CURVE.beyond, CURVE.modes_change],
        "its upper part": [CURVE.modes_change, CURVE.beyond],
        "another cycle": [CURVE.modes_change, CURVE.beyond],
    }
    # just before the end joint 2's rate all but vanishes while it slips
    found, i = folds["lowest"].points, 2
    start = [*found.phi[i], *found.omega[i]]
    rods = Rods(found.first[i], (TAU[i],) * 2, (TAU[i],) * 2)
    states, events = motion(rods, start, np.linspace(0, found.period[i], 2001))
    u2 = states[:, 3] - states[:, 2]
    first = np.array([t for t, joint, _ in events if joint == 2]).min()
    slips = np.linspace(0, found.period[i], 2001) < 0.9 * first
    assert 0 < u2[slips].min() < 1e-2
    # and that code closes the cycle, too, as it does those below
    np.testing.assert_allclose(states[-1], start, rtol=0, atol=3e-8)


# Flips and tori of columns that a search over random ones came upon ------------------

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


@pytest.mark.slow
def test_along_a_curve_of_flips_a_multiplier_is_minus_one_and_it_moves_as_it_says():
    values = np.array([0.08, 0.2])

    @jax.jit
    def follow(c1, start):
        def first(c1):
            numbers = FLIP | {"c": (c1, FLIP["c"][1])}
            course = zj.Course(values=values, second=(0.07, 0.3))
            make = maker(**numbers)
            curve = zj.bifurcation_curve(
                make, "flip", start, second=NEAR_FLIP.tau, course=course
            )
            return curve.points.first, curve

        return jax.jvp(first, (c1,), (jnp.ones_like(c1),), has_aux=True)

    start = np.array([0.0, *NEAR_FLIP.y])
    _, moved = map_by_another_code(
        FLIP, NEAR_FLIP.q, NEAR_FLIP.tau, start, NEAR_FLIP.period
    )
    known = points("flip", NEAR_FLIP, moved)
    c1 = FLIP["c"][0]
    first, slope, curve = follow(c1, known)
    curve = jax.tree.map(np.asarray, curve)
    assert curve.outcome == ORBIT.found and (curve.points.residual < 1e-10).all()
    for i in range(values.size):
        exact = multipliers_by_another_code(FLIP, curve.points, i)
        # measured 2.5e-6: the differences of the other code
        assert np.abs(exact + 1).min() < 1e-5
    # a second pair of curves crosses: another multiplier passes -1
    meets = curve.special.meeting == MEETING.minus
    assert meets.sum() == 1 and 0.25 < curve.special.second[meets][0] < 0.26
    h = 1e-5
    ahead, back = (follow(c1 + d, known)[0] for d in (h, -h))
    # measured 2.3e-8 of it
    np.testing.assert_allclose(slope, (ahead - back) / (2 * h), rtol=1e-6)


@pytest.mark.slow
def test_along_a_curve_of_tori_a_pair_is_on_the_circle():
    @jax.jit
    def follow(start):
        course = zj.Course(values=np.array([0.25, 0.3]), second=(0.22, 0.32))
        make = maker(**TORUS)
        return zj.bifurcation_curve(
            make, "torus", start, second=NEAR_TORUS.tau, course=course
        )

    curve = jax.tree.map(np.asarray, follow(points("torus", NEAR_TORUS)))
    assert curve.ends.tolist() == [CURVE.beyond, CURVE.beyond]
    for i in range(2):
        exact = multipliers_by_another_code(TORUS, curve.points, i)
        pair = exact[exact.imag > 0.1]
        assert len(pair) == 1
        assert abs(np.abs(pair[0]) - 1) < 2e-6  # measured 1.4e-7


# Where a joint begins to stick -------------------------------------------------------


@pytest.mark.slow
def test_a_joint_begins_to_stick_where_the_curve_says():
    @jax.jit
    def follow():
        settled = zj.settle(dry(2.6, 0.023), zj.State(omega=(0.0, 3.0)), certify=False)
        orbit = zj.periodic_orbit(dry(2.6, 0.023), settled.final)
        course = zj.Course(values=np.array([0.015, 0.02, 0.03]), second=(0.014, 0.031))
        return zj.bifurcation_curve(
            dry, "sticking_2", orbit, first=2.6, second=0.023, course=course
        )

    curve = jax.tree.map(np.asarray, follow())
    q, tau = curve.points.first, curve.points.second
    assert (curve.points.residual < 1e-10).all()
    assert (np.diff(q) > 0).all()

    def share(q, tau):
        """Of the time, by another motion: a long one on the attractor."""
        start, observers = zj.State(omega=(0.0, 3.0)), (zj.StickFraction(),)
        return zj.settle(dry(q, tau), start, observers=observers, certify=False)

    shares = jax.jit(jax.vmap(lambda q, tau: share(q, tau).stick_fraction[1]))
    # on the one side it never sticks, on the other it does, within 0.03 % in the torque
    below, above = (np.asarray(shares(q, tau * (1 + d))) for d in (-3e-4, 3e-4))
    assert (below == 0).all() and (above > 0).all()


# The equations, without a motion -----------------------------------------------------


def jet_of_map(first, second):
    no, zero = jnp.asarray(False), jnp.zeros(())
    ends = jnp.zeros(3), zero, (), no, ~no, jnp.zeros((), jnp.int32)
    return Jet(jnp.zeros(4), first, second, *ends)


@pytest.mark.parametrize("kind", [Fold, Flip, Torus], ids=lambda k: k.__name__)
def test_null_vectors_annul_and_the_equations_have_their_jacobian(kind, rng):
    degeneracy = kind()
    basis = jnp.asarray(np.eye(7, 6, k=-1))  # phi2, omega1, omega2, T, both parameters
    first = rng.standard_normal((4, 7))
    if kind is Fold:
        left = rng.standard_normal(4)
        closing = first - np.eye(4, 7)
        inner = closing[:, 1:5]
        # one column is made to depend on the others
        inner[:, 0] = inner[:, 1:] @ left[1:]
        first[:, 1:5] = inner + np.eye(4, 7)[:, 1:5]
    else:
        c, s = (-1.0, 0.0) if kind is Flip else np.array([np.cos(0.7), np.sin(0.7)])
        block = np.diag([1.0, 0.3, c, c])
        block[2, 3], block[3, 2] = -s, s
        block[3, 3] = 0.2 if kind is Flip else c
        axes = rng.standard_normal((4, 4))
        first[:, :4] = axes @ block @ np.linalg.inv(axes)
    second = rng.standard_normal((degeneracy.vectors, 4, 7))
    jet = jet_of_map(jnp.asarray(first), jnp.asarray(second))
    closing = jet.first - jnp.eye(4, 7)
    extra = degeneracy.begin(closing, basis)
    block = degeneracy.block(jet, extra, extra, basis)
    assert np.abs(block.residual).max() < 1e-12  # measured 2e-15
    if kind is Torus:
        assert abs(extra[8] - 0.7) < 1e-12

    def residual(extra, reference=extra):
        return degeneracy.block(jet, extra, reference, basis).residual

    exact = jax.jacfwd(residual)(extra)
    np.testing.assert_allclose(block.in_extra, exact, rtol=0, atol=1e-13)


def test_points_between_knots_lie_on_the_curve():
    """Of a circle in two of the unknowns; the error falls with the fourth power."""

    def miss(count):
        angle = np.linspace(0, 2, count)
        zero = np.zeros((count, 4))
        x = np.column_stack([np.cos(angle), np.sin(angle), zero])
        tangent = np.column_stack([-np.sin(angle), np.cos(angle), zero])
        room = jnp.full((5, 6), jnp.nan)
        knots = Knots(
            jnp.concatenate([x, room]), jnp.concatenate([tangent, room]),
            jnp.asarray(count), jnp.asarray(0),
        )  # fmt: skip
        found, _ = evenly(knots, 101)
        np.testing.assert_allclose(found[0], x[0], rtol=0, atol=1e-15)
        np.testing.assert_allclose(found[-1], x[-1], rtol=0, atol=1e-12)
        return np.abs(np.hypot(found[:, 0], found[:, 1]) - 1).max()

    coarse, fine = miss(9), miss(17)
    assert coarse < 3e-4  # measured 1.6e-4: the chord stands for the arc's length
    assert coarse / fine > 3.5


def test_bad_arguments_are_named(refuses):
    near = points("fold", FOLDS["lowest"])

    def call(kind="fold", start=near, make=dry, **more):
        given = {"second": 0.03} | more
        return lambda: zj.bifurcation_curve(make, kind, start, **given)

    refuses(call(kind="hopf"), "`kind`", "hopf")
    refuses(call(start=3), "`start`", "`PeriodicOrbit`", "3")
    refuses(call(first=1.3), "`first`", "left out", "1.3")
    refuses(call(kind="sticking_2"), "`start`", "`PeriodicOrbit`", "sticking_2")
    refuses(call(make=2.0), "`make_column`", "2.0")
    refuses(call(course=3), "`course`", "`Course`", "3")
    refuses(call(second=np.ones(2)), "`second`", "single number", "(2,)")
    outside = zj.Course(second=(0.3, 0.4))
    refuses(call(course=outside), "`second`", "bounds of `course`", "(0.3, 0.4)")
    refuses(lambda: zj.Course(points=0), "`points`", "at least 1", "0")
    refuses(lambda: zj.Course(values=1.0), "`values`", "one dimension", "()")
    refuses(lambda: zj.Course(values=[np.nan]), "`values`", "finite")
    refuses(lambda: zj.Course(step=-1.0), "`step`", "positive", "-1")
    refuses(lambda: zj.Course(second=(0.3, 0.1)), "`second`", "increase", "(0.3, 0.1)")
