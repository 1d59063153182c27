"""The site's pages in `docs`, without building it."""

import importlib.util
import re
import tomllib
from pathlib import Path

import pytest

import ziegler_jax as zj
from ziegler_jax import results

DOCS = Path(__file__).parents[1] / "docs"
NAVIGATION = (DOCS.parent / "mkdocs.yml").read_text()
NOTEBOOKS = sorted((DOCS / "learn").glob("*.py"))


def hook(name):
    """One of the site's hooks, which import what the extra `docs` brings."""
    pytest.importorskip("mkdocs")
    pytest.importorskip("latex2mathml")
    spec = importlib.util.spec_from_file_location(name, DOCS / f"hooks/{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def place(name):
    """In full where a room of the package has the same name."""
    if (Path(zj.__file__).parent / name).is_dir():
        return f"{getattr(zj, name).__module__}.{name}"
    return f"ziegler_jax.{name}"


def test_every_public_name_is_in_the_reference_once():
    text = "\n".join(p.read_text() for p in sorted((DOCS / "reference").glob("*.md")))
    named = re.findall(r"^::: (\S+)$", text, re.M)
    assert len(named) == len(set(named))
    functions = {f"ziegler_jax.plot.{n}" for n in zj.plot.__all__ if n.islower()}
    public = {place(name) for name in zj.__all__} | functions
    assert public <= set(named)
    others = {name.split(".")[-1] for name in set(named) - public}
    # results and values that functions give, but nobody imports
    assert others == {*("CriticalLoad", "Events", "Linear", "Stabilised", "Step")}


def test_every_question_shows_the_sentences_of_its_codes():
    text = (DOCS / "reference" / "results.md").read_text()
    lists = {n: x for n, x in vars(results).items() if isinstance(x, tuple)}
    codes = {n for n, x in lists.items() if {type(code) for code in x} == {zj.CODE}}
    assert set(re.findall(r"^<!-- codes (\w+) -->$", text, re.M)) == codes


def test_every_notebook_is_in_the_navigation():
    assert len(NOTEBOOKS) == 9
    for path in NOTEBOOKS:
        assert f"learn/{path.stem}.md" in NAVIGATION
        cells = path.read_text().count("# %%\n")
        assert cells >= 5 and "# %% [markdown]\n# # " in path.read_text()


def test_ci_builds_the_site_as_the_readme_says():
    """Where the README has the line; the site fails on the least warning."""
    (line,) = re.findall(r"-m mkdocs build.*", (DOCS.parent / ".ci/run").read_text())
    assert line.split() == ["-m", "mkdocs", "build", "--strict"]
    readme = (DOCS.parent / "README.md").read_text()
    assert all("--strict" in said for said in re.findall(r"mkdocs build.*", readme))


@pytest.mark.parametrize(
    ("row", "warnings"),
    [("| $\\lvert q \\rvert$ | 1 |", 0), ("| $|q|$ | 1 |", 1), ("| `|q|` |", 1)],
)
def test_a_row_of_another_length_than_its_header_is_warned_of(row, warnings, caplog):
    markdown = pytest.importorskip("markdown")
    text = f"| load | value |\n|---|---|\n{row}\n"
    with caplog.at_level("WARNING"):
        markdown.markdown(text, extensions=[hook("tables").Counted()])
    assert len(caplog.records) == warnings


def test_the_name_of_a_function_does_not_stick_to_its_neighbours():
    equations = hook("equations")
    mathml = equations.spaced(equations.convert(r"b \cos D + \cos^2 x + |q| \sin(x)"))
    bare = re.sub(r' width="[^"]*"| (lspace|rspace|stretchy)="[^"]*"| /', "", mathml)
    assert "<mi>b</mi><mspace><mi>cos</mi><mspace><mi>D</mi>" in bare
    assert "<msup><mi>cos</mi><mn>2</mn></msup><mspace><mi>x</mi>" in bare
    assert "<mi>sin</mi><mo>(</mo>" in bare
    assert mathml.count('<mo stretchy="false" lspace="0" rspace="0">|</mo>') == 2


FOLDERS = "docs", "ziegler_jax", "tests", "benchmarks", "figures", "audit", "examples"


def test_the_repository_s_address_stands_in_one_place():
    root = DOCS.parent
    settings = tomllib.loads((root / "pyproject.toml").read_text())
    address = settings["tool"]["hatch"]["metadata"]["hooks"]["custom"]["repository"]
    texts = [
        path
        for pattern in ("*.*", *(f"{name}/**/*.*" for name in FOLDERS), ".ci/*")
        for path in root.glob(pattern)
        if path.is_file() and address in path.read_text(errors="ignore")
    ]
    assert texts == [root / "pyproject.toml"]
    assert (root / "pyproject.toml").read_text().count(address) == 1
