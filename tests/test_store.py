"""Sweeps that go on: nothing committed is lost, nothing half-written is taken."""

import errno
import functools
import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
import zarr

import ziegler_jax as zj
from ziegler_jax import OUTCOME, _blocks, _fingerprint, _store

# A cheap scene of four blocks, and a small one with lanes in legs.

FACTOR, TABLE = 3.0, np.linspace(0.0, 1.0, 5)


def helper(x):
    return x + 1.0


def point(x, y):
    bent = jnp.interp(x, jnp.asarray([0.0, 1.0, 2.0, 3.0, 4.0]), jnp.asarray(TABLE))
    return {"sum": FACTOR * x + helper(y), "bent": bent, "flag": x > y}


X, Y = np.linspace(0.0, 4.0, 8), np.linspace(0.0, 1.0, 5)
sweep = functools.partial(zj.sweep, point, x=X, y=Y, batch_size=4, progress=False)


def settled(q, mu, **budgets):
    friction = zj.SmoothCoulomb(mu, pin_radius=0.05, v_smooth=0.05)
    return zj.settle(
        zj.uniform_rods(q, friction=friction), zj.State(omega=(0.0, 0.3)),
        transient=20.0, window=10.0, rtol=1e-4, atol=1e-4,
        **{"max_windows": 4, "max_steps": 2000, **budgets},
    )  # fmt: skip


Q, MU = np.linspace(1.5, 3.5, 9), np.array([0.05, 0.1, 0.2])


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch):
    monkeypatch.setattr(_blocks, "POINTS_A_BLOCK", 10)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "map.zarr"


def same(one, other):
    """To the last bit, NaN like NaN, with the same labels."""
    timing = {"run_seconds", "points_per_second", "useful_step_fraction"}
    timing |= {"compile_seconds", "threads", "points", "points_done"}
    timing |= {"blocks", "blocks_done", "max_windows", "max_steps"}
    attrs = [
        {k: v for k, v in d.attrs.items() if k not in timing} for d in (one, other)
    ]
    assert attrs[0] == attrs[1]
    assert list(one.data_vars) == list(other.data_vars)
    for name in one.variables:
        assert one[name].attrs == other[name].attrs, name
        assert one[name].dtype == other[name].dtype, name
        assert one[name].values.tobytes() == other[name].values.tobytes(), name
    return True


def lines(log):
    return [json.loads(line) for line in log.read_text().splitlines()]


# The grid cut into blocks -------------------------------------------------------------


@pytest.mark.parametrize("shape", [(1,), (7,), (100,), (5, 3), (2, 40), (3, 4, 5)])
@pytest.mark.parametrize("points", [1, 7, 16, 1000])
def test_blocks_part_the_grid(shape, points):
    grid = {f"a{i}": np.arange(float(n)) for i, n in enumerate(shape)}
    blocks = _blocks.Blocks(grid, points_a_block=points)
    number = np.full(shape, -1)
    for i in range(blocks.count):
        block = blocks.block(i)
        assert (number[block.region] == -1).all()
        number[block.region] = i
        assert block.chosen.sum() == blocks.sizes[i] == number[block.region].size
        first = np.flatnonzero(number.ravel() == i)
        assert (first == blocks.first(i) + np.arange(first.size)).all()
        # regions are chunks, so that two writers never share one
        starts = zip(block.region, blocks.chunk, strict=True)
        assert all(s.start % c == 0 and s.stop - s.start <= c for s, c in starts)
    assert (blocks.number(np.arange(number.size)) == number.ravel()).all()
    # a last axis longer than a block is cut; shorter ones are not
    assert blocks.sizes.max() <= max(2 * points, shape[-1] if points > 1 else 1)


def test_where_is_asked_a_block_at_a_time_and_must_judge_by_values(path, refuses):
    def chosen(x, y):
        return x >= 2 * y

    whole = sweep(where=chosen)
    assert same(sweep(where=chosen, store=path), whole)
    other = sweep(where=lambda x, y: (x < x.max()) & (y >= 0))
    assert other["sum"].notnull().sum() == 35
    refuses(
        lambda: sweep(where=lambda x, y: (x < x.max()) & (y >= 0), store=path),
        "`where`", "by its own values", "x = ",
    )  # fmt: skip
    refuses(
        lambda: sweep(where=lambda x, y: (x < -1) & (y < 0), store=path), "leaves none"
    )


# Storing and going on -----------------------------------------------------------------


def test_a_stored_sweep_is_the_one_in_memory(path):
    found = sweep(store=path)
    assert same(found, sweep())
    assert same(zj.open_sweep(path), found)
    assert {d.chunksizes == {} for d in found.data_vars.values()} == {True}
    assert found.attrs["points"] == found.attrs["points_done"] == 40
    assert found.attrs["blocks"] == found.attrs["blocks_done"] == 4
    with xr.open_zarr(path, consolidated=False, chunks=None) as plain:
        assert set(plain.data_vars) == set(found.data_vars)


