"""The site's pages in `docs`, without building it."""

import re
from pathlib import Path

import ziegler_jax as zj
from ziegler_jax import results

DOCS = Path(__file__).parents[1] / "docs"
NAVIGATION = (DOCS.parent / "mkdocs.yml").read_text()
NOTEBOOKS = sorted((DOCS / "learn").glob("*.py"))


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
    assert len(NOTEBOOKS) == 8
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
