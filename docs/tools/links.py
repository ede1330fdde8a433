"""Check every page of the built site: python docs/tools/links.py site

Relative links lead to a file of the site, and fragments to an element of that page. Pages load no
file from the network. Printed output of tutorials holds no warning of a library or a compiler.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

LOADED = {"img": "src", "script": "src", "source": "src", "video": "src", "iframe": "src"}
_OUTPUT = re.compile(r'<div class="output (?:stream|stderr|traceback).*?</pre>', re.DOTALL)
_WARNING = re.compile(
    r"[^\n>]*(?:warning\b|deprecat|PoCL's compiler|compiler of PoCL)[^\n<]*", re.IGNORECASE
)


class Page(HTMLParser):
    """Links, identifiers and printed warnings of a page."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        text = path.read_text(encoding="utf-8")
        self.warnings = [line for box in _OUTPUT.findall(text) for line in _WARNING.findall(box)]
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.ids: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Collect what a tag names."""
        given = {name: value for name, value in attrs if value is not None}
        self.ids |= {given[name] for name in ("id", "name") if name in given}
        if tag == "a" and "href" in given:
            self.links.append(given["href"])
        if tag == "link" and given.get("rel") in ("stylesheet", "icon", "preload"):
            self.loaded.append(given["href"])
        if tag in LOADED and LOADED[tag] in given:
            self.loaded.append(given[LOADED[tag]])


def faults(site: Path) -> Iterator[str]:
    """Yield a sentence for every broken link and every printed warning."""
    files = [path for path in sorted(site.rglob("*.html")) if "_static" not in path.parts]
    pages = {path.resolve(): Page(path) for path in files}
    for path, page in pages.items():
        where = path.relative_to(site.resolve())
        for line in page.warnings:
            yield f"{where} prints {line.strip()}"
        for link in page.loaded:
            if urlsplit(link).netloc:
                yield f"{where} loads {link} from the net"
        for link in {*page.links, *page.loaded}:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if not target.is_file():
                yield f"{where} links to {link}, and there is no such file"
            elif target in pages and parts.fragment:
                known = pages[target].ids
                if unquote(parts.fragment) not in known:
                    yield f"{where} links to {link}, and there is no such place"


def main() -> None:
    """Print the faults of a site; the exit status is 1 if there are any."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("site", type=Path)
    site = parser.parse_args().site
    found = list(faults(site))
    count = len(list(site.rglob("*.html")))
    print(*found, f"{count} pages, {len(found)} faults", sep="\n")
    raise SystemExit(bool(found) or not count)


if __name__ == "__main__":
    main()
