"""Equations as MathML, which browsers draw by themselves: no script, no network."""

import html
import logging
import re

from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import Files
from mkdocs.structure.pages import Page

log = logging.getLogger("mkdocs.hooks.equations")

EQUATION = re.compile(
    r'<(span|div) class="arithmatex">\\([\[(])(.*?)\\[\])]</\1>', re.S
)


def on_page_content(
    content: str, page: Page, config: MkDocsConfig, files: Files
) -> str:
    """Draw what arithmatex has marked."""
    del config, files

    def drawn(found: re.Match) -> str:
        latex = html.unescape(found[3]).strip()
        display = "block" if found[2] == "[" else "inline"
        mathml = convert(latex, display=display)
        if "\\" in mathml:  # a command that it does not know
            log.warning("%s: an equation is not understood: %s", page.url, latex)
        return mathml

    return EQUATION.sub(drawn, content)
