"""The union of sweeps."""

import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from stored import Opposite

import ziegler_jax as zj
from ziegler_jax.results import REGIMES


def point(x, y):
    code = jnp.where(x > y, int(zj.CODE.flutter), int(zj.CODE.stable))
    return {
        "z": x + 10 * y,
        "regime": zj.Variable(code.astype(jnp.int8), "regime", codes=REGIMES),
        "both": zj.Variable(jnp.stack([x, y]), "both", dims=("rod",)),
    }


def sweep(x, y, **options):
    return zj.sweep(point, x=x, y=y, progress=False, **options)


def of_values(ds):
    return {name: (v.dims, v.values.tolist()) for name, v in ds.variables.items()}


def test_longer_and_finer_axes_are_those_of_one_sweep():
    left = sweep([0.0, 1.0, 2.0], [1.0, 3.0])
    right = sweep([2.0, 1.5, 4.0], [1.0, 3.0])
    merged = zj.merge(left, right)
    whole = sweep([0.0, 1.0, 1.5, 2.0, 4.0], [1.0, 3.0])
    assert of_values(merged) == of_values(whole)
    assert merged.regime.dtype == np.int8
    assert merged.regime.attrs == whole.regime.attrs
    assert merged.attrs["points"] == 12
    assert merged.attrs["scene"] == whole.attrs["scene"]


def test_points_that_nobody_computed_have_no_number_and_no_code():
    corner = zj.merge(sweep([0.0], [1.0]), sweep([2.0], [3.0]))
    assert np.isnan(corner.z.sel(x=0.0, y=3.0))
    assert corner.regime.sel(x=2.0, y=1.0) == zj.CODE.not_computed
    assert corner.z.sel(x=2.0, y=3.0) == 32.0


def test_what_one_left_out_the_other_fills_in():
    x, y = np.arange(4.0), np.arange(3.0)
    parts = [
        sweep(x, y, where=lambda x, y: x < y),
        sweep(x, y, where=lambda x, y: x >= y),
    ]
    assert of_values(zj.merge(*parts)) == of_values(sweep(x, y))


def test_numbers_keep_their_types():
    """Whole numbers that float64 does not hold as well."""
    parts = [
        sweep([float(i)], [1.0]).assign(
            count=("x", [2**53 + 1 + i]), is_last=("x", [i == 1])
        )
        for i in range(2)
    ]
    whole = zj.merge(*parts)
    assert whole.is_last.dtype == bool
    assert whole["count"].values.tolist() == [2**53 + 1, 2**53 + 2]


def test_xarrays_own_tools_join_sweeps_without_losing_codes():
    left, right = sweep([0.0, 1.0], [1.0, 3.0]), sweep([2.0, 4.0], [1.0, 3.0])
    whole = zj.merge(left, right)
    for joined in (
        xr.concat([left, right], "x"),
        xr.combine_by_coords([left, right], combine_attrs="drop_conflicts"),
    ):
        assert joined.regime.dtype == np.int8
        assert joined[list(whole.data_vars)].equals(whole)


def other_scene(ds):
    return ds.assign_attrs(scene_digest="5eed")


def without_digest(ds):
    ds = ds.copy()
    ds.attrs = {}
    return ds


def with_host_callbacks(ds):
    return ds.assign_attrs(scene_digest="none")


def in_unit(ds, unit):
    return ds.assign(z=ds.z.assign_attrs(units=unit))


