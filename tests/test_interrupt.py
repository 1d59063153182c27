"""Ctrl-C ends a sweep, whenever it comes."""

import signal
import subprocess
import sys

import pytest

import ziegler_jax as zj
from ziegler_jax.runtime import held_interrupts

PROGRAM = """
import sys
import numpy as np
import ziegler_jax as zj

def point(q):
    column = zj.uniform_rods(q, damping=zj.Viscous(0.0, 0.01))
    start = zj.State(omega=(0.0, 0.3))
    long, many = zj.Windows(transient=1e5), zj.Method(max_steps=100_000_000)
    # by windows: a certified lane would end long before its transient does
    return zj.settle(column, start, windows=long, method=many, certify=False)

print("ready", flush=True)
try:
    zj.sweep(point, q=np.linspace(1, 2, 4096), lanes=zj.Lanes(8), progress=False)
except KeyboardInterrupt:
    print("interrupted", flush=True)
    sys.exit(3)
"""


@pytest.mark.skipif(
    signal.getsignal(signal.SIGINT) is signal.SIG_IGN,
    reason="this process ignores Ctrl-C, as under nohup, and so do its children",
)
def test_ctrl_c_ends_a_sweep_soon():
    command = [sys.executable, "-c", PROGRAM]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout.readline() == "ready\n"
            with pytest.raises(subprocess.TimeoutExpired):
                process.wait(12)
            process.send_signal(signal.SIGINT)
            out, _ = process.communicate(timeout=20)
        finally:
            process.kill()
    assert out == "interrupted\n"
    assert process.returncode == 3


@pytest.fixture
def pythons_own_handler():
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


class Finalised:
    """Ctrl-C, once, where Python drops an exception with a warning."""

    pressed = False

    def __del__(self):
        if not Finalised.pressed:
            Finalised.pressed = True
            signal.raise_signal(signal.SIGINT)


def test_ctrl_c_in_a_finaliser_while_a_scene_is_traced_is_not_lost(pythons_own_handler):
    def scene(x):
        Finalised()
        return x

    with pytest.raises(KeyboardInterrupt):
        zj.sweep(scene, x=[1.0], progress=False)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert zj.sweep(lambda x: x, x=[1.0], progress=False).value == 1.0


def test_a_second_ctrl_c_ends_tracing_at_once(pythons_own_handler):
    reached = []
    with pytest.raises(KeyboardInterrupt), held_interrupts():
        signal.raise_signal(signal.SIGINT)
        reached.append("after the first")
        signal.raise_signal(signal.SIGINT)
        reached.append("after the second")
    assert reached == ["after the first"]


def test_a_handler_of_the_users_own_is_left_alone():
    seen = []
    before = signal.signal(signal.SIGINT, lambda *_: seen.append("mine"))
    try:
        with held_interrupts():
            signal.raise_signal(signal.SIGINT)
    finally:
        signal.signal(signal.SIGINT, before)
    assert seen == ["mine"]
