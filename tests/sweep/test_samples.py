"""Parameters that share a dimension vary together along it."""

import numpy as np
import pytest
import xarray as xr

import ziegler_jax as zj

pytestmark = pytest.mark.usefixtures("optimised")  # bits, as users get them

RANDOM = np.random.default_rng(0)
Q, MU = (xr.DataArray(RANDOM.normal(size=50), dims="sample") for _ in range(2))
C = np.array([1.0, 2.0])


def point(q, mu, c):
    return {"sum": q + 10 * mu + 100 * c}


def sweep(**options):
    return zj.sweep(point, q=Q, mu=MU, c=C, progress=False, **options)


def test_each_sample_is_computed_once_beside_the_other_axes():
    ds = sweep()
    assert dict(ds.sizes) == {"sample": 50, "c": 2}
    assert ds["sum"].dims == ("sample", "c")
    assert (ds.q == Q).all() and (ds.mu == MU).all()  # the distribution stays
    # measured 2.8e-14: sums in another order
    assert float(np.abs(ds["sum"] - (Q + 10 * MU + 100 * ds.c)).max()) < 1e-12
    assert ds.q.attrs["long_name"] and ds.attrs["points"] == 100


def test_samples_are_the_bits_of_the_grid_that_holds_them():
    def motion(q, mu):
        law = zj.SmoothCoulomb(mu, pin_radius=0.05, v_smooth=0.05)
        windows = zj.Windows(transient=5.0, length=5.0, max_windows=1)
        return zj.settle(
            zj.uniform_rods(q, friction=law), zj.State(omega=(0.0, 0.3)),
            windows=windows, certify=False,
        )  # fmt: skip

    q, mu = np.linspace(1.5, 3.5, 7), np.linspace(0.05, 0.2, 7)
    grid = zj.sweep(motion, q=q, mu=mu, progress=False)
    both = {"q": xr.DataArray(q, dims="n"), "mu": xr.DataArray(mu, dims="n")}
    line = zj.sweep(motion, **both, progress=False)
    diagonal = grid.sel(**both)
    for name in grid.data_vars:
        assert line[name].values.tobytes() == diagonal[name].values.tobytes(), name


def test_a_parameter_may_follow_an_axis():
    q = np.linspace(1.0, 2.0, 5)
    mu = xr.DataArray(q**2, dims="q")
    ds = zj.sweep(lambda q, mu: {"sum": q + mu}, q=q, mu=mu, progress=False)
    assert ds["sum"].dims == ("q",) and list(ds.indexes) == ["q"]
    assert ds["sum"].sel(q=1.5).item() == 3.75


def test_one_parameter_keeps_the_dimension_it_was_given_and_its_repeated_values():
    values = [2.0, 1.0, 2.0]
    q = xr.DataArray(values, dims="sample")
    ds = zj.sweep(lambda q: {"twice": 2 * q}, q=q, progress=False)
    assert ds.twice.dims == ("sample",) and ds.q.dims == ("sample",)
    assert ds.twice.values.tolist() == [4.0, 2.0, 4.0]
    # one that was given none has its own name
    own = xr.DataArray([1.0, 2.0], attrs={"units": "N"})
    ds = zj.sweep(lambda q: {"twice": 2 * q}, q=own, progress=False)
    assert ds.twice.dims == ("q",) and ds.twice.sel(q=2.0) == 4.0


def test_where_sees_samples():
    ds = sweep(where=lambda q, mu, c: (q > 0) & (c > 1))
    expected = ((Q > 0) & (xr.DataArray(C, dims="c") > 1)).transpose("sample", "c")
    assert (np.isfinite(ds["sum"]).values == expected.values).all()


def test_a_store_of_samples_goes_on_and_opens(tmp_path):
    store = tmp_path / "samples.zarr"
    first = sweep(store=store)
    again = sweep(store=store)
    opened = zj.open_sweep(store)
    assert again.identical(first)
    for ds in (again, opened):
        assert (ds.q.values == Q.values).all() and ds.mu.dims == ("sample",)
        assert (ds["sum"].values == sweep()["sum"].values).all()
    with pytest.raises(ValueError, match="dimensions sample, c"):
        zj.sweep(point, q=Q, mu=MU, c=MU, progress=False, store=store)


