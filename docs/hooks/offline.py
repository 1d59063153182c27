"""The site fetches nothing: pictures, scripts and styles come with it."""

import logging
import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig

log = logging.getLogger("mkdocs.hooks.offline")

FETCHED = re.compile(
    r'<(?:script|link|img|iframe|source|object)\b[^>]*\s(?:src|href|data)="(?:https?:)?//'
)


def on_post_build(config: MkDocsConfig) -> None:
    """Look at every page for what a browser would fetch from elsewhere."""
    site = Path(config.site_dir)
    pages = sorted(site.rglob("*.html"))
    for path in pages:
        for found in FETCHED.finditer(path.read_text()):
            log.warning("%s fetches %s...", path.relative_to(site), found[0])
    log.info("%d pages, none of which may fetch anything", len(pages))
