"""`settle`, then `periodic_orbit`, at each point: each motion in chunks of its own."""

import jax
import numpy as np
import pytest

import ziegler_jax as zj
from ziegler_jax.results import CODE
from ziegler_jax.sweep import program

pytestmark = pytest.mark.usefixtures("optimised")  # bits, as users get them

LOADS = np.array([1.2, 1.5, 1.8, 2.0, 2.2, 2.4, 2.7])  # q_cr = 1.656


def point(q):
    column = zj.uniform_rods(q, damping=zj.Viscous(0.1, 0.1))
    kick = zj.State(omega=(0.0, 0.3))
    motion = zj.settle(
        column,
        kick,
        windows=zj.Windows(transient=60.0, max_windows=4, agreement=1e-3),
        certify=False,
    )
    orbit = zj.periodic_orbit(
        column, motion.final, method=zj.Method(rtol=1e-8, atol=1e-8), max_time=20.0
    )
    return {
        "settled": motion.joint_amplitude[1],
        "amplitude": orbit.joint_amplitude[1],
        "period": orbit.period,
        "iterations": orbit.iterations,
        "outcome": orbit.outcome,
        "orbit_steps": orbit.steps,
    }


@pytest.fixture(scope="module")
def swept():
    return zj.sweep(point, q=LOADS, lanes=zj.Lanes(batch_size=4), progress=False)


def test_cycles_of_a_sweep_are_those_of_direct_calls(swept):
    direct = jax.jit(jax.vmap(point))(LOADS)
    found = swept.outcome.values == CODE.found
    assert found.tolist() == [False] * 2 + [True] * 5
    for name, values in direct.items():
        # measured 1.9e-9: another program rounds elsewhere, error estimates feel it,
        # and with them the lengths of steps
        np.testing.assert_allclose(swept[name].values, values, rtol=2e-8, err_msg=name)
    # windows agree early where motions settle slowly, near q_cr; the cycle is exact
    off = swept.settled.values[4:] / swept.amplitude.values[4:] - 1
    assert np.abs(off).max() < 2e-4  # measured 7e-5


def test_the_motion_the_return_and_the_shots_are_cut_apart(swept):
    stages = program.traced(point, ("q",), 4).stages
    assert sum(stage.is_loop for stage in stages) == 3
    # measured 0.11: seven lanes in 32 places
    assert 0.05 < swept.attrs["useful_step_fraction"] <= 1


def test_a_cycle_alone_is_the_same_bit_for_bit(swept):
    alone = zj.sweep(point, q=LOADS[[5]], lanes=zj.Lanes(batch_size=4), progress=False)
    for name in alone.data_vars:
        assert alone[name].values.tobytes() == swept[name].values[[5]].tobytes(), name
