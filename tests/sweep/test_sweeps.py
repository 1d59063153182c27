"""Sweeps: labels, refusals, and lanes that depend on nothing but their own numbers."""

import itertools
import threading

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from jax import lax
from small_map import MU, Q, point, same, sweep

import ziegler_jax as zj
from ziegler_jax import CODE
from ziegler_jax.sweep import grid, pool, program, progress

pytestmark = pytest.mark.usefixtures("optimised")  # bits, as users get them


@pytest.fixture(scope="module")
def whole():
    """The reference: one thread."""
    return sweep(q=Q, mu=MU, lanes=zj.Lanes(32, 1))


# Labels -------------------------------------------------------------------------------


def test_axes_and_results_are_labelled(whole):
    assert whole.joint_amplitude.dims == ("q", "mu", "joint")
    assert whole.rod_amplitude.dims == ("q", "mu", "rod")
    assert whole.period.dims == whole.outcome.dims == ("q", "mu")
    assert whole.joint.values.tolist() == whole.rod.values.tolist() == [1, 2]
    assert (whole.q.values == Q).all() and (whole.mu.values == MU).all()
    assert whole.joint_amplitude.attrs["units"] == "rad"
    assert whole.period.attrs["units"] == "sqrt(m l^2/k)"
    assert whole.q.attrs["long_name"] == "follower load"
    for name, variable in whole.data_vars.items():
        assert variable.attrs["long_name"], name


def test_outcome_is_a_cf_flag_variable(whole):
    attrs = whole.outcome.attrs
    meanings = attrs["flag_meanings"].split()
    assert [CODE[name] for name in meanings] == list(attrs["flag_values"])
    assert "units" not in attrs
    assert CODE.cycle.sentence in attrs["comment"]
    assert whole.outcome.dtype == np.int8
    # the scene has more than one
    assert np.unique(whole.outcome).size >= 2


def test_attributes_say_how_it_was_computed(whole):
    attrs = whole.attrs
    for package in ("ziegler_jax", "jax", "jaxlib", "diffrax", "numpy"):
        assert attrs[f"{package}_version"][0].isdigit()
    assert "def point(q, mu)" in attrs["scene"]
    expected = {
        "rtol": 1e-4, "atol": 1e-4, "transient": 20.0, "window_length": 10.0,
        "solver": "Tsit5", "max_windows": 4, "threads": 1,
        "batch_size": 32, "points": 123,
    }  # fmt: skip
    assert {name: attrs[name] for name in expected} == expected
    assert 0 < attrs["useful_step_fraction"] <= 1
    assert attrs["points_per_second"] > 0


def test_a_dataset_can_be_stored(whole, tmp_path):
    whole.to_zarr(tmp_path / "map.zarr", consolidated=False)
    with xr.open_zarr(tmp_path / "map.zarr", consolidated=False) as back:
        assert same(back.load(), whole)


def test_where_leaves_points_out(whole):
    found = sweep(q=Q, mu=MU, where=lambda q, mu: q * mu <= 0.3)
    chosen = Q[:, None] * MU[None, :] <= 0.3
    assert found.attrs["points"] == chosen.sum() < chosen.size
    assert ((found.outcome == CODE.not_computed).values == ~chosen).all()
    assert np.isnan(found.joint_amplitude.values[~chosen]).all()
    for name in found.data_vars:
        kept = found[name].values[chosen], whole[name].values[chosen]
        assert np.array_equal(*kept, equal_nan=True), name


@pytest.mark.parametrize(
    "scalar, names",
    [
        (lambda x: x * x, ["value"]),
        (lambda x: {"one": x * x, "two": 2.0 * x}, ["one", "two"]),
        (lambda x: {"const": 1.0, "flag": x > 0.5, "one": x * x}, ["flag", "const"]),
    ],
    ids=["scalar", "dict", "others"],
)
def test_scalars_and_dicts_are_results(scalar, names):
    x = np.linspace(0, 1, 5)
    found = zj.sweep(scalar, x=x, progress=False)
    assert set(names) <= set(found.data_vars)
    assert found[list(found.data_vars)[-1]].dims == ("x",)
    if "one" in found:
        assert (found.one.values == x * x).all()


def test_a_dicts_order_does_not_matter():
    x = np.linspace(0, 1, 5)
    found = zj.sweep(lambda x: {"b": x + 10, "a": x}, x=x, progress=False)
    assert (found.a.values == x).all() and (found.b.values == x + 10).all()


def test_axes_may_be_named_like_options():
    def scene(threads, where, x):
        return threads + 10 * where + 100 * x

    found = zj.sweep(
        scene, axes={"threads": [1, 2], "where": [3.0]}, x=[4.0], progress=False
    )
    assert found.value.sel(threads=2, where=3, x=4).item() == 432
    assert set(found.value.dims) == {"threads", "where", "x"}


# Precision ----------------------------------------------------------------------------


def third(x):
    return {"sine": jnp.sin(x) / 3, "tenth": 0.1 * jnp.ones_like(x)}


