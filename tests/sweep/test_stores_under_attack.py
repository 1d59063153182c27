"""Stores under attack: no committed number is lost, and no wrong one is ever read.

A few attacks of each kind are in the first tier. All of them, every file operation,
500 flipped bits, 100 cut and 100 deleted files, 60 races, are in the second:

    python -m pytest -m '' tests/sweep/test_stores_under_attack.py
"""

import multiprocessing
import os
import shutil
import tempfile
import warnings

import numpy as np
import pytest
import xarray as xr
from faults import Killed, cut, flip, stopped_before
from stored import X, Y, same, sweep

import ziegler_jax as zj
from ziegler_jax.sweep import grid, store

pytestmark = [
    pytest.mark.usefixtures("small_blocks", "no_waiting_for_the_disk"),
    # a killed process awaits nothing more
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]


@pytest.fixture
def no_waiting_for_the_disk(monkeypatch):
    """No attack here takes the power away, and waiting is most of the time."""
    monkeypatch.setattr(os, "fsync", lambda _: None)


@pytest.fixture(scope="module")
def truth():
    return sweep(lanes=zj.Lanes(4, 1))


@pytest.fixture
def whole(tmp_path):
    """A store that is complete, and one in which a block is missing."""
    sweep(store=tmp_path / "whole.zarr", lanes=zj.Lanes(4, 1))
    return tmp_path / "whole.zarr"


def right_or_missing(found, truth):
    """Whether every number that can be read is the right one; damage may raise."""
    for name in truth.variables:
        if name not in found.variables:
            continue  # a label that only the record holds
        try:
            values = np.asarray(found[name].values, float)
        except Exception:  # Zarr's, of many kinds
            continue
        missing = values == 0 if name == "regime" else np.isnan(values)
        if not (missing | (values == truth[name].values.astype(float))).all():
            return False
    return True


def reads_right(path, truth):
    """By the package's reader and by Zarr's own."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of damaged blocks
        try:
            assert right_or_missing(zj.open_sweep(path), truth)
        except ValueError as refusal:
            assert "`store`" in str(refusal)
        try:
            plain = xr.open_zarr(path, consolidated=False, chunks=None)
        except Exception:  # Zarr's and xarray's
            return
        assert right_or_missing(plain, truth)


# Stopped ------------------------------------------------------------------------------


def stop_and_go_on(folder, truth, operation):
    """Die before an operation, look at what is left, and start again."""
    folder.mkdir()
    path = folder / "map.zarr"
    with stopped_before(operation, folder), pytest.raises(Killed):
        sweep(store=path, lanes=zj.Lanes(4, 1))
    if path.exists():
        before = zj.open_sweep(path)
        done = before.attrs["blocks_done"]
        assert before["sum"].notnull().sum() >= 10 * done
        reads_right(path, truth)
    assert same(sweep(store=path, lanes=zj.Lanes(4, 1)), truth)
    assert [left.name for left in folder.iterdir()] == ["map.zarr"]
    shutil.rmtree(folder)


@pytest.fixture
def cleared_at_once(monkeypatch):
    """What a killed process left beside a store is nobody's at once."""
    monkeypatch.setattr(store, "ABANDONED", 0.0)


def operations(folder):
    folder.mkdir()
    with stopped_before(None, folder) as watch:
        sweep(store=folder / "map.zarr", lanes=zj.Lanes(4, 1))
    return watch.count


