"""What a designer asks of the critical load: tables, the best parameters, maps."""

import jax
import jax.numpy as jnp
import matplotlib
import numpy as np
import pytest
import xarray as xr

import ziegler_jax as zj
from ziegler_jax.results import CODE

matplotlib.use("Agg")
SQRT2, SQRT7 = np.sqrt(2.0), np.sqrt(7.0)


def ziegler(**parts):
    return zj.point_masses(2, 1, **parts)


def test_sensitivity_lists_every_leaf_of_the_linear_map():
    table = zj.sensitivity(zj.uniform_rods(damping=zj.Viscous(0.1, 0.2)))
    names = ["a", "b", "d", "kappa", "follower", "damping.c1", "damping.c2"]
    assert table.parameter.values.tolist() == names
    dead = zj.sensitivity(zj.uniform_rods(follower=0.9))
    assert "l2" in dead.parameter.values


def test_elasticity_is_per_cent_of_load_per_per_cent_of_parameter():
    column = zj.uniform_rods(damping=zj.Viscous(0.1, 0.2))
    table = zj.sensitivity(column)
    q = table.q_cr
    more = zj.critical_load(zj.uniform_rods(damping=zj.Viscous(0.1, 0.2 * 1.0001))).q_cr
    per_cent = (float(more) / q - 1) / 1e-4
    np.testing.assert_allclose(
        per_cent, table.elasticity.sel(parameter="damping.c2"), rtol=1e-3
    )


def test_the_table_prints_whole():
    table = zj.sensitivity(zj.uniform_rods(follower=0.9, damping=zj.Viscous(0.1, 0.2)))
    assert table.parameter.size == 8
    assert str(table.to_dataframe()).count("\n") == 9 and "..." not in str(
        table.to_dataframe()
    )
    with xr.set_options(display_width=120):
        assert "..." not in repr(table)


def test_units_do_not_matter_elasticities_of_the_inertia_cancel():
    # q_cr does not depend on the unit of mass: undamped, a, b and d together
    table = zj.sensitivity(zj.uniform_rods())
    inertia = table.elasticity.sel(parameter=["a", "b", "d"])
    assert abs(float(inertia.sum())) < 1e-14


def test_sensitivity_to_masses_and_lengths_goes_through_the_constructor():
    # a = m1 + m2, b = d = m2: q_cr = (5 + r - 2 sqrt(r)) / 2 with r = m1 / m2
    table = zj.sensitivity(zj.point_masses, parameters={"m1": 2.0, "m2": 1.0})
    slope = (1 - 1 / SQRT2) / 2
    np.testing.assert_allclose(table.derivative, [slope, -2 * slope], rtol=1e-13)
    share = 2 * slope / (7 / 2 - SQRT2)
    np.testing.assert_allclose(table.elasticity, [share, -share], rtol=1e-13)


def test_sensitivity_has_no_number_where_the_load_jumps():
    table = zj.sensitivity(zj.uniform_rods(damping=zj.Viscous(0.0, 0.0)))
    assert table.outcome == "undamped"
    assert np.isnan(table.derivative.sel(parameter=["damping.c1", "damping.c2"])).all()
    assert np.isfinite(table.derivative.sel(parameter=["a", "b", "d", "kappa"])).all()


def test_sensitivity_refuses_a_load_that_is_not_there():
    with pytest.raises(ValueError, match="outcome is `no_load`"):
        zj.sensitivity(zj.uniform_rods(), "divergence")
    with pytest.raises(ValueError, match="`parameters` must name leaves"):
        zj.sensitivity(zj.uniform_rods(), parameters=["mass"])


def best_ratio(make):
    """c1/c2 of vanishing damping that raises q_cr most, with omega^2 = p2 / (2 p0)."""

    def scene(log_ratio):
        return make(damping=zj.Viscous(1e-9 * jnp.exp(log_ratio), 1e-9))

    best = zj.stabilise(scene, {"log_ratio": (-3.0, 5.0)})
    scan = np.linspace(-3, 5, 100_001)
    loads = jax.jit(jax.vmap(lambda x: zj.critical_load(scene(x)).q_cr))(scan)
    return best, scan[np.argmax(loads)], np.max(loads)


