"""Stores from strangers, and ones that users worked on.

Nothing that a file says is run, and nothing is written outside of the store; what a
user added to it is read, if it is safe to read, and stays.
"""

import hashlib
import json
import os
import pickle
import shutil
import warnings

import numcodecs.pickles
import numpy as np
import pytest
import stored
import xarray as xr
import zarr
from stored import same, sweep

import ziegler_jax as zj
from ziegler_jax.sweep import grid, store

pytestmark = pytest.mark.usefixtures("small_blocks")


@pytest.fixture(scope="module")
def once(tmp_path_factory):
    """A store that is complete."""
    path = tmp_path_factory.mktemp("once") / "map.zarr"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(grid, "POINTS_A_BLOCK", 10)
        sweep(store=path, lanes=zj.Lanes(4, 1))
    return path


@pytest.fixture
def whole(once, path):
    """A copy of it."""
    return shutil.copytree(once, path)


@pytest.fixture(scope="module")
def truth():
    return sweep(lanes=zj.Lanes(4, 1))


@pytest.fixture
def quiet():
    """Zarr and xarray warn as users add to a store."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def contents(folder):
    """All files of a folder, links as what they are."""
    return {
        file: file.read_bytes()
        for file in sorted(folder.rglob("*"))
        if file.is_file() and file.name != "lock"
    }


def rewritten(path, change):
    """Let a stranger change what the store says of itself, with right checksums."""
    for name in store.RECORDS:
        file = path / store.RECORD / name
        record = store.read_record(file)
        change(record)
        text = json.dumps(record, sort_keys=True).encode()
        record = {"sha256": hashlib.sha256(text).hexdigest(), **record}
        file.write_text(json.dumps(record))


# Strangers ----------------------------------------------------------------------------


class Evil:
    """Unpickled, it leaves a trace."""

    trace = None

    def __reduce__(self):
        return os.mkdir, (str(self.trace),)


V2 = {
    "zarr_format": 2, "shape": [8], "chunks": [8], "dtype": "|O", "fill_value": "",
    "compressor": {"id": "pickle", "protocol": 5}, "order": "C",
    "filters": [{"id": "vlen-utf8"}],
}  # fmt: skip


@pytest.fixture
def trace(tmp_path, monkeypatch):
    """Where code of a store would leave a trace, if any of it ran."""
    monkeypatch.setattr(Evil, "trace", tmp_path / "ran")
    # as it was up to numcodecs 0.16.5, and with earlier Zarrs
    monkeypatch.setattr(numcodecs.pickles, "ALLOW_UNSAFE_PICKLE_DECODE", True)
    with zarr.config.set({"array.allow_unsafe_pickle_decode": True}):
        yield Evil.trace
    assert not Evil.trace.exists()


def pickled(folder):
    """An array whose chunk is a pickle."""
    folder.mkdir(exist_ok=True)
    (folder / ".zarray").write_text(json.dumps(V2))
    (folder / ".zattrs").write_text('{"_ARRAY_DIMENSIONS": ["x"]}')
    (folder / "0").write_bytes(pickle.dumps(Evil()))


def test_the_trap_is_one(trace, path, quiet):
    """Else nothing would be seen of a pickle that runs."""
    path.mkdir()
    (path / ".zgroup").write_text('{"zarr_format": 2}')
    pickled(path / "v")
    with pytest.raises(Exception):  # noqa: B017
        zarr.open_group(path, mode="r")["v"][...]
    assert trace.exists()
    trace.rmdir()


@pytest.mark.parametrize("records", ["as they were", "of a stranger"])
def test_no_pickle_of_the_sweeps_own_variables_is_read(
    whole, truth, trace, records, refuses
):
    for file in whole.rglob("zarr.json"):
        file.unlink()
    (whole / ".zgroup").write_text('{"zarr_format": 2}')
    for name in truth.variables:
        shutil.rmtree(whole / name / "c")
        pickled(whole / name)
    if records == "of a stranger":
        rewritten(whole, lambda record: record.update(metadata={}))
        refuses(lambda: zj.open_sweep(whole), "`store`", "describes no sweep's dataset")
        refuses(lambda: sweep(store=whole), "`store`")
        return
    refuses(lambda: zj.open_sweep(whole), "`store`", "x/c/0", "damaged")
    assert same(sweep(store=whole), truth)


def test_a_foreign_pickle_is_left_out_with_a_sentence(whole, truth, trace):
    pickled(whole / "mine")
    before = contents(whole / "mine")
    for read in (zj.open_sweep, lambda path: sweep(store=path)):
        with pytest.warns(UserWarning, match="'mine'.*left out.*no array of Zarr 3"):
            assert same(read(whole).load(), truth)
    assert contents(whole / "mine") == before


BYTES = {"name": "bytes", "configuration": {"endian": "little"}}


def shard(*codecs):
    inner = {"chunk_shape": [2], "codecs": [*codecs], "index_codecs": [BYTES]}
    return {"name": "sharding_indexed", "configuration": inner}


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"codecs": [BYTES, {"name": "numcodecs.pickle"}]}, "'numcodecs.pickle'"),
        ({"codecs": [shard(BYTES, {"name": "numcodecs.lz4"})]}, "'numcodecs.lz4'"),
        ({"codecs": ["os.system"]}, "'os.system'"),
        ({"codecs": 3}, "no array of Zarr 3"),
        ({"data_type": {"name": "pickle", "configuration": {}}}, "'pickle'"),
        ({"storage_transformers": [{"name": "x"}]}, "storage transformer"),
        ({"zarr_format": 2}, "no array of Zarr 3"),
        ({"node_type": "thing"}, "no array of Zarr 3"),
        ({"shape": [7]}, "beside the others"),
        ({"chunk_grid": {"name": "mine"}}, "beside the others"),
    ],
)
def test_a_foreign_variable_of_another_kind_is_left_out_with_a_sentence(
    whole, truth, change, named
):
    group = zarr.open_group(whole, mode="r+")
    group.create_array("mine", data=np.arange(8.0), dimension_names=["x"])
    file = whole / "mine" / "zarr.json"
    about = json.loads(file.read_text())
    assert zj.open_sweep(whole).mine.values.tolist() == list(range(8))
    file.write_text(json.dumps({**about, **change}))
    with pytest.warns(UserWarning, match=f"'mine'.*left out.*{named}"):
        assert same(zj.open_sweep(whole).load(), truth)


def test_what_never_ends_or_is_no_file_is_not_waited_for(whole, truth):
    """Pipes, devices, links, deep JSON, where files should be."""
    (whole / "mine").mkdir()
    os.mkfifo(whole / "mine" / "zarr.json")
    (whole / "deep").mkdir()
    (whole / "deep" / "zarr.json").write_text("[" * 100_000)
    for name in ("regime/c/1/0", f"{store.RECORD}/blocks/0"):
        (whole / name).unlink()
        os.mkfifo(whole / name)
    (whole / store.RECORD / "run.json").unlink()
    (whole / store.RECORD / "run.json").symlink_to("/dev/zero")
    with pytest.warns(UserWarning, match="damaged.*: 1[.]|'deep'.*left out"):
        assert zj.open_sweep(whole).attrs["blocks_done"] == 2
    with pytest.warns(UserWarning, match="'deep'.*left out"):
        assert same(sweep(store=whole), truth)


@pytest.fixture
def outside(tmp_path):
    """A folder beside the store, in which nothing may change."""
    folder = tmp_path / "outside"
    (folder / "c").mkdir(parents=True)
    (folder / "thesis.txt").write_text("years of work")
    before = contents(folder), sorted(folder.rglob("*"))
    yield folder
    assert (contents(folder), sorted(folder.rglob("*"))) == before


def lost(path):
    """A block and the copy of the record: there is something to write."""
    (path / store.RECORD / "blocks" / "1").unlink()
    (path / store.RECORD / store.RECORDS[1]).unlink()


@pytest.mark.parametrize(
    "file", ["../outside/file", "{outside}/file", "x/../../outside/file"]
)
@pytest.mark.parametrize("place", ["chunks", "metadata", "labels", "coords", "blocks"])
def test_nothing_that_a_record_names_is_written(
    whole, truth, outside, file, place, refuses
):
    name = file.format(outside=outside)

    def change(record):
        if place in ("coords", "data_vars"):
            about = record["metadata"]["coords"]["x"]
            record["metadata"][place][name] = about
        elif place != "blocks":
            record[place][name] = record["chunks"].get("x/c/0")

    def sets_marks():
        mark = whole / store.RECORD / "blocks" / "2"
        record = store.read_record(mark)
        record["chunks"][name] = [1, 2, 3]
        store.write_record(mark, record, mark.parents[1] / "parts")

    rewritten(whole, change)
    sets_marks()
    lost(whole)
    if place in ("coords", "labels"):
        refuses(lambda: sweep(store=whole), "`store`", str(whole))
    else:
        assert same(sweep(store=whole), truth)


@pytest.mark.parametrize(
    "link", ["sum", "sum/c", "sum/c/2", "x", f"{store.RECORD}/parts", store.RECORD]
)
def test_no_link_leads_what_is_written_or_deleted_out_of_a_store(
    whole, outside, link, refuses
):
    lost(whole)
    (whole / store.RECORD / "blocks" / "2").unlink()
    shutil.rmtree(whole / link)
    if link == store.RECORD:
        shutil.copytree(whole / "sum", whole.parent / "record")  # not ours to write to
        (whole.parent / "record" / "sweep.json").write_text("{}")
    target = whole.parent / "record" if link == store.RECORD else outside
    (whole / link).symlink_to(target)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of damaged blocks
        refuses(lambda: sweep(store=whole), "`store`")
        if link == store.RECORD:
            return
        refuses(lambda: sweep(store=whole), "links", link.split("/")[0])


def test_a_lock_that_is_a_link_makes_no_file(whole, outside, refuses):
    lost(whole)
    (whole / store.RECORD / "lock").unlink()
    (whole / store.RECORD / "lock").symlink_to(outside / "made")
    refuses(lambda: sweep(store=whole), "`store`", "links", "lock")
    refuses(lambda: sweep(store=zj.Store(whole, overwrite=True)), "links", "lock")


def test_a_record_that_asks_for_other_shapes_is_refused(whole, refuses):
    for change in (
        lambda record: record["metadata"]["data_vars"]["sum"].update(shape=[8, 9]),
        lambda record: record.update(chunk=[3, 5]),
        lambda record: record["metadata"]["data_vars"]["sum"].update(dtype="<U9"),
        lambda record: record["metadata"]["data_vars"]["sum"].update(dtype="O"),
        lambda record: record.update(identity=None),
        lambda record: record.update(labels=[]),
    ):
        files = contents(whole / store.RECORD)
        rewritten(whole, change)
        refuses(lambda: sweep(store=whole), "`store`", str(whole))
        for file, text in files.items():
            file.write_bytes(text)


# Worked on ----------------------------------------------------------------------------


def consolidated(path):
    zarr.consolidate_metadata(path)


def appended(path):
    ds = zj.open_sweep(path)
    ds["mine"] = ds["sum"].mean("y")
    ds.to_zarr(path, mode="a", zarr_format=3)


def appended_alone(path):
    labels = {"z": [1, 2, 3], "label": ("x", list("abcdefgh"))}
    ds = xr.Dataset({"mine": (("x", "z"), np.ones((8, 3)))}, labels, {"note": "mine"})
    ds.to_zarr(path, mode="a", zarr_format=3)


def appended_and_consolidated(path):
    ds = xr.Dataset({"mine": ("x", np.arange(8))})
    ds.to_zarr(path, mode="a", zarr_format=3, consolidated=True)


def annotated(path):
    zarr.open_group(path, mode="r+").attrs["note"] = "mine"
    zarr.open_array(path / "sum", mode="r+").attrs["note"] = "mine"
    (path / "notes.txt").write_text("mine")


WORK = consolidated, appended, appended_alone, appended_and_consolidated, annotated


@pytest.mark.parametrize("work", WORK)
@pytest.mark.parametrize("unfinished", [False, True], ids=["finished", "unfinished"])
def test_a_store_that_a_user_worked_on_opens_goes_on_and_keeps_the_work(
    whole, truth, work, unfinished, quiet
):
    if unfinished:
        lost(whole)
    own, attributes = contents(whole), dict(zarr.open_group(whole, mode="r").attrs)
    work(whole)
    there = contents(whole)
    work_done = {f: t for f, t in there.items() if own.get(f) != t}
    assert work_done
    found = zj.open_sweep(whole)
    assert found.attrs["points_done"] == (30 if unfinished else 40)
    mine = [name for name in found.variables if name not in truth.variables]
    assert bool(mine) == (work not in (consolidated, annotated))
    done = sweep(store=whole)
    assert same(done.drop_vars(mine), truth)
    after = contents(whole)
    changed = {f for f, t in work_done.items() if after.get(f) != t}
    # but for the sweep's own attributes, where xarray replaced them by the user's
    assert changed <= {whole / "zarr.json"}
    root = zarr.open_group(whole, mode="r", use_consolidated=False)
    assert attributes.items() <= root.attrs.asdict().items()
    if "note" in there[whole / "zarr.json"].decode():
        assert root.attrs["note"] == "mine"
    if "consolidated_metadata" in there[whole / "zarr.json"].decode():
        assert (
            root.metadata.consolidated_metadata
            or "consolidated" in (whole / "zarr.json").read_text()
        )
    plain = xr.open_zarr(whole, chunks=None)
    assert set(mine) | set(truth.variables) == set(plain.variables)
    assert (plain["sum"].values == truth["sum"].values).all()
    for name in mine:
        np.testing.assert_array_equal(done[name].values, plain[name].values)


def test_numbers_of_another_sweep_are_not_handed_out(whole, truth, monkeypatch):
    """As after `rsync` of two runs into one folder."""
    other = whole.parent / "other.zarr"
    with monkeypatch.context() as patch:
        patch.setattr(stored, "FACTOR", 4.0)
        sweep(store=other, lanes=zj.Lanes(4, 1))
    shutil.copytree(other / "sum", whole / "sum", dirs_exist_ok=True)
    with pytest.warns(UserWarning, match="damaged.*not computed: 0, 1, 2, 3"):
        found = zj.open_sweep(whole)
    assert found.attrs["points_done"] == 0 and (found.regime == 0).all()
    assert found["sum"].isnull().all() and found["bent"].isnull().all()
    assert same(sweep(store=whole), truth)


def test_what_changed_since_it_was_opened_raises_and_gives_no_number(whole, truth):
    found = zj.open_sweep(whole)
    shutil.copy(whole / "sum" / "c" / "1" / "0", whole / "sum" / "c" / "0" / "0")
    (whole / "bent" / "c" / "2" / "0").unlink()
    for name in ("sum", "bent"):
        with pytest.raises(ValueError, match="checksum"):
            found[name].values  # noqa: B018
    assert (found["sum"][2:].values == truth["sum"][2:].values).all()
    assert same(sweep(store=whole), truth)


def test_a_dataset_of_a_store_goes_to_another_process(whole, truth):
    found = pickle.loads(pickle.dumps(zj.open_sweep(whole)))
    assert same(found, truth)


@pytest.mark.parametrize("layout, version", [(2, "0.2"), (3, "3"), (99, "99")])
def test_a_store_of_another_version_is_refused_with_what_to_do(
    whole, truth, layout, version, refuses
):
    rewritten(whole, lambda record: record.update(layout=layout))
    parts = "`store`", "another version", version, "anew", "xarray.open_zarr"
    refuses(lambda: zj.open_sweep(whole), *parts, "overwrite=True")
    refuses(lambda: sweep(store=whole), *parts, "overwrite=True")
    with xr.open_zarr(whole, consolidated=False, chunks=None) as plain:
        assert (plain["sum"].values == truth["sum"].values).all()
    assert same(sweep(store=zj.Store(whole, overwrite=True)), truth)
