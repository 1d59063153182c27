"""Motions against two free rods that their joints' forces hold together, in scipy.

See `free_bodies`: nothing of it is the package's, nor derived from the same equations.
"""

import dataclasses
from dataclasses import astuple, fields

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from newton_euler import Rods, motion, smoothed

import ziegler_jax as zj
from ziegler_jax import CODE


def column(n, smooth=None):
    """The package's column of a dictionary of the same numbers."""
    load = zj.JointReaction() if n["load"] is None else zj.ConstantLoad(n["load"])
    if n["preload"] is not None:
        load = zj.ConstantLoad(n["preload"]) + load
    given = {"pin_radius": 1.0, "load": load}
    law: zj.SetValuedCoulomb | zj.SmoothCoulomb
    if smooth is None:
        law = zj.SetValuedCoulomb(n["mu_s"], n["mu_k"], **given)
    else:
        law = zj.SmoothCoulomb(n["mu_k"], v_smooth=smooth, **given)
    damping: zj.Sum | zj.Viscous = zj.Viscous(*n["viscous"])
    if n["air"] is not None:
        damping = zj.Sum(damping, zj.Air(*n["air"], n["l2"]))
    parts = {k: n[k] for k in ("kappa", "follower", "m1", "m2", "l2")}
    return zj.uniform_rods(n["q"], damping=damping, friction=law, **parts)


def numbers(rods):
    """Of these rods; air that is still is not there, nor is a preload of zero."""
    named = zip(fields(rods), astuple(rods), strict=True)
    found = {field.name: value for field, value in named}
    there = {name: getattr(rods, name) for name in ("air", "preload")}
    return found | {name: x if any(x) else None for name, x in there.items()}


@jax.jit
def state_and_reactions(n, y, smooth):
    there = column(n, smooth)
    return zj.vector_field(0.0, y, there)[2:], zj.reactions(there, y)


def apart(rods, y, smooth):
    """Differences in accelerations and reactions of smoothed friction."""
    u = y[2], y[3] - y[2]
    levers = [mu * np.tanh(x / smooth) for mu, x in zip(rods.mu_k, u, strict=True)]
    exact, torques, _ = rods.bodies.solved(y, levers)
    forces = rods.bodies.response(y) @ [1, *torques]
    found, reactions = state_and_reactions(numbers(rods), tuple(y), smooth)
    moved = np.abs(np.array(found) - exact).max()
    return moved, np.abs(np.ravel(reactions) - forces[6:10]).max()


def random_rods(rng, **fixed):
    m1, m2, l2, kappa = rng.uniform(0.5, 2, 4)
    q, follower = rng.uniform(0, 4), rng.uniform(-0.5, 1.5)
    mu, viscous = tuple(rng.uniform(0, 0.06, 2)), tuple(rng.uniform(0, 0.3, 2))
    return Rods(
        q, mu, mu, follower=follower, m1=m1, m2=m2, l2=l2, kappa=kappa,
        viscous=viscous, **fixed,
    )  # fmt: skip


@pytest.mark.parametrize(
    "load, preload", [(None, (0, 0)), ((0.7, 1.3), (0, 0)), (None, (0.8, 0.3))]
)
def test_accelerations_and_joint_forces_are_those_of_two_free_bodies(
    rng, load, preload
):
    """Loads that follow in part; friction on given loads, joints' forces, and both."""
    errors = [
        apart(
            random_rods(rng, load=load, preload=preload),
            rng.uniform(-1.5, 1.5, 4),
            0.05,
        )
        for _ in range(100)
    ]
    assert np.max(errors) < 2e-13  # measured 1.5e-14


def test_the_drag_of_air_is_the_sum_of_that_of_its_points(rng):
    errors = []
    for _ in range(100):
        air = tuple(rng.uniform(0, 0.5, 2))
        rods = random_rods(rng, load=(0.7, 1.3), air=air)
        errors.append(apart(rods, rng.uniform(-1.5, 1.5, 4), 0.05)[0])
    assert np.max(errors) < 2e-13  # measured 1.5e-14


def test_joints_carry_the_drag_of_air(rng):
    """Alone, and in a sum with viscous joints, which put no force on the rods."""
    for _ in range(20):
        rods = random_rods(rng, load=(0.7, 1.3), air=tuple(rng.uniform(0, 0.5, 2)))
        state = rng.uniform(-1.5, 1.5, 4)
        assert apart(rods, state, 0.05)[1] < 3e-13
    air, joints = zj.Air(0.2, 0.3), zj.Viscous(0.0, 0.0)
    y = tuple(float(x) for x in state)
    for damping in (zj.Sum(air, joints), zj.Sum(joints, air)):
        one = zj.reactions(zj.uniform_rods(1.2, damping=damping), y)
        other = zj.reactions(zj.uniform_rods(1.2, damping=air), y)
        assert np.abs(one - other).max() < 1e-15
    half = zj.Air(0.1, 0.15)
    twice = zj.reactions(zj.uniform_rods(1.2, damping=zj.Sum(half, half)), y)
    assert np.abs(twice - other).max() < 1e-15


