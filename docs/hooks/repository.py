"""Pages and pictures that lie elsewhere in the repository: nothing is there twice.

A line `<!-- from README.md # Speed -->` in a page stands for that section of that file
(without `#`: for the whole file, without its title; `# ^`: for what comes before the
first section), its links turned to where the page lies; what the site does not have is
linked to in the repository. `<!-- first calls -->` stands for a table of them.
"""

import ast
import json
import posixpath
import re
import tomllib
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[2]
WHOLE = [
    "CHANGELOG.md",
    "CITATION.cff",
    "CONTRIBUTING.md",
    "audit/audit.md",
    "benchmarks/results/extreme.md",
    "examples/studies/README.md",
]
PICTURES = [
    "audit/*.png",
    "figures/*.svg",
    "figures/*.png",
    "benchmarks/results/*.png",
    "examples/studies/*.png",
]
OPENED = {  # what is a folder in the repository, or a file beside it
    "examples": "learn/examples.md",
    "examples/studies": "examples/studies/README.md",
    "figures": "figures/index.md",
}
UNSEARCHED = ("benchmarks/", "audit/")
# what no group names is in a last one; a name without a picture is passed over
GROUPS = {
    "Maps": "first_map bifurcation_map bifurcation_map_both boundaries verdict_map "
    "rods",
    "Friction laws": "regularisation_error",
    "Thresholds: which kick, which load": "critical_kick least_kick basin",
    "Load up and down": "hysteresis_branch ramp",
    "Cycles and their bifurcations": "cycle_fold bifurcation_curves",
    "Motions": "column time_history poincare_section",
    "The linear column": "root_locus stability_map paradox best_damping "
    "whitney_umbrella",
}
SCENES = {
    "one_window": "`settle` with `certify=False` and one window",
    "certified_map": "`settle` with a certificate, smoothed friction",
    "verdict_map": "the same with `exponents=2`",
    "joint_reactions": "`settle`, dry friction on the joints' reactions",
}
FROM = re.compile(r"^<!-- from (\S+?)(?: # (.+?))? -->$", re.M)
LINK = re.compile(r"(\]\()(?!https?://|#|mailto:)([^)\s]+)")
FENCE = re.compile(r"^```.*?^```$", re.M | re.S)


def address() -> str:
    """Where the repository is, by pyproject.toml."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())
    return settings["tool"]["hatch"]["metadata"]["hooks"]["custom"]["repository"]


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Link to the repository at the foot of each page."""
    # not `repo_url`, for which the theme asks some hosts for numbers of the repository
    icon = "fontawesome/brands/git-alt"
    config.extra["social"] = [{"icon": icon, "link": address(), "name": "Repository"}]
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add what lies outside of `docs`."""
    pictures = [p for pattern in PICTURES for p in sorted(ROOT.glob(pattern))]
    for path in [ROOT / name for name in WHOLE] + pictures:
        uri = path.relative_to(ROOT).as_posix()
        files.append(File.generated(config, uri, abs_src_path=str(path)))
    for uri, content in {
        "figures/index.md": gallery(),
        "learn/examples.md": examples(),
        "benchmarks/README.md": benchmarks(),
    }.items():
        files.append(File.generated(config, uri, content=content))
    return files


def on_page_markdown(
    markdown: str, page: Page, config: MkDocsConfig, files: Files
) -> str:
    """Put the sections of other files in their places."""
    del config
    uri = page.file.src_uri
    if uri.startswith(UNSEARCHED):  # tables of numbers, in which every word stands
        page.meta["search"] = {"exclude": True}
    markdown = markdown.replace("<!-- first calls -->", first_calls())
    return FROM.sub(lambda found: section(*found.groups(), uri, files), markdown)


def section(source: str, heading: str | None, uri: str, files: Files) -> str:
    """A part of a file, its links as seen from the page."""
    text = (ROOT / source).read_text()
    blank = FENCE.sub(lambda found: " " * len(found[0]), text)  # no headings in code
    heads = [(m.start(), m.end(), m[1]) for m in re.finditer(r"^## (.+)$", blank, re.M)]
    title = re.match(r"# .*\n", text)
    start, end = title.end() if title else 0, len(text)
    if heading == "^":
        end = heads[0][0]
    elif heading is not None:
        names = [name for *_, name in heads]
        if heading not in names:
            raise PluginError(f"{uri}: {source} has no section {heading!r}: {names}")
        i = names.index(heading)
        start, end = heads[i][1], (heads[i + 1][0] if i + 1 < len(heads) else end)

    def turned(link: re.Match) -> str:
        target = posixpath.normpath(posixpath.join(posixpath.dirname(source), link[2]))
        file, mark, anchor = target.partition("#")
        page = OPENED.get(file, file.removeprefix("docs/"))
        if page.startswith("learn/"):  # a notebook's script becomes a page
            page = page.removesuffix(".py").removesuffix(".md") + ".md"
        if files.get_file_from_path(page) is None and (ROOT / file).exists():
            return f"{link[1]}{address()}/blob/main/{target}"
        return (
            link[1]
            + posixpath.relpath(page, posixpath.dirname(uri) or ".")
            + (mark + anchor)
        )

    return LINK.sub(turned, text[start:end]).strip()


def about(path: Path) -> str:
    """The first paragraph of a script's docstring."""
    text = ast.get_docstring(ast.parse(path.read_text())) or path.stem
    return " ".join(text.split("\n\n")[0].split())


