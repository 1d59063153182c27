"""The Rosenbrock method: its table, its reduced linear algebra, its stiff lanes."""

import itertools
import math

import diffrax as dfx
import jax
import jax.numpy as jnp
import models
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import ziegler_jax as zj
from ziegler_jax import CODE
from ziegler_jax.model.state import PhasePoint
from ziegler_jax.solvers import rosenbrock
from ziegler_jax.solvers.control import judge

pytestmark = pytest.mark.usefixtures("optimised")  # long runs, and batches

STAGES = 8


# The table ----------------------------------------------------------------------------


def triangular(rows, diagonal=0.0):
    full = np.diag(np.full(STAGES, diagonal))
    for i, row in enumerate(rows):
        full[i + 1, : len(row)] = row
    return full


# Hairer & Wanner, Solving ODEs II, IV.7: alpha, Gamma and b from the transformed table
INVERSE = np.eye(STAGES) / rosenbrock.GAMMA - triangular(rosenbrock.C)
GAMMAS = np.linalg.inv(INVERSE)
ALPHA = triangular(rosenbrock.A) @ GAMMAS
BETA = ALPHA + GAMMAS
WEIGHTS = np.array(rosenbrock.M) @ GAMMAS
EMBEDDED = (np.array(rosenbrock.M) - np.eye(STAGES)[-1]) @ GAMMAS


def trees(order):
    """Rooted trees of that order, each a sorted tuple of its branches."""
    if order == 1:
        return {()}
    found = set()
    for parts in partitions(order - 1):
        for branches in itertools.product(*(trees(n) for n in parts)):
            found.add(tuple(sorted(branches)))
    return found


def partitions(n, most=None):
    most = n if most is None else most
    if n == 0:
        return [()]
    return [
        (k, *rest) for k in range(min(n, most), 0, -1) for rest in partitions(n - k, k)
    ]


def size(tree):
    return 1 + sum(map(size, tree))


def density(tree):
    return size(tree) * math.prod(map(density, tree))


def elementary(tree):
    """Of each stage: a vertex with one branch takes beta, one with more takes alpha."""
    matrix = BETA if len(tree) == 1 else ALPHA
    product = np.ones(STAGES)
    for branch in tree:
        product = product * (matrix @ elementary(branch))
    return product


def residuals(weights, order):
    return [abs(weights @ elementary(t) - 1 / density(t)) for t in trees(order)]


@pytest.mark.parametrize("order, count", [(1, 1), (2, 1), (3, 2), (4, 4), (5, 9)])
def test_all_order_conditions_hold_up_to_5_and_up_to_4_embedded(order, count):
    assert len(trees(order)) == count
    # measured 1.6e-14
    assert max(residuals(WEIGHTS, order)) < 1e-13
    if order < 5:
        assert max(residuals(EMBEDDED, order)) < 1e-13  # measured 1.2e-14
    else:  # or the error estimate would vanish
        assert max(residuals(EMBEDDED, order)) > 1e-3  # measured 0.015


def stability(weights, z):
    """R(z): what one step makes of y' = lambda y, z = lambda h."""
    return 1 + z * weights @ np.linalg.solve(np.eye(STAGES) - z * BETA, np.ones(STAGES))


def test_it_is_stiffly_accurate_and_l_stable():
    # the weights are the last row: measured 4e-16
    np.testing.assert_allclose(WEIGHTS, BETA[-1], rtol=0, atol=4e-15)
    for weights in (WEIGHTS, EMBEDDED):
        assert abs(stability(weights, -1e9)) < 1e-7  # measured 1.3e-8
    on_axis = [abs(stability(WEIGHTS, 1j * y)) for y in np.logspace(-3, 4, 400)]
    # measured 1
    assert max(on_axis) < 1 + 1e-13


# One step -----------------------------------------------------------------------------


def columns():
    smooth = {"pin_radius": 0.3, "v_smooth": 0.01}
    two = zj.SmoothCoulomb(0.3, 0.2, v_stribeck=0.1, **smooth)
    reaction = zj.SmoothCoulomb(0.2, load=zj.JointReaction(1), **smooth)
    points = zj.point_masses(2, 1, 1.5, friction=two, follower=0.3, kappa=2.0)
    return [points, zj.uniform_rods(2.0, friction=reaction)]


