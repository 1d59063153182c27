"""What pages say of the package, taken from it: names, codes, the command line.

`<!-- names -->` stands for a table of all public names, `<!-- codes OUTCOMES -->` for
one of a question's codes, `<!-- command line -->` for `python -m ziegler_jax --help`.
Public names in code, as `settle` or `zj.settle`, become links to the reference.
"""

import importlib.util
import inspect
import os
import re
import subprocess
import sys
from xml.etree import ElementTree as etree

from markdown import Markdown
from markdown.extensions import Extension
from markdown.treeprocessors import Treeprocessor
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import Files
from mkdocs.structure.pages import Page

import ziegler_jax as zj
from ziegler_jax import results

# names that are as often those of a number or an argument: links only behind `zj.`
AMBIGUOUS = {"energy", "power", "motion", "scene", "regime", "reactions"}
AMBIGUOUS |= {"threshold"}
CODES = re.compile(r"^<!-- codes (\w+) -->$", re.M)


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Let Markdown make links of names, in docstrings as well."""
    config.markdown_extensions.append(Links())  # type: ignore[arg-type]
    return config


def on_page_markdown(
    markdown: str, page: Page, config: MkDocsConfig, files: Files
) -> str:
    """Fill in the tables."""
    del page, config, files
    markdown = CODES.sub(lambda found: codes(found[1]), markdown)
    if "<!-- names -->" in markdown:
        markdown = markdown.replace("<!-- names -->", names())
    if "<!-- command line -->" in markdown:
        markdown = markdown.replace("<!-- command line -->", command_line())
    return markdown


def identifier(name: str) -> str:
    """Where the reference has it: of `sweep` and `motion`, rooms too, in full."""
    known = getattr(zj, name)
    if importlib.util.find_spec(f"ziegler_jax.{name}") and not inspect.ismodule(known):
        return f"{known.__module__}.{known.__qualname__}"
    return f"ziegler_jax.{name}"


def codes(name: str) -> str:
    """A question's codes as a table."""
    rows = ["| code | name | meaning |", "|---|---|---|"]
    for code in getattr(results, name):
        sentence = in_cell(code.sentence)
        rows.append(f"| {int(code)} | `{code.name}` | {sentence} |")
    return "\n".join(rows)


def in_cell(text: str) -> str:
    """A sentence whose bars do not end the cell of a table."""

    def in_formula(found: re.Match) -> str:
        latex = found[1].replace(r"\|", r"\Vert ").replace("|", r"\vert ")
        return f"${latex.strip()}$"

    # in a formula an escaped bar would be a double one
    return re.sub(r"\$([^$]+)\$", in_formula, text).replace("|", r"\|")


def names() -> str:
    """All public names with the first sentence that is said of each."""
    rows = ["| name | what |", "|---|---|"]
    for name in zj.__all__:
        text = inspect.getdoc(getattr(zj, name)) or ""
        first = in_cell(" ".join(text.split("\n\n")[0].split()))
        rows.append(f"| [`{name}`][{identifier(name)}] | {first} |")
    return "\n".join(rows)


def command_line() -> str:
    """What `--help` prints."""
    done = subprocess.run(
        [sys.executable, "-m", "ziegler_jax", "--help"],
        env={**os.environ, "COLUMNS": "80", "NO_COLOR": "1"},
        capture_output=True,
        text=True,
        check=True,
    )
    return f"```text\n{done.stdout.rstrip()}\n```"


class Links(Extension):
    """Code that is a public name links to it."""

    def extendMarkdown(self, md: Markdown) -> None:  # noqa: N802, Markdown's name
        """After code has become elements."""
        md.treeprocessors.register(_Linked(md), "public_names", 5)


class _Linked(Treeprocessor):
    """Wraps each such element in a cross-reference."""

    def run(self, root: etree.Element) -> None:
        """Walk the tree, but not into links, headings and blocks of code."""
        for parent in list(root.iter()):
            if parent.tag in {"a", "pre", "autoref", *(f"h{n}" for n in range(1, 7))}:
                parent.set("data-unlinked", "")
        self._walk(root)
        for parent in root.iter():
            parent.attrib.pop("data-unlinked", None)

    def _walk(self, parent: etree.Element) -> None:
        for i, child in enumerate(list(parent)):
            if "data-unlinked" in child.attrib:
                continue
            target = _target(child) if child.tag == "code" else None
            if target is None:
                self._walk(child)
                continue
            link = etree.Element("autoref", identifier=target, optional="")
            link.tail, child.tail = child.tail, None
            parent[i] = link
            link.append(child)


def _target(code: etree.Element) -> str | None:
    """The identifier that a piece of code is a name of, if any."""
    found = re.fullmatch(r"(zj\.)?(plot\.)?(\w+)(\(.*\))?", code.text or "")
    if found is None:
        return None
    prefix, plot, name, _ = found.groups()
    if plot:
        known = name in zj.plot.__all__ and name.islower()
        return f"ziegler_jax.plot.{name}" if known else None
    if name not in zj.__all__ or (name in AMBIGUOUS and not prefix):
        return None
    return identifier(name)