def test_float64_whatever_jax_is_set_to():
    x = np.linspace(0, 7, 11)
    wide = zj.sweep(third, x=x, progress=False)
    program._cache.clear()
    with jax.enable_x64(False):
        narrow = zj.sweep(third, x=x, progress=False)
    assert narrow.sine.dtype == np.float64 and same(wide, narrow)
    assert (narrow.tenth == 0.1).all()


# A lane depends on its own numbers alone ----------------------------------------------


@pytest.mark.parametrize("threads", [2, 5])
def test_the_number_of_threads_changes_no_bit(whole, threads):
    assert same(sweep(q=Q, mu=MU, lanes=zj.Lanes(32, threads)), whole)


@pytest.mark.skipif(
    not program.compiles_whole_loops(), reason="its loops are many kernels"
)
@pytest.mark.parametrize("points, lanes", [(41, 32), (82, 64), (164, 128)])
def test_few_points_run_in_small_batches_with_the_same_bits(whole, points, lanes):
    mu = np.concatenate([MU, [0.3]])[: points // 41]
    few = sweep(q=Q, mu=mu, lanes=zj.Lanes())
    assert few.attrs["batch_size"] == lanes
    assert same(few.sel(mu=mu[:3]), whole.sel(mu=mu[:3]))


def test_batch_mates_and_places_change_no_bit(whole):
    scene = program.traced(point, ("q", "mu"), 32)
    compiled, found = program.compiled(scene), {}

    def put(points, results, steps):
        for lane, place in enumerate(points.tolist()):
            found[place] = [r[..., lane].copy() for r in results]

    order = np.random.default_rng(3).permutation(Q.size * MU.size)
    values = grid.Grid(xr.Dataset(coords={"q": Q, "mu": MU})).box.values
    pool.run_lanes(
        compiled, values, iter([order]), put, threads=2,
        on_batch=lambda *_: None,
    )  # fmt: skip
    for number, name in enumerate(scene.variables):
        values = whole[name].values.reshape(order.size, -1)
        for place, results in found.items():
            shuffled = np.asarray(results[number], values.dtype).ravel()
            assert shuffled.tobytes() == values[place].tobytes(), name
    assert same(sweep(q=Q[2:7], mu=MU[1:]), whole.isel(q=slice(2, 7), mu=slice(1, 3)))


@pytest.mark.parametrize("at", [(0, 2), (4, 0), (8, 1)])
def test_a_point_alone_is_the_same_bit_for_bit(whole, at):
    i, j = at
    assert same(sweep(q=Q[[i]], mu=MU[[j]]), whole.isel(q=[i], mu=[j]))


@pytest.mark.parametrize("chunks", [(3, 3, 3), (64, 1, 7), (10**6, 10**6, 10**6)])
def test_the_length_of_chunks_changes_no_bit(whole, monkeypatch, chunks):
    """Down to three steps a chunk, up to all in one."""
    for name, steps in zip(("FIRST", "SHORTEST", "LONGEST"), chunks, strict=True):
        monkeypatch.setattr(pool, f"{name}_CHUNK", steps)
    assert same(sweep(q=Q, mu=MU), whole)


@pytest.mark.parametrize("alike, stragglers", [(0.0, 0.0), (0.0, 0.5), (2.0, 0.05)])
def test_when_lanes_are_replaced_changes_no_bit(whole, monkeypatch, alike, stragglers):
    """When a usual lane has ended, when half have, or each when its chunk ends."""
    monkeypatch.setattr(pool, "ALIKE", alike)
    monkeypatch.setattr(pool, "STRAGGLERS", stragglers)
    monkeypatch.setattr(pool, "LONGEST_RUN", 50)
    found = sweep(q=Q, mu=MU)
    assert same(found, whole)
    assert 0 < found.attrs["useful_step_fraction"] <= 1


def test_lanes_run_in_chunks_at_all(whole):
    """Else the tests above would say nothing of them."""
    assert len(program.traced(point, ("q", "mu"), 32).stages) == 3
    assert whole.steps.max() > 2 * pool.FIRST_CHUNK


def test_the_last_lanes_run_to_their_end_in_one_call(whole, monkeypatch):
    """Where no lane waits for a place, none is made free."""
    lengths, call = [], pool.Run._call

    def watched(self, lanes, function, *arguments):
        lengths.extend(int(x) for x in arguments[:1] if np.ndim(x) == 0)
        return call(self, lanes, function, *arguments)

    monkeypatch.setattr(pool, "FIRST_CHUNK", 3)
    monkeypatch.setattr(pool, "_CALLS", itertools.count(1))  # none is made twice
    monkeypatch.setattr(pool.Run, "_call", watched)
    assert same(sweep(q=Q[:32], mu=MU[:1]), whole.isel(q=slice(32), mu=[0]))
    assert lengths == [pool.LAST_CHUNK]


def direct(scene, **columns):
    """The same numbers without a sweep: one vmapped call."""
    names = list(columns)
    mesh = [m.ravel() for m in np.meshgrid(*columns.values(), indexing="ij")]
    call = jax.jit(jax.vmap(lambda *v: scene(**dict(zip(names, v, strict=True)))))
    return call(*mesh)


def test_a_sweep_is_what_vmap_gives(whole):
    found = direct(point, q=Q, mu=MU)
    amplitude = np.asarray(found.joint_amplitude).reshape(whole.joint_amplitude.shape)
    assert (np.asarray(found.outcome) == whole.outcome.values.ravel()).all()
    assert (np.asarray(found.steps) == whole.steps.values.ravel()).all()
    error = np.abs(amplitude - whole.joint_amplitude.values).max()
    # measured 2.8e-17; another program may round elsewhere
    assert error < 1e-12


def test_lanes_that_fail_do_not_touch_the_others(whole):
    """Negative friction and loads that overflow, between the good ones."""
    q, mu = np.array([-1e200, *Q, 1e18, 1e308]), np.array([-0.1, *MU])
    found = sweep(q=q, mu=mu)
    assert same(found.sel(q=Q, mu=MU), whole)
    assert (found.outcome.sel(mu=-0.1) == CODE.invalid).all()
    bad = found.sel(q=[1e308, 1e18], mu=MU)
    assert (bad.outcome < CODE.unsettled).all()
    assert np.isnan(bad.joint_amplitude).all()


# Several motions, and what cannot be cut ----------------------------------------------

WINDOWS = zj.Windows(transient=5.0, length=5.0, max_windows=2)
SHORT = {"windows": WINDOWS, "method": zj.Method(rtol=1e-4)}


def knee(q, kick):
    found = zj.settle(
        zj.uniform_rods(q), zj.State(omega=(0.0, kick)), **SHORT, certify=False
    )
    return found.joint_amplitude[1]


def two_settles(q):
    return {"first": knee(q, 0.1), "second": knee(q, 0.3)}


def one_after_the_other(q):
    """The second load, and whether it counts, hang on the first motion."""
    first = knee(q, 0.1)
    unread = knee(q, 0.2)
    del unread
    second = knee(q + first, 0.3)
    return {"second": jnp.where(first > 0.01, second, first), "third": 2 * q}


def under_vmap(q):
    return jax.vmap(lambda kick: knee(q, kick))(np.array([0.1, 0.3])).sum()


def with_jvp(q):
    value, slope = jax.jvp(lambda q: knee(q, 0.2), (q,), (jnp.ones_like(q),))
    return {"slope": slope, "value": value}


@pytest.mark.parametrize(
    "scene, loops",
    [(two_settles, 2), (one_after_the_other, 2), (under_vmap, 0),
     (with_jvp, 0)],
)  # fmt: skip
def test_several_motions_and_what_is_not_cut_agree_with_direct_calls(scene, loops):
    q = np.linspace(1.0, 3.0, 5)
    found = zj.sweep(scene, q=q, lanes=zj.Lanes(batch_size=4), progress=False)
    assert len(program.traced(scene, ("q",), 4).stages) == 2 * loops + 1
    expected = direct(scene, q=q)
    if not isinstance(expected, dict):
        expected = {"value": expected}
    for name, values in expected.items():
        error = np.abs(found[name].values / np.asarray(values) - 1).max()
        # measured 1.1e-16; 2.3e-12 of the tangents, on jaxlib 0.12
        assert error < 1e-10


# Errors and interruptions -------------------------------------------------------------


def test_what_a_point_raises_comes_through_and_the_next_sweep_runs(whole):
    def broken(q, mu):
        raise RuntimeError("my own mistake")

    with pytest.raises(RuntimeError, match="my own mistake"):
        zj.sweep(broken, q=Q, mu=MU, progress=False)
    assert same(sweep(q=Q[:1], mu=MU), whole.isel(q=[0]))


def test_an_interruption_leaves_no_thread_behind(whole, monkeypatch):
    class Bar(progress.tqdm):
        def update(self, done=1):
            raise KeyboardInterrupt

    threads = threading.active_count()
    with monkeypatch.context() as patch:
        patch.setattr(progress, "tqdm", Bar)
        with pytest.raises(KeyboardInterrupt):
            sweep(q=np.linspace(1.5, 3.5, 400), mu=MU, lanes=zj.Lanes(32, 2))
    assert threading.active_count() == threads
    assert same(sweep(q=Q, mu=MU), whole)


def test_left_out_points_are_nan_for_whole_and_complex_numbers():
    found = zj.sweep(
        lambda x: {"whole": x.astype(int), "turned": lax.complex(0 * x, x)},
        x=[1.0, 2.0],
        where=lambda x: x > 1,
        progress=False,
    )
    assert np.isnan(found.whole[0]) and found.whole[1] == 2
    assert np.isnan(found.turned[0]) and found.turned[1] == 2j


def test_useful_steps_are_not_invented_where_no_loop_is_cut():
    found = zj.sweep(third, x=[1.0], progress=False)
    assert np.isnan(found.attrs["useful_step_fraction"])