# Motions ------------------------------------------------------------------------------

KICK = np.array([0.0, 0.0, 0.0, 0.4])


@jax.jit
def set_valued(n, ts):
    start = zj.State(tuple(KICK[:2]), tuple(KICK[2:]))
    return zj.trajectory(
        column(n), start, ts, method=zj.Method(rtol=1e-11, atol=1e-11), max_events=1000
    )


def compared(rods, ts):
    """States, times of events, how many of them, and in how many modes a joint sticks.

    The events of both are the same ones, in the same modes.
    """
    exact, log = motion(rods, KICK, ts)
    found = set_valued(numbers(rods), ts)
    assert CODE(int(found.outcome)) is CODE.complete
    y = np.hstack([found.phi, found.omega])
    times, joints, modes = (np.array(x) for x in zip(*log, strict=True))
    # the package's first event is the start
    count = int(found.events.count)
    np.testing.assert_array_equal(found.events.joints[1:count], joints)
    np.testing.assert_array_equal(found.events.modes[1:count], modes)
    late = np.abs(np.asarray(found.events.times)[1:count] - times)
    return np.abs(y - exact).max(), late.max(), len(log), (modes == 0).sum()


def test_friction_on_the_joints_forces_is_followed_for_200_time_units():
    """Onto a cycle: what differs does not grow, but in phase."""
    rods = Rods(2.6, (0.06, 0.06), (0.03, 0.03), load=None)
    states, times, events, sticking = compared(rods, np.linspace(0.0, 200.0, 401))
    assert events > 300 and sticking > 100
    assert states < 1e-7 and times < 1e-7  # measured 1.4e-8 both


PRELOADED = Rods(
    1.8, (0.03, 0.03), (0.02, 0.02), load=None, viscous=(0.02, 0.02), preload=(0.4, 0.8)
)


def test_a_preloaded_joint_that_bears_its_force_swings_as_free_bodies_do():
    """A damped swing, its joints sticking by turns."""
    states, times, events, sticking = compared(PRELOADED, np.linspace(0.0, 40.0, 81))
    assert events > 15 and sticking > 5
    assert states < 5e-10 and times < 1e-9  # measured 5.2e-11 and 9.5e-11
    lighter = dataclasses.replace(PRELOADED, preload=(0.3, 0.8))
    exact, _ = motion(lighter, KICK, [0.0, 3.0])
    assert np.abs(exact[-1] - motion(PRELOADED, KICK, [0.0, 3.0])[0][-1]).max() > 1e-3


def test_derivatives_in_a_preload_are_those_of_another_code():
    def state(preload):
        there = numbers(PRELOADED) | {"preload": (preload, 0.8)}
        found = set_valued(there, np.array([0.0, 3.0]))
        return jnp.stack([*found.phi[-1], *found.omega[-1]])

    def exact(preload):
        rods = dataclasses.replace(PRELOADED, preload=(preload, 0.8))
        return motion(rods, KICK, [0.0, 3.0], tol=1e-12)[0][-1]

    h = 1e-4
    slope = (exact(0.4 + h) - exact(0.4 - h)) / (2 * h)
    assert np.abs(slope).max() > 0.01
    found = jax.jacfwd(state)(0.4)
    assert np.abs(found - slope).max() < 1e-9  # measured 1.6e-11


@pytest.mark.parametrize(
    "rods",
    [
        Rods(2.6, (0.04, 0.04), (0.04, 0.04), (1.0, 1.5), follower=0.8, l2=0.8),
        Rods(2.6, (0.06, 0.06), (0.03, 0.03), follower=0.8),
        Rods(2.6, (0.06, 0.06), (0.03, 0.03), air=(0.02, 0.05)),
    ],
    ids=["follows in part", "a guard dips", "air"],
)
def test_air_and_loads_that_follow_in_part_move_it_alike(rods):
    """In one of them a joint comes to rest in a dip that no step of scipy's ends in."""
    states, times, events, sticking = compared(rods, np.linspace(0.0, 100.0, 201))
    assert events > 50 and sticking > 20
    assert states < 5e-8 and times < 3e-8  # measured 5.4e-9 and 2.8e-9


@pytest.mark.parametrize("air", [(0.0, 0.3), (0.1, 0.05)])
def test_a_column_in_air_moves_as_free_bodies_do(air):
    """Drag of rod 2 alone, and unequal drag; smoothed friction on the joints."""
    rods = Rods(2.8, (0.0,) * 2, (0.01,) * 2, air=air, m2=0.8, l2=1.2, follower=0.9)
    ts = np.linspace(0.0, 40.0, 81)
    exact = smoothed(rods, KICK, ts, 0.1)

    @jax.jit
    def run(n):
        start = zj.State(tuple(KICK[:2]), tuple(KICK[2:]))
        return zj.trajectory(
            column(n, 0.1), start, ts, method=zj.Method(rtol=1e-11, atol=1e-11)
        )

    found = run(numbers(rods))
    y = np.hstack([found.phi, found.omega])
    assert np.abs(exact[-20:]).max() > 0.1
    assert np.abs(y - exact).max() < 2e-8  # measured 1.7e-9
