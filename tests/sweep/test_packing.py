"""What a lane takes along comes out of its rows again, read whole or in part."""

from itertools import combinations

import jax
import numpy as np
import pytest

from ziegler_jax.sweep.packing import GAP, Packing

LEAVES = [
    *(np.full(s, x, d) for s, x, d in [((), 1, bool), ((2, 3), -7, np.int32)]),
    *(np.arange(n, n + n, dtype=np.float64) / 7 for n in (1, 9, 2, 5)),
    np.zeros((0,)),
    np.full((), 2**60 + 1, np.int64),
]
LANES = 4


def packed():
    """Leaves of some lanes, each lane's a multiple, and their rows."""
    lanes = [np.multiply.outer(x, np.arange(LANES)).astype(x.dtype) for x in LEAVES]
    packing = Packing(jax.ShapeDtypeStruct(x.shape, x.dtype) for x in LEAVES)
    with jax.enable_x64(True):
        rows = packing.pack(jax.tree.map(jax.numpy.asarray, lanes))
    return packing, lanes, [np.asarray(x) for x in rows]


def test_leaves_come_out_as_they_went_in():
    packing, lanes, rows = packed()
    for leaf, lane in zip(packing.unpack(rows), lanes, strict=True):
        assert leaf.dtype == lane.dtype
        np.testing.assert_array_equal(leaf, lane)


@pytest.mark.parametrize("count", [1, 2, 3, len(LEAVES)])
def test_any_leaves_are_read_from_their_own_rows(count):
    packing, lanes, rows = packed()
    for places in combinations(range(len(LEAVES)), count):
        runs = packing.runs(places)
        parts = [rows[which][run, 2] for which, run in runs]
        for i in places:
            leaf = packing.leaf(parts, i, runs)
            assert leaf.dtype == lanes[i].dtype
            np.testing.assert_array_equal(leaf, lanes[i][..., 2])
        beside = sum(x.size for x in parts) - sum(LEAVES[i].size for i in places)
        assert 0 <= beside <= GAP * (count - 1), (places, runs)