def gallery() -> str:
    """Every picture of `figures` that has a script, with what that says first."""
    pictures = {p.stem: p.name for p in sorted((ROOT / "figures").glob("*.[ps][nv]g"))}
    scripts = {name for name in pictures if (ROOT / "figures" / f"{name}.py").exists()}
    groups = {title: names.split() for title, names in GROUPS.items()}
    groups["More"] = sorted(scripts - {n for names in groups.values() for n in names})
    lines = ["# Gallery", "", "A picture opens in full; under it is its script.", ""]
    for title, names in groups.items():
        shown = [name for name in names if name in scripts]
        lines += [f"## {title}", "", '<div class="gallery" markdown>', ""] * bool(shown)
        for name in shown:
            words = about(ROOT / "figures" / f"{name}.py")
            script = f"{address()}/blob/main/figures/{name}.py"
            lines += [
                '<div class="card" markdown>',
                f"[![{words}]({pictures[name]}){{ loading=lazy }}]({pictures[name]})",
                "",
                f"{words} [`{name}.py`]({script})",
                "</div>",
                "",
            ]
        lines += ["</div>", ""] * bool(shown)
    return "\n".join(lines)


def first_calls() -> str:
    """What a first call costs, as `benchmarks/b4_first_call.py` has measured it."""
    results = ROOT / "benchmarks" / "results" / "b4_first_call.jsonl"
    measured = [json.loads(line) for line in results.read_text().splitlines()]
    rows = ["| a first call of `sweep` | s | in the next process, cached |"]
    rows += ["|---|---|---|"]
    for one in measured:
        empty, full = (
            f"{one['first_call_seconds'][f'cache_{word}']:.1f}"
            for word in ("empty", "full")
        )
        rows.append(f"| {SCENES[one['scene']]} | {empty} | {full} |")
    last = measured[-1]
    machine = f"{last['cpu']}, {last['cores']} cores, jax {last['jax']}"
    return "\n".join([*rows, "", f"Four points each, on {machine}."])


def examples() -> str:
    """The scripts of `examples`, each under the sentence that it begins with."""
    lines = ["# Short scripts", ""]
    lines += ["Each runs as it stands; the tests run all of them.", ""]
    for path in sorted((ROOT / "examples").glob("*.py")):
        lines += [f"## `{path.name}`", "", about(path), "", "```python"]
        code = path.read_text().split('"""', 2)[2].strip()
        lines += [code, "```", ""]
    return "\n".join(lines)


def benchmarks() -> str:
    """The benchmarks' own page behind what the README says of speed."""
    pictures = sorted((ROOT / "benchmarks" / "results").glob("*.png"))
    lines = ["# Benchmarks", "", "<!-- from README.md # Speed -->", ""]
    lines += ["## How they are run", "", "<!-- from benchmarks/README.md -->", ""]
    lines += ["## All pictures", ""]
    for path in pictures:
        lines += [f"![{path.stem}](results/{path.name})", "", f"`{path.stem}`", ""]
    return "\n".join(lines)
