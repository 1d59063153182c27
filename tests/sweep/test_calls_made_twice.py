"""Calls that are made twice, or that lead nowhere: what a sweep says of its machine."""

import itertools
import threading

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_map import MU, Q, sweep

import ziegler_jax as zj
from ziegler_jax.sweep import pool, program


def test_some_batches_are_computed_twice_and_give_the_same_bits(monkeypatch):
    monkeypatch.setattr(pool, "CANARY", 3)
    found = sweep(q=Q, mu=MU)
    assert found.attrs["canary_checks"] > 0 == found.attrs["canary_mismatches"]


def test_a_batch_that_gives_other_bits_the_second_time_is_told(monkeypatch):
    """As from a processor, or a compiled program, that is wrong now and then."""
    monkeypatch.setattr(pool, "CANARY", 3)
    monkeypatch.setattr(pool, "_CALLS", itertools.count(1))
    run, calls = pool.Run._call, []

    def wrong_now_and_then(self, lanes, *arguments):
        found = run(self, lanes, *arguments)
        calls.append(lanes)
        if len(calls) != 4:
            return found
        return jax.tree.map(lambda a: np.asarray(a) + 1, found)

    monkeypatch.setattr(pool.Run, "_call", wrong_now_and_then)
    with pytest.warns(UserWarning, match="1 of .* computed twice gave other numbers"):
        found = sweep(q=Q, mu=MU, lanes=zj.Lanes(32, 1))
    assert found.attrs["canary_mismatches"] == 1


def test_a_lane_that_takes_no_step_is_told_by_name(monkeypatch):
    run = pool.Run._call

    def stuck(self, lanes, function, *arguments):
        after = run(self, lanes, function, *arguments)
        if len(arguments) < 3:
            return after
        state, phases_and_steps = after
        at = np.asarray(arguments[1][0][0]) == Q[15]
        return state, np.where(at, 0, phases_and_steps)

    monkeypatch.setattr(pool.Run, "_call", stuck)
    with pytest.raises(RuntimeError, match="no step .* at 2.25 <= q <= 2.25"):
        sweep(q=Q, mu=MU, lanes=zj.Lanes(32, 1))


@pytest.mark.parametrize("function", [jnp.sin, jnp.linalg.eigvals, jnp.fft.fft])
def test_programs_that_call_libraries_run_in_one_thread_at_a_time(function):
    """Two of LAPACK's in two threads waited for each other, on jaxlib 0.10.2."""

    def point(q):
        return {"x": jnp.real(function(q * jnp.eye(2))).sum()}

    scene = program.traced(point, ("q",), batch_size=32)
    (stage,) = program.compiled(scene).stages
    ended = threading.Event()

    def call():
        with jax.enable_x64(True):
            stage.function(stage.fixed.empty(32), stage.state.empty(32))
        ended.set()

    thread = threading.Thread(target=call)
    with program._library_lock:
        thread.start()
        assert ended.wait(2.0) == (function is jnp.sin)
    thread.join(60)
    assert ended.is_set()