@pytest.mark.parametrize("column", columns())
def test_one_step_is_that_of_the_method_with_4_by_4_systems(column, rng):
    def field(y):
        return jnp.stack(zj.vector_field(0.0, tuple(y), column))

    h, z = 0.05, 1.0
    step = jax.jit(
        lambda y: zj.Rosenbrock().advance(
            column.system().field, 0.0 * y[0], h, PhasePoint(y), ()
        )
    )
    slope = jax.jit(field)
    jacobian = jax.jit(jax.jacfwd(field))
    a, c = triangular(rosenbrock.A), triangular(rosenbrock.C)
    for y0 in rng.uniform(-0.3, 0.3, (5, 4)):
        matrix = np.eye(4) / (rosenbrock.GAMMA * h) - jacobian(y0)
        u = np.zeros((STAGES, 4))
        for i in range(STAGES):
            u[i] = np.linalg.solve(matrix, slope(y0 + a[i] @ u) + c[i] @ u / h)
        y1 = y0 + rosenbrock.M @ u
        # d/dz of (1-z) y0 + z (y1 + (1-z) (k1 + z (k2 + z k3))) at the end
        k1, k2, k3 = rosenbrock.H @ u
        end = (y1 - y0 - (k1 + z * (k2 + z * k3))) / h
        # the angles have none
        missed = np.append([0.0, 0.0], (slope(y1) - end)[2:])
        defect = np.linalg.solve(matrix, missed) / rosenbrock.GAMMA
        error = np.where(np.abs(defect) > np.abs(u[-1]), defect, u[-1])
        found, found_error, found_end, _ = step(y0)
        # stages of order 1, sums of a few hundred of them; measured 2e-14
        np.testing.assert_allclose(found, y1, rtol=0, atol=2e-13)
        np.testing.assert_allclose(found_error[2:], error[2:], rtol=0, atol=2e-13)
        np.testing.assert_allclose(found_error[:2], u[-1, :2], rtol=0, atol=2e-13)
        # divided by h
        np.testing.assert_allclose(found_end[2:], end[2:], rtol=0, atol=4e-12)


DAMPED = zj.uniform_rods(2.6, damping=zj.Viscous(0.05, 0.02))
SPAN = 4.0


def powers(t, y):
    parts = zj.power(DAMPED, y)
    return parts.follower, parts.damping


def fixed_steps(solver):
    """Ends of SPAN in n equal steps, the two works, and the slope that is handed on."""

    def solve(n, start):
        def body(i, carry):
            y, slope, works = carry
            t0 = i * h
            y, _, slope, more, *_ = solver.advance(
                DAMPED.system().field, t0, t0 + h, y, slope, powers
            )
            return y, slope, tuple(w + d for w, d in zip(works, more, strict=True))

        h = SPAN / n.astype(float)
        y = PhasePoint(start)
        first = zj.vector_field(0.0, y, DAMPED)
        y, slope, works = jax.lax.fori_loop(0, n, body, (y, first, (0.0 * h, 0.0 * h)))
        field = zj.vector_field(0.0, y, DAMPED)
        return jnp.stack(y), jnp.stack(works), jnp.stack(slope) - jnp.stack(field)

    return jax.jit(jax.vmap(solve, in_axes=(None, 0)))


def test_state_and_integrals_converge_with_order_5_and_the_slope_with_4():
    starts = np.random.default_rng(5).uniform(-0.4, 0.4, (64, 4))
    fine = fixed_steps(zj.Explicit(dfx.Dopri8.tableau))(np.int64(800), starts)
    solve = fixed_steps(zj.Rosenbrock())
    counts = [80, 113, 160, 226, 320]
    errors = []
    for n in counts:
        y, works, slope = solve(np.int64(n), starts)
        apart = (y - fine[0], works - fine[1], slope)
        errors.append([np.log(np.abs(e).max(-1)).mean() for e in apart])
    orders = -np.polyfit(np.log(counts), np.array(errors), 1)[0]
    # measured 4.99, 5.01, 3.95
    np.testing.assert_allclose(orders, [5, 5, 4], atol=0.3)


# Stiff lanes --------------------------------------------------------------------------


def rubbing(v_smooth, mu=0.26, q=2.0):
    friction = zj.SmoothCoulomb(
        mu, pin_radius=0.1, v_smooth=v_smooth, load=zj.ConstantLoad(1.0)
    )
    return zj.uniform_rods(q, friction=friction)


KICK = zj.State(omega=(0.0, 0.3))


def test_stiff_motions_meet_tolerances():
    """Against scipy's Radau at 1e-12, with stick and slip on the way."""
    ts = np.linspace(0.0, 12.0, 13)

    @jax.jit
    @jax.vmap
    def run(v_smooth, mu, tol):
        column = rubbing(v_smooth, mu)
        return zj.trajectory(
            column,
            KICK,
            ts,
            method=zj.Method(solver=zj.Rosenbrock(), rtol=tol, atol=tol),
        )

    scenes = np.array(list(itertools.product([1e-2, 1e-4, 1e-6], [0.1, 0.26])))
    tols = np.array([1e-5, 1e-6, 1e-7, 1e-8])
    found = run(*np.repeat(scenes, tols.size, 0).T, np.tile(tols, len(scenes)))
    assert (found.outcome == CODE.complete).all()
    ends = np.concatenate([found.phi, found.omega], -1)
    ends = ends.reshape(len(scenes), tols.size, ts.size, 4)
    for (v_smooth, mu), end in zip(scenes, ends, strict=True):
        truth = solve_ivp(
            lambda _, y, *numbers: models.field(y, *numbers),
            (0.0, 12.0), [0.0, 0.0, 0.0, 0.3], "Radau", ts,
            rtol=1e-12, atol=1e-13, args=(2.0, 0.1 * mu, v_smooth, 0.0, 0.0),
        )  # fmt: skip
        apart = np.abs(end - truth.y.T).max((1, 2)) / tols
        # measured 39, at v_smooth = 1e-4; with the embedded estimate alone 480
        assert apart.max() < 150, (v_smooth, mu, apart)


