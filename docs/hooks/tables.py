r"""Looks at each table: every row has as many cells as the header.

Markdown drops the cells that are too many and leaves empty those that are missing, so
that a `|` in a formula breaks a table without a word. In a formula write `\lvert`.
"""

import logging
import re
from collections.abc import Sequence
from html.parser import HTMLParser
from xml.etree import ElementTree as etree

from markdown import Markdown
from markdown.extensions.tables import TableExtension, TableProcessor
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import Files
from mkdocs.structure.pages import Page

log = logging.getLogger("mkdocs.hooks.tables")

# a paragraph that begins as a row does: its table has no separator of the same length
NO_TABLE = re.compile(r"<p>\s*\|[^<]*")


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Count cells as Markdown splits them, in docstrings as well."""
    config.markdown_extensions.append(Counted())  # type: ignore[arg-type]
    return config


def on_page_content(
    content: str, page: Page, config: MkDocsConfig, files: Files
) -> str:
    """Look at the tables as they are drawn."""
    del config, files
    for found in NO_TABLE.finditer(content):
        log.warning("%s: no table is made of %r", page.url, found[0])
    reader = _Cells()
    reader.feed(content)
    for header, *rows in filter(None, reader.tables):
        for row in rows:
            if row != header:
                log.warning("%s: a row of %d cells, not %d", page.url, row, header)
    return content


class Counted(TableExtension):
    """The tables of Markdown, with a warning for each row of another length."""

    def extendMarkdown(self, md: Markdown) -> None:  # noqa: N802, Markdown's name
        """In the place of the usual one."""
        super().extendMarkdown(md)
        processor = _CountedRows(md.parser, self.getConfigs())
        md.parser.blockprocessors.register(processor, "table", 75)


class _CountedRows(TableProcessor):
    def _build_row(
        self, row: str, parent: etree.Element, align: Sequence[str | None]
    ) -> None:
        cells = len(self._split_row(row))
        if cells != len(align):
            log.warning("A row of %d cells, not %d: %s", cells, len(align), row)
        super()._build_row(row, parent, align)


class _Cells(HTMLParser):
    """The number of cells in each row of each table."""

    def __init__(self) -> None:
        super().__init__()
        self.tables: list[list[int]] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag == "table":
            self.tables.append([])
        elif tag == "tr" and self.tables:
            self.tables[-1].append(0)
        elif tag in ("td", "th") and self.tables and self.tables[-1]:
            self.tables[-1][-1] += int(dict(attrs).get("colspan") or 1)
