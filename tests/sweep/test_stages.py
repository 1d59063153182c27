"""A point cut at its loops: the same numbers, and no more taken along than is read."""

import threading
import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import stored
from cut_points import SCENES, TABLE, X, Y, decided, loop, numbers, one, sweep, three
from jax import lax
from jax.experimental import io_callback
from jax.extend.core import jaxpr_as_fun

import ziegler_jax as zj
from ziegler_jax.numerics import resumable
from ziegler_jax.sweep import pool, program
from ziegler_jax.sweep.jaxpr_digest import digest_of

pytestmark = pytest.mark.usefixtures("optimised")  # bits, as users get them


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("threads", [1, 3])
def test_a_point_that_is_cut_computes_what_it_computes_whole(scene, threads):
    found = sweep(scene, lanes=zj.Lanes(8, threads))
    mesh = [m.ravel() for m in np.meshgrid(X, Y, indexing="ij")]
    whole = jax.jit(jax.vmap(scene))(*mesh)
    assert set(whole) == set(found.data_vars)
    for name, values in whole.items():
        # measured 0; another program may round elsewhere
        np.testing.assert_allclose(found[name].values.ravel(), values, rtol=1e-12)


@pytest.mark.parametrize("scene, loops", SCENES.items())
def test_there_is_a_stage_for_every_loop_that_is_read(scene, loops):
    stages = program.traced(scene, ("x", "y"), 8).stages
    assert [s.is_loop for s in stages] == [False, *[True, False] * loops]


def with_jvp(point):
    """With a derivative of its own, which no sweep asks for."""
    own = jax.custom_jvp(point)
    own.defjvp(lambda at, along: (own(*at), own(*along)))
    return own


def with_vjp(point):
    """The same in reverse."""
    own = jax.custom_vjp(point)
    own.defvjp(lambda *at: (own(*at), at), lambda at, back: at)
    return own


CALLS = {
    "jit": jax.jit,
    "remat": jax.checkpoint,
    "custom_jvp": with_jvp,
    "custom_vjp": with_vjp,
    "two": lambda point: jax.jit(jax.checkpoint(point)),
}


@pytest.mark.parametrize("call", CALLS)
def test_a_call_around_a_loop_is_no_obstacle(call):
    """The same program: a batch waits for no slow lane there either."""
    around = CALLS[call](three)

    def point(x, y):
        return around(x, y)

    plain, called = (program.traced(p, ("x", "y"), 8) for p in (three, point))
    assert len(plain.stages) == 7 and called.digest == plain.digest
    found, known = (numbers(sweep(p)) for p in (point, three))
    for name, values in known.items():
        np.testing.assert_array_equal(found[name], values)


def test_a_loop_within_a_conditional_runs_whole_and_warns_once():
    def point(x, y):
        far = lax.cond(y < 2, lambda x: loop(50 * y, x)[0], lambda x: x, x)
        return {"far": loop(100 * y, far)[0]}

    with pytest.warns(UserWarning, match="cannot pause") as told:
        found = sweep(point)
    assert len(told) == 1
    mesh = np.meshgrid(X, Y, indexing="ij")
    whole = jax.vmap(jax.vmap(point))(*mesh)["far"]
    np.testing.assert_array_equal(found["far"], whole)


def test_the_primitive_may_be_transformed_wherever_it_is_called():
    """Of a call the loop is known by its equations alone."""
    start, step = jnp.array([0.3, 0.7]), 1e-6

    def far(x):
        return loop(20.0, x, 1.5 + x)[0]

    called = jax.jit(far)
    plain = jnp.stack([far(x) for x in start])
    for values in (jax.vmap(called)(start), jax.jit(jax.vmap(called))(start)):
        np.testing.assert_allclose(values, plain, rtol=1e-15)
    ahead, back = (jnp.stack([far(x) for x in start + d]) for d in (step, -step))
    _, slope = jax.jvp(jax.vmap(called), (start,), (jnp.ones(2),))
    # measured 1.1e-9 of it
    np.testing.assert_allclose(slope, (ahead - back) / (2 * step), rtol=1e-7)


