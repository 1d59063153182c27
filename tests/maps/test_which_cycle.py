"""Which cycle a cell has: against sheets that are known, and a map of two cycles."""

import numpy as np
import pytest
import xarray as xr

import ziegler_jax as zj

Q, KICK = np.linspace(1.0, 2.0, 81), np.linspace(0.0, 1.0, 70)


def sheets(q):
    """Period and amplitudes of two cycles; the second ends in a fold at q = 1.6."""
    left = np.sqrt(np.clip(1.6 - q, 0.0, None))
    first = 8.0 - 1.5 * (q - 1), 0.5 + 0.4 * (q - 1) ** 2, 0.9 - 0.5 * (q - 1)
    second = 8.1 - 0.5 * q, 0.9 + 0.25 * left, 0.3 + 0.2 * left
    return np.stack([first, second])


def drawn(seed=0, q=Q, kick=KICK):
    """A map of them: basins that a start decides, some cells at rest or undecided."""
    rng = np.random.default_rng(seed)
    at = np.broadcast_to(q[:, None], (q.size, kick.size))
    waves = np.sin(9 * at + 14 * kick + rng.uniform(0, 6))
    second = (waves + rng.normal(0, 0.6, at.shape) > 0.2) & (at < 1.6)
    rests = rng.random(at.shape) < 0.2
    numbers = np.where(second, sheets(at)[1], sheets(at)[0])
    numbers *= 1 + rng.uniform(-1e-5, 1e-5, numbers.shape)  # as certificates differ
    outcome = np.where(rests, zj.CODE.stuck, zj.CODE.cycle)
    return dataset(numbers, outcome, q=q, kick=kick), np.where(second, 2, 1) * ~rests


def dataset(numbers, outcome, **axes):
    numbers = np.where(outcome == zj.CODE.cycle, numbers, np.nan)
    dims = tuple(axes)
    return xr.Dataset(
        {
            "outcome": (dims, outcome),
            "period": (dims, numbers[0]),
            "joint_amplitude": (("joint", *dims), numbers[1:]),
        },
        coords={**axes, "joint": [1, 2]},
    )


def agree(label, hand):
    """One number for each cycle, and nothing where there is none."""
    pairs = {(int(a), int(b)) for a, b in zip(label.flat, hand.flat, strict=True)}
    return len(pairs) == len(dict(pairs)) == len({b for _, b in pairs})


@pytest.mark.parametrize("seed", range(4))
def test_two_cycles_keep_their_labels_through_basins_of_one_cell(seed):
    ds, hand = drawn(seed)
    found = zj.label_cycles(ds)
    assert (hand == 2).sum() > 800 and (hand == 1).sum() > 2000
    assert agree(found.cycle_label.values, hand)
    assert set(np.unique(found.cycle_label)) == {0, 1, 2}
    # whatever way the axes stand
    turned = zj.label_cycles(ds.isel(q=slice(None, None, -1)).transpose())
    assert (
        turned.cycle_label.transpose("q", "kick")
        .sortby("q")
        .equals(found.cycle_label.sortby("q"))
    )


def test_a_steep_cycle_stays_one_where_its_slopes_agree():
    """Ten per cent a cell, twice the jump; a step of as much is another cycle."""
    q = np.linspace(0.0, 1.0, 12)
    smooth = np.stack([np.exp(1.1 * q) * c for c in (8.0, 0.5, 0.4)])
    cycle = np.full(q.size, zj.CODE.cycle)
    one = zj.label_cycles(dataset(smooth, cycle, q=q)).cycle_label
    assert (one[1:-1] == 1).all() and (one[[0, -1]] > 1).all()  # one line alone
    apart = np.stack([np.where(q < 0.5, 1.0, 1.1) * c for c in (8.0, 0.5, 0.4)])
    two = zj.label_cycles(dataset(apart, cycle, q=q)).cycle_label
    assert two.values.tolist() == [1] * 6 + [2] * 6


def test_only_cells_within_reach_are_one_where_a_cycle_moves():
    q = np.arange(12.0)
    numbers = np.stack([8.0 + 0.01 * q, 0.5 + 0.001 * q, 0.4 + 0.001 * q])
    gap = np.where((q > 3) & (q < 7), zj.CODE.stuck, zj.CODE.cycle)
    ds = dataset(numbers, gap, q=q)
    assert zj.label_cycles(ds, reach=4).cycle_label.max() == 1
    label = zj.label_cycles(ds).cycle_label
    assert label.values.tolist() == [2] * 4 + [0] * 3 + [1] * 5
    # over starts it does not move, and distance is nothing
    still = dataset(numbers[:, :1].repeat(12, axis=1), gap, kick=q)
    assert zj.label_cycles(still, reach=1).cycle_label.max() == 1


def test_at_a_flip_another_label_begins():
    q = np.linspace(0.0, 1.0, 20)
    doubled = np.where(q > 0.5, 2.0, 1.0)
    numbers = np.stack([8.0 * doubled, 0.5 + 0.1 * q, 0.4 + 0.1 * q])
    cycle = np.full(q.size, zj.CODE.cycle)
    label = zj.label_cycles(dataset(numbers, cycle, q=q)).cycle_label
    assert label.values.tolist() == [1] * 10 + [2] * 10


def test_bad_datasets_are_named(refuses):
    ds, _ = drawn()
    refuses(lambda: zj.label_cycles(3), "`dataset`", "3")
    refuses(lambda: zj.label_cycles(ds.drop_vars("period")), "`period`", "`settle`")
    refuses(lambda: zj.label_cycles(ds.sel(joint=2)), "`dataset`", "both joints")
    refuses(lambda: zj.label_cycles(ds, jump=0.0), "`jump`", "0")
    refuses(lambda: zj.label_cycles(ds, reach=1.5), "`reach`", "1.5")
    refuses(lambda: zj.label_cycles(ds.drop_vars("q")), "`q`", "rise or fall")
    mixed = ds.assign_coords(q=ds.q.values[np.argsort(np.sin(9 * Q))])
    refuses(lambda: zj.label_cycles(mixed), "`q`", "rise or fall")


def folding(q):
    """Two cycles attract between q = 1.6247 and 1.6510 (see `test_branches`)."""
    law = zj.SmoothCoulomb(
        0.1, pin_radius=1.0, v_smooth=0.05, load=zj.ConstantLoad(1.0)
    )
    return zj.uniform_rods(q, friction=law, damping=zj.Viscous(0.002, 0.002))


def test_in_a_map_with_two_attracting_cycles_no_label_is_wrong():
    """By hand: joint 1 swings by more than 0.7 in one of them, by less in the other."""

    def point(q, kick):
        return zj.settle(folding(q), zj.State(omega=(0.0, kick)))

    axes = {"q": np.linspace(1.61, 1.69, 101), "kick": np.linspace(0.5, 2.7, 150)}
    ds = zj.label_cycles(zj.sweep(point, progress=False, **axes))
    large = ds.joint_amplitude.sel(joint=1).values > 0.7
    cycles = ds.outcome.values == zj.CODE.cycle
    # 7007 and 2051
    assert cycles.sum() > 5000 and (cycles & ~large).sum() > 1000
    assert agree(ds.cycle_label.values, np.where(large, 1, 2) * cycles)
    small = ds.q.values[(ds.cycle_label == 2).any("kick").values]
    assert 1.6247 < small.min() < small.max() < 1.6511
