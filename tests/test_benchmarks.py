"""Every benchmark runs: a script that nobody runs breaks unnoticed."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
BENCHMARKS = ROOT / "benchmarks"
SCRIPTS = sorted(path.stem for path in BENCHMARKS.glob("[abcd][0-9]*_*.py"))
# how each is called for a small run; most of its time it compiles
SMALL = {
    "a0_throughput": "--lanes 128 --repeats 1",
    "a12_fold_curves": "--points 20",
    "a13_certified_truth": "share onsets --cells 16 --side 2 --scanned 0",
    "a15_chains": "--rods 3 --cells 6",
    "a1_linear": "--columns 500",
    "a3_friction": "cycles --lanes 16 --repeats 1",
    "a5_certificates": "--cells 32 --beside 4 --again 200",
    "a9_least_kick": "--groups rates --cases 1 --random 16",
    "b0_work_precision": "--scenes stiff_1e-3 --stiff-lanes 8 --repeats 1",
    "b1_lanes": "--lanes 64 --threaded 64 --rounds 1",
    "b3_questions": "--cells 16 --repeats 1 --only certified windows",
    "b4_first_call": "--processes 1 --scenes one_window",
    "c0_extreme": "--only mu_s",
    "c1_honesty": "--span 20",
    "d0_soak": "--sweeps 2 --copies 2",
}
IMPORTED = """
import importlib, sys
for name in sys.argv[1:]:
    importlib.import_module(name)
"""


def python(*arguments, results=None):
    folders = [ROOT, BENCHMARKS, ROOT / "figures", ROOT / "audit", ROOT / "tests"]
    own = {"PYTHONPATH": os.pathsep.join(map(str, folders))}
    done = subprocess.run(
        [sys.executable, *arguments],
        env={**os.environ, **own, "ZIEGLER_RESULTS": str(results)},
        capture_output=True, text=True, timeout=1200,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-3000:]
    return done.stdout


def test_every_script_of_these_folders_is_imported():
    """What it does it does in `main`."""
    folders = [ROOT / name for name in ("benchmarks", "figures", "audit")]
    paths = [path for folder in folders for path in folder.glob("*.py")]
    for path in paths:
        text = path.read_text()
        assert "\ndef main(" not in text or '\nif __name__ == "__main__"' in text, path
    # heyoka, which the reference of `b0_work_precision` needs, is an extra
    python("-c", IMPORTED, *sorted({path.stem for path in paths} - {"reference"}))


def test_every_script_has_a_small_run():
    assert sorted(SMALL) == SCRIPTS


@pytest.mark.parametrize("script", SMALL)
def test_a_script_runs(script, tmp_path):
    if script == "b0_work_precision":
        pytest.importorskip("heyoka")
    command = str(BENCHMARKS / f"{script}.py"), *SMALL[script].split()
    printed = python(*command, results=tmp_path)
    assert json.loads(printed.splitlines()[-1])["benchmark"] == script
