"""A step stays as lean as it is: instructions of a lane's step in compiled code."""

import json
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
sys.path.append(str(BENCHMARKS))
import census  # noqa: E402

# For eight lanes, one vector of AVX-512, with this jaxlib; on an Intel Xeon. By the
# section of the guard that counts them.
RECORDED = "0.10.2"
INSTRUCTIONS = {
    "other lanes": {
        "frictionless": 14528,
        "smoothed, Tsit5": 41026,
        "set-valued, Tsit5": 12195,
        "smoothed, Rosenbrock": 40030,
    },
    "certified map": {"shots": 7582},
}
# Of the lanes by windows most is what is asked at a window's end alone, and stands in
# the same loop: whether what is left decays, by 64 pairs of dampings with friction, and
# how two windows compare.
# for other processors of this kind LLVM orders otherwise: steps of before took up to
# 10 % more here than on an AMD EPYC
MORE = 1.15


def obstacle():
    """Why what was recorded cannot be compared with; None where it can."""
    if metadata.version("jaxlib") != RECORDED:
        return f"What was recorded is of jaxlib {RECORDED}."
    if census.width() != 8:
        return "What was recorded is of a processor with AVX-512."
    return census.obstacle()


@pytest.mark.skipif(obstacle() is not None, reason=str(obstacle()))
@pytest.mark.parametrize("section", INSTRUCTIONS)
def test_a_lanes_step_takes_no_more_instructions_than_it_did(section):
    command = [sys.executable, BENCHMARKS / "guard.py", "--section", section]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    lines = json.loads(done.stdout.splitlines()[-1])
    for lane, recorded in INSTRUCTIONS[section].items():
        counted = lines[f"census, {lane}: all"]["instructions"]
        # half of it would be another loop than the step's
        assert 0.5 * recorded < counted < MORE * recorded, (lane, counted)
