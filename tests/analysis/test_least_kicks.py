"""Least kicks: closed forms, made-up thresholds, random kicks, differences."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from scipy.optimize import minimize

import ziegler_jax as zj
from ziegler_jax.analysis.kick_search import Plan, Rays, sphere


def sliding(tau1, tau2):
    """Set-valued friction with constant torques."""
    load = zj.ConstantLoad(1.0)
    return zj.SetValuedCoulomb((tau1, tau2), pin_radius=1.0, load=load)


# The search alone, on thresholds that are written down --------------------------------


def plane(c):
    """A manifold at the distance 1."""
    return 1.0 / jnp.maximum(jnp.abs(c[-1]), 1e-12)


def jump(c):
    """Two arcs; the lower one ends, where it is lowest, in a jump."""
    angle = jnp.arctan2(c[1], c[0]) % jnp.pi
    return jnp.where(angle < 2.0, 1.0 + 0.3 * (2.0 - angle), 1.5)


def edge(c):
    """A valley without curvature."""
    return 1.0 + jnp.abs(jnp.arctan2(c[1], c[0]) % jnp.pi - 1.234)


def two(c):
    """Two minima, 1 and 1.1, of unlike kicks and opposites."""
    deep, wide = jnp.array([-0.6, -0.8]), jnp.array([0.96, 0.28])
    return jnp.minimum(1 + 20 * (1 - c @ deep), 1.1 + (1 - c @ wide))


def everywhere(c):
    return 0.0 * c[0] + 1.0


def nowhere(c):
    return 0.0 * c[0] + jnp.inf


def at_once(c):
    return 0.0 * c[0]


MADE_UP = {2: (plane, jump, edge, two, everywhere, nowhere, at_once), 4: (plane,)}


def searched(k, lanes):
    """Where the search ends; lanes (threshold, odd, what lingers about it)."""
    thresholds, neighbours = MADE_UP[k], sphere(256, k, 0.25)

    @jax.jit
    @jax.vmap
    def search(which, odd, lingers):
        sizes = jnp.zeros(()), jnp.array(10.0)
        plan = Plan(*sizes, odd, 8, 1e-6, sphere(24, k), neighbours)

        def move(now):
            threshold = jax.lax.switch(which, thresholds, now.c)
            ended = jnp.where(now.r > threshold, zj.CODE.cycle, zj.CODE.stuck)
            slow = jnp.abs(now.r - threshold) < lingers
            ended = jnp.where(slow, zj.CODE.unsettled, ended)
            return plan.after(now, ended, ended == zj.CODE.cycle)

        def goes_on(now):
            return (now.outcome == zj.CODE.not_computed) & (now.motions < 5000)

        now = jax.lax.while_loop(goes_on, move, plan.begin(jnp.array(True)))
        return now, jax.lax.switch(which, thresholds, now.best.c)

    which = [thresholds.index(lane[0]) for lane in lanes]
    return search(
        jnp.array(which),
        jnp.array([lane[1] for lane in lanes]),
        jnp.array([lane[2] for lane in lanes]),
    )


def test_the_search_ends_at_the_lowest_threshold_or_says_why_not():
    """Smooth, on a jump, on an edge, of two minima; a motion's verdict is one bit."""
    lanes = [(x, x is not two, 0.0) for x in MADE_UP[2]]
    now, threshold = searched(2, [*lanes, (everywhere, True, 1e-3)])
    code = zj.CODE
    assert now.outcome.tolist() == [
        *[code.found] * 5, code.rests, code.moves, code.undecided
    ]  # fmt: skip
    low, high = now.best.low[:5], now.best.high[:5]
    assert ((low <= threshold[:5]) & (threshold[:5] <= high)).all()
    np.testing.assert_allclose(high, low, rtol=1e-6)
    # of second order in the last step, 1e-3, where it is smooth: 9.9e-7; of first on
    # a jump, 1.3e-5, and on an edge, 4.7e-4
    np.testing.assert_allclose(high[jnp.array([0, 3, 4])], 1.0, rtol=1e-5)
    np.testing.assert_allclose(high[1:3], 1.0, rtol=2e-3)
    assert now.best.high[7] > 1.001 - 1e-9 and now.best.low[7] < 0.999


