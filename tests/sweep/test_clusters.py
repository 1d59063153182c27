"""Blocks as tasks of a Dask cluster on this machine, workers that die included."""

import os
import signal
import threading

import numpy as np
import pytest

import ziegler_jax as zj
from ziegler_jax.sweep import cluster, grid, store

distributed = pytest.importorskip("distributed")
pytestmark = pytest.mark.usefixtures("optimised")  # as the workers compile

X, Y = np.linspace(0.0, 4.0, 30), np.linspace(0.0, 1.0, 20)


def point(x, y):
    return {"sum": x + y, "product": x * y}


def slow(x, y):
    """Long enough for a worker to be killed in the middle."""
    start = zj.State(omega=(0.0, 0.1 + 0 * y))
    return zj.settle(
        zj.uniform_rods(1 + x / 4),
        start,
        windows=zj.Windows(transient=200.0, length=10.0),
        certify=False,
    )


def sweep(scene, **options):
    options = {"lanes": zj.Lanes(batch_size=8), **options}
    return zj.sweep(scene, x=X, y=Y, progress=False, **options)


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch):
    monkeypatch.setattr(grid, "POINTS_A_BLOCK", 40)


@pytest.fixture(scope="module")
def client():
    """Two worker processes of one thread each, without a dashboard."""
    cluster = distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0",
        host="127.0.0.1",
    )  # fmt: skip
    with cluster, distributed.Client(cluster) as client:
        yield client


def same(one, other):
    assert list(one.data_vars) == list(other.data_vars)
    for name in one.variables:
        assert one[name].values.tobytes() == other[name].values.tobytes(), name
    return True


def test_results_are_gathered_or_written_by_the_workers(client, tmp_path, told):
    whole = sweep(point)
    assert same(sweep(point, client=client, where=lambda x, y: x >= 0), whole)
    before = len(told())
    found = sweep(point, client=client, store=tmp_path / "a")
    assert same(found, whole)
    written = told()[before:]
    with pytest.MonkeyPatch.context() as patch:  # a large point is sent by itself
        patch.setattr(cluster, "SENT_WITH_A_TASK", 0)
        assert same(sweep(point, client=client), whole)
    assert found.attrs["blocks_done"] == found.attrs["blocks"] == 15
    assert sorted(line["block"] for line in written) == list(range(15))


def test_a_store_begun_by_threads_is_finished_by_a_cluster(
    client, tmp_path, told, monkeypatch
):
    keep = store.SweepStore.write_block

    def interrupted(self, block, *rest):
        if block.number == 5:
            raise KeyboardInterrupt
        keep(self, block, *rest)

    with monkeypatch.context() as patch:
        patch.setattr(store.SweepStore, "write_block", interrupted)
        with pytest.raises(KeyboardInterrupt):
            sweep(point, store=tmp_path / "a", lanes=zj.Lanes(8, 1))
    before = len(told())
    found = sweep(point, client=client, store=tmp_path / "a")
    written = told()[before:]
    assert same(found, sweep(point))
    assert sorted(line["block"] for line in written) == list(range(5, 15))


def test_what_a_point_raises_comes_from_the_worker_with_its_values(client):
    def scene(x, y):
        import jax

        def check(x):
            if (np.asarray(x) > 3.9).any():
                raise RuntimeError("my own mistake")
            return np.asarray(x)

        like = jax.ShapeDtypeStruct((), x.dtype)
        checked = jax.pure_callback(check, like, x, vmap_method="expand_dims")
        return {"sum": checked + y}

    with pytest.raises(Exception, match="my own mistake") as caught:
        sweep(scene, client=client)
    assert "x <= 4" in " ".join(caught.value.__notes__)
    assert same(sweep(point, client=client), sweep(point))


def test_a_client_that_is_closed_is_refused(client, refuses):
    other = distributed.Client(client.scheduler.address)
    other.close()
    refuses(lambda: sweep(point, client=other), "`client`", "closed", "connect")
    refuses(lambda: sweep(point, client=3), "`client`", "3")


def test_a_client_that_is_closed_on_the_way_says_what_is_safe(client, tmp_path):
    other = distributed.Client(client.scheduler.address)
    finished = zj.sweep.__globals__["Progress"].finished

    def close(self, *done):
        finished(self, *done)
        if other.status == "running":
            other.close()

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(zj.sweep.__globals__["Progress"], "finished", close)
        with pytest.raises(RuntimeError, match="was closed|was cancelled") as caught:
            sweep(point, client=other, store=tmp_path / "a")
    note = " ".join(caught.value.__notes__)
    assert "Of 15 blocks" in note and str(tmp_path / "a") in note
    assert same(sweep(point, client=client, store=tmp_path / "a"), sweep(point))


def test_a_point_that_cannot_be_sent_is_refused_with_a_cure(client, refuses):
    lock = threading.Lock()

    def scene(x, y):
        with lock:
            return {"sum": x + y}

    parts = "`point`", "sent to the workers", "made inside it"
    refuses(lambda: sweep(scene, client=client), *parts)


@pytest.mark.parametrize("stored", [False, True])
def test_a_worker_that_is_killed_loses_nothing(client, tmp_path, told, stored):
    whole = sweep(slow)
    assert same(sweep(slow, client=client), whole)  # both have compiled
    killed, before = [], len(told())
    advance = zj.sweep.__globals__["Progress"].advance

    def kill_one(self, *done):
        if not killed:
            worker = next(iter(client.run(os.getpid).values()))
            os.kill(worker, signal.SIGKILL)
            killed.append(worker)
        advance(self, *done)

    options = {"store": tmp_path / "a"} if stored else {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(zj.sweep.__globals__["Progress"], "advance", kill_one)
        found = sweep(slow, client=client, **options)
    assert killed and same(found, whole)
    blocks = [line["block"] for line in told()[before:]]
    assert sorted(blocks) == list(range(15))
