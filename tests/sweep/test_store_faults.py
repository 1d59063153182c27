"""Killed, full or broken: nothing committed is lost, nothing half-written is taken."""

import errno
import functools
import itertools
import json
import os
import random
import signal
import subprocess
import sys
import time

import jax
import numpy as np
import pytest
import xarray as xr
from stored import X, Y, same, sweep

import ziegler_jax as zj
from ziegler_jax.sweep import assembly, grid, store

pytestmark = pytest.mark.usefixtures("small_blocks")


@pytest.mark.parametrize("written", ["sum", "marker"])
def test_a_full_disk_loses_nothing_and_names_the_block(path, monkeypatch, written):
    put, mark = store.write, store.write_record

    def no_space(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def fill(at, content, parts):
        full = written == "sum" and at.as_posix().endswith("sum/c/2/0")
        (no_space if full else put)(at, content, parts)

    def record(at, content, parts):
        full = written == "marker" and at.name == "2"
        (no_space if full else mark)(at, content, parts)

    with monkeypatch.context() as patch:
        patch.setattr(store, "write", fill)
        patch.setattr(store, "write_record", record)
        with pytest.raises(OSError, match="No space left") as caught:
            sweep(store=path, lanes=zj.Lanes(4, 1))
    note = " ".join(caught.value.__notes__)
    assert "block 2" in note and "<= x <=" in note and str(path) in note
    assert zj.open_sweep(path).attrs["blocks_done"] == 2
    assert same(sweep(store=path), sweep())


def test_chunks_have_reached_the_disk_before_their_block_has_a_mark(path, monkeypatch):
    """And each file before its name does."""
    sync, replace, seen = os.fsync, os.replace, []

    def synced(file):
        seen.append(("on the disk", os.fstat(file).st_ino))
        sync(file)

    def replaced(part, at):
        (_, last), inner = seen[-1], os.path.relpath(at, path)
        assert last == os.stat(part).st_ino, f"{inner} had not reached the disk"
        replace(part, at)
        seen.append((inner, os.stat(os.path.dirname(at)).st_ino))

    sweep(store=path, x=X[:1])
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", synced)
        patch.setattr(os, "replace", replaced)
        sweep(store=zj.Store(path, overwrite=True), lanes=zj.Lanes(4, 1))
    for (file, folder), (_, after) in itertools.pairwise(seen):
        named = file == "on the disk" or after == folder
        assert named, f"the name {file} had not reached the disk"
    order = [file for file, _ in seen if file != "on the disk"]
    marks = [file for file in order if "/blocks/" in file]
    assert len(marks) == 4
    for mark in marks:
        mine = order.index(mark)
        assert {f.split("/")[0] for f in order[mine - 4 : mine]} == {
            "sum", "bent", "flag", "regime"
        }  # fmt: skip
        assert order[mine - 1].startswith("regime")  # codes after numbers


def test_a_replaced_store_takes_nothing_more_from_its_former_sweep(path, refuses):
    """As from a cluster's worker that still computes for a sweep that was stopped."""
    whole = sweep(store=path).load()
    former = store.SweepStore(path)
    block = grid.Grid(xr.Dataset(coords={"x": X, "y": Y})).block(0)
    wrong = {name: np.zeros_like(whole[name][:4]) for name in whole}
    tally = assembly.Tally(10, 0.0, 0, {}, {})
    sweep(store=zj.Store(path, overwrite=True))
    refuses(lambda: former.write_block(block, wrong, tally), "`store`", "another")
    assert same(zj.open_sweep(path), whole)


def test_a_deletion_that_is_killed_leaves_no_store_behind(path, monkeypatch):
    whole = sweep(store=path).load()

    def killed(*_, **__):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(store.shutil, "rmtree", killed)
        with pytest.raises(KeyboardInterrupt):
            sweep(store=zj.Store(path, overwrite=True))
    assert not path.exists()
    assert same(sweep(store=path), whole)
    sweep(store=zj.Store(path, overwrite=True))
    assert [left.name for left in path.parent.iterdir()] == [path.name]


def test_a_small_disk_that_is_full(tmp_path):
    """The same with a real one, where this process may make it."""
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=512k", "tmpfs", str(disk)]
    try:
        made = subprocess.run(mount, capture_output=True).returncode == 0
    except FileNotFoundError:
        made = False
    if not made:
        pytest.skip("needs the right to mount a tmpfs")
    try:
        with (disk / "filler").open("wb") as filler:
            filler.write(bytes(300 * 1024))
        with pytest.raises(OSError, match="No space left"):
            sweep(store=disk / "map.zarr", x=np.linspace(0, 4, 800))
        (disk / "filler").unlink()
        before = zj.open_sweep(disk / "map.zarr").attrs["blocks_done"]
        remount = ["mount", "-o", "remount,size=64m", str(disk)]
        subprocess.run(remount, check=True)
        found = sweep(store=disk / "map.zarr", x=np.linspace(0, 4, 800))
        assert 0 < before < found.attrs["blocks_done"]
        assert same(found.load(), sweep(x=np.linspace(0, 4, 800)))
        subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
        again = sweep(store=disk / "map.zarr", x=np.linspace(0, 4, 800))
        assert same(again.load(), found)
        with pytest.raises(OSError, match="Read-only"):
            sweep(store=disk / "other.zarr")
        with pytest.raises(OSError, match="Read-only"):
            sweep(store=zj.Store(disk / "map.zarr", overwrite=True))
        assert same(zj.open_sweep(disk / "map.zarr"), found)
    finally:
        subprocess.run(["umount", str(disk)], check=True)


def test_a_point_that_raises_for_one_batch_names_its_values(path):
    broken = {"at": 3.0}

    def check(x):
        if (np.asarray(x) > broken["at"]).any():
            raise RuntimeError("my own mistake")
        return np.asarray(x)

    def scene(x, y):
        like = jax.ShapeDtypeStruct((), x.dtype)
        checked = jax.pure_callback(check, like, x, vmap_method="expand_dims")
        return {"sum": checked + y}

    fine = np.linspace(0.0, 1.0, 32)
    run = functools.partial(
        zj.sweep,
        scene,
        x=X,
        y=fine,
        lanes=zj.Lanes(batch_size=32, threads=1),
        progress=False,
    )
    # what the host computes no digest shows, and so nobody knows the store again
    with (
        pytest.warns(UserWarning, match="cannot be resumed.*check"),
        pytest.raises(Exception, match="my own mistake") as caught,
    ):
        run(store=path)
    (note,) = caught.value.__notes__
    assert "3.42857142857142" in note and "<= x <=" in note and "<= y <=" in note
    assert zj.open_sweep(path).attrs["blocks_done"] == 18  # three to a row
    broken["at"] = 5.0
    with pytest.raises(ValueError, match="cannot be resumed.*overwrite"):
        run(store=path)
    found = run()
    assert found.attrs["scene_digest"] == "none"
    assert (found["sum"].values == X[:, None] + fine).all()


KILLED = """
import logging
import sys
import numpy as np
import ziegler_jax as zj
from ziegler_jax.sweep import grid

grid.POINTS_A_BLOCK = 40
log = logging.getLogger("ziegler_jax.sweep")
log.setLevel("INFO")
log.addHandler(logging.FileHandler(sys.argv[2]))

def point(x, y):
    return {"sum": x + y, "product": x * y, "half": x / 2}

print("ready", flush=True)
zj.sweep(point, x=np.linspace(0, 1, 300), y=np.linspace(1, 2, 20), lanes=zj.Lanes(8),
         store=sys.argv[1], progress=False)
"""


def committed(path):
    try:
        return {n: m["seconds"] for n, m in store.SweepStore(path).marks().items()}
    except ValueError:
        return {}


def killed(arguments, seconds, path, least):
    """Start the sweep and kill it some time after it has finished `least` blocks."""
    process = subprocess.Popen(
        [sys.executable, *arguments], stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout.readline() == "ready\n"
        while process.poll() is None and len(committed(path)) < least:
            time.sleep(0.001)
        try:
            process.wait(seconds)
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGKILL)
        return process.wait()
    finally:
        process.kill()
        process.communicate()


def test_killed_at_any_moment_it_goes_on_where_it_was(tmp_path, path):
    """Twice in the middle of 150 blocks; and then to the end."""
    rng = random.Random(3)
    arguments = ["-c", KILLED, str(path), str(tmp_path / "log")]
    kills, before = 0, {}
    for least in (1, 40):
        kills += killed(arguments, rng.uniform(0, 0.03), path, least) != 0
        after = committed(path)
        assert before.items() <= after.items()  # none was written twice
        before = after
    assert kills and 0 < len(before) < 150
    assert killed(arguments, 200.0, path, 0) == 0
    assert before.items() <= committed(path).items()
    told = (tmp_path / "log").read_text().splitlines()
    blocks = [json.loads(line)["block"] for line in told]
    assert len(set(blocks)) == len(blocks) >= 150 - kills
    found = zj.open_sweep(path)
    x, y = found.x.values[:, None], found.y.values
    assert found.attrs["blocks_done"] == 150
    assert (found["sum"].values == x + y).all()
    assert (found["product"].values == x * y).all()
    assert not list(path.rglob("*.partial"))