def test_the_search_ends_at_the_lowest_threshold_in_four_dimensions():
    now, _ = searched(4, [(plane, True, 0.0)])
    assert now.outcome[0] == zj.CODE.found
    np.testing.assert_allclose(now.best.high, 1.0, rtol=2e-5)  # 2.1e-6


def test_a_start_has_the_energy_that_is_asked_for():
    """The energy of rates and angles is not quite a square."""
    column = zj.uniform_rods(2.0, kappa=1.7)
    rays = Rays(column, zj.energy, (0, 1, 2, 3))
    starts = jax.jit(jax.vmap(lambda c: rays.at(column, c, 1.3)))(sphere(20, 4))
    exact = zj.energy(column, tuple(starts.T))
    np.testing.assert_allclose(exact, 1.3**2 / 2, rtol=5e-15)  # 4.4e-16


# Motions ------------------------------------------------------------------------------


def kick(numbers, eta, escape, largest):
    """The least energy, and all else, of a scene whose rates are kicked."""
    q, tau1, tau2 = numbers
    column = zj.uniform_rods(q, follower=eta, friction=sliding(tau1, tau2))
    result = zj.least_kick(
        column,
        (0.0, largest),
        directions=zj.Directions(count=8, scan=4, width=1e-7),
        windows=zj.Windows(escape=escape),
        method=zj.Method(rtol=1e-9, atol=1e-9 * tau1),
    )
    return result.energy, result


TAU = 0.02
NUMBERS, STEP = np.array([2.3, TAU, TAU]), 1e-3 * np.array([1.0, 2.0, -1.0])
LANES = [
    (0.8, 0.05, 10.0, 0.0, 0.5, 1.0),  # a pendulum on a spring under a dead load
    (1.2, 0.05, 10.0, 0.0, 0.5, 1.0),
    (2.2, TAU, TAU, 1.0, np.pi, 20 * TAU**2),
    (2.3, TAU, TAU, 1.0, np.pi, 20 * TAU**2),
    (2.2, TAU, TAU, 1.0, np.pi, 2 * TAU**2),  # less than the least kick
    (2.2, TAU, -TAU, 1.0, np.pi, 2 * TAU**2),
    *((2.1, tau, tau, 1.0, np.pi, 20 * tau**2) for tau in (0.001, 0.02, 0.04)),
    *((*NUMBERS * (1 + x * STEP), 1.0, np.pi, 20 * TAU**2) for x in (1, -1)),
]


@pytest.fixture(scope="module")
def least():
    """Least kicks of all lanes, and the derivatives of their energies: one program."""
    lanes = np.array(LANES)
    call = jax.jit(jax.vmap(jax.value_and_grad(kick, has_aux=True)))
    (_, result), slopes = call(lanes[:, :3], *lanes[:, 3:].T)
    ds = result.to_dataset().rename(lane_1="lane")
    return ds.assign(slope=(("lane", "number"), np.asarray(slopes)))


def top(q, tau):
    """Where a column that is stiff in joint 2 overturns under a dead load."""
    angle = tau / (2 * q - 1)
    for _ in range(20):
        angle -= (2 * q * np.sin(angle) - angle - tau) / (2 * q * np.cos(angle) - 1)
    return angle


