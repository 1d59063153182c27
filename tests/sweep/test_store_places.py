"""Where a store may lie: behind links, beside nothing else, and while it is there."""

import os
import shutil

import pytest
from stored import same, sweep

import ziegler_jax as zj
from ziegler_jax.sweep import store

pytestmark = pytest.mark.usefixtures("small_blocks")


@pytest.mark.parametrize("target", ["a store", "an empty folder", "nothing"])
@pytest.mark.parametrize("overwrite", [False, True])
def test_a_link_stays_and_what_it_names_becomes_the_store(tmp_path, target, overwrite):
    disk, link = tmp_path / "scratch" / "map", tmp_path / "map.zarr"
    disk.parent.mkdir()
    link.symlink_to(disk)
    if target == "a store":
        sweep(store=disk)
    elif target == "an empty folder":
        disk.mkdir()
    assert same(sweep(store=zj.Store(link, overwrite=overwrite)), sweep())
    assert link.is_symlink() and (disk / "zarr.json").is_file()
    assert same(zj.open_sweep(link), sweep())
    assert os.listdir(disk.parent) == ["map"]


@pytest.mark.parametrize(
    "store, parts",
    [
        (3, ("`store`", "path", "3")),
        ("", ("`store`", "path", "''")),
        (".", ("`store`", "'.'", "map.zarr")),
        ("..", ("`store`", "'..'", "map.zarr")),
        ("s3://bucket/map.zarr", ("`store`", "this machine", "s3://")),
        ("a\0b", ("`store`", "path")),
    ],
)
def test_what_can_be_no_place_is_refused(store, parts, tmp_path, monkeypatch, refuses):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    for overwrite in (False, True):
        refuses(lambda o=overwrite: sweep(store=zj.Store(store, overwrite=o)), *parts)
    refuses(lambda: zj.open_sweep(store), *parts)
    assert [p.name for p in tmp_path.rglob("*")] == ["here"]


@pytest.mark.parametrize(
    "name", ["map.zarr#2", "map.zarr?v=2", "map.zarr;x", "a b", "ö"]
)
def test_a_path_is_no_address(tmp_path, name):
    """Zarr would cut it at `#`, `?` and `;`, and read another store."""
    sweep(store=tmp_path / "map.zarr", x=[1.0, 2.0])
    assert same(sweep(store=tmp_path / name), sweep())
    assert same(zj.open_sweep(tmp_path / name), sweep())
    assert zj.open_sweep(tmp_path / "map.zarr").x.size == 2


def test_a_store_that_vanishes_on_the_way_is_told_as_that(path, monkeypatch):
    keep = store.SweepStore.write_block

    def vanished(self, *block):
        shutil.rmtree(self.path)
        keep(self, *block)

    monkeypatch.setattr(store.SweepStore, "write_block", vanished)
    with pytest.raises(OSError, match="is gone: it was moved or deleted") as caught:
        sweep(store=path, lanes=zj.Lanes(4, 1))
    assert "It was writing block 0" in " ".join(caught.value.__notes__)


def test_a_store_of_version_one_is_told_as_that_and_replaced(path, refuses):
    (path / "progress" / "blocks").mkdir(parents=True)
    (path / "progress" / "sweep.json").write_text("{}")
    parts = "`store`", "another version", "overwrite=True"
    refuses(lambda: sweep(store=path), *parts)
    refuses(lambda: zj.open_sweep(path), *parts)
    assert same(sweep(store=zj.Store(path, overwrite=True)), sweep())


def test_a_sweep_that_replaced_it_meanwhile_keeps_the_store(path, refuses):
    """One that was opened before, and claims it after, writes nothing into it."""
    sweep(store=path)
    former = store.SweepStore(path)
    sweep(store=zj.Store(path, overwrite=True))
    refuses(former.claim, "`store`", "taken over by another")
