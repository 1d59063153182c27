"""`configure_cpu` says what it did, does no harm, and changes nothing too late."""

import os
import subprocess
import sys
from importlib import metadata

import pytest

import ziegler_jax as zj
from ziegler_jax import runtime

WHOLE_LOOPS = "xla_cpu_small_while_loop_byte_threshold=1000000000"
SOONER = "xla_cpu_disable_loop_unrolling=true"
BOTH = f"{WHOLE_LOOPS},{SOONER}"
WITHOUT = "--xla_disable_hlo_passes=while-loop-invariant-code-motion"


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


@pytest.mark.parametrize(
    "version, options",
    [("0.10.2", BOTH), ("0.10.9", BOTH), ("0.11.0", SOONER), ("0.12.0.1", SOONER)],
)
def test_versions_get_the_options_from_which_they_gain(flags, version, options):
    said, after = flags(version, None)
    assert after == f"--xla_backend_extra_options={options} {WITHOUT}"
    assert options in said and "added" in said


def test_what_the_user_set_stays_in_front(flags):
    _, after = flags("0.10.2", "--xla_dump_to=here")
    assert after == f"--xla_dump_to=here --xla_backend_extra_options={BOTH} {WITHOUT}"


@pytest.mark.parametrize("version", ["0.9.1", "0.10.1", "0.13.0", "1.0.0"])
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
    "before, said_of_it",
    [
        (f"--xla_backend_extra_options={BOTH}", f"{WITHOUT} was added"),
        ("--xla_backend_extra_options=xla_cpu_other=1", f"left alone; add {BOTH}"),
        (f"--xla_backend_extra_options={WHOLE_LOOPS}", f"left alone; add {SOONER}"),
    ],
)
def test_options_that_stand_there_are_left_alone(flags, before, said_of_it):
    said, after = flags("0.10.2", before)
    assert after == f"{before} {WITHOUT}"
    assert said_of_it in said


def test_passes_that_are_left_out_stay_the_users(flags):
    before = f"--xla_backend_extra_options={BOTH} --xla_disable_hlo_passes=cse"
    said, after = flags("0.10.2", before)
    assert after == before and f"add {WITHOUT[25:]}" in said
    said, after = flags("0.10.2", f"--xla_backend_extra_options={BOTH} {WITHOUT}")
    assert "nothing was changed" in said


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
    version = metadata.version("jaxlib")
    gains = version.startswith(("0.10.", "0.11.", "0.12."))
    assert (SOONER in after) == (WITHOUT in after) == (gains and not late)
    assert (WHOLE_LOOPS in after) == (version.startswith("0.10.") and not late)
    assert ("nothing was changed" in said) == (late or not gains)
    assert total == "6.0"


SWEEP = """
import hashlib
import numpy as np
import ziegler_jax as zj
zj.configure_cpu()
def point(q):
    stribeck = dict(v_stribeck=0.05, v_smooth=0.01)
    law = zj.SmoothCoulomb(0.1, 0.08, pin_radius=0.1, **stribeck)
    windows = zj.Windows(transient=20.0, length=20.0, max_windows=1)
    start = zj.State(omega=(0.0, 0.2))
    column = zj.uniform_rods(q=q, friction=law)
    return zj.settle(column, start, windows=windows, certify=False)
ds = zj.sweep(point, q=np.linspace(1.0, 4.0, 256), progress=False)
print(int(ds.steps.sum()))
print(hashlib.sha256(b"".join(ds[n].values.tobytes() for n in ds)).hexdigest())
"""


def test_loops_that_are_written_out_give_the_same_bits():
    """A store is gone on with whether or not these options are set."""
    said = []
    for unrolled in (False, True):
        options = f"{WHOLE_LOOPS},{SOONER}".replace("true", str(not unrolled).lower())
        flags = f"--xla_backend_extra_options={options}"
        flags += " --xla_disable_hlo_passes=none" if unrolled else f" {WITHOUT}"
        done = subprocess.run(
            [sys.executable, "-c", SWEEP], env={**os.environ, "XLA_FLAGS": flags},
            capture_output=True, text=True, timeout=200,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        said.append(done.stdout.split())
    assert int(said[0][0]) > 256 * 50
    assert said[0] == said[1]