def test_what_an_axis_says_beside_its_labels_stays_out_of_the_sweep(tmp_path):
    """Else a store would read its values scaled, masked or as another type."""
    attrs = {"scale_factor": 10.0, "_FillValue": 9.0, "dtype": "bool", "units": "N"}
    q = xr.DataArray([1.0, 2.0], dims="s", attrs=attrs)
    ds = zj.sweep(lambda q: {"twice": 2 * q}, q=q, progress=False, store=tmp_path / "a")
    assert ds.q.attrs == {"long_name": "follower load", "units": "N", "symbol": "$q$"}
    for read in (ds, zj.open_sweep(tmp_path / "a")):
        assert read.q.values.tolist() == [1.0, 2.0] and read.q.dtype == np.float64


def test_an_axis_without_a_dimension_of_its_own_is_not_paired_with_another():
    unnamed = xr.DataArray([1.0, 2.0])
    other = xr.DataArray([10.0, 20.0], dims="q")
    with pytest.raises(ValueError, match=r"`mu` must not lie along `q`.*rename"):
        zj.sweep(lambda q, mu: {"sum": q + mu}, q=unnamed, mu=other, progress=False)
    with pytest.raises(ValueError, match="Dimension None must have a name"):
        zj.sweep(lambda q: {"q": q}, q=xr.DataArray([1.0], dims=(None,)))
    with pytest.raises(ValueError, match=r"`q` must have each value once"):
        zj.sweep(lambda q: {"v": q}, q=xr.DataArray([1.0, 1.0]))


def test_a_number_is_what_all_points_have(tmp_path):
    ds = sweep()
    with_mu = zj.sweep(point, q=Q, mu=2.0, c=C, progress=False)
    one = zj.sweep(point, q=Q, mu=[2.0], c=C, progress=False)
    assert with_mu["sum"].dims == ("sample", "c") and with_mu.mu.ndim == 0
    assert with_mu.mu == 2.0 and with_mu.attrs["scene_axes"] == "q, mu, c"
    bits = one["sum"].isel(mu=0).values.tobytes()
    assert with_mu["sum"].values.tobytes() == bits
    assert with_mu.attrs["scene_digest"] == ds.attrs["scene_digest"]
    given = xr.DataArray(2.0, attrs={"units": "N"})  # whatever its form
    assert zj.sweep(point, q=Q, mu=given, c=C, progress=False).mu.attrs["units"] == "N"


def test_a_store_has_its_number_to_the_last_bit_and_mends_it(tmp_path):
    folder, third = tmp_path / "map.zarr", 1 / 3

    def stored(mu):
        return zj.sweep(point, q=Q, mu=mu, c=C, store=folder, progress=False)

    whole = stored(third).load()
    assert float(zj.open_sweep(folder).mu) == float(whole.mu) == third
    assert float(xr.open_zarr(folder, consolidated=False).mu) == third
    with pytest.raises(ValueError, match="axis `mu` of the number 0.333.*, and this"):
        stored(np.nextafter(third, 1))
    with pytest.raises(ValueError, match="has dimensions"):
        stored([third])
    (folder / "mu" / "c").write_bytes(b"damaged")
    with pytest.raises(ValueError, match="damaged"):
        zj.open_sweep(folder)
    assert stored(third).load().identical(whole)
    assert float(zj.open_sweep(folder).mu) == third


def test_sweeps_of_one_number_are_merged_and_of_two_are_not():
    parts = [
        zj.sweep(point, q=[1.0, 2.0], mu=mu, c=[c], progress=False)
        for mu, c in ((0.1, 1.0), (0.1, 2.0), (0.2, 2.0))
    ]
    assert zj.merge(*parts[:2])["sum"].shape == (2, 2)
    with pytest.raises(ValueError, match="its `mu` is '0.2'"):
        zj.merge(*parts[1:])
