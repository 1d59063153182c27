"""The union of sweeps."""

import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr

import ziegler_jax as zj


def point(x, y):
    code = jnp.where(x > y, int(zj.REGIME.flutter), int(zj.REGIME.stable))
    return {
        "z": x + 10 * y,
        "regime": zj.Variable(code.astype(jnp.int8), "regime", codes=zj.REGIME),
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
    assert corner.regime.sel(x=2.0, y=1.0) == zj.REGIME.not_computed
    assert corner.z.sel(x=2.0, y=3.0) == 32.0


def test_what_one_left_out_the_other_fills_in():
    x, y = np.arange(4.0), np.arange(3.0)
    parts = [
        sweep(x, y, where=lambda x, y: x < y),
        sweep(x, y, where=lambda x, y: x >= y),
    ]
    assert of_values(zj.merge(*parts)) == of_values(sweep(x, y))


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
    return ds.assign_attrs(scene="def point(x, y): ...")


@pytest.mark.parametrize(
    "change, words",
    [
        (other_scene, ("`sweeps[1]`", "`scene`")),
        (lambda ds: ds.assign_attrs(precision="float32"), ("`precision`", "float32")),
        (lambda ds: ds.rename(x="w"), ("axes", "'w'")),
        (lambda ds: ds.drop_vars("z"), ("holds", "'z'")),
        (lambda ds: ds.assign(z=ds.z + 1), ("`z`", "x = 1", "agree")),
        (lambda ds: ds.assign_coords(w=("x", [1.0])), ("`w`", "xr.concat")),
        (lambda ds: 3, ("`sweeps[1]`", "3")),
    ],
)
def test_what_is_not_of_one_scene_is_refused(change, words):
    ds = sweep([0.0, 1.0], [0.0, 2.0])
    part = ds.isel(x=[1])
    with pytest.raises(ValueError) as error:
        zj.merge(ds, change(part))
    assert all(word in str(error.value) for word in words), error.value


def test_a_number_that_both_are_at_stays_and_another_is_refused():
    ds = sweep([0.0, 1.0], [0.0, 2.0])
    left, right = ds.isel(x=[0]).assign_coords(c=1.0), ds.isel(x=[1])
    assert zj.merge(left, right.assign_coords(c=1.0)).c == 1.0
    with pytest.raises(ValueError, match="its `c` is"):
        zj.merge(left, right.assign_coords(c=2.0))