def test_a_joint_that_breaks_loose_within_a_step_is_seen():
    """It leaves a layer as narrow as the tolerance, from 3.3 v_smooth.

    The method damps its error estimate by the layer's slope at the start, 500 times too
    much at the end: only the controller, which looks at the layer, rejects the step.
    """
    v, tol, h = 1e-8, 1e-8, 0.013
    column, u1 = rubbing(v, mu=0.3), 0.11462121
    start = -0.0628783, -0.16778115, u1, u1 + 3.2539 * v

    @jax.jit
    def run(n):
        def body(i, carry):
            y, _ = carry
            t = i * h / n
            field = column.system().field
            return zj.Rosenbrock().advance(field, t, t + h / n, y, ())[:2]

        y = PhasePoint(map(jnp.asarray, start))
        return jax.lax.fori_loop(0, n, body, (y, y))

    y, error = run(1)
    truth, _ = run(20_000)
    wrong = max(abs(float(a - b)) for a, b in zip(y, truth, strict=True))
    assert wrong > 500 * tol  # measured 2310
    y0 = PhasePoint(map(jnp.asarray, start))
    for layer, passes in ((None, True), (v, False)):
        square, _ = judge(tol, tol, y0, y, error, 5, layer)
        assert (float(square) <= 1) == passes  # measured 0.06 and 22


LAYERS = 10.0 ** -np.arange(2, 9)


def point(v_smooth, q, mu):
    return zj.settle(
        rubbing(v_smooth, mu, q),
        KICK,
        windows=zj.Windows(transient=40.0, length=20.0, max_windows=1),
        observers=(zj.StickFraction(), zj.EnergyBalance()),
        method=zj.Method(solver=zj.Rosenbrock(), max_steps=20_000),
        certify=False,
    )


@pytest.fixture(scope="module")
def creeping():
    """Lanes that slip, stick and creep, for layers far below the tolerance, too."""
    axes = {"q": np.linspace(1.2, 3.2, 6), "mu": [0.02, 0.1, 0.2, 0.4]}
    return zj.sweep(point, v_smooth=LAYERS, progress=False, **axes)


def test_the_cost_hardly_depends_on_the_layer(creeping):
    steps = creeping.steps.mean(["q", "mu"]).values
    assert steps[4] < 3 * steps[0]  # v_smooth = 1e-6 and 1e-2; measured 2.4
    assert steps[-1] < 4 * steps[0]  # 1e-8; measured 3.2
    assert (creeping.outcome >= CODE.unsettled).all()


def test_creeping_joints_count_as_sticking_and_energy_balances(creeping):
    held = creeping.sel(mu=0.4, q=1.2)
    assert (held.outcome == CODE.stuck).all()
    np.testing.assert_array_equal(held.stick_fraction, 1.0)
    # measured 4.9e-7
    assert np.abs(creeping.energy_imbalance).max() < 5e-6


def test_legs_and_batches_change_nothing(creeping):
    mesh = [
        m.ravel() for m in np.meshgrid(LAYERS, creeping.q, creeping.mu, indexing="ij")
    ]
    at_once = jax.jit(jax.vmap(point))(*mesh)
    np.testing.assert_array_equal(creeping.outcome.values.ravel(), at_once.outcome)
    apart = creeping.rod_amplitude.values.reshape(-1, 2) - at_once.rod_amplitude
    # another program: equal to rounding, which friction magnifies; measured
    assert np.abs(apart).max() < 1e-9


def test_set_valued_friction_is_refused(refuses):
    column = zj.uniform_rods(1.0, friction=zj.SetValuedCoulomb(0.1, pin_radius=0.1))
    for run in (zj.settle, lambda *args, **more: zj.trajectory(*args, [0, 1], **more)):
        refuses(
            lambda run=run: run(column, KICK, method=zj.Method(zj.Rosenbrock())),
            "`solver`", "explicit", "SetValuedCoulomb", "`Rosenbrock()`",
        )  # fmt: skip
    refuses(lambda: zj.Method("stiff"), "`solver`", "'stiff'")
