"""Twelve tasks of a user, each a short script, run as they stand on small grids."""

import runpy
import subprocess
import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import pytest

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
    "hysteresis": ["hysteresis.png"],
    "onset_over_friction": ["onset.png"],
    "own_laws": ["own_laws.png"],
    "own_map": ["own_map.png"],
    "samples": ["samples.png"],
    "store": ["low.zarr", "regime.png"],
    "transforms": [],
}


def test_each_of_twelve_tasks_is_a_script_of_at_most_25_lines():
    assert sorted(p.stem for p in SCRIPTS) == sorted(WRITTEN) and len(SCRIPTS) == 12
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
        if script.stem == "hysteresis":  # the branch passes its fold
            stable = names["branch"].points.stable[: names["branch"].count]
            assert stable.any() and not stable.all()
        plt.close("all")
    assert sorted(p.name for p in tmp_path.iterdir()) == WRITTEN[script.stem]
