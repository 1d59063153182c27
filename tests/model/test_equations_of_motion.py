"""The equations of motion, their energy, and the joints' reactions."""

import diffrax as dfx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import ziegler_jax as zj

FREE = ["free_q1_0_0_0_2", "free_q2.6_0_0_0_0.01", "free_q2.6_0_0_0_2"]
FREE += ["free_q4_0_0_0_0.01"]
DAMPED = "damped_q2.6_c0.05_0.01"


def stacked(y):
    return jnp.stack(y)


# Motions of other codes ---------------------------------------------------------------


@jax.jit
def free_motion(q, y0, ts):
    start = zj.State((y0[0], y0[1]), (y0[2], y0[3]))
    return zj.trajectory(
        zj.uniform_rods(q), start, ts, method=zj.Method(rtol=1e-11, atol=1e-11)
    )


@jax.jit
def damped_motion(q, c1, c2, y0, ts):
    start = zj.State((y0[0], y0[1]), (y0[2], y0[3]))
    column = zj.uniform_rods(q, damping=zj.Viscous(c1, c2))
    return zj.trajectory(column, start, ts, method=zj.Method(rtol=1e-11, atol=1e-11))


@jax.jit
def motion_by(defects, q, y0, ts):
    """Uniform rods with the two printed misprints switched on by 1, off by 0.

    Written once more here, so that the test can tell them apart: defects[0] drops
    phi2'^2 sin D from row 1, defects[1] puts phi2'^2 for phi1'^2 into row 2.
    """

    def field(t, y, args):
        p1, p2, w1, w2 = y
        s, c = jnp.sin(p1 - p2), jnp.cos(p1 - p2)
        row1 = q * s - 2 * p1 + p2 - (1 - defects[0]) * s * w2**2 / 2
        row2 = p1 - p2 + s * ((1 - defects[1]) * w1**2 + defects[1] * w2**2) / 2
        det = 4 / 9 - c * c / 4
        a1 = (row1 / 3 - c * row2 / 2) / det
        a2 = (4 * row2 / 3 - c * row1 / 2) / det
        return jnp.stack([w1, w2, a1, a2])

    solution = dfx.diffeqsolve(
        dfx.ODETerm(field),
        dfx.Dopri8(),
        ts[0],
        ts[-1],
        0.01,
        y0,
        stepsize_controller=dfx.PIDController(rtol=1e-11, atol=1e-11),
        saveat=dfx.SaveAt(ts=ts),
        max_steps=100_000,
    )
    return solution.ys


def array(motion):
    assert int(motion.outcome) == zj.CODE.complete
    return np.concatenate([motion.phi, motion.omega], axis=1)


def start_of(data):
    return np.concatenate([data["phi0"], data["w0"]])


@pytest.mark.parametrize("name", FREE)
@pytest.mark.parametrize("code", ["ref", "mujoco"])
def test_free_motions_agree_with_other_codes(reference, name, code):
    data = reference(name)
    found = array(free_motion(data["q"], start_of(data), data["t"]))
    until = data["t"] <= data["Tstar"]
    error = np.abs(found - data[code])[until].max()
    # measured 8.0e-10, at q = 4 where a perturbation of 1e-10 may grow to 1e-6
    assert error < 5e-9


@pytest.mark.parametrize("code", ["ref", "mujoco"])
def test_damped_motion_agrees_with_other_codes(reference, code):
    data = reference(DAMPED)
    c1, c2 = data["c"]
    found = array(damped_motion(data["q"], c1, c2, start_of(data), data["t"]))
    # measured 3.3e-11
    assert np.abs(found - data[code]).max() < 3e-10


@pytest.mark.parametrize(
    "defects, least",
    # measured 1.6, 22 and 1.1 rad
    [((1.0, 1.0), 0.2), ((1.0, 0.0), 0.2), ((0.0, 1.0), 0.2)],
)
def test_the_misprinted_equations_would_not_pass(reference, defects, least):
    data = reference("free_q2.6_0_0_0_2")
    right, printed = (
        np.asarray(motion_by(np.array(d), data["q"], start_of(data), data["t"]))
        for d in ((0.0, 0.0), defects)
    )
    # measured 3.9e-10: the test's own equations are right without the defects
    assert np.abs(right - data["ref"]).max() < 5e-9
    assert np.abs(printed - data["ref"])[:, :2].max() > least


def test_without_load_the_energy_stays(reference):
    ts = reference(FREE[0])["t"]
    y0 = np.array([0.4, -0.7, 0.5, 1.0])
    motion = array(free_motion(np.float64(0), y0, ts))
    energies = jax.vmap(lambda y: zj.energy(zj.uniform_rods(), tuple(y)))(motion)
    # measured 2.9e-11
    assert np.ptp(energies) < 2e-10


def test_the_frictionless_flow_runs_backward(reference):
    ts = reference(FREE[0])["t"]
    y0 = np.array([0.1, -0.2, 0.3, 0.1])
    turn = np.array([1.0, 1.0, -1.0, -1.0])
    there = array(free_motion(np.float64(1), y0, ts))
    back = array(free_motion(np.float64(1), turn * there[-1], ts))
    # measured 1.5e-11
    assert np.abs(turn * back[::-1] - there).max() < 2e-10


# What is refused ----------------------------------------------------------------------

ROD = {"a": 4 / 3, "b": 1 / 2, "d": 1 / 3}


