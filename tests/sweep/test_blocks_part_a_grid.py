"""A grid is cut into blocks that part it, and `where` is asked about each."""

import numpy as np
import pytest
import xarray as xr
from stored import same, sweep

from ziegler_jax.sweep.grid import Grid

pytestmark = pytest.mark.usefixtures("small_blocks")


@pytest.mark.parametrize("shape", [(1,), (7,), (100,), (5, 3), (2, 40), (3, 4, 5)])
@pytest.mark.parametrize("points", [1, 7, 16, 1000])
def test_blocks_part_the_grid(shape, points):
    axes = {f"a{i}": np.arange(float(n)) for i, n in enumerate(shape)}
    blocks = Grid(xr.Dataset(coords=axes), points_a_block=points)
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


@pytest.mark.parametrize(
    ("points", "blocks"), [(1, 1), (400, 2), (4096, 16), (105_780, 16), (10**6, 61)]
)
def test_small_sweeps_are_kept_in_sixteenths_and_long_ones_in_blocks(
    points, blocks, monkeypatch
):
    """A part has 256 points at least and 16 384 at most."""
    monkeypatch.undo()  # of what makes blocks small in the tests beside
    axes = {"x": np.arange(float(points))}
    assert Grid(xr.Dataset(coords=axes)).count == blocks


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