def test_what_varies_with_no_lane_is_not_taken_along():
    stages = program.traced(three, ("x", "y"), 8).stages
    rows = [sum(s.fixed.used) + sum(s.state.used) for s in stages]
    # two values; a loop's target, its state of two, and what is read behind it
    assert max(rows) <= 8, rows


def test_lanes_are_decided_as_often_as_each_asks():
    cuts = sweep(decided)["cuts"].values
    # so many at least that the table is read at other places
    assert np.unique(cuts).size > 10 and cuts.min() == 0, cuts


@pytest.mark.parametrize("scene", [three, decided])
def test_places_mates_threads_and_chunks_change_no_bit(monkeypatch, scene):
    whole = numbers(sweep(scene))
    monkeypatch.setattr(pool, "FIRST_CHUNK", 7)
    monkeypatch.setattr(pool, "SHORTEST_CHUNK", 3)
    for options in (
        {"lanes": zj.Lanes(8, 3)},
        {"lanes": zj.Lanes(8, 1)},
        {"x": X[::-1].copy()},
        {"x": X[5:9]},
    ):
        part = sweep(scene, **options).sel(x=options.get("x", X))
        for name, values in numbers(part).items():
            rows = np.searchsorted(X, options.get("x", X))
            assert values.tobytes() == whole[name][rows].tobytes(), (name, options)


def test_every_place_of_a_batch_rounds_alike():
    """Lanes, each in all places at once, to its end, in batches as narrow as they get.

    Batches of 8 failed it for 1 of 100 states: the compiler unrolls two vectors.
    """
    scene = program.traced(stored.settled, ("q", "mu"), 1)
    begin, loop, _ = program.compiled(scene).stages
    lanes = np.stack(
        [m.ravel() for m in np.meshgrid(stored.Q, stored.MU, indexing="ij")]
    )
    padded = np.resize(lanes.T, (begin.lanes, 2)).T
    with jax.enable_x64(True):
        fixed, state = begin.function((padded,), ())
        for lane in range(lanes.shape[1]):
            spread = [np.repeat(np.asarray(x)[:, [lane]], loop.lanes, 1) for x in fixed]
            now = [np.repeat(np.asarray(x)[:, [lane]], loop.lanes, 1) for x in state]
            for _ in range(40):
                now, *_ = loop.function(np.int32(20), tuple(spread), tuple(now))
                for x in map(np.asarray, now):
                    assert x.tobytes() == np.repeat(x[:, :1], x.shape[1], 1).tobytes()


def test_lanes_in_flight_are_few_however_many_points_there_are(monkeypatch):
    """Later loops go first: open blocks, and what is taken along, stay bounded."""
    most, give = 0, pool.Pool.give

    def watched(lanes, *given, **options):
        nonlocal most
        give(lanes, *given, **options)
        most = max(most, int(lanes.counts[1:].sum()))

    monkeypatch.setattr(pool.Pool, "give", watched)
    sweep(three, x=np.linspace(0.5, 3.0, 2000), lanes=zj.Lanes(32, 2))
    # before each loop what a segment leads there and less than a batch
    bound = 32 * (3 + 4 * program.SEGMENTS)
    assert 0 < most <= bound < 2000


def test_the_steps_of_a_loop_are_counted():
    found = sweep(one)
    assert found.attrs["useful_step_fraction"] > 0.3  # measured 0.71
    assert (found.steps.values > 0).all()


# What a review found ------------------------------------------------------------------


def sums(x, y):
    far, steps = loop(1e3 * y, x)
    return {"r": far + steps.astype(float)}


def starts(x, y):
    """Its last stage reads the start, where that of `sums` reads the loop's end."""
    _, steps = loop(1e3 * y, x)
    return {"r": x + steps.astype(float)}


