"""`solver="auto"`: lanes of a kind share a program, and each tells its kind."""

import jax
import numpy as np
import pytest

import ziegler_jax as zj
from ziegler_jax import OUTCOME, SOLVER
from ziegler_jax._choice import is_stiff, lanes_of

KICK = zj.State(omega=(0.0, 0.3))
SHORT = {"transient": 5.0, "window": 5.0, "max_windows": 1}


def column(v_smooth, mu=0.2, q=2.0):
    friction = zj.SmoothCoulomb(
        mu, pin_radius=0.1, v_smooth=v_smooth, load=zj.ConstantLoad(1.0)
    )
    return zj.uniform_rods(q, friction=friction)


def with_solver(solver):
    def point(v_smooth, mu):
        return zj.settle(column(v_smooth, mu), KICK, solver=solver, **SHORT)

    return point


AXES = {"v_smooth": [1e-1, 1e-2, 1e-4, 1e-6], "mu": [0.0, 0.1, 0.4]}


@pytest.fixture(scope="module")
def chosen():
    return zj.sweep(with_solver("auto"), progress=False, **AXES)


def test_the_rule_is_that_of_the_jacobian_at_rest():
    """15.4 tau / v_smooth against the column's fastest rate, by hand."""
    mass, damping, stiffness = zj.linearise(zj.tangent_column(column(1.0, mu=1.0)))
    decay = np.trace(np.linalg.solve(mass, damping))
    rate = np.linalg.norm(np.linalg.solve(mass, stiffness)) ** 0.5
    assert abs(decay / 0.1 - 15.43) < 0.01
    for rtol in (1e-4, 1e-10):
        border = decay * rtol**0.2 / rate  # v_smooth at mu = 1
        assert is_stiff(column(0.99 * border, 1.0), rtol)
        assert not is_stiff(column(1.01 * border, 1.0), rtol)


def test_a_sweep_groups_lanes_by_kind_and_tells_it(chosen):
    expected = np.vectorize(lambda v, mu: bool(is_stiff(column(v, mu), 1e-6)))
    stiff = expected(*np.meshgrid(AXES["v_smooth"], AXES["mu"], indexing="ij"))
    assert stiff.any() and not stiff.all()
    kinds = np.where(stiff, SOLVER.stiff, SOLVER.explicit)
    np.testing.assert_array_equal(chosen.solver_kind, kinds)
    assert chosen.solver_kind.attrs["flag_meanings"] == "not_computed explicit stiff"
    assert chosen.attrs["solver"] == "auto"
    assert (chosen.outcome >= OUTCOME.unsettled).all()


def test_each_lane_is_that_of_its_kind_alone(chosen):
    found = zj.sweep(with_solver(zj.Rosenbrock()), progress=False, **AXES)
    assert "solver_kind" not in found
    mine = chosen.solver_kind == SOLVER.stiff
    for name in ("steps", "rod_amplitude"):
        same = (found[name] == chosen[name]).where(mine, True)
        assert same.all(), name


def test_a_program_holds_one_method():
    """That of a group of stiff lanes is as long as that of the method by name."""

    def length(solver, kind):
        with lanes_of(kind):
            return len(str(jax.make_jaxpr(with_solver(solver))(1e-4, 0.2)))

    chosen = length("auto", SOLVER.stiff)
    # the kind is one number more
    assert abs(chosen / length(zj.Rosenbrock(), None) - 1) < 0.01


def test_known_numbers_are_chosen_for_in_python():
    @jax.jit
    def lane():
        return zj.settle(column(1e-4), KICK, solver="auto", **SHORT).solver_kind

    assert int(lane()) == SOLVER.stiff


def test_traced_numbers_outside_a_sweep_are_refused(refuses):
    refuses(
        lambda: jax.jit(with_solver("auto"))(1e-4, 0.2), "`solver`", "'auto'", "`sweep`"
    )

    def inner(v_smooth, mu):
        return {"steps": jax.jit(lambda: with_solver("auto")(v_smooth, mu).steps)()}

    refuses(
        lambda: zj.sweep(inner, progress=False, **AXES), "`solver`", "transformation"
    )


def test_traced_invalid_numbers_end_a_trajectory_as_invalid():
    run = jax.jit(
        lambda mu, ts: zj.trajectory(column(0.1, mu), KICK, ts, rtol=1e-4, atol=1e-4)
    )
    ts = np.linspace(0.0, 2.0, 3)
    assert int(run(0.1, ts).outcome) == OUTCOME.complete
    for bad in (np.nan, -1.0):
        found = run(bad, ts)
        assert int(found.outcome) == OUTCOME.invalid
        assert np.isnan(found.phi).all() and int(found.steps) == 0
        assert int(run(0.1, np.array([0.0, 2.0, bad])).outcome) == OUTCOME.invalid