def test_a_stiff_column_is_overturned_by_the_energy_of_the_saddle(least):
    """Whose rods turn alike, as what slips in the stiff joint is lost.

    The edge state is the equilibrium under joint 1's sliding friction.
    """
    for lane in (0, 1):
        q, tau = LANES[lane][:2]
        angle, one = top(q, tau), least.isel(lane=lane)
        work = angle**2 / 2 - 2 * q * (1 - np.cos(angle)) + tau * angle
        assert one.outcome == zj.CODE.found
        # the share of rates that the stiff joint stops: measured
        # 5.2e-8
        np.testing.assert_allclose(one.energy, work, rtol=5e-7)
        np.testing.assert_allclose(*one.rate, rtol=1e-2)
        assert one.edge == zj.CODE.equilibrium
        phi1, d = one.edge_amplitude.values  # joint 2 holds a little
        sides = [q * np.sin(phi1) + q * np.sin(phi1 + x) - phi1 for x in (d, -d)]
        assert np.min(np.abs(np.array(sides) - tau)) < 1e-9 and d < 0.01 * phi1


def test_below_the_least_kick_it_rests_and_above_it_flutters(least):
    """So it does along random directions: none flutters with less energy."""
    factor = np.linalg.cholesky([[4 / 3, 1 / 2], [1 / 2, 1 / 3]])
    rng = np.random.default_rng(3)
    turns = rng.uniform(0, 2 * np.pi, 600)
    circle = np.linalg.solve(factor.T, [np.cos(turns), np.sin(turns)])
    lanes = (2, 3)
    own = [least.rate.values[i] * share for i in lanes for share in (0.998, 1.002)]
    random = [
        circle * np.sqrt(2 * least.energy.values[i] * rng.uniform(0.3, 1, turns.size))
        for i in lanes
    ]
    q = np.repeat([2.2, 2.3], turns.size + 2)
    rates = np.concatenate(
        [part for two, many in zip((own[:2], own[2:]), random, strict=True)
         for part in (np.array(two), many.T)]
    )  # fmt: skip

    def plain(q, omega1, omega2):
        column = zj.uniform_rods(q, friction=sliding(TAU, TAU))
        windows = zj.Windows(transient=1500.0, agreement=1e-3)
        start = zj.State(omega=(omega1, omega2))
        method = zj.Method(rtol=1e-8)
        return zj.settle(column, start, windows=windows, method=method, certify=False)

    axes = {"q": q, "omega1": rates[:, 0], "omega2": rates[:, 1]}
    axes = {name: xr.DataArray(x, dims="kick") for name, x in axes.items()}
    ended = zj.sweep(plain, axes=axes, progress=False).outcome.values
    ended = ended.reshape(2, -1)
    assert (ended[:, 0] == zj.CODE.stuck).all()
    assert (ended[:, 1] == zj.CODE.repeats).all()
    assert (ended[:, 2:] == zj.CODE.stuck).all()


def test_the_least_kick_is_a_critical_kick_with_its_normal_along_the_gradient(least):
    """The edge is a cycle with one unstable multiplier, through which it passes."""
    for lane in (2, 3):
        one = least.isel(lane=lane)
        assert one.outcome == zj.CODE.found and one.edge == zj.CODE.saddle_cycle
        assert one.misalignment < 2e-3 and one.edge_multiplier > 1  # 1.4e-4
        assert one.width / one.energy < 4e-6


def test_lanes_without_a_least_kick_say_why(least):
    assert least.outcome[4] == zj.CODE.rests and least.edge[4] == zj.CODE.no_threshold
    assert least.outcome[5] == zj.CODE.invalid
    for name in ("energy", "width", "rate", "misalignment", "edge_period"):
        assert np.isnan(least[name][4:6]).all(), name


def test_the_energy_over_the_square_of_the_torque_departs_as_its_square(least):
    """Small motions with Coulomb friction are homogeneous in state and torque."""
    small, *larger = (i for i, lane in enumerate(LANES) if lane[0] == 2.1)
    scaled = least.energy.values / np.array(LANES)[:, 1] ** 2
    one, two = (scaled[i] / scaled[small] - 1 for i in larger)
    assert 0 < one < 2e-3 and abs(two / one - 4) < 0.1  # 4.013