@pytest.mark.parametrize(
    "change, words",
    [
        (other_scene, ("`sweeps[1]`", "`scene_digest`", "5eed", "another program")),
        (with_host_callbacks, ("`sweeps[1]`", "host callbacks", "xarray")),
        (without_digest, ("`sweeps[1]`", "no attribute `scene_digest`")),
        (lambda ds: ds.assign_attrs(jax_version="9.9"), ("9.9", 'versions="any"')),
        (lambda ds: ds.rename(x="w"), ("axes", "'w'")),
        (lambda ds: ds.drop_vars("z"), ("holds", "'z'")),
        (lambda ds: ds.assign(z=ds.z + 1), ("`z`", "x = 1", "agree")),
        (lambda ds: ds.assign_coords(w=("x", [1.0])), ("`w`", "xr.concat")),
        (
            lambda ds: ds.assign_coords(x=("x", [1.0], {"units": "m"})),
            ("`units`", "`x`", "'m'", "'1'"),
        ),
        (lambda ds: in_unit(ds, "mm"), ("`units`", "`z`", "'mm'", "'1'")),
        (lambda ds: ds.assign_coords(c=1.0), ("labels", "'c'")),
        (lambda ds: 3, ("`sweeps[1]`", "3")),
    ],
)
def test_what_is_not_of_one_scene_is_refused(change, words):
    ds = sweep([0.0, 1.0], [0.0, 2.0])
    part = ds.isel(x=[1])
    with pytest.raises(ValueError) as error:
        zj.merge(ds, change(part))
    assert all(word in str(error.value) for word in words), error.value


def test_a_coordinate_assigned_anew_and_axes_in_another_order_are_joined():
    ds = sweep([0.0, 1.0], [0.0, 2.0])
    left, right = ds.isel(x=[0]), ds.isel(x=[1])
    other = right.assign_coords(x=right.x.values).transpose()
    assert zj.merge(left, other).identical(zj.merge(left, right))


def test_a_number_that_both_are_at_stays_and_another_is_refused():
    ds = sweep([0.0, 1.0], [0.0, 2.0])
    left, right = ds.isel(x=[0]).assign_coords(c=1.0), ds.isel(x=[1])
    assert zj.merge(left, right.assign_coords(c=1.0)).c == 1.0
    with pytest.raises(ValueError, match="its `c` is"):
        zj.merge(left, right.assign_coords(c=2.0))


def made_by(factor):
    """Points of one factory have one source, and numbers of their own in it."""

    def made(x, y):
        return {"z": factor * x + y}

    return made


def test_points_of_one_factory_are_two_scenes_unless_their_numbers_are_one():
    sweeps = [
        zj.sweep(made_by(jnp.asarray(factor)), x=[x], y=[1.0], progress=False)
        for factor, x in ((2.0, 0.0), (3.0, 1.0), (2.0, 4.0))
    ]
    assert sweeps[0].attrs["scene"] == sweeps[1].attrs["scene"]
    with pytest.raises(ValueError, match="`scene_digest`"):
        zj.merge(*sweeps[:2])
    assert zj.merge(sweeps[0], sweeps[2]).z.values.tolist() == [[1.0], [9.0]]


def test_one_scene_is_known_whatever_order_its_axes_and_results_stand_in():
    def turned(y, x):
        return dict(reversed(point(x, y).items()))

    one = sweep([0.0, 1.0], [1.0])
    other = zj.sweep(turned, y=[3.0], x=[0.0, 1.0], progress=False)
    other = other.transpose("x", "y", "rod")
    swapped = zj.sweep(lambda x, y: point(y, x), x=[0.0], y=[3.0], progress=False)
    assert zj.merge(one, other).z.values.tolist() == [[10.0, 30.0], [11.0, 31.0]]
    with pytest.raises(ValueError, match="`scene_digest`"):
        zj.merge(one, swapped)


def test_sweeps_of_two_versions_merge_by_consent():
    one, other = sweep([0.0], [1.0]), sweep([1.0], [1.0])
    newer = other.assign_attrs(jax_version="9.9", scene_digest="5eed")
    with pytest.raises(ValueError, match="jax_version.*9.9.*versions="):
        zj.merge(one, newer)
    with pytest.raises(ValueError, match="`versions`.*'all'"):
        zj.merge(one, newer, versions="all")
    both = zj.merge(one, newer, versions="any")
    assert both.z.values.tolist() == [[10.0], [11.0]]
    for key in ("jax_version", "scene_digest"):
        assert both.attrs[key] == f"{one.attrs[key]}, {newer.attrs[key]}"
    # consent is to versions: of one version the digest still speaks
    with pytest.raises(ValueError, match="`scene_digest`"):
        zj.merge(one, other_scene(other), versions="any")
    # and numbers that meet are compared
    with pytest.raises(ValueError, match="agree where they meet"):
        moved = newer.assign_coords(x=("x", [0.0], newer.x.attrs))
        zj.merge(one, moved, versions="any")


