"""Looks at the finished pages: every link leads somewhere, and nothing is fetched.

MkDocs itself knows the links in Markdown; here are those in docstrings, notebooks and
templates as well, with their anchors. Pictures, scripts and styles come with the site.
"""

import logging
import re
from pathlib import Path
from urllib.parse import unquote

from mkdocs.config.defaults import MkDocsConfig

log = logging.getLogger("mkdocs.hooks.links")

FETCHED = re.compile(
    r'<(?:script|link|img|iframe|source|object)\b[^>]*\s(?:src|href|data)="(?:https?:)?//'
)
TARGET = re.compile(r'\s(?:href|src)="([^"]*)"')
ANCHOR = re.compile(r'\sid="([^"]+)"')
ELSEWHERE = ("http:", "https:", "mailto:", "data:", "javascript:")


def on_post_build(config: MkDocsConfig) -> None:
    """Read all pages once."""
    site = Path(config.site_dir)
    texts = {path.resolve(): path.read_text() for path in sorted(site.rglob("*.html"))}
    anchors = {path: {"", *ANCHOR.findall(text)} for path, text in texts.items()}
    links = 0
    for path, text in texts.items():
        name = path.relative_to(site.resolve())
        for fetched in FETCHED.finditer(text):
            log.warning("%s fetches %s...", name, fetched[0])
        if name.name == "404.html":  # is shown at any address: its links are absolute
            continue
        for target in {t for t in TARGET.findall(text) if not t.startswith(ELSEWHERE)}:
            links += 1
            file, _, anchor = unquote(target).partition("#")
            there = (path.parent / file).resolve() if file else path
            if there.is_dir():
                there /= "index.html"
            if not there.exists():
                log.warning("%s: nothing is at %s", name, target)
            elif there in anchors and anchor not in anchors[there]:
                log.warning("%s: no anchor at %s", name, target)
    log.info("%d pages with %d links within the site", len(texts), links)
