"""Tasks of a user, each a short script, run as they stand on small grids."""

import runpy
import subprocess
import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import pytest

import ziegler_jax as zj

EXAMPLES = Path(__file__).parents[1] / "examples"
# these run longer than they compile: last, and compiled as for users
LONG = {"cell", "chaos_map", "onset_over_friction"}
SCRIPTS = sorted(EXAMPLES.glob("*.py"), key=lambda p: (p.stem in LONG, p.stem))
WRITTEN = {  # what each leaves
    "cell": ["cell.png", "cells.html"],
    "chaos_map": ["chaos.png"],
    "critical_load": [],
    "dask_cluster": ["dask.png", "dask.zarr"],
    "device_si": ["device.png"],
    "gravity": [],
    "hysteresis": ["hysteresis.png"],
    "imperfection": [],
    "onset_over_friction": ["onset.png"],
    "own_laws": ["own_laws.png"],
    "own_map": ["own_map.png"],
    "pulsating_load": ["pulsation.png"],
    "ramp": ["ramp.png"],
    "samples": ["samples.png"],
    "store": ["low.zarr", "regime.png"],
    "three_rods": [],
    "transforms": [],
}


MASS = np.array([[4 / 3, 1 / 2], [1 / 2, 1 / 3]])  # uniform rods


def rates(mass, stiffness, damping):
    """The eigenvalues of the linear column."""
    inverse, zero = np.linalg.inv(mass), np.zeros_like(mass)
    rows = [zero, np.eye(len(mass))], [-inverse @ stiffness, -inverse @ damping]
    return np.linalg.eigvals(np.block(list(map(list, rows))))


def of_hysteresis(names):
    """The branch passes its fold."""
    stable = names["branch"].points.stable[: names["branch"].count]
    assert stable.any() and not stable.all()


def of_an_imperfection(names):
    first = 0.02 - 0.8 * np.sin(0.03)
    # a motion is at rest where it is slow: measured 2e-4
    np.testing.assert_allclose(names["rest"](0.8), (first, first + 0.03), atol=1e-3)


def of_three_rods(names):
    """Two frequencies meet at q_cr: by Newton's matrices of three uniform rods."""
    m = np.array([2.0, 1.5, 1.0])
    lever = np.tril(np.ones((3, 3)), -1) + np.eye(3) / 2  # of each centre
    mass = lever.T @ np.diag(m) @ lever + np.diag(m / 12)
    turns = np.eye(3) - np.eye(3, k=-1)

    def grows(q):
        stiffness = turns.T @ turns - q * np.diag([1.0, 1.0, 0.0])
        stiffness[:2, 2] += q
        return np.abs(np.linalg.eigvals(np.linalg.solve(mass, stiffness)).imag).max()

    q = names["q_cr"]
    assert grows(0.9999 * q) < 1e-9 < 1e-3 < grows(1.0001 * q)
    assert names["end"].outcome == zj.CODE.cycle


def of_gravity(names):
    """The weights take g (s1 + m2) and g b from the diagonal of the stiffness."""
    for g in (-0.4, 0.0, 0.4):
        q = float(names["ds"].q_cr.sel(g=g, method="nearest"))
        for beside, flutters in ((-1e-4, False), (1e-4, True)):
            one = q + beside
            stiffness = [[2 - one - 1.5 * g, one - 1], [-1, 1 - 0.5 * g]]
            squares = np.linalg.eigvals(np.linalg.solve(MASS, np.array(stiffness)))
            assert bool(np.abs(squares.imag).max() > 1e-9) == flutters


def of_a_ramp(names):
    """Flutter comes late: where the growth so far, by eigenvalues, makes up for decay.

    A kick of 0.01 and the growth say 0.1 within a factor of 2, which is 0.02 in q.
    """
    damping = 0.1 * np.array([[2, -1], [-1, 1]])
    loads = np.linspace(1.0, 2.4, 281)
    growth = [
        rates(MASS, np.array([[2 - q, q - 1], [-1, 1]]), damping).real.max()
        for q in loads
    ]
    logs = np.cumsum(growth) * 1000 / 280  # the ramp takes 1000
    late = loads[np.flatnonzero(logs > np.log(10))[0]]
    assert names["q_cr"] + 0.3 < late and abs(names["up"] - late) < 0.06
    assert names["down"] < names["q_cr"]


def of_a_pulsating_load(names):
    """It grows about twice the lower frequency, the wider the more it pulsates."""
    stiffness = np.array([[1.0, 0.0], [-1.0, 1.0]])
    lower = np.sqrt(np.linalg.eigvals(np.linalg.solve(MASS, stiffness)).real.min())
    grows = names["grows"]
    assert bool(grows.sel(p=0.5).sel(rate=2 * lower, method="nearest"))
    width = grows.sum("rate").values
    assert (np.diff(width) >= 0).all() and width[-1] > width[0] and width[-1] < 10


CHECKS = {
    "gravity": of_gravity,
    "hysteresis": of_hysteresis,
    "imperfection": of_an_imperfection,
    "pulsating_load": of_a_pulsating_load,
    "ramp": of_a_ramp,
    "three_rods": of_three_rods,
}


def test_each_task_is_a_script_of_at_most_25_lines():
    assert sorted(p.stem for p in SCRIPTS) == sorted(WRITTEN)
    for script in SCRIPTS:  # blank ones apart
        assert sum(map(bool, script.read_text().splitlines())) <= 25


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda p: p.stem)
def test_a_task_runs_as_it_stands(script, tmp_path, monkeypatch, request):
    monkeypatch.chdir(tmp_path)
    if script.stem in LONG:
        request.getfixturevalue("optimised")
    if script.stem == "dask_cluster":  # workers import it: a process of its own
        pytest.importorskip("distributed")
        run = [sys.executable, str(script)]
        done = subprocess.run(run, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        assert "Traceback" not in done.stderr and "Error" not in done.stderr
    else:
        monkeypatch.syspath_prepend(str(EXAMPLES))
        names = runpy.run_path(str(script), run_name="__main__")
        if script.stem in CHECKS:
            CHECKS[script.stem](names)
        plt.close("all")
    assert sorted(p.name for p in tmp_path.iterdir()) == WRITTEN[script.stem]