def test_the_least_energy_moves_as_its_derivative_says(least):
    """In the load and both torques; by differences of least energies."""
    high, low = least.energy.values[9:]
    along = least.slope.values[3] @ (2 * STEP * NUMBERS)
    np.testing.assert_allclose(along, high - low, rtol=2e-3)  # 1.9e-4
    # at the saddle of a pendulum: the loads' and the friction's own work
    for lane in (0, 1):
        q, tau = LANES[lane][:2]
        angle = top(q, tau)
        exact = [-2 * (1 - np.cos(angle)), angle, 0.0]
        # measured 2e-6
        np.testing.assert_allclose(least.slope[lane], exact, rtol=2e-5, atol=1e-9)
    assert np.isnan(least.slope[4:6]).all()


def test_bad_arguments_are_named(refuses):
    column = zj.uniform_rods(2.0, friction=sliding(TAU, TAU))
    refuses(lambda: zj.least_kick(2.0, (0, 1)), "`column`", "2.0")
    refuses(lambda: zj.least_kick(column, (1, 0)), "`bracket`", "(1, 0)")
    refuses(lambda: zj.least_kick(column, (-1, 1)), "`bracket[0]`", "-1")
    refuses(lambda: zj.least_kick(column, (0, 1), norm=2), "`norm`", "2")
    refuses(
        lambda: zj.least_kick(column, (0, 1), directions="rates"),
        "`directions`",
        "`Directions`",
    )
    refuses(lambda: zj.Directions("speeds"), "`free`", "rates, angles, both", "speeds")
    refuses(lambda: zj.Directions(count=0), "`count`", "0")
    refuses(lambda: zj.Directions(width=0.0), "`width`", "0.0")
    refuses(lambda: zj.Directions(width="a"), "`width`", "number", "'a'")

    def both(column, y):
        return jnp.stack([y[2] ** 2, y[3] ** 2])

    for norm, part in (
        (both, "shape (2,)"),
        (lambda y: y[2], "takes (y)"),
        (lambda column, y: "energy", "'energy'"),
    ):
        refuses(partial(zj.least_kick, column, (0, 1), norm=norm), "`norm`", part)
    refuses(lambda: jax.jit(lambda x: zj.Directions(width=x).width)(0.1), "`width`")


def test_a_starts_derivative_is_refused(refuses):
    """`energy` has one; the direction's would need second variations."""

    def angle(q):
        leaves = [q * 0 + 1.0] * 5
        kick = zj.LeastKick(
            leaves[0], leaves[0], jnp.ones(4) * leaves[0], *[leaves[0]] * 2,
            jnp.ones(4), *[leaves[0]] * 2, jnp.ones(2), *[leaves[0]] * 5, settings=(),
        )  # fmt: skip
        return kick.rate[0]

    refuses(lambda: jax.grad(angle)(1.0), "least kick", "energy")


def test_scipy_agrees_on_the_least_angles_that_overturn():
    """Released from rest: the saddle's torque balance, elastic energy least."""
    q, tau = 1.2, 0.05

    def elastic(x):
        return x[0] ** 2 / 2 + x[1] ** 2 / 2

    def drive(x):  # beyond friction, of both rods about the base
        return q * np.sin(x[0]) + q * np.sin(x[0] + x[1]) - x[0] - tau

    balance = {"type": "eq", "fun": drive}
    exact = minimize(elastic, [0.05, 0.05], constraints=balance, tol=1e-14)
    assert exact.success
    law = sliding(tau, 10.0)
    column = zj.uniform_rods(q, follower=0.0, friction=law)

    @jax.jit
    def released():
        return zj.least_kick(
            column,
            (0.0, 0.1),
            directions=zj.Directions("angles", count=6, scan=4),
            windows=zj.Windows(escape=0.5),
        )

    kick = released()
    assert kick.outcome == zj.CODE.found
    np.testing.assert_allclose(kick.energy, exact.fun, rtol=1e-5)
