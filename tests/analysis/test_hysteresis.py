"""Loads that rise and fall: hysteresis, and agreement with motions on their own."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from moreau import motion

import ziegler_jax as zj
from ziegler_jax.results import OUTCOMES, AbstractResult, Settings, quantity

LOADS = np.array([1.1, 1.2, 1.4, 1.7, 2.1, 2.5])


def dry(q, tau):
    law = zj.SetValuedCoulomb(tau, pin_radius=1.0, load=zj.ConstantLoad(1.0))
    return zj.uniform_rods(q, friction=law)


def point(tau, kick):
    return zj.sweep_up_down(
        lambda q: dry(q, tau),
        LOADS,
        kick=zj.State(omega=(0.0, kick)),
        observers=(zj.StickFraction(),),
    )


def stepped(q, kick, span, tau=0.01, h=5e-3):
    """After a kick: the largest |phi2 - phi1| and rate of 10 time units after a span.

    By Moreau's scheme.
    """
    y = motion(q, (tau, tau), (0.0, 0.0), (0.0, kick), span, round(span / h))
    knee, rate = 0.0, 0.0
    for _ in range(500):
        y = motion(q, (tau, tau), y[:2], y[2:], 0.02, 4)
        knee, rate = max(knee, abs(y[1] - y[0])), max(rate, abs(y[2]), abs(y[3]))
    return knee, rate


def test_the_way_down_leaves_the_cycle_at_the_fold_and_the_way_up_far_above():
    found = zj.sweep(
        point,
        tau=[0.01],
        kick=[0.0, 0.07],
        lanes=zj.Lanes(batch_size=2),
        progress=False,
    )
    found = found.squeeze()
    still, kicked = found.sel(kick=0.0), found.sel(kick=0.07)
    # without a kick nothing moves, however high the load
    assert (still.outcome == zj.CODE.stuck).all()
    assert (still.joint_amplitude == 0).all()
    assert (still.stick_fraction == 1).all()
    up, down = kicked.sel(branch="up"), kicked.sel(branch="down")
    # where a kick of 0.07 comes to rest, and where it grows, by time stepping
    codes = zj.CODE.stuck, zj.CODE.cycle
    for i, grows in ((0, False), (3, False), (5, True)):
        assert (stepped(LOADS[i], 0.07, 40.0)[1] > 0.01) == grows
        assert up.outcome[i] == codes[grows]
    assert (up.outcome[:4] == zj.CODE.stuck).all()
    # the cycle folds at 1.28802 (see `test_cycles`)
    cycles = down.q > 1.28802
    assert (down.outcome.where(~cycles, zj.CODE.stuck) == zj.CODE.stuck).all()
    assert (down.outcome.where(cycles, zj.CODE.cycle) == zj.CODE.cycle).all()
    # the cycle that time stepping settles on from far outside: fast at 2.5, not yet in
    # 300 time units at 1.4; measured 2.6e-6 and 0.023
    for i, share in ((5, 1e-4), (2, 0.1)):
        largest = stepped(LOADS[i], 2.0, 300.0)[0]
        knee = down.joint_amplitude.sel(joint=2)[i].item()
        assert abs(knee / largest - 1) < share
    assert (up.stick_fraction[0] == 1).all() and (down.stick_fraction[-1] < 1).all()
    # both branches tell of the one cycle at the top, to their agreement of 1e-3
    np.testing.assert_allclose(
        up.joint_amplitude[-1], down.joint_amplitude[-1], rtol=5e-3
    )


def test_certified_cycles_of_both_ways_are_those_that_a_hard_kick_reaches():
    """Smoothed friction: at 1.6 rest and a cycle coexist."""

    def smooth(load):
        law = zj.SmoothCoulomb(0.1, pin_radius=0.1, v_smooth=0.1)
        return zj.uniform_rods(load, friction=law, damping=zj.Viscous(0.02, 0.02))

    @jax.jit
    def both():
        kick = zj.State(omega=(0, 0.1))
        return zj.sweep_up_down(smooth, [1.4, 1.6, 1.8, 2.2], kick=kick)

    found = both()
    names = [[zj.CODE(int(x)).name for x in row] for row in found.outcome]
    assert names == [["stuck"] * 2 + ["cycle"] * 2, ["stuck"] + ["cycle"] * 3]
    assert dict(found.settings)["solver"] == "Tsit5"
    assert found.to_dataset().joint_amplitude.dims == ("branch", "load", "joint")
    # each is the orbit that closes there
    for place, load in ((1, 1.6), (2, 1.8), (3, 2.2)):
        start = zj.State(omega=(0, 1.5))
        alone = jax.jit(lambda q, start=start: zj.settle(smooth(q), start))(load)
        np.testing.assert_allclose(
            found.joint_amplitude[1, place], alone.joint_amplitude, 5e-5
        )  # measured 9.7e-6: an orbit closes to 1e-5
        assert abs(found.period[1, place] / alone.period - 1) < 2e-6  # measured 2.4e-7


def test_certified_ways_up_and_down_refuse_derivatives(refuses):
    def amplitude(tau):
        def make(q):
            law = zj.SmoothCoulomb(tau, pin_radius=0.1, v_smooth=0.1)
            return zj.uniform_rods(q, friction=law)

        found = zj.sweep_up_down(make, [1.4, 1.6], kick=zj.State(omega=(0, 0.1)))
        return found.joint_amplitude

    refuses(lambda: jax.eval_shape(jax.jacfwd(amplitude), 0.1), "certify=False")


class Pairs(AbstractResult):
    """A result with an outcome a joint: as one with branches, but cheap."""

    outcome: Any = eqx.field(
        metadata=quantity("how it ended", dims=("joint",), codes=OUTCOMES)
    )
    settings: Settings = ()


def test_a_sweep_keeps_several_outcomes_of_a_point(told):
    def pairs(x):
        ended = jnp.array([zj.CODE.stuck, zj.CODE.cycle], jnp.int8)
        return Pairs(jnp.where(x > 2, ended, ended[::-1]))

    ds = zj.sweep(pairs, x=np.arange(5.0), progress=False)
    first = ds.outcome.sel(joint=1)
    assert (first == np.where(ds.x > 2, zj.CODE.stuck, zj.CODE.cycle)).all()
    assert told()[-1]["outcomes"] == {"stuck": 5, "cycle": 5}


def test_bad_arguments_are_named(refuses):
    kick = zj.State(omega=(0, 0.1))

    def up_down(make=lambda q: dry(q, 0.1), values=(1.0, 2.0), kick=kick, **options):
        return zj.sweep_up_down(make, values, kick=kick, **options)

    refuses(lambda: up_down(make=dry(1.0, 0.1)), "`make_column`", "function")
    refuses(lambda: up_down(make=lambda q: q), "`make_column`", "`Column`")
    refuses(lambda: up_down(values=(2.0, 1.0)), "`values`", "increase")
    refuses(lambda: up_down(values=[1.0]), "`values`", "at least two")
    refuses(lambda: up_down(kick=0.1), "`kick`", "`State`")
    refuses(lambda: up_down(make=lambda joint: dry(joint, 0.1)), "`joint`", "unlike")
    refuses(
        lambda: up_down(make=lambda period: dry(period, 0.1), certify=True), "period"
    )
    refuses(lambda: up_down(make=lambda outcome: dry(outcome, 0.1)), "`outcome`")
    refuses(lambda: up_down(certify=1), "`certify`", "1")
    refuses(lambda: up_down(start=0.1), "`start`", "`State`")
    refuses(lambda: up_down(windows=zj.Windows(length=0.0)), "`length`", "0")
