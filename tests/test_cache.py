"""Compiled programs on a disk: a second process starts without compiling."""

import os
import subprocess
import sys

import jax
import pytest
from stored import settled

import ziegler_jax as zj

CACHED = """
import sys
import jax, jax.numpy as jnp
import ziegler_jax as zj
from jax import monitoring
events = []
monitoring.register_event_listener(lambda name, **_: events.append(name))
print(zj.configure_cache(sys.argv[1]))
def point(q):
    return zj.settle(zj.uniform_rods(q), zj.State(omega=(0.0, 0.3)),
                     windows=zj.Windows(5.0, 5.0, 2))
zj.sweep(point, q=[1.0, 2.0], lanes=zj.Lanes(2), progress=False)
print(sum(e.endswith("cache_hits") for e in events))
"""


def test_no_host_callback_keeps_a_program_from_the_disk():
    """JAX does not keep one that has them; diffrax checks `dt0` by one."""
    with jax.enable_x64(True):
        program = jax.make_jaxpr(lambda q: settled(q, 0.1).outcome)(2.0)
    assert "while" in str(program) and "callback" not in str(program)


def test_a_second_process_starts_without_compiling(tmp_path):
    environment = {k: v for k, v in os.environ.items() if "CACHE" not in k}
    hits = []
    for _ in range(2):
        done = subprocess.run(
            [sys.executable, "-c", CACHED, str(tmp_path / "cache")],
            env=environment, capture_output=True, text=True, timeout=300,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        said, count = done.stdout.splitlines()
        assert str(tmp_path / "cache") in said
        hits.append(int(count))
    assert hits[0] == 0 and hits[1] >= 1


def test_a_folder_that_cannot_be_written_to_is_a_warning_and_no_cache(tmp_path):
    before = jax.config.jax_compilation_cache_dir
    (tmp_path / "file").write_text("")
    with pytest.warns(UserWarning, match="cannot be written to"):
        said = zj.configure_cache(tmp_path / "file" / "cache")
    assert "not kept" in said and jax.config.jax_compilation_cache_dir == before
