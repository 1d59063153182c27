"""Rest is what decays: the linear column about a slow motion decides."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import ziegler_jax as zj
from ziegler_jax.motion.spans import AbstractSpans
from ziegler_jax.solvers import Step
from ziegler_jax.steady.rest import decays


def smoothed(tau, v_smooth):
    load = zj.ConstantLoad(1.0)
    return zj.SmoothCoulomb(tau, pin_radius=1.0, v_smooth=v_smooth, load=load)


FIELD, DECAYS = (
    jax.jit(zj.vector_field),
    jax.jit(lambda c, *at: decays(c.system(), *at)),
)


def by_eigenvalues(column, phi, rate):
    """The largest growth, each joint's slopes those that the law has up to this rate.

    And the means of the slope at rest and each of those.
    """

    def slopes(angles, states, direction, step=1e-7):
        """Of the accelerations, at rates of this joint."""
        ends = [
            np.concatenate([np.broadcast_to(angles, (len(states), 2)), states], 1).T
            + way * step * np.reshape(direction, (4, 1))
            for way in (1, -1)
        ]
        above, below = (np.array(FIELD(0.0, tuple(y), column)[2:]) for y in ends)
        return (above - below) / (2 * step)

    stiff = [slopes(phi, np.zeros((1, 2)), (*d, 0, 0)) for d in ((1, 1), (0, 1))]
    sizes = rate * np.geomspace(1e-3, 1, 19)  # 1, 0.1, 0.01 and 0.001 among them
    sizes = np.concatenate([[0.0], sizes, -sizes])
    share = np.linspace(0, 1, 5)[:, None]
    damping = []
    for joint in ((1, 1), (0, 1)):
        here = slopes(phi, np.outer(sizes, joint), (0, 0, *joint))
        still = here[:, None, :1]
        damping.append((still + share * (here[:, None] - still)).reshape(2, -1))
    # of the joints' angles and rates
    (k1, k2), (c1, c2) = [[np.array([x[0], x[1] - x[0]]) for x in pair]
                          for pair in (stiff, damping)]  # fmt: skip
    whole = np.zeros((c1.shape[1], c2.shape[1], 4, 4))
    whole[..., 0, 2] = whole[..., 1, 3] = 1
    whole[..., 2:, 0], whole[..., 2:, 1] = k1[:, 0], k2[:, 0]
    whole[..., 2:, 2], whole[..., 2:, 3] = c1.T[:, None], c2.T[None]
    return np.linalg.eigvals(whole).real.max()


def test_what_decays_is_what_the_eigenvalues_say():
    source, seen = np.random.default_rng(3), []
    for _ in range(60):
        law = smoothed(tuple(source.uniform(0.001, 0.05, 2)), 0.05)
        column = zj.uniform_rods(
            source.uniform(0.3, 2.5), friction=law, kappa=source.uniform(0.5, 2),
            damping=quadratic(source.uniform(0, 0.3), source.uniform(0, 0.1, 2)),
        )  # fmt: skip
        phi, rate = source.uniform(-0.1, 0.1, 2), 10 ** source.uniform(-3, -0.5)
        growth = by_eigenvalues(column, phi, rate)
        said = DECAYS(column, (*phi, 0.01, 0.02), rate)
        # 5 of 1000 grow by up to 0.007 under slopes between those that are asked
        assert growth < 0.01 if said else growth > 0
        seen.append(bool(said))
    assert 10 < sum(seen) < 50


def test_a_bent_column_that_decays_is_at_rest():
    """Its linear column decays by exp(-0.124 t): M and C are those of the bent one."""
    column = zj.uniform_rods(
        2.66993, kappa=1.8885, follower=0.50681, damping=zj.Viscous(0.22775, 0.1352)
    )
    state = jnp.array([-0.02627, 2.48705, 0.0, 0.0])
    assert decays(column.system(), state, jnp.asarray(1e-6))


def quadratic(c, viscous):
    return zj.model.damping.Sum(zj.Viscous(*viscous), Quadratic(c))


class Quadratic(zj.AbstractDamping):
    c: float

    def matrix(self, cos_d, omega):
        c1, c2 = self.c * abs(omega[0]), self.c * abs(omega[1] - omega[0])
        return (c1 + c2, -c2), (-c2, c2)


def test_a_cycle_below_the_noise_of_the_steps_is_not_rest():
    """Friction damps below its layer, the damping above the cycle; neither between.

    A finer run ends all of them as cycles of amplitudes 0.22 to 0.5 of the size.
    """

    @jax.jit
    @jax.vmap
    def ends(q, size, tol):
        law = zj.SmoothCoulomb(
            1.0, pin_radius=1.0, v_smooth=1e-3 * size,
            load=zj.ConstantLoad(1.5e-3 * size),
        )  # fmt: skip
        column = zj.uniform_rods(q, friction=law, damping=Quadratic(3 / size))
        start, method = zj.State(omega=(0.0, 0.5 * size)), zj.Method(rtol=tol, atol=tol)
        return zj.settle(column, start, method=method).outcome

    loads, sizes = np.array([2.0, 2.3, 2.6, 2.8]), np.array([1e-4, 0.1, 0.01])
    q, size = np.tile(loads, 3), np.repeat(sizes, 4)
    loose = ends(q, size, np.repeat([1e-8, 1e-3, 1e-4], 4))
    assert set(np.asarray(loose)) <= {zj.CODE.unsettled, zj.CODE.cycle}
    np.testing.assert_array_equal(ends(q, size, 1e-9 * size), zj.CODE.cycle)


@pytest.mark.parametrize("law", ["smoothed", "viscous"])
def test_rest_ends_at_the_load_where_the_linear_column_flutters(law):
    """Equal damping c: q_cr = 74/45 + 6 c^2/5."""
    c = 0.3
    critical = 74 / 45 + 6 * c**2 / 5
    options = {"damping": zj.Viscous(c, c)}
    if law == "smoothed":
        options = {"friction": smoothed(0.015, 0.05)}
    for off in (1e-6, -1e-6):
        column = zj.uniform_rods(critical * (1 + off), **options)
        assert decays(column.system(), jnp.zeros(4), jnp.asarray(1e-6)) == (off < 0)


def test_a_column_that_stands_still_is_at_rest():
    for damping in (zj.Viscous(0.01, 0.01), None):
        column = zj.uniform_rods(2.6, damping=damping)
        assert decays(column.system(), jnp.zeros(4), jnp.zeros(()))


def test_what_dissipates_nothing_never_rests():
    column = zj.uniform_rods(1.0)  # stable: small motions last
    assert not decays(column.system(), jnp.zeros(4), jnp.asarray(1e-6))
    assert zj.settle(column, zj.State((1e-9, 0.0))).outcome == zj.CODE.unsettled


def test_a_column_whose_rest_is_unstable_is_never_stuck():
    """q = 1.8 is above q_cr(c = 0.2) = 1.69: what a kick leaves grows slowly."""
    column = zj.uniform_rods(1.8, friction=smoothed(0.01, 0.05))
    windows = zj.Windows(transient=100, length=40, max_windows=5)

    @jax.jit
    def ends(kick):
        start = zj.State(omega=(0.0, kick))
        return zj.settle(column, start, windows=windows).outcome

    assert ends(1e-6) == zj.CODE.unsettled
    assert ends(0.0) == zj.CODE.stuck


@pytest.mark.parametrize("direction", [(1.0, 0.0), (-0.3, 0.95)])
def test_a_threshold_within_frictions_layer_is_that_of_long_motions(direction):
    """Beside it motions fall for hundreds of time units before they grow."""
    column = zj.point_masses(
        q=2.6, kappa=1.3, friction=smoothed((0.04, 0.02), 0.02),
        damping=zj.Viscous(0.01, 0.01),
    )  # fmt: skip
    ts = np.linspace(0, 3000, 61)

    @jax.jit
    def flutters(size):
        start = zj.State(omega=tuple(size * x for x in direction))
        phi = zj.trajectory(column, start, ts, method=zj.Method(rtol=1e-8)).phi
        return jnp.abs(phi[-10:]).max() > 0.1

    @jax.jit
    def ends(size):
        return zj.settle(column, zj.State(omega=tuple(size * x for x in direction)))

    low, high = 0.01, 0.05
    while high > low * 1.0002:
        middle = (low + high) / 2
        low, high = (low, middle) if flutters(middle) else (middle, high)
    assert ends(high * 1.001).outcome == zj.CODE.cycle
    assert ends(low * 0.999).outcome == zj.CODE.stuck


def test_a_cycle_below_the_cut_is_not_rest():
    """Both ends of joint 2's slopes are stable, and those between are not."""
    law = zj.SmoothCoulomb(
        (0.0, 0.21666582), (0.0, 0.021666582), pin_radius=1.0, v_smooth=0.05,
        v_stribeck=0.001, load=zj.ConstantLoad(1.0),
    )  # fmt: skip
    column = zj.uniform_rods(
        1.1632675412820945, kappa=0.8866909922224421, friction=law,
        damping=zj.Viscous(0.16182351, 0.0),
    )  # fmt: skip
    start, ts = zj.State(omega=(0.0, 0.03)), np.linspace(0, 2500, 5001)
    motion = jax.jit(lambda: zj.trajectory(column, start, ts))()
    rates = np.abs(motion.omega[-400:, 0])
    assert 0.02 < rates.max() < 0.05  # slower than v_smooth, and for ever
    found = jax.jit(lambda: zj.settle(column, start))()
    assert found.outcome not in (zj.CODE.stuck, zj.CODE.rest)


