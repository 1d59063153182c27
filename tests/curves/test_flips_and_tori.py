"""Flips, tori and pitchforks against multipliers by another code.

Of columns that a search over random ones came upon.
"""

import jax
import jax.numpy as jnp
import numpy as np
from near import Near, points
from newton_euler import Rods, motion

import ziegler_jax as zj
from ziegler_jax import CODE

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
            curve = zj.bifurcation_curve(
                make, "flip", start, second=NEAR_FLIP.tau, course=course
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
