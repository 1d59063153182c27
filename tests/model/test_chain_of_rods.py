"""Chains of n rods against free bodies, energy, limits, and the column of two."""

import free_bodies
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import ziegler_jax as zj
from ziegler_jax.model.chain import solved

REACTION = zj.JointReaction()


def scene(n, rng):
    """A chain with everything, and the same as free bodies."""
    draw = lambda low, high: tuple(rng.uniform(low, high, n))  # noqa: E731
    lengths, masses, springs = draw(0.7, 1.3), draw(0.5, 1.5), draw(0.8, 1.2)
    centres, inertias = draw(0.3, 0.6), draw(0.02, 0.1)
    bent, viscous, air = draw(-0.1, 0.1), draw(0.01, 0.05), draw(0.01, 0.05)
    foundation, weights = draw(0.05, 0.2), draw(0.2, 0.5)
    follower, at = draw(0.5, 1.0), draw(0.3, 1.0)
    both = {
        "q": 1.3, "lengths": lengths, "masses": masses, "springs": springs,
        "centres": centres, "inertias": inertias, "tip_mass": 0.2,
        "tip_inertia": 0.03, "rest_angles": bent, "air": air,
        "foundation": foundation,
    }  # fmt: skip
    chain = {
        "damping": zj.Viscous(*viscous),
        "forces": zj.FollowerForces(weights, follower, at),
        "gravity": zj.Gravity(0.1, 0.3),
        "dead_load": zj.DeadLoad(0.2, -0.2),
    }
    pattern = list(zip(range(n), weights, follower, at, strict=True))
    bodies = {
        "viscous": viscous,
        "forces": pattern,
        "gravity": (0.1, 0.3),
        "dead_load": (0.2, -0.2),
    }
    return both | chain, both | bodies


@pytest.mark.parametrize("n", [2, 3, 5])
def test_accelerations_are_those_of_free_bodies(rng, n):
    chain, bodies = scene(n, rng)
    chain, bodies = zj.Chain(**chain), free_bodies.Bodies(**bodies)
    field = jax.jit(lambda y: chain.system().field(0.0, zj.PhasePoint(y)).omega)
    for _ in range(50):
        y = rng.uniform(-1.5, 1.5, 2 * n)
        expected, *_ = bodies.solved(y, [0.0] * n)
        found = np.array(field(tuple(map(jnp.asarray, y))))
        # measured 4.3e-15
        np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize("n", [3, 5])
def test_a_smoothed_motion_is_that_of_free_bodies(rng, n):
    chain, bodies = scene(n, rng)
    tau = 0.03
    friction = zj.SmoothCoulomb(
        1.0, pin_radius=tau, v_smooth=0.05, load=zj.ConstantLoad(1.0)
    )
    start = zj.State(omega=(0.0,) * (n - 1) + (0.4,))
    ts = np.linspace(0.0, 20.0, 9)
    method = zj.Method(rtol=1e-12, atol=1e-12)
    found = zj.trajectory(
        zj.Chain(**chain, friction=friction), start, ts, method=method
    )
    other = free_bodies.smoothed(
        free_bodies.Bodies(**bodies, mu_k=(tau,) * n), list(start.y), ts, 0.05, 1e-12
    )
    states = np.concatenate([found.phi, found.omega], 1)
    np.testing.assert_allclose(states, other, atol=2e-10)  # measured 8.7e-12