def test_consent_to_versions_lets_no_other_scene_in():
    """Any two of one version are compared, also behind one of another version."""
    one, two, three = (sweep([x], [1.0]) for x in (0.0, 1.0, 2.0))
    old = one.assign_attrs(jax_version="0.1", scene_digest="5eed")
    with pytest.raises(ValueError, match=r"`sweeps\[2\]`.*`sweeps\[1\]`.*`scene_d"):
        zj.merge(old, two, other_scene(three), versions="any")
    both = zj.merge(old, two, versions="any")  # which still knows whose is which
    with pytest.raises(ValueError, match="`scene_digest`"):
        zj.merge(both, three.assign_attrs(scene_digest="5eed"), versions="any")
    assert zj.merge(both, three).z.values.tolist() == [[10.0], [11.0], [12.0]]


@pytest.mark.parametrize("place", [0, 1])
def test_consent_to_versions_is_none_to_scenes_that_are_not_known(place):
    sweeps = [sweep([0.0], [1.0]), sweep([1.0], [1.0])]
    sweeps[place] = sweeps[place].assign_attrs(jax_version="9", scene_digest="none")
    with pytest.raises(ValueError, match=rf"`sweeps\[{place}\]`.*host callbacks"):
        zj.merge(*sweeps, versions="any")


def test_codes_of_two_meanings_are_two_scenes_to_merge():
    def turned(x, y):
        found = point(x, y)
        return {**found, "regime": found["regime"]._replace(codes=tuple(Opposite))}

    one = sweep([0.0], [1.0])
    other = zj.sweep(turned, x=[1.0], y=[1.0], progress=False)
    assert one.attrs["scene_digest"] == other.attrs["scene_digest"]
    with pytest.raises(ValueError, match=r"`sweeps\[1\]`.*`flag_.*`regime`"):
        zj.merge(one, other)


def test_sweeps_in_si_units_of_two_scales_are_refused_and_the_scale_stays():
    def turning(v):
        return {"w": zj.Variable(2.0 * v, "torque", "k")}

    parts = [zj.sweep(turning, v=[v], progress=False) for v in (0.0, 1.0)]
    units = [zj.SI(m=1.0, l=1.0, k=k) for k in (10.0, 1000.0)]
    with pytest.raises(ValueError, match="`si_unit`.*`w`.*1000.0.*10.0"):
        zj.merge(*(unit.restore(ds) for unit, ds in zip(units, parts, strict=True)))
    whole = zj.merge(*(units[0].restore(ds) for ds in parts))
    assert whole.w.attrs == units[0].restore(parts[0]).w.attrs
    assert whole.w.attrs["si_unit"] == 10.0


def test_axes_that_differ_by_rounding_are_one():
    """Of np.arange and np.linspace three of five values differ, by up to 4.4e-16."""
    a, b = np.arange(1.0, 1.5, 0.1), np.linspace(1.0, 1.4, 5)
    assert 0 < np.abs(a - b).max() < 1e-15
    for first, second in ((a, b), (b, a)):
        one, two = sweep(first, [0.5, 1.0]), sweep(second, [2.0, 3.0])
        whole = zj.merge(one, two)
        assert whole.x.values.tolist() == first.tolist()
        assert not np.isnan(whole.z).any()
    # where both have a cell the first dataset's stays
    one, two = sweep(a, [1.0]), sweep(b, [1.0])
    whole = zj.merge(one, two)
    assert whole.z.values.tobytes() == one.z.values.tobytes()
    assert (whole.both.values != two.both.values).any()


