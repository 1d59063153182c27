"""What a package index shows, from the address of the repository in pyproject.toml."""

import re
from pathlib import Path

from hatchling.metadata.plugin.interface import MetadataHookInterface


class IndexPage(MetadataHookInterface):
    """Addresses, and the README with links that lead from an index's page."""

    def update(self, metadata: dict) -> None:
        """Fill in what pyproject.toml calls dynamic."""
        address = self.config["repository"]
        metadata["urls"] = {
            "Homepage": address,
            "Repository": address,
            "Issues": f"{address}/issues",
            "Changelog": f"{address}/blob/main/CHANGELOG.md",
        }
        # pictures and files are beside the README in the repository, not on the index
        text = (Path(self.root) / "README.md").read_text(encoding="utf-8")
        link = re.compile(r"\]\((?!https?://|#)([^)]+)\)")

        def from_outside(match: re.Match) -> str:
            kind = "raw" if match[1].endswith((".png", ".svg")) else "blob"
            return f"]({address}/{kind}/main/{match[1]})"

        metadata["readme"] = {
            "content-type": "text/markdown",
            "text": link.sub(from_outside, text),
        }