def test_lanes_in_legs_and_their_outcomes_are_stored(path, tmp_path):
    run = functools.partial(
        zj.sweep, settled, q=Q, mu=MU, where=lambda q, mu: q * mu < 0.5, batch_size=8,
        progress=False,
    )  # fmt: skip
    whole = run()
    assert same(run(store=path, log=tmp_path / "log"), whole)
    assert zarr.open_group(path, mode="r")["outcome"].chunks == (3, 3)
    found = lines(tmp_path / "log")
    assert sum(line["points"] for line in found) == whole.attrs["points"]
    assert sum(line["steps"] for line in found) == whole.steps.sum()
    for code in OUTCOME:
        if code != OUTCOME.not_computed:
            counted = sum(line["outcomes"].get(code.name, 0) for line in found)
            assert counted == (whole.outcome == code).sum()
    for line in found:
        low, high = line["ranges"]["q"]
        part = whole.sel(q=slice(low, high))
        assert part.q.size == 3 and line["steps"] == part.steps.sum()


def test_an_interrupted_sweep_computes_only_what_is_missing(
    path, tmp_path, monkeypatch
):
    keep = _store.Store.keep

    def interrupted(self, block, *rest):
        if block.number == 2:
            raise KeyboardInterrupt
        keep(self, block, *rest)

    with monkeypatch.context() as patch:
        patch.setattr(_store.Store, "keep", interrupted)
        with pytest.raises(KeyboardInterrupt):
            sweep(store=path, threads=1)
    part = zj.open_sweep(path)
    assert (part.attrs["points_done"], part.attrs["blocks_done"]) == (20, 2)
    whole = sweep()
    done = whole["sum"].values[:4], part["sum"].values[:4]
    assert (done[0] == done[1]).all() and part["sum"][4:].isnull().all()
    found = sweep(store=path, log=tmp_path / "log")
    assert same(found, whole)
    assert sorted(line["block"] for line in lines(tmp_path / "log")) == [2, 3]
    assert same(sweep(store=path, log=tmp_path / "again"), whole)
    assert not (tmp_path / "again").exists()


def test_a_reader_sees_what_is_finished(path):
    seen = []

    class Watching(_store.Store):
        def keep(self, *block):
            super().keep(*block)
            seen.append(zj.open_sweep(path).load())

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_store, "Store", Watching)
        sweep(store=path, threads=1)
    counts = [int(ds["sum"].notnull().sum()) for ds in seen]
    assert counts == [ds.attrs["points_done"] for ds in seen] == [10, 20, 30, 40]


def test_codes_are_written_last(path):
    run = functools.partial(zj.sweep, settled, q=Q[:2], mu=MU, batch_size=8)
    run(store=path, progress=False)
    names = list(_store.Store(path).arrays)
    assert names[-1] == "outcome" and len(names) > 3


def test_two_sweeps_do_not_write_to_one_store(path, refuses):
    sweep(store=path)
    first = _store.Store(path)
    first.claim()
    refuses(lambda: sweep(store=path, resume="overwrite"), "`store`", "another sweep")
    first.release()
    assert same(sweep(store=path, resume="overwrite"), sweep())


# Which sweep a store belongs to -------------------------------------------------------


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
        monkeypatch.setitem(globals(), "FACTOR", 3.0000000001)
    elif change == "table":  # in place: neither its name nor its identity changes
        monkeypatch.setitem(globals(), "TABLE", TABLE.copy())
        sweep(store=path)
        TABLE[3] += 1e-12
    else:
        monkeypatch.setitem(globals(), "helper", lambda x: x + 1.0000001)
    refuses(lambda: sweep(store=path), "`store`", "another scene")


def test_a_table_that_changed_in_place_is_computed_with(path, monkeypatch):
    monkeypatch.setitem(globals(), "TABLE", TABLE.copy())
    before = sweep(store=path)["bent"].values
    TABLE[:] *= 2
    after = sweep(store=path, resume="overwrite")["bent"].values
    np.testing.assert_allclose(after, 2 * before, rtol=1e-15)


