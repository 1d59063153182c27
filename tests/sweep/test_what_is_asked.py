"""A program is known by what its results ask for: no more, and no less."""

import sys
import threading

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from ziegler_jax.__main__ import point
from ziegler_jax.numerics.resumable import Phase, place_of, resumable
from ziegler_jax.sweep import program
from ziegler_jax.sweep.jaxpr_digest import digest_of_function

held: list = []


def twice(x, a, hold):
    """2 x; what nothing reads is written down where its tracer is held."""
    if hold:
        held.append(jnp.asarray(np.arange(7.0)))
        jnp.sin(a)
    return x + x


def steps(number):
    return number.astype(float)


def straight(x, a, hold):
    return twice(x, a, hold)


def called(x, a, hold):
    return jax.jit(lambda x: twice(x, a, hold))(x)


def chosen(x, a, hold):
    return lax.cond(x > 0.0, lambda: twice(x, a, hold), lambda: x)


def turned(x, a, hold):
    return lax.while_loop(lambda y: y < 9.0, lambda y: y + twice(y, a, hold), x)


def scanned(x, a, hold):
    def row(y, z):
        return y + twice(y, a, hold) * z, twice(z, a, hold)

    return lax.scan(row, x, jnp.arange(1.0, 3.0))[0]


def paused(x, a, hold):
    def advance(y, max_steps):
        return y + twice(y, a, hold) * steps(max_steps)

    phases = [Phase(advance)]
    return resumable(x, phases, lambda y: (place_of(y < 9.0), jnp.int32(0)))


def batched(x, a, hold):
    return jax.vmap(lambda y: chosen(y, a, hold))(x + jnp.arange(2.0)).sum()


def within(x, a, hold):
    return lax.while_loop(lambda y: y < 9.0, lambda y: y + scanned(y, a, hold), x)


def traced(function, *more):
    return jax.make_jaxpr(lambda x, a: [function(x, a, *more)])(1.5, 2.5)


def digest(function, *more):
    return digest_of_function(traced(function, *more), ["x", "a"], ["z"]).value


@pytest.mark.parametrize(
    "function",
    [straight, called, chosen, turned, scanned, paused, batched, within],
    ids=lambda function: function.__name__,
)
def test_what_nothing_reads_leaves_no_trace_though_its_tracer_is_held(function):
    held.clear()
    program = str(traced(function, True))
    assert "f64[7]" in program and " sin " in program
    assert digest(function, True) == digest(function, False)
    held.clear()


def test_a_scene_is_the_same_beside_a_profiler():
    """One that looks at the stack of calls, as that of a cluster's worker does."""
    names = ("q", "mu_s", "mu_k")
    alone = program.traced(point, names, None).digest
    ended, mine = threading.Event(), threading.get_ident()

    def look():
        while not ended.is_set():
            frame = sys._current_frames().get(mine)
            while frame is not None:
                frame = frame.f_back

    profiler = threading.Thread(target=look)
    profiler.start()
    try:
        beside = {program.traced(point, names, None).digest for _ in range(8)}
    finally:
        ended.set()
        profiler.join()
    assert beside == {alone}


@pytest.mark.parametrize("shape", [(), (3,)])
@pytest.mark.parametrize("within", [jax.jit, jax.checkpoint])
def test_a_table_that_is_changed_in_place_makes_another_program(shape, within):
    table = np.full(shape, 2.0)
    law = within(lambda x: (x * table).sum())
    before = digest(lambda x, a: law(x) + a)
    assert digest(lambda x, a: law(x) + a) == before
    table[...] = 7.0
    assert digest(lambda x, a: law(x) + a) != before


def both(x, a):
    return lax.sort((jnp.stack([x, a]), jnp.stack([a, x])), num_keys=1)


def rows(x, a):
    return lax.scan(lambda y, z: (y + z * a, (y, z)), x, jnp.arange(3.0))[1]


def loop(x, a, b):
    return lax.while_loop(lambda y: y < a, lambda y: y + b, x)


def pair(x, a):
    return jax.jit(lambda x, a: (jnp.sin(x) + a, jnp.sin(a) + x))(x, a)


def running(x, a, state):
    def advance(y, max_steps):
        return y[0] + a * steps(max_steps), y[1] + y[0]

    def status(y):
        return place_of(y[0] < 9.0), jnp.int32(0)

    return resumable(state, [Phase(advance)], status)


@pytest.mark.parametrize(
    "one, other",
    [
        (lambda x, a: x - a, lambda x, a: a - x),
        (lambda x, a: both(x, a)[0][0], lambda x, a: both(x, a)[1][0]),
        (lambda x, a: rows(x, a)[0][2], lambda x, a: rows(x, a)[1][2]),
        (lambda x, a: loop(x, a, x), lambda x, a: loop(x, x, a)),
        (lambda x, a: loop(x, a, a), lambda x, a: loop(a, a, a)),
        (lambda x, a: pair(x, a)[0], lambda x, a: pair(x, a)[1]),
        (lambda x, a: pair(x, a)[0], lambda x, a: pair(a, x)[0]),
        (
            lambda x, a: lax.cond(x > a, lambda: x, lambda: a),
            lambda x, a: lax.cond(x > a, lambda: a, lambda: x),
        ),
        (
            lambda x, a: lax.cond(x > a, jnp.sin, jnp.cos, x),
            lambda x, a: lax.cond(x > a, jnp.sin, jnp.cos, a),
        ),
        (lambda x, a: running(x, a, (x, a))[1], lambda x, a: running(x, x, (x, a))[1]),
        (lambda x, a: running(x, a, (x, a))[1], lambda x, a: running(x, a, (a, x))[1]),
        (lambda x, a: running(x, a, (x, a))[1], lambda x, a: running(x, a, (x, a))[0]),
        (
            lambda x, a: lax.fori_loop(0, 3, lambda _, y: y * x, a),
            lambda x, a: lax.fori_loop(0, 4, lambda _, y: y * x, a),
        ),
        (lambda x, a: jax.nn.relu(x - a), lambda x, a: jax.nn.relu(a - x)),
    ],
)
def test_programs_that_differ_in_what_they_read_are_two(one, other):
    assert digest(one) == digest(one)
    assert digest(one) != digest(other)