def test_a_motion_of_three_rods_sticks_and_slips_as_free_bodies_do():
    """At least twenty events: their times, joints, and modes."""
    tau = 0.05, 0.04, 0.03
    law = zj.SetValuedCoulomb(
        tuple(1.2 * t for t in tau), tau, pin_radius=1.0, load=zj.ConstantLoad(1.0)
    )
    numbers = {"q": 2.6, "lengths": (1.0,) * 3, "masses": (1.0, 0.8, 0.6)}
    springs = (1.0, 1.1, 0.9)
    chain = zj.Chain(**numbers, springs=springs, friction=law)
    start = zj.State(omega=(0.0, 0.0, 0.4))
    ts = np.linspace(0.0, 20.0, 5)
    bodies = free_bodies.Bodies(
        **numbers, springs=springs, mu_s=tuple(1.2 * t for t in tau), mu_k=tau
    )
    other, log = free_bodies.motion(bodies, list(start.y), ts, 1e-12)
    assert len(log) >= 20
    for solver in (zj.Taylor(12), zj.Explicit()):
        method = zj.Method(solver, rtol=1e-12, atol=1e-12)
        found = zj.trajectory(chain, start, ts, method=method)
        count = int(found.events.count)
        assert count == len(log) + 1
        # forty events: their times measured within 1.4e-10, the states 1.1e-10
        times = np.array(found.events.times[1:count])
        np.testing.assert_allclose(times, [t for t, *_ in log], atol=1e-8)
        joints = [2 ** (joint - 1) for _, joint, _ in log]
        assert found.events.joints[1:count].tolist() == joints
        modes = [list(modes) for *_, modes in log]
        assert found.events.modes[1:count].tolist() == modes
        states = np.concatenate([found.phi, found.omega], 1)
        np.testing.assert_allclose(states, other, atol=1e-8)


@pytest.mark.parametrize("n", [2, 3, 5])
def test_energy_changes_by_the_powers(rng, n):
    numbers, _ = scene(n, rng)
    law = zj.SmoothCoulomb(0.3, pin_radius=0.1, v_smooth=0.05)
    chain = zj.Chain(**numbers, friction=law)
    system = chain.system()

    @jax.jit
    def imbalance(y):
        y = zj.PhasePoint(y)
        slope = system.field(0.0, y)
        change = jax.jvp(system.energy, (y,), (slope,))[1]
        power, known = system.power(y), system.energy_rate(y, slope.omega)
        expected = power.follower - power.damping - power.friction
        return change - expected, known.rate - change

    worst = 0.0
    for _ in range(50):
        y = tuple(map(jnp.asarray, rng.uniform(-1.5, 1.5, 2 * n)))
        worst = max(worst, *map(abs, map(float, imbalance(y))))
    assert worst < 2e-13  # measured 1.4e-14


def test_the_energy_of_a_motion_is_what_its_powers_say():
    chain = zj.Chain(
        2.0, lengths=(1.0,) * 3, friction=zj.SmoothCoulomb(0.1, pin_radius=0.1,
        v_smooth=0.05), gravity=zj.Gravity(0.1, 0.4), foundation=0.1, rest_angles=0.05,
    )  # fmt: skip
    start = zj.State(omega=(0.0, 0.0, 0.3))
    windows = zj.Windows(transient=0.0, length=20.0, max_windows=1)
    end = zj.settle(
        chain, start, windows=windows, observers=(zj.EnergyBalance(),),
        method=zj.Method(rtol=1e-12, atol=1e-12), certify=False,
    )  # fmt: skip
    assert abs(float(end.energy_imbalance)) < 1e-12  # measured 1.0e-14


@pytest.mark.parametrize("rods", [3, 6])
def test_accelerations_of_many_rods_and_their_derivatives_are_lapacks(rods, rng):
    half = rng.standard_normal((rods, rods))
    moments = half @ half.T + rods * np.eye(rods)
    i, j = np.indices((rods, rods), float)

    def mine(t):
        rows = moments * jnp.cos(t * (i - j))
        mass = tuple(tuple(rows[k, : k + 1]) for k in range(rods))
        return jnp.stack(solved(mass, tuple(jnp.sin(t + np.arange(float(rods))))))

    def others(t):
        right = jnp.sin(t + np.arange(float(rods)))
        return jnp.linalg.solve(moments * jnp.cos(t * (i - j)), right)

    ways = jax.jacfwd, jax.jacrev, lambda f: jax.jacrev(jax.jacfwd(f))
    for way in (lambda f: f, *ways):
        batch = jax.jit(jax.vmap(way(mine)))(jnp.array([0.3, 0.5]))
        exact = jax.vmap(way(others))(jnp.array([0.3, 0.5]))
        # measured 4e-16
        np.testing.assert_allclose(batch, exact, rtol=0, atol=1e-14)


