"""`configure_cpu` says what it did, does no harm, and changes nothing too late."""

import os
import subprocess
import sys
from importlib import metadata

import pytest

import ziegler_jax as zj
from ziegler_jax import runtime

OPTION = "xla_cpu_small_while_loop_byte_threshold=1000000000"


@pytest.fixture
def flags(monkeypatch):
    """Sets the installed version and XLA_FLAGS; returns what a call says and leaves."""

    def call(version, before, started=False):
        monkeypatch.setattr(runtime.metadata, "version", lambda name: version)
        monkeypatch.setattr(runtime, "_backend_started", lambda: started)
        if before is None:
            monkeypatch.delenv("XLA_FLAGS", raising=False)
        else:
            monkeypatch.setenv("XLA_FLAGS", before)
        said = zj.configure_cpu()
        return said, os.environ.get("XLA_FLAGS")

    return call


@pytest.mark.parametrize("version", ["0.10.2", "0.10.9"])
def test_versions_that_gain_get_the_option(flags, version):
    said, after = flags(version, None)
    assert after == f"--xla_backend_extra_options={OPTION}"
    assert OPTION in said and "added" in said


def test_what_the_user_set_stays_in_front(flags):
    _, after = flags("0.10.2", "--xla_dump_to=here")
    assert after == f"--xla_dump_to=here --xla_backend_extra_options={OPTION}"


@pytest.mark.parametrize("version", ["0.9.1", "0.10.1", "0.11.0", "0.12.0.1", "1.0.0"])
def test_versions_that_do_not_gain_are_left_alone(flags, version):
    said, after = flags(version, None)
    assert after is None
    assert version in said and "nothing was changed" in said


@pytest.mark.parametrize(
    "version", ["0.12.0rc1", "0.11.0.dev20250101", "0.10.3.dev1", "0.10.2+own", "0.12"]
)
def test_versions_of_any_spelling_are_understood(flags, version):
    said, _ = flags(version, None)
    assert said.endswith(".")


@pytest.mark.parametrize(
    "before",
    [
        f"--xla_backend_extra_options={OPTION}",
        "--xla_backend_extra_options=xla_cpu_other=1",
    ],
)
def test_options_that_stand_there_are_left_alone(flags, before):
    said, after = flags("0.10.2", before)
    assert after == before
    assert "nothing was changed" in said or "left alone" in said


def test_after_the_backend_started_nothing_is_changed(flags):
    said, after = flags("0.10.2", None, started=True)
    assert after is None
    assert "before the first computation" in said


PROGRAM = """
import os
import jax.numpy as jnp
import ziegler_jax as zj
late = {late}
if late:
    jnp.zeros(3).block_until_ready()
said = zj.configure_cpu()
print(said)
print(os.environ.get("XLA_FLAGS", ""))
print(float(jnp.arange(4.0).sum()))
"""


@pytest.mark.parametrize("late", [False, True])
def test_a_fresh_process_computes_on(late):
    """With the installed version, whichever that is: the flag must not abort it."""
    environment = {k: v for k, v in os.environ.items() if k != "XLA_FLAGS"}
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM.format(late=late)],
        env=environment, capture_output=True, text=True, timeout=100,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    said, after, total = done.stdout.splitlines()
    gains = metadata.version("jaxlib").startswith("0.10.")
    assert (OPTION in after) == (gains and not late)
    assert ("nothing was changed" in said) == (late or not gains)
    assert total == "6.0"
