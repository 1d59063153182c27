"""The page on other tools: its lines run as they stand, and files have the numbers."""

import re
from pathlib import Path

import jax
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from scipy.io import loadmat

import ziegler_jax as zj

PAGE = Path(__file__).parents[1] / "docs" / "learn" / "export.md"


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """The folder of the files, and the names that the page's blocks leave."""
    folder, names = tmp_path_factory.mktemp("export"), {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for block in re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.S):
            exec(compile(block, str(PAGE), "exec"), names)  # noqa: S102
    return folder, names


def test_a_csv_has_a_row_a_point_with_the_sweep_s_numbers(page):
    folder, names = page
    table, ds = pd.read_csv(folder / "map.csv"), names["ds"]
    assert len(table) == ds.sizes["q"] * ds.sizes["mu"]
    for row in table.itertuples():
        lane = ds.sel(q=row.q, mu=row.mu)
        assert zj.CODE[row.outcome] == lane.outcome
        np.testing.assert_equal(row.joint_amplitude, lane.joint_amplitude.values[1])


def test_matlab_and_netcdf_files_have_the_same_arrays(page):
    folder, names = page
    ds = names["ds"]
    file, back = loadmat(folder / "map.mat"), xr.load_dataset(folder / "map.nc")
    for name in ds.data_vars:
        np.testing.assert_array_equal(file[name], ds[name])
        np.testing.assert_array_equal(back[name], ds[name])
    assert back.period.attrs["units"] == ds.period.attrs["units"]
    assert back.outcome.attrs["flag_meanings"] == ds.outcome.attrs["flag_meanings"]


def test_hertz_are_turns_a_second(page):
    _, names = page
    ds, seconds = names["ds"], np.sqrt(0.1 * 0.2**2 / 0.5)
    assert (ds.outcome == zj.CODE.cycle).any()
    np.testing.assert_allclose(names["hertz"], 1 / (ds.period * seconds), rtol=1e-14)
    np.testing.assert_allclose(names["force"], ds.q * 0.5 / 0.2, rtol=1e-14)


def test_a_motion_s_file_has_its_states(page):
    folder, names = page
    rows = np.loadtxt(folder / "motion.csv", delimiter=",", skiprows=1)
    motion = names["motion"]
    assert rows.shape == (90, 5)
    states = np.column_stack([motion.phi, motion.omega])
    np.testing.assert_array_equal(rows[:, 1:], states)
    assert jax.numpy.isfinite(motion.phi).all()