@pytest.mark.parametrize("certify", [True, False])
def test_a_rod_that_turns_back_within_a_step_has_turned_over(certify):
    """The farthest end of a step lies 8 % below the angle's peak."""
    start, windows = zj.State(omega=(0.3, -1.0)), {"transient": 0.0, "length": 8.0}
    column = zj.uniform_rods(q=1.0, damping=zj.Viscous(0.05, 0.05))
    times = np.linspace(0, 8, 100_001)
    found = zj.trajectory(column, start, times, method=zj.Method(rtol=1e-11))
    peak = np.abs(found.phi).max()

    @jax.jit
    def outcome(escape):
        return zj.settle(
            column,
            start,
            windows=zj.Windows(**windows, max_windows=2, escape=escape),
            method=zj.Method(diffrax.Dopri8(), rtol=1e-5),
            certify=certify,
        ).outcome

    # measured: 1.5e-5 above the peak
    assert outcome(peak * (1 - 5e-4)) == zj.CODE.escaped
    assert outcome(peak * (1 + 5e-4)) != zj.CODE.escaped


class Counted(AbstractSpans):
    """Spans that only watch for rods that turn over."""

    def begin(self, column, t0, y0):
        return 0.0 * y0[0]

    def watch(self, column, state, step):
        return state.watch, False, None

    def judge(self, column, state, step, ended):
        return state.watch, state.outcome


def test_a_rod_turns_over_whatever_its_batch_mates_do():
    """A step that is not looked at for itself is not, either, for a mate's sake."""
    fold = Counted(1e9, 1.0, 5, np.pi)

    def outcome(y, v0, v1, a0, a1):
        z = 0.0 * y
        ends = (y, z, v0, z), (y, z, v1, z), (v0, z, a0, z), (v1, z, a1, z)
        step = Step(z, z + 1.0, *map(zj.PhasePoint, ends), ())
        return fold.step(None, fold.init(None, z, step.y0), step)[0].outcome

    slow, fast = [3.13, 0.001, -0.001, 1.0, 1.0], [3.13, 0.1, -0.1, -0.2, -0.2]
    alone, beside = (
        jax.jit(jax.vmap(outcome))(*jnp.asarray(rows).T)
        for rows in ([slow, slow], [slow, fast])
    )
    assert beside[1] == zj.CODE.escaped
    assert alone[0] == beside[0]
