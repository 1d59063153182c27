"""The package as others get it."""

import json
import re
import subprocess
import sys
import tarfile
from pathlib import Path

import pytest

import ziegler_jax as zj

ROOT = Path(__file__).parents[1]


def run(*command):
    done = subprocess.run(
        [sys.executable, "-m", *command], cwd=ROOT, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_it_builds_is_small_and_says_where_it_comes_from(tmp_path):
    for name in ("build", "twine", "hatchling"):
        pytest.importorskip(name)
    run("build", "--no-isolation", "--outdir", str(tmp_path), ".")
    files = sorted(tmp_path.iterdir())
    assert [f.suffix for f in files] == [".whl", ".gz"] and len(files) == 2
    run("twine", "check", "--strict", *map(str, files))
    assert max(f.stat().st_size for f in files) < 1_000_000
    with tarfile.open(files[1]) as archive:
        (info,) = [n for n in archive.getnames() if n.endswith("/PKG-INFO")]
        text = archive.extractfile(info).read().decode()
    python = "Programming Language :: Python :: " + ".".join(
        map(str, sys.version_info[:2])
    )
    assert f"Classifier: {python}\n" in text and "Project-URL: Repository, " in text
    assert f"Version: {zj.__version__}\n" in text
    assert f"version: {zj.__version__}\n" in (ROOT / "CITATION.cff").read_text()
    links = re.findall(r"\]\(([^)\s]+)\)", text)
    assert len(links) > 10 and all(re.match("https://|#", link) for link in links)


def test_a_flat_tuple_is_no_state_to_the_type_checker():
    """Two lines of a file are refused, each for its argument, and the third is not."""
    pytest.importorskip("pyright")
    file = "tests/refused_by_pyright.py"
    done = subprocess.run(
        [sys.executable, "-m", "pyright", "--pythonpath", sys.executable]
        + ["--outputjson", file],
        cwd=ROOT, capture_output=True, text=True,
    )  # fmt: skip
    found = json.loads(done.stdout)["generalDiagnostics"]
    text = (ROOT / file).read_text().splitlines()
    lines = [text[f["range"]["start"]["line"]].strip() for f in found]
    assert [f["rule"] for f in found] == ["reportArgumentType"] * 2
    assert lines == [
        "system.field(0.0, (0.1, 0.2, 0.0, 0.0))", "system.energy((0.1, 0.2, 0.0, 0.0))"
    ]  # fmt: skip