def test_two_rods_are_the_column():
    """Of uniform rods with a partly following load, a tip mass and gravity."""
    parts = {
        "damping": zj.Viscous(0.1, 0.2), "gravity": zj.Gravity(0.3, 0.2),
        "dead_load": zj.DeadLoad(0.1), "rest_angles": (0.1, -0.1),
        "foundation": (0.2, 0.3), "tip_mass": 0.3, "tip_inertia": 0.05,
    }  # fmt: skip
    column = zj.uniform_rods(
        1.7, m1=0.8, m2=1.2, l2=0.7, kappa=1.3, follower=0.6, **parts
    )
    chain = zj.Chain(
        1.7, lengths=(1.0, 0.7), masses=(0.8, 1.2), springs=(1.3, 1.0),
        forces=zj.FollowerForces((0.0, 1.0), 0.6), **parts,
    )  # fmt: skip
    y = zj.PhasePoint((0.3, -0.7, 0.4, 1.1))
    one, other = (np.array(c.system().field(0.0, y)) for c in (column, chain))
    np.testing.assert_allclose(one, other, rtol=1e-14)
    assert abs(zj.energy(column, y) - zj.energy(chain, y)) < 1e-15


def test_air_on_two_rods_is_that_of_the_column():
    column = zj.uniform_rods(1.0, l2=0.7, damping=zj.Air(0.2, 0.3, 0.7))
    chain = zj.Chain(1.0, lengths=(1.0, 0.7), air=(0.2, 0.3))
    y = zj.PhasePoint((0.3, -0.7, 0.4, 1.1))
    one, other = (np.array(c.system().field(0.0, y)) for c in (column, chain))
    np.testing.assert_allclose(one, other, rtol=1e-13)


def test_a_part_that_is_not_named_is_not_in_the_program():
    def ops(**parts):
        def field(y):
            chain = zj.Chain(1.0, lengths=(1.0,) * 3, **parts)
            return chain.system().field(0.0, zj.PhasePoint(y))

        return len(str(jax.make_jaxpr(field)((0.1,) * 6)))

    bare = ops()
    assert ops(forces=zj.FollowerForces((0.0, 0.0, 1.0))) == bare
    for part in (
        {"gravity": zj.Gravity(0.1)},
        {"foundation": 0.1},
        {"air": 0.1},
        {"rest_angles": 0.1},
        {"dead_load": zj.DeadLoad(0.1)},
        {"forces": zj.FollowerForces((0.0, 1.0, 1.0))},
    ):
        assert ops(**part) > bare


