"""Tables that a point or a law holds are arguments of its program."""

import subprocess
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

import ziegler_jax as zj
from ziegler_jax.motion.implicit import moving
from ziegler_jax.numerics import resumable
from ziegler_jax.sweep import program
from ziegler_jax.sweep.tables import LARGEST_CONSTANT

X = np.linspace(0.1, 0.9, 5)
SIZE = LARGEST_CONSTANT // 8 + 1
PLACES, VALUES = np.linspace(0.0, 1.0, SIZE), np.linspace(0.0, 1.0, SIZE) ** 2
look = jax.jit(lambda x: jnp.interp(x, PLACES, VALUES))


def straight(x):
    return {"r": jnp.interp(x, PLACES, VALUES)}


def called(x):
    return {"r": look(look(x))}


def in_loops(x):
    up = lax.while_loop(lambda s: look(s) < 0.5, lambda s: s + 0.1 * look(s) + 0.1, x)
    over = lax.scan(lambda s, y: (s + look(y), s), x, jnp.array([0.25, 0.5]))
    return {"r": up + over[0] + over[1].sum()}


def in_a_loop_that_is_cut(x):
    def goes(state):
        return state[0] < 40

    def advance(state, max_steps):
        return lax.while_loop(
            lambda s: goes(s) & (s[1] < state[1] + max_steps),
            lambda s: (s[0] + look(x) + s[0] * look(s[0] / 40), s[1] + 1),
            state,
        )

    def status(state):
        return resumable.place_of(goes(state)), state[1]

    first = look(x), jnp.zeros((), jnp.int32)
    last = resumable.resumable(first, [resumable.Phase(advance)], status)
    return {"r": last[0] + look(x)}


POINTS = {straight: 1, called: 1, in_loops: 1, in_a_loop_that_is_cut: 3}


@pytest.mark.parametrize("point, parts", POINTS.items())
def test_a_table_is_an_argument_wherever_it_stands(point, parts):
    scene = program.traced(point, ("x",), None)
    assert [x.shape for x in scene.tables] == [(SIZE,), (SIZE,)]
    assert len(scene.stages) == parts
    for stage in scene.stages:
        text = program.lowered(stage, scene).lowered.as_text()
        assert 'dense<"0x' not in text  # no array of many numbers
    with jax.enable_x64(True):
        right = [float(point(jnp.asarray(x))["r"]) for x in X]
    found = zj.sweep(point, x=X, progress=False).r
    np.testing.assert_allclose(found, right, rtol=1e-15, atol=0)  # measured 0


def test_numbers_and_small_arrays_stay_constants():
    few = PLACES[: LARGEST_CONSTANT // 8]
    scene = program.traced(lambda x: x * 3.0 + jnp.asarray(few).sum(), ("x",), 8)
    assert scene.tables == ()


def test_another_table_is_another_scene_and_no_other_program():
    scale = {"by": 1.0}

    def point(x):
        return jnp.interp(x, PLACES, scale["by"] * VALUES)

    first = zj.sweep(point, x=X, progress=False)
    kept = len(program._cache)
    scale["by"] = 2.0
    other = zj.sweep(point, x=X, progress=False)
    np.testing.assert_array_equal(other.value, 2 * first.value)
    assert other.attrs["scene_digest"] != first.attrs["scene_digest"]
    assert len(program._cache) == kept


CLOSED_OVER = """
import resource, sys, time
import numpy as np
import jax.numpy as jnp
import ziegler_jax as zj

big = np.random.default_rng(0).random(int(sys.argv[1]))

def small(x):
    return {"v": x + jnp.asarray(big[:4])[0]}

def point(x):
    return {"v": x + jnp.asarray(big)[0]}

def peak():
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss

zj.sweep(small, x=[1.0, 2.0])
before, start = peak(), time.perf_counter()
found = zj.sweep(point, x=[1.0, 2.0])
assert found.v.values.tolist() == [1.0 + big[0], 2.0 + big[0]]
print((peak() - before) / big.nbytes, time.perf_counter() - start)
"""


# 5 million numbers, 40 MB; by hand as many as of the user who met it
@pytest.mark.parametrize("size", [5_000_000, 30_000_000])
def test_a_point_that_closes_over_a_large_array_takes_about_as_much(size):
    done = subprocess.run(
        [sys.executable, "-c", CLOSED_OVER, str(size)],
        capture_output=True, text=True, timeout=200,
    )  # fmt: skip
    arrays, seconds = map(float, done.stdout.split()[-2:])
    assert arrays < 2.5  # measured 1.2, and 8 to 13 as text of the program
    assert seconds < 5  # measured 0.5, and 20 as text of the larger one


class Measured(zj.AbstractRateFriction):
    """A friction curve from a table, its numbers the fields of the law."""

    rate: jax.Array
    torque: jax.Array

    def levers(self, u1, u2):
        rates = jnp.concatenate([-self.rate[:0:-1], self.rate])
        torques = jnp.concatenate([-self.torque[:0:-1], self.torque])
        one, two = (jnp.interp(u, rates, torques) for u in (u1, u2))
        return one, two

    def rate_cut(self):
        return 0.005


RATE = np.array([0.0, 0.002, 0.05, 0.2, 1.0])
TORQUE = 0.05 * np.array([0.0, 0.12, 0.10, 0.09, 0.09])


@pytest.mark.parametrize("holds", [np.asarray, jnp.asarray])
def test_a_law_whose_fields_are_tables_is_swept(holds):
    def point(q, s):
        law = Measured(holds(RATE), holds(TORQUE) * s)
        return zj.settle(zj.uniform_rods(q, friction=law), zj.State(omega=(0.0, 0.1)))

    ds = zj.sweep(point, q=[0.8, 1.0], s=[1.0, 1.2], progress=False)
    assert (ds.outcome == zj.CODE.stuck).all()
    assert (ds.time < 60).all()  # measured 21 to 27


def test_a_columns_numbers_are_a_vector_tables_and_all():
    law = Measured(jnp.asarray(RATE), jnp.asarray(TORQUE))
    column = zj.uniform_rods(jnp.asarray(2.0), friction=law)
    p, make = moving(column, jnp.float64)
    assert p.shape == (1 + 5 + 5,)
    assert eqx.tree_equal(make(p), column)