def chosen_of(place):
    pick = jax.jit(lambda a, b: (a, b))

    def scene(x, y):
        far, steps = loop(1e3 * y, x)
        return {"r": pick(x, far)[place] + steps.astype(float)}

    return scene


@pytest.mark.parametrize(
    "one, other", [(sums, starts), (chosen_of(0), chosen_of(1))], ids=["read", "picked"]
)
def test_scenes_that_read_other_numbers_are_other_programs(one, other):
    digests = {program.traced(s, ("x", "y"), 8).digest for s in (one, other)}
    assert len(digests) == 2
    for scene in (one, other, one):
        mesh = [m.ravel() for m in np.meshgrid(X, Y, indexing="ij")]
        whole = jax.jit(jax.vmap(scene))(*mesh)["r"]
        np.testing.assert_array_equal(sweep(scene).r.values.ravel(), whole)


def test_nothing_is_computed_at_points_that_are_not_asked_for():
    """A loop without an end at zero, and a callback that refuses it."""

    def scene(x, y):
        def checked(value):
            assert (value > 0).all()
            return value

        grown = lax.while_loop(lambda s: s < 1, lambda s: s + x, 0 * x)
        like = jax.ShapeDtypeStruct((), x.dtype)
        seen = jax.pure_callback(checked, like, x, vmap_method="expand_dims")
        return {"r": loop(100 * y, grown + seen)[0]}

    assert (sweep(scene).r.values >= 100 * Y).all()


def test_what_a_point_does_beside_is_done_once_and_where_it_stands():
    lanes = []

    def scene(x, y):
        jax.debug.callback(lambda value: lanes.append(float(value)), x)
        return {"r": loop(100 * y, x)[0]}

    sweep(scene, x=X[:8], y=[1.0])
    jax.effects_barrier()
    assert set(lanes) == set(X[:8].tolist())


def test_no_thread_ends_while_lanes_are_led_to_a_loop(monkeypatch):
    threads, lead = set(), pool.Run.lead

    def watched(run, number, *batch):
        if run.program.stages[number].is_loop:
            threads.add(threading.get_ident())
            time.sleep(0.01)
        else:
            time.sleep(0.05)
        return lead(run, number, *batch)

    monkeypatch.setattr(pool.Run, "lead", watched)
    sweep(one, lanes=zj.Lanes(8, 2))  # 69 points: nine batches, two segments
    assert len(threads) == 2


def test_a_scene_that_has_not_changed_is_not_lowered_again(monkeypatch):
    calls = []
    lowered = program.lowered
    monkeypatch.setattr(
        program, "lowered", lambda *stage: calls.append(stage) or lowered(*stage)
    )
    held = {"factor": 3.0}

    def scene(x):
        return held["factor"] * x

    def once():
        before = len(calls)
        found = zj.sweep(scene, x=[2.0], progress=False)
        return float(found.value.item()), len(calls) - before

    assert once() == (6.0, 1) and once() == (6.0, 0)
    held["factor"] = 5.0
    assert once() == (10.0, 1)
    held["factor"] = 3.0
    assert once() == (6.0, 0)


def test_a_batching_rule_of_the_users_own_is_asked_again():
    """It may read anything, and nothing of it stands in what was traced."""
    held = {"factor": 3.0}

    @jax.custom_batching.custom_vmap
    def scaled(x):
        return 1.0 * x

    @scaled.def_vmap
    def of_a_batch(axis_size, batched, x):
        return held["factor"] * x, True

    def once():
        found = zj.sweep(lambda x: scaled(x), x=[2.0], progress=False)
        return float(found.value.item())

    assert not digest_of(jax.make_jaxpr(scaled)(1.0)).repeatable
    assert once() == 6.0
    held["factor"] = 5.0
    assert once() == 10.0


def random_in(partitionable):
    """A random number of one of JAX's two ways to split its keys."""

    def point(x):
        with jax.threefry_partitionable(partitionable):
            return x + jax.random.uniform(jax.random.PRNGKey(0), (3,)).sum()

    return point