@pytest.mark.parametrize("some", [8, None], ids=["some", "all"])
def test_a_sweep_stopped_before_a_file_operation_goes_on(
    tmp_path, truth, some, cleared_at_once
):
    count = operations(tmp_path / "count")
    assert count > 50  # else they are not seen; measured 239
    for operation in range(1, count + 1, 1 if some is None else count // some):
        stop_and_go_on(tmp_path / str(operation), truth, operation)


def test_an_overwriting_sweep_stopped_on_the_way_leaves_the_old_one_or_none(
    tmp_path, truth
):
    """Some operations of the replacement; the computing is tried above."""
    path = tmp_path / "map.zarr"
    for operation in (1, 3, 5, 8, 12, 20, 40, 100):
        sweep(store=zj.Store(path, overwrite=path.exists()), x=X[:5])
        with stopped_before(operation, tmp_path), pytest.raises(Killed):
            sweep(store=zj.Store(path, overwrite=True), lanes=zj.Lanes(4, 1))
        if path.exists():
            left = zj.open_sweep(path)
            assert left.x.size == 5 or right_or_missing(left, truth)
        assert same(sweep(store=zj.Store(path, overwrite=True)), truth)


# Damaged ------------------------------------------------------------------------------


def files(path):
    """All but the lock, which holds nothing."""
    found = sorted(p for p in path.rglob("*") if p.is_file() and p.name != "lock")
    kinds = {"sweep.json", "sweep.copy.json", "run.json", "zarr.json"}
    assert kinds <= {p.name for p in found}
    assert {p.parent.name for p in found} >= {"blocks", "c"}
    return found


def mended(path, truth):
    """What the same sweep makes of it: a second one has nothing to do."""
    found = sweep(store=path, lanes=zj.Lanes(4, 1))
    assert same(found, truth) and same(zj.open_sweep(path), truth)
    again = store.SweepStore(path)
    blocks = grid.Grid(xr.Dataset(coords={"x": X, "y": Y}))
    assert again.missing(blocks) == {} and again.damaged() == []


def damage(whole, truth, attack, times):
    """Attack one file after the other, each time a complete store."""
    rng = np.random.default_rng(7)
    run = (whole / "sweep-record" / "run.json").read_bytes()
    order = rng.permutation(len(files(whole)))
    for number in range(times):
        attack(files(whole)[order[number % order.size]], rng)
        reads_right(whole, truth)
        mended(whole, truth)
        # what a run cost is not known again
        (whole / "sweep-record" / "run.json").write_bytes(run)


def flipped(path, rng):
    flip(path, int(rng.integers(8 * path.stat().st_size)))


def truncated(path, rng):
    cut(path, int(rng.integers(path.stat().st_size)))


def deleted(path, rng):
    path.unlink()


@pytest.mark.parametrize(
    "attack, times",
    [
        pytest.param(attack, times, id=f"{draw}-{attack.__name__}")
        for draw, attacks in {
            "some": [(flipped, 20), (truncated, 8), (deleted, 8)],
            "all": [(flipped, 500), (truncated, 100), (deleted, 100)],
        }.items()
        for attack, times in attacks
    ],
)
def test_any_file_may_be_damaged(whole, truth, attack, times):
    damage(whole, truth, attack, times)


def test_both_copies_of_the_record_damaged_are_refused_and_replaced(
    whole, truth, refuses
):
    for name in ("sweep.json", "sweep.copy.json"):
        (whole / "sweep-record" / name).write_bytes(b"")
    parts = "`store`", "sweep.copy.json", "damaged", "overwrite=True"
    refuses(lambda: zj.open_sweep(whole), *parts)
    refuses(lambda: sweep(store=whole), *parts)
    assert same(sweep(store=zj.Store(whole, overwrite=True)), truth)


def test_a_damaged_block_is_told_and_one_that_is_short_does_not_count(whole, truth):
    chunk = whole / "sum" / "c" / "2" / "0"
    cut(chunk, 10)
    with pytest.warns(UserWarning, match="damaged.*: 2[.]"):
        found = zj.open_sweep(whole)
    assert found.attrs["blocks_done"] == 3 and found.attrs["points_done"] == 30
    for name in truth.data_vars:  # also of a number that is undamaged
        reads = found[name][4:6] == 0 if name == "regime" else found[name][4:6].isnull()
        assert reads.all() and (found[name][:4] == truth[name][:4]).all()
    assert same(sweep(store=whole), truth)


def test_a_block_in_anothers_place_is_seen(whole, truth):
    """Its own checksum is right: the marker's is not."""
    shutil.copy(whole / "sum" / "c" / "1" / "0", whole / "sum" / "c" / "0" / "0")
    with pytest.warns(UserWarning, match="damaged.*: 0[.]"):
        assert zj.open_sweep(whole).attrs["blocks_done"] == 3
    assert same(sweep(store=whole), truth)


@pytest.mark.parametrize(
    "file",
    [
        "sum/c/1/0", "sum/zarr.json", "zarr.json", "x/c/0", "sweep-record/sweep.json",
        "sweep-record/run.json", "sweep-record/blocks/1", "sweep-record/parts/mine",
    ],
)  # fmt: skip
def test_a_folder_where_a_file_should_be_is_damage(whole, truth, file):
    (whole / file).unlink(missing_ok=True)
    (whole / file).mkdir()
    reads_right(whole, truth)
    mended(whole, truth)


def test_folders_that_a_copy_left_out_are_made_again(whole, truth):
    for name in ("parts", "blocks"):
        shutil.rmtree(whole / "sweep-record" / name)
    assert zj.open_sweep(whole).attrs["blocks_done"] == 0
    assert same(sweep(store=whole), truth)


def test_a_sweep_that_stops_before_it_computes_gives_the_lock_back(
    path, truth, monkeypatch
):
    with monkeypatch.context() as patch:
        patch.setattr(store.SweepStore, "missing", lambda *_: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            sweep(store=path)
    assert same(sweep(store=path), truth)


def test_a_stray_marker_does_not_count(whole):
    blocks = whole / "sweep-record" / "blocks"
    shutil.copy(blocks / "1", blocks / "77")
    (blocks / "notes.txt").write_text("mine")
    (blocks / "²").write_text("{}")
    found = zj.open_sweep(whole)
    assert (found.attrs["points_done"], found.attrs["blocks_done"]) == (40, 4)


# Two at once --------------------------------------------------------------------------


def race(folder, place, barrier, results, times):
    """Begin store after store at the same moment as the other process.

    Each with a folder of its own for temporary files, as containers have that share one
    for stores.
    """
    os.environ["TMPDIR"] = str(place)
    tempfile.tempdir = None
    assert tempfile.gettempdir() == str(place)
    race_sweep()  # compiled
    for number in range(times):
        barrier.wait(60)
        try:
            found = zj.sweep(
                both,
                x=RACE_X,
                y=RACE_Y,
                store=f"{folder}/{number}.zarr",
                progress=False,
            )
            results.put((number, bool((found["sum"].values == RACE_SUM).all())))
        except Exception as error:
            results.put((number, f"{type(error).__name__}: {error}"))


def both(x, y):
    return {"sum": x + y}


def race_sweep(**options):
    return zj.sweep(both, x=RACE_X, y=RACE_Y, progress=False, **options)


RACE_X, RACE_Y = np.linspace(0, 1, 12), np.linspace(1, 2, 5)
RACE_SUM = RACE_X[:, None] + RACE_Y


def test_of_two_that_begin_a_store_at_once_one_makes_it(tmp_path, tmp_path_factory):
    times = 60
    context = multiprocessing.get_context("spawn")
    barrier, results = context.Barrier(2), context.Queue()
    places = [tmp_path_factory.mktemp("temporary") for _ in range(2)]
    processes = [
        context.Process(target=race, args=(tmp_path, place, barrier, results, times))
        for place in places
    ]
    for process in processes:
        process.start()
    ends = [results.get(timeout=120) for _ in range(2 * times)]
    for process in processes:
        process.join(60)
    lost = [end for _, end in ends if end is not True]
    for number in range(times):
        mine = [end for n, end in ends if n == number]
        assert True in mine, mine
        found = zj.open_sweep(tmp_path / f"{number}.zarr")
        assert (found["sum"].values == RACE_SUM).all()
        assert (found.x.values == RACE_X).all() and (found.y.values == RACE_Y).all()
    for end in lost:
        assert end.startswith("ValueError: Argument `store` must not be written to"), (
            end
        )
    assert len(list(tmp_path.iterdir())) == times  # nothing is left beside them
