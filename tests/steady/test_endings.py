"""How a motion may end: never in a cycle or a rest that is none."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr

import ziegler_jax as zj

pytestmark = pytest.mark.usefixtures("optimised")  # long runs

CODE = zj.CODE


def dry(tau, q=0.0, **options):
    law = zj.SetValuedCoulomb(1.0, pin_radius=1.0, load=zj.ConstantLoad(tau))
    return zj.uniform_rods(q, friction=law, **options)


def samples(**values):
    return {name: xr.DataArray(x, dims="sample") for name, x in values.items()}


def codes(ds, name="outcome"):
    return [CODE(int(code)).name for code in ds[name].values]


# Without load energy only falls


def unloaded(law, t1, t2, a, b, kappa):
    load = zj.ConstantLoad((t1, t2))
    if law == "viscous":
        column = zj.uniform_rods(0.0, kappa=kappa, damping=zj.Viscous(t1, t2))
    elif law == "smoothed":
        friction = zj.SmoothCoulomb(1.0, pin_radius=1.0, v_smooth=1e-2, load=load)
        column = zj.uniform_rods(0.0, kappa=kappa, friction=friction)
    else:
        column = dry((t1, t2), kappa=kappa)
    return column, zj.State((a, b))


def ends_without_load(law, certify, count, seed):
    source = np.random.default_rng(seed)
    axes = samples(
        t1=10 ** source.uniform(-6, 0, count), t2=10 ** source.uniform(-6, 0, count),
        a=source.uniform(-1, 1, count), b=source.uniform(-1, 1, count),
        kappa=10 ** source.uniform(-0.5, 0.5, count),
    )  # fmt: skip

    def point(**numbers):
        end = zj.settle(*unloaded(law, **numbers), certify=certify)
        return {"outcome": end.outcome}

    return codes(zj.sweep(point, axes=axes, progress=False))


@pytest.mark.parametrize("law, certify", [("dry", None), ("viscous", False)])
def test_without_load_nothing_repeats(law, certify):
    ends = set(ends_without_load(law, certify, 192, 1))
    assert ends <= {"stuck", "rest", "unsettled"} and len(ends) == 2


@pytest.mark.parametrize("certify", [False, None])
@pytest.mark.parametrize("law", ["dry", "smoothed", "viscous"])
def test_of_many_columns_without_load_none_repeats(law, certify):
    ends = set(ends_without_load(law, certify, 2048, 2))
    assert ends <= {"stuck", "rest", "unsettled"} and len(ends) == 2


def test_under_a_load_that_does_not_pay_nothing_repeats():
    """Little dissipates; what the load feeds in at chosen times hides that."""
    source, count = np.random.default_rng(1), 384
    follower = np.where(np.arange(count) < count / 2, 0.0, 0.5)

    @jax.jit
    @jax.vmap
    def ends(follower, q, tau, a, b, rtol):
        start, method = zj.State((a, b)), zj.Method(rtol=rtol)
        column = dry(tau, q=q, follower=follower)
        return zj.settle(column, start, method=method, certify=False).outcome

    found = ends(
        follower, source.uniform(0, 0.35 + 0.4 * follower),
        10 ** source.uniform(-7, -5, count), source.uniform(0.02, 0.4, count),
        source.uniform(-0.4, 0.4, count), 10 ** source.uniform(-9, -7, count),
    )  # fmt: skip
    assert (found != CODE.repeats).all()


def test_a_cycle_whose_joints_turn_several_times_a_period_repeats():
    """Each turn has an energy of its own; certificates say that both are cycles."""

    def ends(q, kappa, follower, c1, c2, tau, a, b):
        law = zj.SmoothCoulomb(
            tau, pin_radius=1.0, v_smooth=0.05, load=zj.ConstantLoad(1.0)
        )
        column = zj.uniform_rods(
            q, kappa=kappa, follower=follower, damping=zj.Viscous(c1, c2), friction=law
        )
        return zj.settle(column, zj.State((a, b)), certify=False).outcome

    found = jax.jit(jax.vmap(ends))(*jnp.array([
        [2.533, 0.5659, 0.7566, 0.004078, 0.00799, 0.0039, 0.03276, 0.1],
        [2.297, 1.73, 0.8587, 0.0005033, 0.00455, 0.0006806, -0.3406, 0.0],
    ]).T)  # fmt: skip
    assert (found == CODE.repeats).all()


@pytest.mark.parametrize("offset", [0.5, 0.0])
def test_an_offset_does_not_hide_that_a_joint_rings_down(offset):
    """Joint 1 sticks; joint 2 rings at 0.01 rad and loses 4 tau a period.

    Closed form: at rest after 0.01 / (4 tau) periods of 2 pi / sqrt(3).
    """
    start = zj.State((offset, offset + 0.01))
    slow, fast = (zj.settle(dry((0.8, tau)), start) for tau in (1e-6, 1e-5))
    assert slow.outcome == CODE.unsettled and fast.outcome == CODE.stuck
    assert abs(float(fast.time) - 907) < 40
    # the last window began at 1660, where so much was left; measured 1.9e-4 of 8e-3,
    # as steps of a tolerance of 1e-6 lose some
    left = 0.01 - 4 * 1e-6 * 1660 / (2 * np.pi / 3**0.5)
    assert abs(float(slow.joint_amplitude[1]) - left) < 5e-4


def test_what_does_not_dissipate_is_conservative_whatever_the_kick():
    """Joint 1 sticks, joint 2 has no friction: each kick swings on for ever."""

    @jax.jit
    @jax.vmap
    def ends(kick):
        start = zj.State(omega=(0.0, kick))
        return zj.settle(dry((1.0, 0.0)), start, certify=False)

    kicks = jnp.array([0.3, 0.5])
    found = ends(kicks)
    assert (found.outcome == CODE.conservative).all()
    # d = 1/3, a spring of 1: theta = omega / sqrt(3); at 1e-6 measured 9.5e-6
    np.testing.assert_allclose(found.joint_amplitude[:, 1], kicks / 3**0.5, atol=1e-4)


def test_a_window_of_less_than_a_return_tells_nothing():
    """Of a cycle of period 5.2."""

    @jax.jit
    @jax.vmap
    def ends(length):
        windows = zj.Windows(length=length, max_windows=8)
        start = zj.State(omega=(0.0, 1.0))
        column = dry(0.026, q=2.6)
        return zj.settle(column, start, windows=windows, certify=False).outcome

    found = ends(jnp.array([1e-6, 1.2, 2.4, 20.0]))
    assert (found[:3] == CODE.unsettled).all()
    assert found[3] == CODE.repeats


# Rest


def viscous_columns(count, seed, grows):
    """Columns whose upright state is a focus: with growth rate above 0, or below."""
    source, drawn = np.random.default_rng(seed), 4 * count
    axes = samples(
        q=source.uniform(0, 2.5, drawn), kappa=10 ** source.uniform(-0.5, 0.5, drawn),
        c1=10 ** source.uniform(-3, 0.3, drawn),
        c2=10 ** source.uniform(-3, 0.3, drawn),
    )  # fmt: skip

    def growth(q, kappa, c1, c2):
        column = zj.uniform_rods(q, kappa=kappa, damping=zj.Viscous(c1, c2))
        return {"growth": zj.spectral_abscissa(column)}

    rate = zj.sweep(growth, axes=axes, progress=False).growth.values
    chosen = np.flatnonzero((rate > 0) == grows)[:count]
    return {name: x[chosen] for name, x in axes.items()}, rate[chosen], source


def decayed(certify, count, seed):
    axes, rate, source = viscous_columns(count, seed, grows=False)
    axes |= samples(a=source.uniform(-1, 1, count), b=source.uniform(-1, 1, count))

    def point(q, kappa, c1, c2, a, b):
        column = zj.uniform_rods(q, kappa=kappa, damping=zj.Viscous(c1, c2))
        end = zj.settle(column, zj.State((a, b)), certify=certify)
        return {"outcome": end.outcome}

    ends = np.array(codes(zj.sweep(point, axes=axes, progress=False)))
    return ends[rate * 1660 < np.log(1e-8)]


@pytest.mark.parametrize("certify", [None, False])
def test_what_has_decayed_below_the_steps_error_is_at_rest(certify):
    ends = decayed(certify, 192, 3)
    assert len(ends) > 80 and (ends == "rest").mean() >= 0.98


@pytest.mark.parametrize("certify", [None, False])
def test_of_many_columns_what_has_decayed_is_at_rest(certify):
    ends = decayed(certify, 2048, 4)
    assert len(ends) > 1000 and (ends == "rest").mean() >= 0.98


class Quadratic(zj.AbstractDamping):
    c1: float
    c2: float

    def matrix(self, cos_d, omega):
        c1, c2 = self.c1 * abs(omega[0]), self.c2 * abs(omega[1] - omega[0])
        return (c1 + c2, -c2), (-c2, c2)


@pytest.mark.parametrize("certify", [None, False])
def test_of_many_small_cycles_none_is_stuck(certify):
    """Friction and damping of any scale, below the cut or the noise of the steps."""
    source, count = np.random.default_rng(8), 768
    bounds = {
        "size": (-5, -1), "slope1": (-3, 0.3), "slope2": (-3, 0.3), "v": (-3, 0),
        "v_stribeck": (-3, 0), "c1": (-4, -0.5), "c2": (-4, -0.5), "e1": (-1, 1),
        "e2": (-1, 1), "kick": (-1, 0.3), "tol": (-8, -3),
    }  # fmt: skip
    scenes = {
        name: jnp.asarray(10 ** source.uniform(*ends, count))
        for name, ends in bounds.items()
    }
    scenes["q"] = jnp.asarray(source.uniform(1, 3.5, count))

    def settled(s, method):
        v, size = s["v"] * s["size"], s["size"]
        static = s["slope1"] * v, s["slope2"] * v
        law = zj.SmoothCoulomb(
            static, (0.6 * static[0], 0.6 * static[1]), pin_radius=1.0, v_smooth=v,
            v_stribeck=s["v_stribeck"] * size, load=zj.ConstantLoad(1.0),
        )  # fmt: skip
        damping = zj.model.damping.Sum(
            zj.Viscous(s["c1"], s["c2"]), Quadratic(s["e1"] / size, s["e2"] / size)
        )
        column = zj.uniform_rods(s["q"], friction=law, damping=damping)
        start = zj.State(omega=(0.0, s["kick"] * size))
        return zj.settle(column, start, method=method, certify=certify).outcome

    @jax.jit
    @jax.vmap
    def ends(s):
        return settled(s, zj.Method(rtol=s["tol"], atol=s["tol"]))

    @jax.jit
    @jax.vmap
    def finer(s):
        return settled(s, zj.Method(rtol=1e-8, atol=1e-10 * s["size"]))

    stuck = np.flatnonzero(ends(scenes) == CODE.stuck)
    assert len(stuck) > 50
    again = finer({name: x[stuck] for name, x in scenes.items()})
    assert not np.isin(again, [CODE.cycle, CODE.repeats]).any()


def ends_of_what_grows(certify, count, seed):
    axes, _, source = viscous_columns(count, seed, grows=True)
    axes |= samples(
        size=10 ** source.uniform(-10, 0, count),
        way=source.uniform(0, 2 * np.pi, count),
        rtol=10 ** source.uniform(-9, -3, count),
    )

    def point(q, kappa, c1, c2, size, way, rtol):
        column = zj.uniform_rods(q, kappa=kappa, damping=zj.Viscous(c1, c2))
        start = zj.State((size * jnp.cos(way), size * jnp.sin(way)))
        method = zj.Method(rtol=rtol, max_steps=100_000)
        end = zj.settle(column, start, method=method, certify=certify)
        return {"outcome": end.outcome}

    return set(codes(zj.sweep(point, axes=axes, progress=False)))


def test_what_grows_is_never_at_rest():
    """Damping that destabilises among it; any start, at any tolerance."""
    ends = ends_of_what_grows(None, 192, 5)
    assert not ends & {"rest", "stuck"} and "cycle" in ends


@pytest.mark.parametrize("certify", [None, False])
def test_of_many_columns_none_that_grows_is_at_rest(certify):
    ends = ends_of_what_grows(certify, 2048, 6)
    assert not ends & {"rest", "stuck"} and ends & {"cycle", "repeats"}


def test_a_small_cycle_is_not_taken_for_rest_at_a_coarse_tolerance():
    """Just above q_cr(c) = 74/45 + 6 c^2/5 the cycle's angles are a few hundredths."""
    c = 1.0
    critical = 74 / 45 + 6 * c**2 / 5

    @jax.jit
    @jax.vmap
    def ends(off, rtol):
        column = zj.uniform_rods(critical * (1 + off), damping=zj.Viscous(c, c))
        method, windows = zj.Method(rtol=rtol), zj.Windows(max_windows=150)
        start = zj.State((0.05, 0.05))
        return zj.settle(column, start, method=method, windows=windows).outcome

    off, rtol = jnp.meshgrid(
        jnp.array([1e-5, 1e-4, 3e-3, 1e-2]), jnp.array([1e-8, 1e-6, 1e-4, 1e-3])
    )
    found = np.asarray(ends(off.ravel(), rtol.ravel()))
    assert not np.isin(found, [CODE.rest, CODE.stuck]).any()
    assert (found == CODE.cycle).any()
