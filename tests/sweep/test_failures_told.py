"""What a sweep says beside its numbers: lanes that failed, a forked process."""

import subprocess
import sys
import warnings
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import ziegler_jax as zj
from ziegler_jax.results import CRITICAL_LOADS, KINDS, ONSETS, ORBITS, OUTCOMES
from ziegler_jax.sweep.assembly import REMEDIES

ENDS = float(zj.CODE.step_vanished), float(zj.CODE.complete)


def coded(codes):
    def point(x):
        return {"outcome": zj.Variable(x.astype(jnp.int8), "how it ended", codes=codes)}

    return point


def told(codes, x, **options):
    """The warnings of a sweep whose points end as `x` says."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        zj.sweep(coded(codes), x=x, progress=False, **options)
    return [str(warning.message) for warning in caught]


def test_a_sweep_in_which_lanes_failed_warns_once_and_names_the_cure(small_blocks):
    codes = np.linspace(2.9, 4.9, 21)  # in three blocks: 1, 10 and 10 of each
    (sentence,) = told(OUTCOMES, codes)
    for part in (
        "Of 21 points", "At 10 `outcome` is `step_vanished`", "`Method(rtol=",
        "At 10 `outcome` is `budget_spent`", "`Method(max_steps=",
        "At 1 `outcome` is `not_finite`",
    ):  # fmt: skip
        assert part in sentence, sentence


@pytest.mark.parametrize(
    "codes, code", [(OUTCOMES, "chattering"), (ORBITS, "not_integrated"),
                    (ORBITS, "no_return"), (ORBITS, "not_converged"),
                    (CRITICAL_LOADS, "invalid"), (OUTCOMES, "invalid")]
)  # fmt: skip
def test_each_failure_has_a_remedy(codes, code):
    (sentence,) = told(codes, [float(zj.CODE[code])])
    assert f"`{code}` ({zj.CODE[code].sentence}): " in sentence


@pytest.mark.parametrize(
    "codes, names",
    [
        (OUTCOMES, ("not_computed", "escaped", "unsettled", "stuck", "cycle")),
        (KINDS, ("slow", "chaotic")),
        (ONSETS, ("undecided", "rests")),
        (ORBITS, ("collapsed", "found")),
    ],
)
def test_what_a_column_does_is_no_failure(codes, names):
    assert told(codes, [float(zj.CODE[name]) for name in names]) == []


def test_a_lane_without_numbers_has_failed_or_turned_over():
    below = [code for code in OUTCOMES if code < zj.CODE.unsettled]
    assert {c.name for c in below} - set(REMEDIES) == {"escaped"}
    page = Path(__file__).parents[2].joinpath("docs/reference/results.md").read_text()
    assert "Failures and escaped motions have no numbers" in page


def test_a_finished_store_says_nothing_twice(path):
    assert len(told(OUTCOMES, ENDS, store=path)) == 1
    assert told(OUTCOMES, ENDS, store=path) == []


FORKED = """
import os, sys, time, warnings
warnings.simplefilter("ignore")  # JAX warns at a fork
import jax
jax.config.update("jax_enable_x64", True)
import ziegler_jax as zj

def sweep():
    return zj.sweep(lambda x: 2 * x, x=[1.0, 2.0], progress=False).value.values

def critical():
    return zj.critical_load(zj.uniform_rods(1.0)).q_cr

law = zj.SmoothCoulomb(0.1, pin_radius=0.1, v_smooth=0.1)
column, y = zj.uniform_rods(1.0, friction=law), (0.1, 0.2, 0.3, 0.4)

def energy():
    return zj.energy(column, y)

def power():
    return zj.power(column, y).follower

def forces():
    return zj.reactions(column, y)[0, 0]

def field():
    return zj.vector_field(0.0, y, column)[2]

def stiff():
    return 1.0 + zj.is_stiff(column, 1e-6)

def child(question):
    pid = os.fork()
    if not pid:
        try:
            print(question(), flush=True)
        except RuntimeError as error:
            print(type(error).__name__, error, flush=True)
        os._exit(0)
    os.waitpid(pid, 0)

if sys.argv[1] == "after":
    sweep()
for question in sweep, critical, energy, power, forces, field, stiff:
    child(question)
"""


@pytest.mark.skipif(not hasattr(sys, "getdlopenflags"), reason="Windows forks none")
@pytest.mark.parametrize("when", ["before", "after"])
def test_a_forked_process_computes_or_says_that_it_cannot(when):
    """After a sweep in the parent it waited for ever."""
    done = subprocess.run(
        [sys.executable, "-c", FORKED, when],
        capture_output=True, text=True, timeout=100,
    )  # fmt: skip
    lines = done.stdout.splitlines()
    assert len(lines) == 7, done.stderr
    if when == "before":
        assert lines[0] == "[2. 4.]"
        assert all(0 < abs(float(line)) < np.inf for line in lines[1:])
    else:
        for line in lines:
            assert line.startswith("RuntimeError") and "fork" in line
            assert '`spawn`: `multiprocessing.get_context("spawn")`' in line