@pytest.mark.parametrize(
    ("numbers", "parts"),
    [
        ({"lengths": ()}, ("`lengths`", "at least two numbers")),
        ({"lengths": (1.0,)}, ("`lengths`", "at least two numbers")),
        ({"lengths": (1.0,) * 30}, ("`lengths`", "at most 16", "30")),
        ({"lengths": 3}, ("`lengths`", "at least two numbers", "3")),
        ({"lengths": (1, -1, 1)}, ("`lengths[1]`", "positive", "-1")),
        ({"masses": (1, 1)}, ("`masses`", "each of 3 joints", "2 numbers")),
        ({"masses": 0.0}, ("`masses`", "positive", "0")),
        ({"masses": (1, 0, 1)}, ("`masses[1]`", "positive", "0")),
        ({"springs": (1, 1, 0)}, ("`springs[2]`", "positive", "0")),
        ({"springs": (1, 1, 1, 1)}, ("`springs`", "each of 3 joints", "4 numbers")),
        ({"foundation": -0.1}, ("`foundation`", "nonnegative", "-0.1")),
        ({"foundation": (0.1, 0.1)}, ("`foundation`", "each of 3 joints")),
        ({"tip_mass": -1.0}, ("`tip_mass`", "nonnegative", "-1")),
        ({"centres": 0.0, "inertias": 0.0}, ("`inertias`", "positive definite")),
        (
            {"centres": (0.5, 0.5, 0), "inertias": (0.1, 0.1, 0), "tip_mass": 0.0},
            ("`tip_mass`", "positive definite"),
        ),
        ({"damping": zj.Viscous(0.1, 0.1)}, ("`damping`", "3 joints", "has 2")),
        ({"damping": zj.Air(0.1, 0.1)}, ("`damping`", "3 rods", "`Air`")),
        (
            {"lengths": (0.5, 0.5), "damping": zj.Viscous(0, 0) + zj.Air(1, 1, 0.5)},
            ("`damping`", "`Air`", "air="),
        ),
        (
            {"lengths": (1.0,) * 5, "friction": zj.SetValuedCoulomb(0.1, pin_radius=1)},
            ("`friction`", "4 rods", "5"),
        ),
        ({"gravity": 0.1}, ("`gravity`", "Gravity", "0.1")),
        ({"forces": zj.FollowerForces((0, 1))}, ("`weights`", "3 joints", "2 numbers")),
        (
            {"friction": zj.SetValuedCoulomb(0.1, pin_radius=1, load=REACTION)},
            ("`friction`", "`JointReaction()`", "`ConstantLoad(n)`"),
        ),
        (
            {"friction": zj.SetValuedCoulomb((0.1, 0.1), pin_radius=1.0)},
            ("`mu_s`", "3 joints", "2 numbers"),
        ),
    ],
)  # fmt: skip
def test_bad_numbers_are_refused_by_name_value_and_rule(refuses, numbers, parts):
    refuses(lambda: zj.Chain(**{"lengths": (1.0,) * 3} | numbers).system(), *parts)


class OwnJoints(zj.AbstractDamping):
    """Viscous joints, written for any number of rods."""

    c: tuple

    def rows(self, sines, omega):
        bent = np.eye(len(omega)) - np.eye(len(omega), k=-1)
        return tuple(map(tuple, bent.T @ np.diag(self.c) @ bent))


class Neither(zj.AbstractDamping):
    pass


@pytest.mark.parametrize("n", [2, 3])
def test_a_damping_law_by_its_rows_is_one_for_any_number_of_rods(refuses, n):
    """Alone and in a sum; in the motion and in the linear questions."""
    c = (0.1, 0.2, 0.3)[:n]
    own, joints = OwnJoints(c), zj.Viscous(*c)
    y = tuple(np.linspace(0.1, 0.5, 2 * n))
    make = zj.uniform_rods if n == 2 else lambda q, **parts: zj.beck(n, q, **parts)
    for one, other in ((own, joints), (own + joints, joints + joints)):
        here, there = (make(1.0, damping=law) for law in (one, other))
        field = zj.vector_field(0.0, y, here)
        np.testing.assert_allclose(field, zj.vector_field(0.0, y, there), atol=1e-14)
        found, known = (zj.linearise(x).damping for x in (here, there))
        np.testing.assert_allclose(found, known, atol=1e-15)
    refuses(lambda: make(1.0, damping=Neither()), "`damping`", "`rows`", "`Neither`")


def test_what_is_not_worked_out_beside_fixed_forces_is_refused(refuses):
    """Joint reactions under gravity; closed forms of the sticking set; least kicks."""
    heavy, bent = {"gravity": zj.Gravity(0.1)}, {"rest_angles": 0.1}
    dry = zj.SetValuedCoulomb(0.1, pin_radius=0.1)
    on_pins = zj.SmoothCoulomb(0.1, pin_radius=0.1, v_smooth=0.1, load=REACTION)
    upright, zero = zj.uniform_rods(0.5, **heavy), zj.State()
    refuses(lambda: zj.reactions(upright, zero), "`gravity`", "`reactions`")
    refuses(lambda: zj.reactions(zj.beck(2), zero), "`column`", "`Column`")
    refuses(
        lambda: zj.uniform_rods(0.5, friction=on_pins, dead_load=zj.DeadLoad(0.1)),
        "`dead_load`", "`JointReaction()`",
    )  # fmt: skip
    held = zj.sticking_set(zj.uniform_rods(2.0, friction=dry, **heavy))
    refuses(lambda: held.corners, "`corners`", "alone")
    refuses(lambda: held.area, "`area`", "alone")
    leaning = zj.uniform_rods(1.5, friction=dry, **bent)
    refuses(lambda: zj.least_kick(leaning, (0.1, 1.0)), "`column`", "upright")


