"""Pages and pictures that lie elsewhere in the repository: nothing is there twice.

A line `<!-- from README.md # Speed -->` in a page stands for that section of that file
(without `#`: for the whole file, without its title; `# ^`: for what comes before the
first section), its links turned to where the page lies.
"""

import ast
import posixpath
import re
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
    "figures/*.png",
    "benchmarks/results/*.png",
    "examples/studies/*.png",
]
OPENED = {  # what is a folder in the repository, or a file beside it
    "examples": "learn/examples.md",
    "examples/studies": "examples/studies/README.md",
    "figures": "figures/index.md",
    "CITATION.cff": "CITATION.cff",
}
FROM = re.compile(r"^<!-- from (\S+?)(?: # (.+?))? -->$", re.M)
LINK = re.compile(r"(\]\()(?!https?://|#|mailto:)([^)#\s]+)")
FENCE = re.compile(r"^```.*?^```$", re.M | re.S)


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
    del config, files
    uri = page.file.src_uri
    return FROM.sub(lambda found: section(*found.groups(), uri), markdown)


def section(source: str, heading: str | None, uri: str) -> str:
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
        target = OPENED.get(target, target)
        return link[1] + posixpath.relpath(target, posixpath.dirname(uri) or ".")

    return LINK.sub(turned, text[start:end]).strip()


def about(path: Path) -> str:
    """The first paragraph of a script's docstring."""
    text = ast.get_docstring(ast.parse(path.read_text())) or path.stem
    return " ".join(text.split("\n\n")[0].split())


def gallery() -> str:
    """Every picture of `figures`, under it what its script says."""
    lines = [
        "# Figures",
        "",
        "Each is written by the script of its name in `figures/`, in the repository.",
        "",
    ]
    for path in sorted((ROOT / "figures").glob("*.png")):
        words = about(path.with_suffix(".py"))
        lines += [f"![{words}]({path.name})", "", f"`{path.stem}.py`: {words}", ""]
    return "\n".join(lines)


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