HASH = """
import sys
sys.path[:0] = {path!r}
import jax
import test_store
from ziegler_jax._fingerprint import scene_hash
print(scene_hash(test_store.point, ("x", "y"), True),
      scene_hash(test_store.settled, ("q", "mu"), True))
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
    assert same(after, many(store=tmp_path / "whole.zarr"))
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


# Faults -------------------------------------------------------------------------------


@pytest.mark.parametrize("written", ["sum", "marker"])
def test_a_full_disk_loses_nothing_and_names_the_block(path, monkeypatch, written):
    put, write = zarr.Array.__setitem__, _store._write
    full = {"now": False}

    def no_space(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def fill(array, region, values):
        full["now"] |= array.name == "/sum" and region[0].start == 4
        (no_space if full["now"] and written == "sum" else put)(array, region, values)

    def mark(at, content):
        (no_space if full["now"] and at.parent.name == "blocks" else write)(at, content)

    with monkeypatch.context() as patch:
        patch.setattr(zarr.Array, "__setitem__", fill)
        patch.setattr(_store, "_write", mark)
        with pytest.raises(OSError, match="No space left") as caught:
            sweep(store=path, threads=1)
    note = " ".join(caught.value.__notes__)
    assert "block 2" in note and "<= x <=" in note and str(path) in note
    assert zj.open_sweep(path).attrs["blocks_done"] == 2
    assert same(sweep(store=path), sweep())


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
            sweep(store=disk / "map.zarr", resume="overwrite")
        assert same(zj.open_sweep(disk / "map.zarr"), found)
    finally:
        subprocess.run(["umount", str(disk)], check=True)


def test_a_point_that_raises_for_one_batch_names_its_values(path, tmp_path):
    broken = {"at": 3.0}

    def check(x):
        if (np.asarray(x) > broken["at"]).any():
            raise RuntimeError("my own mistake")
        return np.asarray(x)

    def scene(x, y):
        like = jax.ShapeDtypeStruct((), x.dtype)
        checked = jax.pure_callback(check, like, x, vmap_method="expand_dims")
        return {"sum": checked + y}

    run = functools.partial(
        zj.sweep, scene, x=X, y=Y, batch_size=5, threads=1, progress=False
    )
    with pytest.raises(Exception, match="my own mistake") as caught:
        run(store=path)
    (note,) = caught.value.__notes__
    assert "3.42857142857142" in note and "<= x <=" in note and "<= y <=" in note
    assert zj.open_sweep(path).attrs["blocks_done"] == 3
    broken["at"] = 5.0  # a host callback is not seen: it is still the same sweep
    found = run(store=path, log=tmp_path / "log")
    assert [line["block"] for line in lines(tmp_path / "log")] == [3]
    assert (found["sum"].values == X[:, None] + Y).all()


KILLED = """
import sys
import numpy as np
import ziegler_jax as zj
from ziegler_jax import _blocks

_blocks.POINTS_A_BLOCK = 40

def point(x, y):
    return {"sum": x + y, "product": x * y, "half": x / 2}

print("ready", flush=True)
zj.sweep(point, x=np.linspace(0, 1, 300), y=np.linspace(1, 2, 20), batch_size=8,
         store=sys.argv[1], log=sys.argv[2], progress=False)
"""


def committed(path):
    try:
        return {n: m["seconds"] for n, m in _store.Store(path).marks().items()}
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
    """Three times in the middle of 150 blocks; `benchmarks/s0_store.py` has twenty."""
    rng = random.Random(3)
    arguments = ["-c", KILLED, str(path), str(tmp_path / "log")]
    kills, before = 0, {}
    for least in (1, 30, 60):
        kills += killed(arguments, rng.uniform(0, 0.03), path, least) != 0
        after = committed(path)
        assert before.items() <= after.items()  # none was written twice
        before = after
    assert kills >= 2 and 0 < len(before) < 150
    assert killed(arguments, 200.0, path, 0) == 0
    assert before.items() <= committed(path).items()
    blocks = [line["block"] for line in lines(tmp_path / "log")]
    assert len(set(blocks)) == len(blocks) >= 150 - kills
    found = zj.open_sweep(path)
    x, y = found.x.values[:, None], found.y.values
    assert found.attrs["blocks_done"] == 150
    assert (found["sum"].values == x + y).all()
    assert (found["product"].values == x * y).all()
    assert not list(path.rglob("*.partial"))


# Compiled programs on a disk ----------------------------------------------------------

CACHED = """
import sys
import jax, jax.numpy as jnp
import ziegler_jax as zj
from jax import monitoring
events = []
monitoring.register_event_listener(lambda name, **_: events.append(name))
print(zj.configure_cache(sys.argv[1]))
def point(q):
    return zj.settle(zj.uniform_rods(q), zj.State(omega=(0.0, 0.3)),
                     transient=5.0, window=5.0, max_windows=2)
zj.sweep(point, q=[1.0, 2.0], batch_size=2, progress=False)
print(sum(e.endswith("cache_hits") for e in events))
"""


def test_no_host_callback_keeps_a_program_from_the_disk():
    """JAX does not keep one that has them; diffrax checks `dt0` by one."""
    with jax.enable_x64(True):
        program = jax.make_jaxpr(lambda q: settled(q, 0.1).outcome)(2.0)
    assert "while" in str(program) and "callback" not in str(program)


@pytest.mark.slow
def test_a_second_process_starts_without_compiling(tmp_path):
    environment = {k: v for k, v in os.environ.items() if "CACHE" not in k}
    hits = []
    for _ in range(2):
        done = subprocess.run(
            [sys.executable, "-c", CACHED, str(tmp_path / "cache")],
            env=environment, capture_output=True, text=True, timeout=300,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        said, count = done.stdout.splitlines()
        assert str(tmp_path / "cache") in said
        hits.append(int(count))
    assert hits[0] == 0 and hits[1] >= 1
