"""Curves of folds against other codes' figures; the equations without a motion."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from near import Near, dry, points
from newton_euler import Rods, motion
from scipy.interpolate import CubicSpline

import ziegler_jax as zj
from ziegler_jax import CODE
from ziegler_jax.curves.degeneracy import Flip, Fold, Torus
from ziegler_jax.curves.fill import Knots, evenly
from ziegler_jax.curves.start import of_points
from ziegler_jax.steady.jets import Jet

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


@pytest.fixture(scope="module")
def follow():
    """A curve of folds and how it moves with viscous damping: one program for all."""

    @jax.jit
    def curve_and_slopes(start, tau, c):
        def curve(c):
            course = zj.Course(values=TAU, second=(0.0025, 0.3))

            def make(q, tau):
                return dry(q, tau, damping=zj.Viscous(c, c))

            found = zj.bifurcation_curve(make, "fold", start, second=tau, course=course)
            return found.points, found

        _, slopes, found = jax.jvp(curve, (c,), (1.0,), has_aux=True)
        return found, slopes

    def of(name, c=0.0):
        near = FOLDS[name]
        found = curve_and_slopes(points("fold", near), near.tau, c)
        return jax.tree.map(np.asarray, found)

    return of


@pytest.fixture(scope="module")
def folds(follow):
    """The three curves of folds without damping."""
    return {name: follow(name)[0] for name in FOLDS}


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
    assert (there == (found.outcome == CODE.found)).all() and not there.all()


def test_curves_of_folds_end_at_their_bounds_and_where_the_cycle_grazes(folds):
    ends = {name: curve.ends.tolist() for name, curve in folds.items()}
    assert ends == {
        "lowest": [CODE.beyond, CODE.modes_change],
        "its upper part": [CODE.modes_change, CODE.beyond],
        "another cycle": [CODE.modes_change, CODE.beyond],
    }
    # at that end, which is a special point, joint 2's rate vanishes while it slips
    found = folds["lowest"].special
    (i,) = np.flatnonzero(found.meeting == CODE.modes_change)
    start = [*found.phi[i], *found.omega[i]]
    torques = (found.second[i],) * 2
    rods = Rods(found.first[i], torques, torques)
    states, events = motion(rods, start, np.linspace(0, found.period[i], 2001))
    u2 = states[:, 3] - states[:, 2]
    first = np.array([t for t, joint, _ in events if joint == 2]).min()
    slips = np.linspace(0, found.period[i], 2001) < 0.9 * first
    assert 0 < u2[slips].min() < 2e-4  # measured 2.3e-5
    # and that code closes the cycle, too, as it does those below
    np.testing.assert_allclose(states[-1], start, rtol=0, atol=3e-8)


def test_folds_move_with_a_third_parameter_as_their_derivatives_say(follow):
    c, h = 2e-3, 1e-4
    (below, _), (found, slopes), (above, _) = (
        follow("lowest", x) for x in (c - h, c, c + h)
    )
    (i,) = np.flatnonzero(TAU == 0.03)
    for curve in (below, found, above):
        assert curve.points.outcome[i] == CODE.found
    for name in ("first", "period", "phi", "omega"):
        one, other = (getattr(curve.points, name)[i] for curve in (below, above))
        difference, slope = (other - one) / (2 * h), getattr(slopes, name)[i]
        # measured 3.1e-6
        np.testing.assert_allclose(slope, difference, rtol=1e-5, err_msg=name)


# Folds of smoothed friction and their cusp --------------------------------------------

# by AUTO-07p (`tests/reference/auto_branch.py`), at 0.1 with v_smooth = 0.05
AUTO = 1.6510286132, 1.6247482283
NEAR_AUTO = Near((-0.16208, 0.46753, 0.77757), 8.26963, 1.65103, 0.1)


def test_two_curves_of_folds_meet_in_a_cusp():
    def make(q, tau):
        load = zj.ConstantLoad(1.0)
        law = zj.SmoothCoulomb(tau, pin_radius=1.0, v_smooth=0.05, load=load)
        return zj.uniform_rods(q, friction=law, damping=zj.Viscous(0.002, 0.002))

    @jax.jit
    def follow(start):
        course = zj.Course(points=60, second=(0.03, 0.12))
        return zj.bifurcation_curve(make, "fold", start, second=0.1, course=course)

    curve = jax.tree.map(np.asarray, follow(points("fold", NEAR_AUTO)))
    q, tau = curve.points.first, curve.points.second
    assert (curve.points.residual < 1e-10).all()
    assert curve.ends.tolist() == [CODE.beyond, CODE.beyond]
    meets = curve.special.meeting == CODE.cusp
    assert meets.sum() == 1
    least = np.argmin(tau)
    sides = slice(None, least), slice(least, None)
    ours = [
        CubicSpline(*np.array(sorted(zip(tau[side], q[side], strict=True))).T)
        for side in sides
    ]
    # it passes two of AUTO's folds, one on each side of the cusp
    found = sorted(float(side(0.1)) for side in ours)
    # measured 4e-10 between the points of the curve
    np.testing.assert_allclose(found, sorted(AUTO), rtol=0, atol=1e-8)
    # the gap between both falls with the power 3/2 of the distance from it
    (cusp,) = curve.special.second[meets]
    near = cusp + np.array([0.002, 0.004])
    one, other = (abs(ours[0](t) - ours[1](t)) for t in near)
    assert abs(np.log2(other / one) - 1.5) < 0.1  # measured 1.46


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


def test_a_curve_begins_at_the_first_point_of_its_own_kind():
    near, other = FOLDS["lowest"], FOLDS["another cycle"]
    both = jax.tree.map(
        lambda a, b: jnp.concatenate([a, b]),
        points("fold", near),
        points("flip", other),
    )
    for kind, q in (("fold", near.q), ("flip", other.q)):
        begin = of_points(kind, both)
        assert begin.failure == 0 and begin.first == q
    assert of_points("torus", both).failure == CODE.beyond


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
    refuses(call(course=3), "`course`", "a `Course`", "3")
    refuses(call(arc=3), "`arc`", "an `Arc`", "3")
    refuses(call(second=np.ones(2)), "`second`", "single number", "(2,)")
    outside = zj.Course(second=(0.3, 0.4))
    refuses(call(course=outside), "`second`", "bounds of `course`", "(0.3, 0.4)")
    refuses(call(make=lambda q: q), "`make_column`", "two numbers", "takes (q)")
    many = jax.tree.map(lambda x: jnp.stack([x, x]), near)
    refuses(call(start=many), "`start`", "one branch", "shape (2,)")
    alone = jax.tree.map(lambda x: x[0], near)
    refuses(call(start=alone), "`start`", "one branch", "shape ()")
    refuses(lambda: zj.Course(values=["a"]), "`values`", "numbers", "'a'")
    beyond = {"values": [0.1, 0.2], "second": (0.1, 0.15)}
    refuses(lambda: zj.Course(**beyond), "`values`", "in `second`", "0.1, 0.15", "0.2")
    refuses(lambda: zj.Course(points=0), "`points`", "at least 1", "0")
    both = {"points": 9, "values": [0.1]}
    refuses(lambda: zj.Course(**both), "`points` and `values`", "9 and 1 values")
    refuses(lambda: zj.Course(values=1.0), "`values`", "one dimension", "()")
    refuses(lambda: zj.Course(values=[np.nan]), "`values`", "finite")
    refuses(lambda: zj.Course(step=-1.0), "`step`", "positive", "-1")
    refuses(lambda: zj.Course(second=(0.3, 0.1)), "`second`", "increase", "(0.3, 0.1)")
