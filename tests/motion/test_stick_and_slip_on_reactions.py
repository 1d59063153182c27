"""Set-valued friction on the joints' own reactions: torques and loads at once."""

import jax
import jax.numpy as jnp
import numpy as np

import ziegler_jax as zj
from ziegler_jax.model.chain import joint_angles
from ziegler_jax.model.state import PhasePoint
from ziegler_jax.results import CODE

COUNT = 5000


def law(mu_s, mu_k=None):
    return zj.SetValuedCoulomb(
        mu_s, mu_k, pin_radius=1.0, load=zj.JointReaction(newton_steps=4)
    )


def joints(system, y, modes):
    """In given modes: torques, the joints' accelerations, and their reactions' size."""
    balance = system.balance(y)
    loaded = system.in_modes(modes).law.loaded(balance)
    a1, a2 = loaded.accelerations(balance)
    size = jnp.linalg.norm(jnp.array(balance.reactions.at(a1, a2)), axis=-1)
    return jnp.stack(loaded.torques(balance)), jnp.stack([a1, a2 - a1]), size


@jax.jit
@jax.vmap
def chosen(q, mu_s, mu_k, y, rest):
    """The modes that a state starts in, and what follows."""
    system = zj.uniform_rods(q, friction=law(mu_s, mu_k)).system()
    w1 = jnp.where(rest[0], 0.0, y[2])
    w2 = jnp.where(rest[1], w1, y[3])
    y = PhasePoint((y[0], y[1], w1, w2))
    u = joint_angles(y.omega)
    modes = system.coulomb.at_state(system.balance(y), u, rest).modes
    return jnp.stack(modes), *joints(system, y, modes)


def test_modes_and_loads_agree_with_the_law_whatever_the_state(rng):
    """|T| is mu_k |R| in slip and at most mu_s |R| at rest, where nothing moves."""
    q, y = rng.uniform(0, 4, COUNT), tuple(rng.uniform(-1, 1, (4, COUNT)))
    mu_s = rng.uniform(0.01, 0.3, COUNT)
    mu_k = mu_s / rng.choice([1.0, 1.5, 4.0], COUNT)
    rest = tuple(rng.random((2, COUNT)) < 0.7)
    found = chosen(q, mu_s, mu_k, y, rest)
    modes, torque, moves, size = (np.array(x).T for x in found)
    assert np.isfinite(moves).all()
    stuck, released = modes == 0, np.array(rest) & (modes != 0)
    assert stuck.sum() > 1000 and released.sum() > 1000
    np.testing.assert_allclose(moves[stuck], 0.0, rtol=0, atol=1e-15)
    assert (np.abs(torque) <= mu_s * size)[stuck].all()
    # what is left of the loads' equations; measured 8e-12
    slip = (torque - modes * mu_k * size)[~stuck]
    np.testing.assert_allclose(slip, 0.0, rtol=0, atol=1e-10)
    assert (modes * moves)[released].min() > 0


def test_loads_without_one_solution_give_no_motion(rng):
    """A coefficient of 3: friction changes the reactions by more than themselves."""
    q, y = rng.uniform(0, 4, COUNT), tuple(rng.uniform(-1, 1, (4, COUNT)))
    moving = (np.zeros(COUNT, bool),) * 2
    three = np.full(COUNT, 3.0)
    _, _, moves, _ = chosen(q, three, three, y, moving)
    assert np.isnan(np.asarray(moves)).all(axis=1).mean() > 0.9


def test_a_joint_at_rest_beside_loads_without_a_solution_has_no_mode():
    """Held at rest, joint 1 leaves joint 2 too much friction; moving, it would not."""
    one, zero = np.ones(1), np.zeros(1)
    mu = 0.01 * one, 0.8 * one
    y = 0.1 * one, 0.1 * one, zero, one
    modes, _, moves, _ = chosen(2.0 * one, mu, mu, y, (zero == 0, zero != 0))
    assert np.isnan(modes[0, 0]) and np.isnan(moves).all()


