"""Which sweep a store belongs to: another is refused by name."""

import functools
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import stored
import xarray as xr
from stored import MU, Q, X, Y, lines, point, same, settled, sweep

import ziegler_jax as zj
from ziegler_jax import OUTCOME, _blocks, _fingerprint

pytestmark = pytest.mark.usefixtures("small_blocks")


def test_another_sweep_is_refused_by_name_and_replaced_on_demand(
    path, refuses, monkeypatch
):
    sweep(store=path)
    others = [
        ({"x": X[:-1]}, ("axis `x`", "8 values", "7")),
        ({"y": Y * (1 + 1e-15)}, ("axis `y`",)),
        ({"x": np.where(X == X[3], X[3] + 1e-12, X)}, ("axis `x`", "between")),
        ({"axes": {"y": Y, "x": X}, "x": None, "y": None}, ("axes x, y", "y, x")),
        ({"where": lambda x, y: x + y > 1}, ("other points",)),
        ({"precision": "float32"}, ("precision float64", "float32")),
        ({"batch_size": 5}, ("batch_size 4", "5")),
    ]
    for change, parts in others:
        options = {"x": X, "y": Y, "batch_size": 4, "progress": False, **change}
        options = {k: v for k, v in options.items() if v is not None}
        refuses(
            lambda options=options: zj.sweep(point, store=path, **options),
            "`store`", str(path), *parts, "overwrite",
        )  # fmt: skip
    with monkeypatch.context() as patch:
        known = _fingerprint.metadata.version
        patch.setattr(
            _fingerprint.metadata, "version",
            lambda name: "9.9" if name == "ziegler_jax" else known(name),
        )  # fmt: skip
        refuses(lambda: sweep(store=path), "computed with ziegler_jax", "9.9")
    assert sweep(store=path, resume="overwrite", x=X[:-1]).x.size == 7
    assert zj.open_sweep(path).attrs["points_done"] == 35


@pytest.mark.parametrize("change", ["constant", "table", "helper"])
def test_a_scene_is_known_by_its_program(path, refuses, monkeypatch, change):
    """What the source does not show: each of them changes a number somewhere."""
    sweep(store=path)
    if change == "constant":
        monkeypatch.setattr(stored, "FACTOR", 3.0000000001)
    elif change == "table":  # in place: neither its name nor its identity changes
        monkeypatch.setattr(stored, "TABLE", stored.TABLE.copy())
        sweep(store=path)
        stored.TABLE[3] += 1e-12
    else:
        monkeypatch.setattr(stored, "helper", lambda x: x + 1.0000001)
    refuses(lambda: sweep(store=path), "`store`", "another scene")


def test_a_table_that_changed_in_place_is_computed_with(path, monkeypatch):
    monkeypatch.setattr(stored, "TABLE", stored.TABLE.copy())
    before = sweep(store=path)["bent"].values
    stored.TABLE[:] *= 2
    after = sweep(store=path, resume="overwrite")["bent"].values
    np.testing.assert_allclose(after, 2 * before, rtol=1e-12, atol=0)


HASH = """
import sys
sys.path[:0] = {path!r}
import jax
import stored
from ziegler_jax._fingerprint import scene_hash
print(scene_hash(stored.point, ("x", "y"), True),
      scene_hash(stored.settled, ("q", "mu"), True))
"""


def test_a_scenes_hash_is_the_same_in_another_process():
    environment = {**os.environ, "PYTHONHASHSEED": "5"}
    program = HASH.format(path=[str(Path(__file__).parent)])
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=environment, capture_output=True, text=True, timeout=200,
    )  # fmt: skip
    here = [
        _fingerprint.scene_hash(point, ("x", "y"), True),
        _fingerprint.scene_hash(settled, ("q", "mu"), True),
    ]
    assert done.stdout.split() == here, done.stderr


def test_every_setting_is_refused_by_name():
    settings = {"rtol": 1e-4, "solver": "Tsit5", "max_windows": 4}
    blocks = _blocks.Blocks({"x": X, "y": Y})
    of = functools.partial(
        _fingerprint.fingerprint, point, blocks, scene="", batch_size=4, wide=True
    )
    there = json.loads(json.dumps(of(settings=settings)))
    assert _fingerprint.difference(there, of(settings=settings)) is None
    for name, value in {"rtol": 1e-5, "solver": "Dopri8", "max_windows": 5}.items():
        said = _fingerprint.difference(there, of(settings={**settings, name: value}))
        assert said == f"has {name} {settings[name]}, and this sweep {value}"


@pytest.mark.slow
def test_larger_budgets_compute_the_unsettled_points_alone(path, tmp_path, refuses):
    def with_windows(count):
        def scene(q, mu):
            return settled(q, mu, max_windows=count)

        return functools.partial(
            zj.sweep, scene, q=Q, mu=MU, batch_size=8, progress=False
        )

    few, many = with_windows(4), with_windows(9)
    before = few(store=path).load()
    unsettled = before.outcome == OUTCOME.unsettled
    assert 0 < unsettled.sum() < unsettled.size
    refuses(lambda: many(store=path), "max_windows 4", "9")
    after = many(store=path, resume="unsettled", log=tmp_path / "log")
    assert sum(line["points"] for line in lines(tmp_path / "log")) == unsettled.sum()
    # two programs: a compiler may round their amplitudes otherwise; measured 3e-16
    whole = many(store=tmp_path / "whole.zarr")
    xr.testing.assert_allclose(after, whole, rtol=1e-12, atol=0)
    assert (after.outcome == OUTCOME.unsettled).sum() < unsettled.sum()
    many(store=path, resume="unsettled", log=tmp_path / "again")
    assert not (tmp_path / "again").exists()
    refuses(
        lambda: few(store=path, resume="unsettled"), "max_windows 9", "not shrink", "4"
    )


def test_what_has_no_outcome_has_no_unsettled_points(path, refuses):
    sweep(store=path)
    changed = functools.partial(
        zj.sweep, lambda x, y: {"sum": x}, x=X, y=Y, batch_size=4, progress=False
    )
    refuses(lambda: changed(store=path, resume="unsettled"), "another scene")


@pytest.mark.parametrize(
    "options, parts",
    [
        ({"resume": "overwrite"}, ("`resume`", "`store`")),
        ({"resume": "yes", "store": "x"}, ("`resume`", "'yes'")),
        ({"client": 3}, ("`client`", "3")),
    ],
)
def test_wrong_options_are_refused(refuses, options, parts):
    refuses(lambda: sweep(**options), *parts)


def test_a_folder_of_something_else_is_left_alone(tmp_path, refuses):
    (tmp_path / "thesis.txt").write_text("years of work")
    for resume in ("same", "overwrite"):
        refuses(lambda r=resume: sweep(store=tmp_path, resume=r), "`store`", "is none")
    assert (tmp_path / "thesis.txt").read_text() == "years of work"
    refuses(lambda: zj.open_sweep(tmp_path / "nothing"), "`store`", "nothing")
    refuses(lambda: sweep(store=tmp_path / "thesis.txt"), "`store`", "thesis")


def test_a_half_deleted_store_can_be_overwritten(path):
    sweep(store=path)
    (path / "zarr.json").unlink()
    assert same(sweep(store=path, resume="overwrite"), sweep())
