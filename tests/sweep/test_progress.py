"""What a sweep says while it runs."""

import io
import subprocess
import sys
import types

import jax
import numpy as np
import pytest
import xarray as xr

import ziegler_jax as zj
from ziegler_jax.results import OUTCOMES
from ziegler_jax.sweep import assembly, progress
from ziegler_jax.sweep.grid import Grid

# XLA folds so many terms at 20 000 places itself, for two or three seconds
TERMS = 8001 if jax.__version_info__ >= (0, 11) else 101
SLOW = f"""
import jax.numpy as jnp, ziegler_jax as zj
from jax import lax
def point(x):
    a = lax.iota(jnp.float64, 20000)
    return x + lax.reduce_window(a, 0.0, lax.add, ({TERMS},), (1,), "SAME")[3]
ds = zj.sweep(point, x=[1.0, 2.0], progress=True)
assert ds.attrs["compile_seconds"] > 1, ds.attrs["compile_seconds"]
again = zj.sweep(point, x=[1.0, 3.0], progress=False)
assert again.attrs["compile_seconds"] < 1, again.attrs["compile_seconds"]
"""


def test_a_slow_compilation_is_announced_with_its_seconds_and_without_alarm():
    """And `compile_seconds` is this run's: what was compiled before costs nothing."""
    run = [sys.executable, "-c", SLOW]
    said = subprocess.run(run, capture_output=True, text=True, check=True).stderr
    assert "compiling the scene, 1 s" in said and "100%" in said
    assert "slow" not in said and "XLA" not in said


class ZMQInteractiveShell:
    """What a notebook's kernel runs."""


@pytest.mark.parametrize(
    ("shell", "terminal", "show", "shown"),
    [
        (ZMQInteractiveShell, False, None, True),
        (ZMQInteractiveShell, False, False, False),
        (type(None), True, None, True),
        (type(None), False, None, False),
        (type(None), False, True, True),
    ],
)
def test_the_bar_is_shown_on_a_terminal_and_in_a_notebook(
    monkeypatch, shell, terminal, show, shown
):
    stream = io.StringIO()
    stream.isatty = lambda: terminal
    kernel = types.SimpleNamespace(get_ipython=shell)
    monkeypatch.setitem(sys.modules, "IPython", kernel)
    notebook = shell is ZMQInteractiveShell
    monkeypatch.setattr(sys, "stdout" if notebook else "stderr", stream)
    zj.sweep(lambda x: 2 * x, x=[1.0, 2.0], progress=show)
    assert ("100%" in stream.getvalue()) == shown
    assert progress.shown(show) == shown


@pytest.mark.parametrize("name, failures", [("obstacle", 0), ("smoothed_outcome", 3)])
def test_what_a_search_met_on_its_way_is_no_failure_of_the_point(name, failures):
    """An onset that is found names no motion that stood in its way."""
    a_code = jax.ShapeDtypeStruct((), np.int8)
    variables = {name: zj.Variable(a_code, "how a motion ended", codes=OUTCOMES)}
    block = Grid(xr.Dataset(coords={"x": [1.0, 2.0, 3.0]})).block(0)
    # what the column does itself is none
    for code, expected in ((zj.CODE.budget_spent, failures), (zj.CODE.escaped, 0)):
        opened = assembly.OpenBlock(block, variables)
        assert opened.put(np.arange(3), [np.full(3, code, np.int8)], np.zeros(3))
        assert opened.tally().failures == expected
