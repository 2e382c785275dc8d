# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Links of the site and of the repository's Markdown: ``python links.py HTML-FOLDER``.

One to a file or a heading that isn't there is an error. Links to the net are listed, not followed.
"""

import re
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

ROOT = Path(__file__).parents[2]
MARKDOWN = "README.md", "CONTRIBUTING.md", "CHANGELOG.md", "CODE_OF_CONDUCT.md", "demos/README.md"


class Page(HTMLParser):
    """Links and anchors of a page."""

    def __init__(self, text: str):
        """Read it."""
        super().__init__()
        self.links: list[str] = []
        self.anchors: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        """Keep what leads somewhere and what can be led to."""
        for name, value in attrs:
            if name in ("href", "src") and value and tag != "link":
                self.links.append(value)
            elif name in ("id", "name") and value:
                self.anchors.add(value)


def of_site(folder: Path) -> Iterator[tuple[Path, str]]:
    """Links of a built site that lead nowhere, and to the net."""
    pages = {f: Page(f.read_text(encoding="utf-8")) for f in sorted(folder.rglob("*.html"))}
    for file, page in pages.items():
        for link in page.links:
            parts = urlsplit(link)
            if parts.scheme or link.startswith("//"):
                yield file, link
                continue
            target = (file.parent / unquote(parts.path)).resolve() if parts.path else file
            anchor = unquote(parts.fragment)
            there = target.is_file() or (target / "index.html").is_file()
            if not there or (anchor and target in pages and anchor not in pages[target].anchors):
                yield file, link


def of_markdown() -> Iterator[tuple[Path, str]]:
    """The same of the repository's Markdown."""
    for file in (ROOT / name for name in MARKDOWN if (ROOT / name).exists()):
        text = re.sub(r"```.*?```", "", file.read_text(encoding="utf-8"), flags=re.DOTALL)
        for link in re.findall(r"\]\(([^)\s]+)\)|<img src=\"([^\"]+)\"", text):
            (link,) = filter(None, link)
            parts = urlsplit(link)
            if parts.scheme:
                yield file, link
            elif parts.path and not (file.parent / parts.path).exists():
                yield file, link


def is_outside(link: str) -> bool:
    """Whether a link leads to the net."""
    return re.match(r"(https?:)?//|mailto:|data:", link) is not None


if __name__ == "__main__":
    found = [*of_site(Path(sys.argv[1]).resolve()), *of_markdown()]
    dead = [(file, link) for file, link in found if not is_outside(link)]
    outside = sorted({link for _, link in found} - {link for _, link in dead})
    print("Links to the net (not followed):", *outside, sep="\n  ")
    for file, link in dead:
        print(f"dead link in {file}: {link}", file=sys.stderr)
    sys.exit(bool(dead))