@pytest.mark.parametrize(
    "call, parts",
    [
        (lambda: zj.Column(np.nan, **ROD), ("`q`", "nan", "finite")),
        (lambda: zj.Column(np.inf, **ROD), ("`q`", "inf", "finite")),
        (lambda: zj.Column("2", **ROD), ("`q`", "'2'", "number")),
        (lambda: zj.Column(None, **ROD), ("`q`", "None", "number")),
        (lambda: zj.Column([1.0, 2.0], **ROD), ("`q`", "(2,)", "single number")),
        (lambda: zj.Column(jnp.ones(3), **ROD), ("`q`", "(3,)", "single number")),
        (lambda: zj.Column(1.0, -1.0, 0.5, 0.3), ("`a`", "-1", "positive")),
        (lambda: zj.Column(1.0, 1.0, 0.5, 0.0), ("`d`", "0", "positive")),
        (lambda: zj.Column(1.0, 1.0, 1.0, 1.0), ("`a`, `b`, `d`", "1", "a d > b^2")),
        (lambda: zj.Column(1.0, **ROD, kappa=-0.5), ("`kappa`", "-0.5", "nonneg")),
        (lambda: zj.Column(1.0, **ROD, m2=-2.0), ("`m2`", "-2", "nonnegative")),
        (lambda: zj.Column(1.0, **ROD, l2=0.0), ("`l2`", "0", "positive")),
        (lambda: zj.Column(1.0, **ROD, damping=0.1), ("`damping`", "0.1", "law")),
        (lambda: zj.Column(1.0, **ROD, friction="dry"), ("`friction`", "dry", "law")),
        (lambda: zj.uniform_rods(m1=0.0), ("`m1`", "0", "positive")),
        (lambda: zj.uniform_rods(l2=-1.0), ("`l2`", "-1", "positive")),
        (lambda: zj.point_masses(2.0, -1.0), ("`m2`", "-1", "positive")),
        (lambda: zj.State(phi=0.1), ("`phi`", "0.1", "at least two numbers")),
        (lambda: zj.State(phi=(0.1,)), ("`phi`", "(0.1,)", "at least two numbers")),
        (lambda: zj.State(omega=(0.0, np.nan)), ("`omega[1]`", "nan", "finite")),
        (lambda: zj.Viscous(-0.1, 0.0), ("`c1`", "-0.1", "nonnegative")),
        (lambda: zj.Viscous(0.1, np.nan), ("`c2`", "nan", "nonnegative")),
        (
            lambda: zj.energy(zj.Column(1.0, **ROD), (0.1,) * 5),
            ("`y`", "4 scalars", "0.1"),
        ),
        (lambda: zj.vector_field(0.0, (0.2,), zj.Column(1.0, **ROD)), ("`y`", "0.2")),
    ],
)
def test_a_wrong_number_is_refused_by_name_value_and_rule(refuses, call, parts):
    refuses(call, *parts)


def test_reactions_need_masses(refuses):
    bare = zj.Column(1.0, **ROD)
    refuses(lambda: zj.reactions(bare, (0.0,) * 4), "`m2`", "`s1`", "None")
    friction = zj.SmoothCoulomb(
        0.1, pin_radius=0.1, v_smooth=0.1, load=zj.JointReaction()
    )
    refuses(lambda: zj.Column(1.0, **ROD, friction=friction), "`m2`", "JointReaction")


def test_traced_numbers_that_break_a_rule_are_found_inside():
    """`valid` is what a concrete number's ValueError becomes when it is traced."""

    @jax.jit
    @jax.vmap
    def valid(q, a, kappa, mu, c1):
        friction = zj.SmoothCoulomb(mu, pin_radius=0.1, v_smooth=0.1)
        damping = zj.Viscous(c1, 0.1)
        column = zj.Column(q, a, 0.5, 1 / 3, kappa, damping=damping, friction=friction)
        return column.valid()

    good = np.array([1.0, 4 / 3, 1.0, 0.1, 0.1])
    bad = [(0, np.nan), (1, -1.0), (1, 0.7), (2, -1.0), (3, -0.1), (4, -0.1)]
    rows = np.tile(good, (len(bad) + 1, 1))
    for row, (place, value) in enumerate(bad, start=1):
        rows[row, place] = value
    found = np.asarray(valid(*rows.T))
    assert found.tolist() == [True] + [False] * len(bad)


def test_a_turn_of_both_rods_winds_up_spring_1_alone(rng):
    """The same accelerations but for its torque, to the digits that the angle keeps."""
    field = jax.jit(zj.vector_field)
    for turns in (1, 1000, 160_000):  # up to 1e6 rad
        for phi1, phi2, w1, w2 in rng.uniform(-0.5, 0.5, (5, 4)):
            free = zj.uniform_rods(2.0, kappa=0.0)
            wound = zj.uniform_rods(2.0, kappa=1.0)
            far = 2 * np.pi * turns
            here = (phi1, phi2, w1, w2)
            there = (phi1 + far, phi2 + far, w1, w2)
            moved = np.subtract(field(0.0, there, free), field(0.0, here, free))
            # accelerations have slopes of up to 13 here; measured 1.9
            assert np.abs(moved).max() < 20 * 2.0**-52 * far
            torque = np.subtract(field(0.0, there, wound), field(0.0, there, free))
            s = np.cos(phi1 - phi2) / 2
            expected = np.array([1 / 3, -s]) * -there[0] / (4 / 9 - s * s)
            np.testing.assert_allclose(torque[2:], expected, rtol=1e-9)