def test_gravity_upwards_is_gravity_backwards():
    up, back = zj.Gravity(0.2, np.pi), zj.Gravity(-0.2)
    one, other = (zj.Chain(1.0, lengths=(1.0, 1.0), gravity=g) for g in (up, back))
    assert not one.system().displaced
    y = zj.PhasePoint((0.3, -0.2, 0.1, 0.4))
    assert one.system().field(0.0, y) == other.system().field(0.0, y)


def test_questions_of_two_rods_refuse_more(refuses):
    law = zj.SmoothCoulomb(0.1, pin_radius=0.1, v_smooth=0.05)
    chain = zj.Chain(2.0, lengths=(1.0,) * 3, friction=law)
    start = zj.State(omega=(0.0, 0.0, 0.3))
    orbit = jax.eval_shape(lambda: zj.periodic_orbit(chain, start, period=3.0))

    def two(q):
        return zj.uniform_rods(q, friction=law)

    refuses(lambda: zj.continue_cycle(two, orbit, 2.0), "`orbit`", "is of 3")

    def three(q):
        return zj.Chain(q, lengths=(1.0,) * 3, friction=law)

    shapes = jax.eval_shape(lambda o: zj.continue_cycle(three, o, 2.0).special, orbit)
    points = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes)
    course = zj.Course(points=4, second=(0.1, 0.2))
    refuses(
        lambda: zj.bifurcation_curve(
            lambda q, eta: zj.uniform_rods(q, follower=eta, friction=law),
            "fold", points, second=0.1, course=course,
        ),
        "`start`", "of 2 rods", "is of 3",
    )  # fmt: skip
    refuses(lambda: zj.least_kick(chain, lambda c, y: y[0]), "has 3")
    refuses(lambda: zj.trajectory(chain, zj.State(), (0.0, 1.0)), "`start`", "3 rods")
    refuses(lambda: zj.energy(chain, (0.1,) * 4), "`y`", "3 rods")


@pytest.mark.parametrize("n", [0, 1, 30, 2.5])
def test_a_chain_of_the_literature_has_two_to_sixteen_rods(refuses, n):
    for make in (zj.beck, zj.leipholz, lambda n: zj.pflueger(n, 1.0)):
        refuses(lambda make=make: make(n), "`n`", f"{n}")


def test_a_chain_in_si_units_is_the_scaled_one():
    """Lengths in m, masses in kg: its times are the scaled ones times the unit."""
    units = zj.SI(m=0.4, l=0.5, k=3.0)
    parts = {
        "damping": zj.Viscous(0.01, 0.02, 0.03), "air": 0.02, "foundation": 0.3,
        "gravity": zj.Gravity(9.81, 0.1), "dead_load": zj.DeadLoad(0.5),
        "rest_angles": (0.1, 0.0, 0.0), "tip_mass": 0.1, "tip_inertia": 0.01,
    }  # fmt: skip
    chain = zj.Chain(4.0, lengths=(0.5, 0.4, 0.3), masses=0.4, springs=3.0, **parts)
    start, ts = zj.State(omega=(0.0, 0.0, 0.5)), np.linspace(0.0, 2.0, 3)
    method = zj.Method(rtol=1e-10, atol=1e-10)
    own = zj.trajectory(chain, start, ts, method=method)
    scaled = zj.trajectory(
        units.scaled(chain), units.scaled(start), ts / units.time, method=method
    )
    restored = units.restore(scaled)
    np.testing.assert_allclose(own.phi, restored.phi, atol=1e-8)
    np.testing.assert_allclose(own.omega, restored.omega, atol=1e-7)
