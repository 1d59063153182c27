"""Results print their numbers, label them, and give a sweep all that they hold."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import ziegler_jax as zj
from ziegler_jax import results

KICK = zj.State(omega=(0.0, 0.3))
SHORT = zj.Windows(transient=5.0, length=5.0, max_windows=1)
UNIT = zj.ConstantLoad(1.0)
CYCLE = zj.State((0.0, 0.30), (0.59, 1.79))  # near that of `sliding(2.6)`


def settled(q):
    return zj.settle(zj.uniform_rods(q), KICK, windows=SHORT, certify=False)


def sliding_law(tau):
    return zj.SetValuedCoulomb(tau, pin_radius=1.0, load=UNIT)


def sliding(q):
    return zj.uniform_rods(q, friction=sliding_law(0.026))


def test_a_result_prints_its_numbers_with_units_and_what_its_code_means():
    result = zj.critical_load(zj.uniform_rods())
    text = repr(result)
    assert "q_cr" in text and "2.541699" in text
    assert "sqrt(k/(m l^2))" in text
    assert f"found: {zj.CODE.found.sentence}" in text


def test_lanes_are_counted_by_what_became_of_them():
    lanes = jax.vmap(settled)(jnp.array([1.0, 2.0, np.nan]))
    text = repr(lanes)
    assert "1 invalid, 2 unsettled" in text
    assert "(shape" not in text.split("outcome")[1].split("\n")[0]


def test_a_result_prints_where_nothing_is_known_yet():
    texts = []

    @jax.jit
    def traced(q):
        result = settled(q)
        texts.append(repr(result))
        return result.steps

    traced(1.0)
    assert "rod_amplitude" in texts[0] and "float64[2]" in texts[0]
    shapes = jax.eval_shape(settled, 1.0)
    assert "ShapeDtypeStruct" in repr(shapes)
    orbit = jax.eval_shape(lambda: zj.periodic_orbit(sliding(2.6), CYCLE))
    assert repr(orbit).startswith("PeriodicOrbit")
    assert "None" in repr(jax.tree.map(lambda x: None, shapes))


def test_a_code_that_is_none_is_shown_as_its_number():
    strange = jax.tree.map(lambda x: jnp.zeros_like(x) - 75, settled(1.0))
    assert "1 -75" in repr(strange)


def test_a_dataset_of_a_result_is_that_of_a_sweep_at_one_point():
    alone = settled(1.5).to_dataset()
    swept = zj.sweep(settled, q=[1.5], progress=False).isel(q=0)
    assert set(alone.data_vars) == set(swept.data_vars)
    for name, values in alone.data_vars.items():
        assert values.attrs == swept[name].attrs and values.dims == swept[name].dims
        # another program: equal to rounding; measured 2e-16
        np.testing.assert_allclose(values, swept[name], rtol=1e-12)
    assert alone.attrs.items() <= swept.attrs.items()
    lanes = jax.vmap(settled)(jnp.array([1.0, 1.5])).to_dataset()
    assert lanes.rod_amplitude.dims == ("lane_1", "rod")


def test_a_time_history_is_swept_over_its_times(tmp_path):
    ts = np.linspace(0, 4, 5)

    def point(q):
        return zj.trajectory(zj.uniform_rods(q), KICK, ts)

    ds = zj.sweep(point, q=[1.0, 2.0], progress=False, store=tmp_path / "map.zarr")
    assert ds.phi.dims == ("q", "ts", "rod") and ds.ts.attrs["units"] == "sqrt(m l^2/k)"
    alone = point(2.0)
    # measured 0
    np.testing.assert_allclose(ds.phi.sel(q=2.0), alone.phi, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(ds.phi.sel(q=2.0, ts=4.0).ts, 4.0)
    units = zj.SI(m=1.0, l=1.0, k=4.0)
    for dataset in (ds, alone.to_dataset()):
        seconds = units.restore(dataset)
        assert seconds.ts.attrs["units"] == "s"
        np.testing.assert_allclose(seconds.ts, ts / 2, rtol=1e-14)

    def late(q, end):  # times that are not the same in all lanes
        return zj.trajectory(zj.uniform_rods(q), KICK, jnp.stack([0 * end, end]))

    ds = zj.sweep(late, q=[1.0], end=[1.0, 2.0], progress=False)
    assert ds.ts.dims == ("q", "end", "sample") and ds.ts.values[0, :, 1].tolist() == [
        1,
        2,
    ]


def test_events_are_swept_with_their_modes():
    def point(q):
        return zj.trajectory(sliding(q), KICK, [0.0, 5.0], max_events=20)

    ds, alone = zj.sweep(point, q=[2.6], progress=False).isel(q=0), point(2.6)
    count = int(alone.events.count)
    assert 2 < count == ds.event_count < 20
    np.testing.assert_allclose(ds.event_times, alone.events.times, rtol=1e-12)
    np.testing.assert_array_equal(ds.event_modes[:count], alone.events.modes[:count])


def test_events_are_a_dataset_of_their_own_as_many_as_there_are():
    alone = zj.trajectory(sliding(2.6), KICK, [0.0, 5.0])  # room for 1000
    count = int(alone.events.count)
    assert len(alone.to_dataset().to_dataframe()) == 2 * 2  # times and rods
    events = alone.event_dataset()
    assert events.sizes == {"event": count, "joint": 2} and events.event_count == count
    np.testing.assert_array_equal(events.event_times, alone.events.times[:count])
    with pytest.raises(ValueError, match="set-valued friction"):
        zj.trajectory(zj.uniform_rods(2.6), KICK, [0.0, 5.0]).event_dataset()


def test_energy_power_and_reactions_take_a_state_and_its_numbers():
    column = sliding(2.6)
    for question in (zj.energy, zj.power, zj.reactions):
        one, other = question(column, KICK), question(column, KICK.y)
        assert jax.tree.all(jax.tree.map(np.array_equal, one, other))


def test_a_section_is_swept():
    def point(q):
        return zj.poincare(zj.uniform_rods(q), KICK, points=3, transient=0.0)

    ds, alone = zj.sweep(point, q=[1.0], progress=False).isel(q=0), point(1.0)
    assert ds.phi.dims == ("point", "rod") and int(ds["count"]) == 3
    np.testing.assert_allclose(ds.times, alone.times, rtol=1e-12)


def test_a_branch_is_swept():
    def point(tau):
        def column(q):
            return zj.uniform_rods(q, friction=sliding_law(tau))

        orbit = zj.periodic_orbit(column(2.6), CYCLE)
        return zj.continue_cycle(column, orbit, 2.6, arc=zj.Arc(points=3))

    ds = zj.sweep(point, tau=[0.026], progress=False).isel(tau=0)
    assert ds.outcome == zj.CODE.found and int(ds["count"]) == 3
    assert ds.parameter.dims == ("point",) and (np.diff(ds.parameter) > 0).all()
    assert ds.stable.all() and ds.special_kind.dims == ("special_point",)


def test_results_beside_each_other_go_by_their_names():
    def point(q):
        load = zj.critical_load(zj.uniform_rods(follower=q / 10))
        s = zj.spectrum(zj.uniform_rods(q))
        growth = zj.Variable(s.real, "growth rate", "sqrt(k/(m l^2))", ("mode",))
        return {"run": settled(q), "load": load, "growth": growth, "twice": 2 * q}

    ds = zj.sweep(point, q=[1.0, 2.0], progress=False)
    assert ds.run_rod_amplitude.dims == ("q", "rod")
    assert ds.load_outcome.attrs["flag_meanings"].split()[-1] == "found"
    assert ds.growth.dims == ("q", "mode") and ds.growth.attrs["long_name"]
    assert ds.twice.values.tolist() == [2.0, 4.0]
    assert ds.attrs["run_rtol"] == 1e-6 and ds.attrs["load_kind"] == "flutter"


class Named(zj.AbstractObserver):
    """An observer whose number has this name."""

    name = "mine"
    number: str

    def init(self, column, t, y):
        return y[0]

    def step(self, column, state, step):
        return step.y1[0]

    def result(self, column, state, span, y):
        return {self.number: zj.Variable(state, "an angle", "rad")}


@pytest.mark.parametrize("name", ["steps", "final", "rod_amplitude"])
def test_an_observer_hides_no_number_of_the_result(refuses, name):
    def call():
        watch = (Named(name),)
        return zj.settle(
            zj.uniform_rods(1.0), KICK, windows=SHORT, observers=watch, certify=False
        )

    refuses(call, "observer `mine`", f"`{name}`", "unlike")


def test_what_was_not_asked_for_is_named():
    with pytest.raises(AttributeError, match="`period` only where .* rod_amplitude"):
        _ = settled(1.0).period


def test_an_obstacle_that_there_was_not_is_none():
    @jax.jit
    def onset():
        return zj.flutter_onset(
            lambda q: zj.uniform_rods(q, damping=zj.Viscous(0.05, 0.05)),
            zj.State(omega=(0.0, 0.1)),
            (0.5, 0.6),
            search=zj.Search(scan=2, halvings=1),
        )

    assert re.search(r"obstacle *= none\n", repr(onset()))


def questions():
    """The lists of codes that questions can answer, by name."""
    known = {n: x for n, x in vars(results).items() if isinstance(x, tuple)}
    return {n: x for n, x in known.items() if {type(code) for code in x} == {zj.CODE}}


def test_each_code_has_one_number_one_word_one_sentence_and_is_an_answer():
    asked = questions()
    assert len(asked) == 13
    for codes in asked.values():
        assert list(codes) == sorted(set(codes))  # in order of precedence
    answers = {zj.CODE.not_computed}.union(*asked.values())
    assert answers == set(zj.CODE)
    assert len({code.sentence for code in zj.CODE}) == len(zj.CODE)
    assert 0 <= min(zj.CODE) and max(zj.CODE) <= np.iinfo(np.int8).max


def test_any_flag_variable_may_be_not_computed_and_lists_what_it_can_hold():
    codes = (zj.CODE.stuck, zj.CODE.cycle)
    about = results.flag_attributes(codes)
    assert about["flag_values"] == [0, *codes]
    assert about["flag_meanings"] == "not_computed stuck cycle"
    assert zj.CODE.cycle.sentence in about["comment"]
    assert results.flag_attributes((zj.CODE.not_computed, *codes)) == about
