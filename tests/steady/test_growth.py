"""How much a difference in the kick grows: against differences, and what it tells."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import ziegler_jax as zj
from ziegler_jax.__main__ import KICK
from ziegler_jax.steady.growth import growth_variables

SMOOTH = zj.SmoothCoulomb(0.026, pin_radius=1, v_smooth=0.05, load=zj.ConstantLoad(1))
SET_VALUED = zj.SetValuedCoulomb(0.026, pin_radius=1, load=zj.ConstantLoad(1))
FINE = zj.Method(zj.Explicit(), rtol=1e-9)


@pytest.mark.parametrize(
    "friction, method",
    [(SMOOTH, FINE), (SET_VALUED, FINE), (SET_VALUED, zj.Method(rtol=1e-9))],
    ids=["smoothed", "stick", "stick by Taylor"],
)
def test_growth_is_that_of_differences(friction, method):
    """Of a motion of known length; the tangent is looked at where steps end."""
    column, end = zj.uniform_rods(2.6, friction=friction), 30.0
    windows = zj.Windows(transient=end - 10, length=10.0, max_windows=1)

    @jax.jit
    def growth():
        return zj.settle(
            column, zj.State(omega=KICK), windows=windows, method=method,
            observers=(zj.Growth(),), certify=True,
        )  # fmt: skip

    settled = growth()
    assert settled.outcome == zj.CODE.unsettled

    @jax.jit
    def states(kick):
        ts = jnp.linspace(0.0, end - 10, 4001)
        motion = zj.trajectory(column, zj.State(omega=(0.0, kick)), ts, method=method)
        return jnp.concatenate([motion.phi, motion.omega], axis=-1)

    h = 1e-6
    apart = (states(KICK[1] + h) - states(KICK[1] - h)) / (2 * h)
    largest = np.linalg.norm(apart, axis=-1).max()
    assert largest > 2
    # measured: 2.9e-4 and 4.4e-4 less
    assert settled.growth == pytest.approx(largest, rel=2e-3)


def test_a_start_at_rest_has_no_direction_and_a_failed_lane_no_growth():
    column = zj.uniform_rods(2.6, friction=SMOOTH)

    @jax.jit
    def growth(kick):
        start = zj.State(omega=(0.0, kick))
        return zj.settle(column, start, observers=(zj.Growth(),))

    at_rest, failed = growth(0.0), growth(jnp.nan)
    assert at_rest.outcome == zj.CODE.stuck and jnp.isnan(at_rest.growth)
    assert failed.outcome == zj.CODE.invalid and jnp.isnan(failed.growth)
    assert not at_rest.sensitive and not failed.sensitive


def test_a_thousandth_of_the_state_is_the_bound():
    growth = jnp.asarray([0.99e3, 1.01e3, jnp.nan])
    failed = jnp.asarray([False, False, True])
    found = growth_variables(growth, failed, 1e-6)
    assert found["sensitive"].value.tolist() == [False, True, False]
    assert growth_variables(growth, failed, 1e-8)["sensitive"].value.sum() == 0


def test_growth_is_refused_where_windows_judge(refuses):
    column, start = zj.uniform_rods(2.6, friction=SMOOTH), zj.State(omega=KICK)
    growth = (zj.Growth(),)
    for options in ({"certify": False}, {"method": zj.Method(zj.Rosenbrock())}):
        refuses(
            lambda options=options: zj.settle(
                column, start, observers=growth, **options
            ),
            "`observers`", "Growth()", "certify",
        )  # fmt: skip
