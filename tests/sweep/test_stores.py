"""Sweeps that go on: what is stored is what was computed, and is not computed again."""

import functools

import jax
import jax.numpy as jnp
import pytest
import xarray as xr
import zarr
from stored import MU, Q, same, settled, sweep

import ziegler_jax as zj
from ziegler_jax.results import OUTCOMES, AbstractResult, Variable
from ziegler_jax.sweep import store

pytestmark = pytest.mark.usefixtures("small_blocks")


def test_a_stored_sweep_is_the_one_in_memory(path):
    found = sweep(store=path)
    assert same(found, sweep())
    assert same(zj.open_sweep(path), found)
    assert {d.chunksizes == {} for d in found.data_vars.values()} == {True}
    assert found.attrs["points"] == found.attrs["points_done"] == 40
    assert found.attrs["blocks"] == found.attrs["blocks_done"] == 4
    with xr.open_zarr(path, consolidated=False, chunks=None) as plain:
        assert set(plain.data_vars) == set(found.data_vars)


def test_lanes_in_chunks_and_their_outcomes_are_stored(path, told):
    run = functools.partial(
        zj.sweep,
        settled,
        q=Q,
        mu=MU,
        where=lambda q, mu: q * mu < 0.5,
        lanes=zj.Lanes(batch_size=8),
        progress=False,
    )
    whole = run()
    before = len(told())
    assert same(run(store=path), whole)
    assert zarr.open_group(path, mode="r")["outcome"].chunks == (3, 3)
    found = told()[before:]
    assert sum(line["points"] for line in found) == whole.attrs["points"]
    assert sum(line["steps"] for line in found) == whole.steps.sum()
    for code in OUTCOMES:
        counted = sum(line["outcomes"].get(code.name, 0) for line in found)
        assert counted == (whole.outcome == code).sum()
    for line in found:
        low, high = line["ranges"]["q"]
        part = whole.sel(q=slice(low, high))
        assert part.q.size == 3 and line["steps"] == part.steps.sum()


def test_an_interrupted_sweep_computes_only_what_is_missing(path, told, monkeypatch):
    keep = store.SweepStore.write_block

    def interrupted(self, block, *rest):
        if block.number == 2:
            raise KeyboardInterrupt
        keep(self, block, *rest)

    with monkeypatch.context() as patch:
        patch.setattr(store.SweepStore, "write_block", interrupted)
        with pytest.raises(KeyboardInterrupt):
            sweep(store=path, lanes=zj.Lanes(4, 1))
    part = zj.open_sweep(path)
    assert (part.attrs["points_done"], part.attrs["blocks_done"]) == (20, 2)
    whole = sweep()
    done = whole["sum"].values[:4], part["sum"].values[:4]
    assert (done[0] == done[1]).all() and part["sum"][4:].isnull().all()
    before = len(told())
    assert same(sweep(store=path), whole)
    assert sorted(line["block"] for line in told()[before:]) == [2, 3]
    assert same(sweep(store=path), whole) and len(told()) == before + 2


def test_a_reader_sees_what_is_finished(path):
    seen = []

    class Watching(store.SweepStore):
        def write_block(self, *block):
            super().write_block(*block)
            seen.append(zj.open_sweep(path).load())

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(store, "SweepStore", Watching)
        sweep(store=path, lanes=zj.Lanes(4, 1))
    counts = [int(ds["sum"].notnull().sum()) for ds in seen]
    assert counts == [ds.attrs["points_done"] for ds in seen] == [10, 20, 30, 40]


def test_codes_are_written_last(path):
    run = functools.partial(
        zj.sweep, settled, q=Q[:2], mu=MU, lanes=zj.Lanes(batch_size=8)
    )
    run(store=path, progress=False)
    names = store.SweepStore(path).names
    assert names[-1] == "outcome" and len(names) > 3


def test_two_sweeps_do_not_write_to_one_store(path, refuses):
    sweep(store=path)
    with store.SweepStore(path) as one:
        one.claim()
        refuses(
            lambda: sweep(store=zj.Store(path, overwrite=True)),
            "`store`",
            "another sweep",
        )
    assert same(sweep(store=zj.Store(path, overwrite=True)), sweep())


class Labelled(AbstractResult):
    """A result with a dimension of words and one of numbers."""

    value: jax.Array
    settings: tuple = ()

    def variables(self):
        return {
            "up_and_down": Variable(self.value, "both", "1", ("branch",)),
            "both_joints": Variable(self.value, "both", "1", ("joint",)),
        }

    def coordinates(self):
        return {"branch": ("up", "down")}


def test_labels_come_back_as_they_were(path):
    def point(x):
        return Labelled(jnp.stack([x, 2 * x]))

    run = functools.partial(zj.sweep, point, x=[1.0, 2.0], progress=False)
    found = run(store=path)
    assert found.branch.values.tolist() == ["up", "down"]
    assert found.joint.dtype == int and same(found, run())
    assert found.up_and_down.sel(branch="down").values.tolist() == [2.0, 4.0]
    (path / "joint" / "c" / "0").unlink()
    assert same(run(store=path), run())