def test_the_best_damping_ratio_of_zieglers_column_is_4_and_5_sqrt2():
    best, scanned, top = best_ratio(ziegler)
    assert best.converged
    # a maximum is flat: q_cr to 1e-10 fixes the ratio to 1e-5
    np.testing.assert_allclose(
        best.parameters["log_ratio"], np.log(4 + 5 * SQRT2), atol=1e-5
    )
    assert abs(best.parameters["log_ratio"] - scanned) < 1e-4
    np.testing.assert_allclose(float(best.load.q_cr), 7 / 2 - SQRT2, rtol=1e-10)
    assert float(best.load.q_cr) > top - 1e-10


def test_the_best_damping_ratio_of_the_seed_undoes_the_paradox():
    # r(q) = p3/p1 = p2/(2 p0) = sqrt(36/7) at the undamped q_cr
    best, scanned, top = best_ratio(zj.uniform_rods)
    q, r = (18 - 2 * SQRT7) / 5, np.sqrt(36 / 7)
    ratio = _ratio_at(q, r)
    np.testing.assert_allclose(best.parameters["log_ratio"], np.log(ratio), atol=1e-5)
    assert abs(best.parameters["log_ratio"] - scanned) < 1e-4
    np.testing.assert_allclose(float(best.load.q_cr), q, rtol=1e-10)
    assert float(best.load.q_cr) > top - 1e-10


def _ratio_at(q, r):
    """c1/c2 that makes p3 = r p1 at q, both linear in the dampings."""

    def gap(c1, c2):
        p1 = 4 / 3 * c2 + (c1 + c2) / 3 + 2 * c2 / 2
        k = np.array([[2 - q, q - 1], [-1.0, 1.0]])
        p3 = (c1 + c2) * k[1, 1] + c2 * k[0, 0] + c2 * k[1, 0] + c2 * k[0, 1]
        return p3 - r * p1

    return -gap(0.0, 1.0) / gap(1.0, 0.0)


def test_stabilise_reaches_a_bound_and_never_leaves_the_box():
    column = zj.uniform_rods(damping=zj.Viscous(0.1, 0.2))
    box = {"damping.c1": (0.01, 1.0), "damping.c2": (0.01, 1.0), "kappa": (0.5, 2.0)}
    best = zj.stabilise(column, box)
    assert best.converged and int(best.load.outcome) == CODE.found
    grid = [np.linspace(lo, hi, 25) for lo, hi in box.values()]
    mesh = [x.ravel() for x in np.meshgrid(*grid)]

    def load(c1, c2, kappa):
        damping = zj.Viscous(c1, c2)
        return zj.critical_load(zj.uniform_rods(kappa=kappa, damping=damping)).q_cr

    scan = jax.vmap(load)(*mesh)
    assert float(best.load.q_cr) >= float(scan.max()) - 1e-9
    for name, (lo, hi) in box.items():
        path = best.history[name].values
        assert (path >= lo).all() and (path <= hi).all()
    assert best.history.q_cr.values[-1] == best.history.q_cr.max()
    first = best.history.isel(step=0)
    np.testing.assert_allclose([first.kappa, first["damping.c2"]], [1.0, 0.2])


def test_stabilise_stops_where_divergence_would_come_first():
    # more c2 raises flutter beyond the divergence load of this eta > 1
    def scene(c2):
        damping = zj.Viscous(1.87, c2)
        return zj.Column(0.0, 2.4, 0.57, 0.75, 0.97, 1.12, damping, l2=1.76)

    best = zj.stabilise(scene, {"c2": (0.05, 0.44)}, start={"c2": 0.1})
    wall = float(zj.critical_load(scene(0.1), "divergence").q_cr)
    assert int(best.load.outcome) == CODE.found
    # the steps are spent in front of the wall: measured 9e-9 below it
    assert wall * (1 - 1e-6) < float(best.load.q_cr) < wall


def test_stabilise_names_what_is_wrong():
    column = zj.uniform_rods(damping=zj.Viscous(0.1, 0.2))
    for bounds, word in (({"mass": (0, 1)}, "leaves"), ({"a": (2, 1)}, "low < high")):
        with pytest.raises(ValueError, match=word):
            zj.stabilise(column, bounds)
    with pytest.raises(ValueError, match="outcome is `no_load`"):
        zj.stabilise(zj.uniform_rods(), {"kappa": (0.5, 2.0)}, kind="divergence")
    with pytest.raises(ValueError, match="`start` must name"):
        zj.stabilise(column, {"kappa": (0.5, 2.0)}, start={"b": 1.0})


