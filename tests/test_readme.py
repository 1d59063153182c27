"""What README.md shows runs as it stands, and gives what the text around it says."""

import os
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
import xarray as xr

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```$", README, re.M | re.S)
PYTHON = [text for language, text in BLOCKS if language == "python"]
SHELL = [text for language, text in BLOCKS if language == "sh"]

# the blocks one after the other, as a reader would type them
IN_ORDER = """
import pathlib, sys
names = {"__name__": "__main__"}
for file in sorted(pathlib.Path().glob("block*.py")):
    exec(compile(file.read_text(), file, "exec"), names)
names["ds"].to_zarr("ds.zarr", consolidated=False, zarr_format=3)
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Where the Python blocks have run."""
    folder = tmp_path_factory.mktemp("readme")
    for number, text in enumerate(PYTHON):
        (folder / f"block{number:02d}.py").write_text(text)
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", IN_ORDER],
        cwd=folder,
        env={**os.environ, "XDG_CACHE_HOME": str(folder / "cache")},
        capture_output=True,
        text=True,
        timeout=500,
    )
    assert done.returncode == 0, done.stderr
    (folder / "printed.txt").write_text(done.stdout)
    return folder


def test_its_first_call_leaves_a_cache(folder):
    assert list((folder / "cache" / "ziegler_jax").iterdir())


def test_the_block_gives_the_dataset_that_the_text_describes(folder):
    assert len(PYTHON) == 1
    ds = xr.open_zarr(folder / "ds.zarr", consolidated=False)
    grid = {"q": 81, "mu": 40}
    dims = {"joint_amplitude": {"joint": 2}, "rod_amplitude": {"rod": 2}}
    dims |= {"steps": {}, "outcome": {}, "period": {}}
    for name, own in dims.items():
        assert dict(ds[name].sizes) == {**grid, **own}, name
    codes = dict(
        zip(
            ds["outcome"].attrs["flag_meanings"].split(),
            ds["outcome"].attrs["flag_values"],
            strict=True,
        )
    )
    assert {"cycle", "stuck", "rest", "unsettled", "escaped"} <= codes.keys()
    cycle = (ds["outcome"] == codes["cycle"]).values
    assert 0.05 < cycle.mean() < 0.95  # the map has both sides of its onset
    assert (ds["joint_amplitude"].sel(joint=2).values[cycle] > 0).all()
    failed = (ds["outcome"] < codes["unsettled"]).values
    assert np.isnan(ds["joint_amplitude"].values[failed]).all()
    assert {"scene", "rtol", "atol", "jax_version"} <= ds.attrs.keys()


def test_it_prints_what_the_text_says(folder):
    word, first, second, period = re.search(
        r"It prints `(\w+) \[(\S+) (\S+)\] (\S+)`", README
    ).groups()
    printed = (folder / "printed.txt").read_text()
    found = re.search(rf"^{word} \[(\S+)\s+(\S+)\] (\S+)$", printed, re.M)
    assert found, printed
    # as many digits as are written
    np.testing.assert_allclose(
        [float(x) for x in found.groups()],
        [float(x) for x in (first, second, period)],
        rtol=0,
        atol=6e-4,
    )


def test_its_picture_is_a_map_and_no_blank(folder):
    picture = matplotlib.image.imread(folder / "map.png")[..., :3]
    colours = np.unique(picture.reshape(-1, 3), axis=0)
    assert min(picture.shape[:2]) > 200 and len(colours) > 100


def commands(text):
    """The words of each command of a line that joins them by &&."""
    parts = text.strip().split(" && ")
    return [shlex.split(part) for part in parts]


def test_the_commands_make_an_environment_and_install_what_is_there():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert len(SHELL) == 3
    for text in SHELL:
        subprocess.run(["sh", "-n", "-c", text], check=True)
        venv, pip, last = commands(text)
        assert venv == ["python3", "-m", "venv", ".venv"]
        assert pip[:-1] == [".venv/bin/pip", "install", "-q"]
        name, extra = re.fullmatch(r"([^\[]*)(?:\[(\w+)\])?", pip[-1]).groups()
        assert name == "." and (
            extra is None or extra in project["optional-dependencies"]
        )
        assert last[:2] == [".venv/bin/python", "-m"]


def test_the_first_command_writes_the_map_where_it_stands(tmp_path):
    *_, (_, *words) = commands(SHELL[0])
    command = [sys.executable, *words, "--points", "20"]
    subprocess.run(command, cwd=tmp_path, check=True, timeout=400)
    there = {path.name for path in tmp_path.iterdir()}
    assert there == {"bifurcation_map.zarr", "bifurcation_map.png"}


def test_the_second_command_runs_the_first_tier_and_ci_all():
    *_, (_, *words) = commands(SHELL[1])
    assert words == ["-m", "pytest", "-q", "-n", "auto"]
    options = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["pytest"]
    assert "-m 'not slow'" in options["ini_options"]["addopts"]
    # as CI does, from the same line
    assert "all=\"$line -m ''\"" in (ROOT / ".ci/run").read_text()