@pytest.mark.parametrize(
    "one, other",
    [
        (lambda x: x * jnp.asarray(2.0), lambda x: x * jnp.asarray(3.0)),
        (lambda x: x * TABLE.sum(), lambda x: x * (TABLE + 1).sum()),
        (lambda x: (x * TABLE).sum(), lambda x: (x * (TABLE + 1)).sum()),
        (
            lambda x: lax.cond(x > 1, lambda: x, lambda: 2 * x),
            lambda x: lax.cond(x > 1, lambda: x, lambda: 3 * x),
        ),
        (lambda x: jnp.divide(x, 0.0), lambda x: jnp.divide(x, -0.0)),
        (random_in(True), random_in(False)),
    ],
)
def test_points_that_differ_anywhere_have_digests_of_their_own(one, other):
    def key(point):
        with program._TRACE(next(program._TRACES)):
            return digest_of(jax.make_jaxpr(point)(1.5))

    assert key(one).repeatable and key(one) == key(one) and key(one) != key(other)
    for point in (one, other):
        found = zj.sweep(point, x=[1.5], progress=False)
        assert found.value.item() == float(point(1.5))


def test_a_table_that_is_changed_in_place_is_read_again_wherever_it_stands():
    """JAX holds it by reference, in equations that outlive a sweep."""
    table = np.array([1.0, 2.0])
    inner = jax.jit(lambda x: (x * table).sum())
    outer = jax.jit(lambda x: inner(x) + 0.0 * x)
    with jax.enable_x64(True):
        closed = jax.make_jaxpr(lambda x: outer(x))(1.0)

    def once():
        point = jaxpr_as_fun(closed)
        found = zj.sweep(lambda x: point(x)[0], x=[2.0], progress=False)
        return float(found.value.item())

    assert once() == 6.0
    table[:] = 10.0, 20.0
    assert once() == 60.0


def test_calls_that_a_stage_could_not_hand_on_stay_whole():
    """With keys, or with the host's doings: they did before calls were opened."""

    @jax.jit
    def with_keys(x, y):
        one, other = jax.random.split(jax.random.key(jnp.asarray(10 * x, int)))
        far, _ = loop(100 * y, x + jax.random.uniform(one))
        return {"far": far + jax.random.normal(other)}

    @jax.jit
    def with_host(x, y):
        six = io_callback(lambda: np.float64(6.0), jax.ShapeDtypeStruct((), float))
        return {"far": loop(100 * y, x)[0] + six}

    mesh = np.meshgrid(X, Y, indexing="ij")
    whole = jax.vmap(jax.vmap(with_keys))(*mesh)["far"]
    np.testing.assert_allclose(sweep(with_keys)["far"], whole, rtol=1e-12)
    far = jax.vmap(jax.vmap(lambda x, y: loop(100 * y, x)[0]))(*mesh)
    np.testing.assert_allclose(sweep(with_host)["far"], far + 6, rtol=1e-12)


def test_a_loop_that_calls_back_does_so_within_jit():
    told = []

    def far(x):
        def advance(state, max_steps):
            jax.debug.callback(told.append, state[0], ordered=True)
            return state[0] * 2, state[1] + max_steps

        phases = [resumable.Phase(advance)]
        first = x, jnp.zeros((), jnp.int32)
        return resumable.resumable(first, phases, lambda s: (s[1] * 0 - 1, s[1]))[0]

    assert jax.jit(far)(1.5) == 3.0
    jax.effects_barrier()
    assert told == [1.5]


def test_a_call_that_is_not_traced_compiles_its_loop_once():
    """`jax.checkpoint` outside of `jit` runs equation by equation."""
    called = jax.checkpoint(lambda x: loop(20.0, x)[0])
    assert called(0.3) == called(0.3)
    before = resumable._compiled.cache_info().misses
    called(0.4)
    assert resumable._compiled.cache_info().misses == before