def regime_of_mass_ratio(ratio, q):
    return {"regime": zj.regime(zj.uniform_rods(q, m1=ratio))}


def regime_of_eta(q, eta):
    return {"regime": zj.regime(zj.uniform_rods(q, follower=eta))}


def load_of_dampings(c1, c2):
    return zj.critical_load(zj.uniform_rods(damping=zj.Viscous(c1, c2)))


def regime_of_smoothing(q, v_smooth):
    friction = zj.SmoothCoulomb(0.1, pin_radius=0.1, v_smooth=v_smooth)
    column = zj.tangent_column(zj.uniform_rods(q, friction=friction))
    return {"regime": zj.regime(column)}


def test_maps_of_regimes_go_through_sweep():
    q = np.linspace(0, 6, 121)
    ds = zj.sweep(regime_of_eta, q=q, eta=np.linspace(0, 1, 41))
    seed = ds.regime.sel(eta=1.0)
    turns = (18 - 2 * SQRT7) / 5, (18 + 2 * SQRT7) / 5
    expected = np.where(q < turns[0], CODE.marginal, CODE.flutter)
    expected[q > turns[1]] = CODE.divergence
    np.testing.assert_array_equal(seed, expected)
    assert "divergence" in ds.regime.attrs["flag_meanings"]
    ds = zj.sweep(regime_of_mass_ratio, q=q, ratio=np.linspace(0.2, 3, 15))
    column = ds.regime.sel(ratio=1.0)
    np.testing.assert_array_equal(column, expected)


def test_whitneys_umbrella_goes_through_sweep():
    c = np.array([1e-6, 0.1, 1.0])
    ds = zj.sweep(load_of_dampings, c1=c, c2=c)
    assert (ds.outcome == CODE.found).all()
    np.testing.assert_allclose(ds.q_cr[0, 0], 74 / 45, rtol=1e-9)
    alone = zj.critical_load(zj.uniform_rods(damping=zj.Viscous(0.1, 1.0)))
    np.testing.assert_allclose(ds.q_cr.sel(c1=0.1, c2=1.0), alone.q_cr, rtol=1e-13)
    np.testing.assert_allclose(ds.frequency[1, 2], alone.frequency, rtol=1e-13)


def test_a_smoothed_map_is_a_map_of_v_smooth():
    # q = 1.8, tau = 0.018: stable or flutter by the smoothing alone
    ds = zj.sweep(
        regime_of_smoothing, q=np.array([1.8, 2.0]), v_smooth=np.geomspace(1e-3, 1, 40)
    )
    assert {CODE.stable, CODE.flutter} == set(ds.regime.sel(q=1.8).values.tolist())


@pytest.mark.parametrize(
    ("parameters", "word"),
    [({}, "at least one"), (["a"], "map"), ({"kappa": 1.0}, "two numbers")]
    + [({"kappa": ("a", "b")}, "must be a number")],
)
def test_stabilise_refuses_what_are_no_bounds(parameters, word):
    column = zj.uniform_rods(damping=zj.Viscous(0.1, 0.2))
    with pytest.raises(ValueError, match=f"`parameters.*{word}"):
        zj.stabilise(column, parameters)


def test_stabilise_needs_a_step():
    with pytest.raises(ValueError, match="`max_steps` must be positive, but is 0"):
        zj.stabilise(zj.uniform_rods(), {"kappa": (0.5, 2.0)}, max_steps=0)


def test_sensitivity_names_an_argument_that_the_function_does_not_have():
    with pytest.raises(ValueError, match="`parameters` must name .*'mass'"):
        zj.sensitivity(zj.uniform_rods, parameters={"mass": 1.0})


def test_sensitivity_inside_jit_says_so():
    ask = lambda k: zj.sensitivity(zj.uniform_rods(kappa=k))  # noqa: E731
    with pytest.raises(ValueError, match="'kappa' is traced: call this outside"):
        jax.jit(ask)(1.0)


def test_a_jump_is_seen_through_a_square():
    def scene(c, kappa):
        return zj.uniform_rods(kappa=kappa, damping=zj.Viscous(c * c, c * c))

    table = zj.sensitivity(scene, parameters={"c": 0.0, "kappa": 1.0})
    assert np.isnan(table.derivative.sel(parameter="c"))
    assert np.isfinite(table.derivative.sel(parameter="kappa"))
