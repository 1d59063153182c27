"""Equations as MathML, which browsers draw by themselves: no script, no network."""

import html
import logging
import re
from itertools import pairwise
from xml.etree import ElementTree as etree

from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import Files
from mkdocs.structure.pages import Page

log = logging.getLogger("mkdocs.hooks.equations")

EQUATION = re.compile(
    r'<(span|div) class="arithmatex">\\([\[(])(.*?)\\[\])]</\1>', re.S
)
CODE = re.compile(r"<(pre|code)\b.*?</\1>", re.S)
LEFT = re.compile(r"\$[^$<]*\\[a-zA-Z][^$<]*\$")
ROWS = {"math", "mrow", "mstyle", "msqrt", "mtd"}  # any number of children, in a line
SCRIPTS = {"msub", "msup", "msubsup", "munder"}


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
        mathml = spaced(mathml)
        # a long equation scrolls in a box of its own, not the page with it
        if display == "block":
            return f'<div class="equation" tabindex="0">{mathml}</div>'
        return mathml

    content = EQUATION.sub(drawn, content)
    for left in LEFT.findall(CODE.sub("", content)):
        log.warning("%s: an equation is not recognised: %s", page.url, left)
    return content


def spaced(mathml: str) -> str:
    """The same, with the spaces of TeX: b cos D, not bcosD, and |x| without any."""
    etree.register_namespace("", "http://www.w3.org/1998/Math/MathML")
    root = etree.fromstring(mathml)
    for row in list(root.iter()):
        if _name(row) == "mo" and row.text == "|":
            row.set("lspace", "0")
            row.set("rspace", "0")
        if _name(row) not in ROWS:
            continue
        children = list(row)
        gaps = [i for i, pair in enumerate(pairwise(children), 1) if _apart(*pair)]
        for i in reversed(gaps):
            space = etree.Element(children[0].tag.split("}")[0] + "}mspace")
            space.set("width", "0.167em")
            row.insert(i, space)
    return etree.tostring(root, encoding="unicode")


def _name(element: etree.Element) -> str:
    return element.tag.split("}")[-1]


def _apart(left: etree.Element, right: etree.Element) -> bool:
    """Whether browsers set no space between both, and TeX does."""
    if "mo" in (_name(left), _name(right)) or "mspace" in (_name(left), _name(right)):
        return False
    return _word(left) or _word(right) or _name(left) == _name(right) == "mn"


def _word(element: etree.Element) -> bool:
    """The name of a function, with or without an index or a power."""
    if _name(element) in SCRIPTS:
        element = element[0]
    return _name(element) == "mi" and len(element.text or "") > 1
