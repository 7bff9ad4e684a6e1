"""Follows every link inside the built site: `python docs/check_links.py docs/_build/html`; exits with 1 for a dead one.

Sphinx warns of links between pages that it wrote. This looks at what a browser gets: files and anchors of each `href`
and `src`. Links that leave the site are counted, not followed.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit


class Page(HTMLParser):
    """What a page links to, and the anchors that it has."""

    def __init__(self, text: str) -> None:
        """Read a page."""
        super().__init__()
        self.links: list[str] = []
        self.anchors: set[str] = {"", "top"}
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note links and anchors."""
        for name, value in attrs:
            if name in ("href", "src") and value is not None:
                self.links.append(value)
            elif name in ("id", "name") and value:
                self.anchors.add(value)


def dead_links(site: Path) -> Iterator[str]:
    """One sentence for each link to a file or anchor that the site does not have."""
    pages = {path.resolve(): Page(path.read_text(encoding="utf-8")) for path in sorted(site.rglob("*.html"))}
    for path, page in pages.items():
        for link in dict.fromkeys(page.links):
            parts = urlsplit(link)
            if parts.scheme or parts.netloc or (link.startswith("#") and parts.fragment in page.anchors):
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            target = target / "index.html" if target.is_dir() else target
            name = path.relative_to(site.resolve())
            if not target.is_file():
                yield f"{name}: {link}: no such file"
            elif target in pages and unquote(parts.fragment) not in pages[target].anchors:
                yield f"{name}: {link}: no such anchor"


def main(site: Path) -> int:
    """Print the dead links of a site; returns the exit code."""
    if not (site / "index.html").is_file():
        print(f"{site}: expected a built site, there is no index.html", file=sys.stderr)
        return 2
    dead = list(dead_links(site))
    print("\n".join(dead) or f"{site}: every internal link leads somewhere")
    return 1 if dead else 0


if __name__ == "__main__":
    raise SystemExit(main(Path(sys.argv[1])))