def test_the_column_rests_where_it_would_under_the_load_itself(rng):
    """At rest both joints carry q."""
    phi = rng.uniform(-0.6, 0.6, (2, COUNT))
    on = [
        zj.sticking_set(zj.uniform_rods(2.3, follower=0.5, friction=friction))
        for friction in (law(0.1), zj.SetValuedCoulomb(0.1, pin_radius=1.0))
    ]
    inside, follower = (np.asarray(x.contains(*phi)) for x in on)
    np.testing.assert_array_equal(inside, follower)
    zero = np.zeros(COUNT)
    q, mu = zero + 2.3, zero + 0.1
    modes, *_ = chosen(q, mu, mu, (*phi, zero, zero), (zero == 0,) * 2)
    still = zj.sticking_set(zj.uniform_rods(2.3, friction=law(0.1)))
    rests = (np.asarray(modes) == 0).all(axis=1)
    np.testing.assert_array_equal(rests, still.contains(*phi))
    assert 100 < rests.sum() < COUNT - 100


TS = np.linspace(0, 12, 241)
Q, MU = 2.6, 0.03


def motion(v_smooth=None):
    """Joint 2 sticks at first, then joint 1 for a while."""
    friction: zj.SetValuedCoulomb | zj.SmoothCoulomb = law(MU)
    if v_smooth is not None:
        friction = zj.SmoothCoulomb(
            MU, pin_radius=1.0, v_smooth=v_smooth, load=zj.JointReaction()
        )
    column = zj.uniform_rods(Q, friction=friction)
    start = zj.State(omega=(0.0, 0.4))
    return zj.trajectory(
        column, start, TS, method=zj.Method(rtol=1e-10, atol=1e-10, max_steps=500_000)
    )


def test_the_smoothed_law_on_reactions_tends_to_the_exact_one():
    found = jax.jit(motion)()
    smoothed = jax.jit(motion)
    exact = np.hstack([found.phi, found.omega])
    assert CODE(int(found.outcome)) is CODE.complete
    events = found.events
    count = int(events.count)
    assert count > 6

    def error(v_smooth):
        other = smoothed(v_smooth)
        return np.abs(np.hstack([other.phi, other.omega]) - exact).max()

    errors = [error(v) for v in (1e-2, 1e-3, 1e-4)]
    # measured 0.76, 0.130, 0.0137: the motion grows
    assert errors[0] > 3 * errors[1] > 9 * errors[2], errors
    assert errors[2] < 0.02

    # the torque that holds a joint never exceeds what its reaction allows
    last = np.searchsorted(np.asarray(events.times[:count]), TS, side="right") - 1
    modes = np.asarray(events.modes, float)[last]
    system = zj.uniform_rods(Q, friction=law(MU)).system()
    held = jax.jit(jax.vmap(lambda y, m: joints(system, PhasePoint(y), tuple(m))))
    torque, _, size = map(np.asarray, held(exact, modes))
    stuck = modes == 0
    assert stuck.sum() > 20 and (~stuck).sum() > 200
    assert (np.abs(torque) <= MU * size * (1 + 1e-7))[stuck].all()


def test_energy_and_outcomes_of_lanes_on_reactions():
    def scene(q, mu):
        return zj.settle(
            zj.uniform_rods(q, friction=law(1.3 * mu, mu)),
            zj.State(omega=(0.0, 0.4)),
            windows=zj.Windows(transient=0.0, length=60.0, max_windows=1, escape=1e3),
            method=zj.Method(rtol=1e-10, atol=1e-10),
            observers=(zj.EnergyBalance(), zj.StickFraction()),
            certify=False,
        )

    axes = {"q": np.linspace(0.5, 4, 12), "mu": np.linspace(0.01, 0.2, 8)}
    ds = zj.sweep(scene, progress=False, **axes)
    assert np.isin(ds.outcome, (CODE.stuck, CODE.unsettled)).all()
    assert np.abs(ds.energy_imbalance.values * 60.0).max() < 1e-8  # measured 9e-10
    fraction = ds.stick_fraction.values
    assert ((fraction > 0.1) & (fraction < 0.9)).any() and (fraction > 0.99).any()