@pytest.mark.parametrize(
    "one, other, together",
    [
        ([0.0, 1.0], [0.9e-9, 1.0], 2),  # of the gap beside them, 1
        ([0.0, 1.0], [1.1e-9, 1.0], 3),
        ([0.0, 1.0], [0.9e-9, 0.1], 4),  # the smaller gap is 0.1: one of its own
        ([0.0, 0.1], [-5e-17, 0.2], 3),  # zero as a difference gives it
        ([3.0], [3.0 + 2e-9], 1),  # of the magnitude
        ([3.0], [3.0 + 4e-9], 2),
        ([3.0], [3.0 + 2e-9, 3.5], 3),  # of the gap, which there is
        ([0.0], [1e-300], 2),
        ([1.0, 1.0 + 1e-12], [1.0 + 2e-12, 1.0], 3),  # a very fine axis
    ],
)
def test_values_are_one_below_a_billionth_of_the_gap_beside_them(one, other, together):
    for first, second in ((one, other), (other, one)):
        whole = zj.merge(sweep(first, [1.0]), sweep(second, [1.0]))
        assert whole.x.size == together
        assert not np.isnan(whole.z).any()
        assert set(first) <= set(whole.x.values.tolist())


def test_a_cell_is_one_datasets_even_where_it_failed():
    """Numbers of a near cell do not stand beside the first one's code."""
    one, two = sweep([0.0, 0.1], [1.0]), sweep([0.0, 0.1 + 1e-14], [1.0])
    failed = one.assign(z=one.z.where(one.x < 0.05))
    whole = zj.merge(failed, two)
    assert np.isnan(whole.z.values[1, 0])
    assert whole.regime.values[1, 0] == one.regime.values[1, 0]
    nothing = failed.assign(
        regime=failed.regime.where(failed.x < 0.05, 0),
        both=failed.both.where(failed.x < 0.05),
    )
    assert zj.merge(nothing, two).z.values[1, 0] == two.z.values[1, 0]


@pytest.mark.parametrize("alone", ["x", "y", None])
def test_a_variable_without_all_axes_takes_no_cells_from_the_others(alone):
    """Near values of `x` are one, and at each of them all four of `y` were computed."""

    def parts(x, y):
        ds = sweep(x, y)
        return ds.assign(w=2 * ds[alone] if alone else xr.DataArray(2.0))

    one = parts([0.0, 0.1, 0.2], [1.0, 2.0])
    whole = zj.merge(one, parts([0.0, 0.1 + 1e-14, 0.2], [3.0, 4.0]))
    assert not any(np.isnan(v).any() for v in whole.data_vars.values())
    assert of_values(whole)["x"] == of_values(one)["x"]
    if alone:
        expected = 2 * (one.x if alone == "x" else whole.y)
        assert whole.w.values.tolist() == expected.values.tolist()


def test_an_axis_of_another_name_is_one():
    """And so are the cells along it, which have not all been computed."""
    one, two = sweep([0.0, 0.1], [1.0, 2.0]), sweep([0.0, 0.1 + 1e-14], [1.0, 2.0])
    one = one.where(one.y < 1.5).assign(regime=one.regime.where(one.y < 1.5, 0))
    whole = zj.merge(one.rename(x="load"), two.rename(x="load"))
    assert not np.isnan(whole.z).any()


def test_a_cell_is_of_the_first_dataset_that_computed_it_whatever_follows():
    """Also of a near one, before one at the first dataset's own coordinates."""
    exact, near = sweep([0.0, 0.1], [1.0]), sweep([0.0, 0.1 + 1e-14], [1.0])
    nothing = exact.where(False).assign(regime=exact.regime * 0)
    assert exact.z.values[1, 0] != near.z.values[1, 0]
    for order, first in (((near, exact), near), ((exact, near), exact)):
        whole = zj.merge(nothing, *order, *order)
        assert whole.x.values.tolist() == exact.x.values.tolist()
        assert whole.z.values.tobytes() == first.z.values.tobytes()
    # two at one coordinate still have to agree
    with pytest.raises(ValueError, match="agree where they meet"):
        zj.merge(nothing, near, exact, near.assign(z=near.z + 1))


def test_a_value_stays_with_the_one_it_was_taken_for():
    """A later one, too far from the first to be it, may be nearer."""
    parts = [sweep([x, 1.0], [0.0]) for x in (0.0, 0.9e-9, 1.1e-9)]
    failed = parts[0].where(False).assign(regime=parts[0].regime * 0)
    whole = zj.merge(failed, *parts[1:])
    assert whole.x.values.tolist() == [0.0, 1.1e-9, 1.0]
    assert whole.z.values[:, 0].tolist() == [0.9e-9, 1.1e-9, 1.0]
