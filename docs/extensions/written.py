"""Pages that are generated before Sphinx reads the others."""

from __future__ import annotations

from pathlib import Path


def write_page(path: Path, text: str) -> None:
    """Write a page where its text is another one, so that only what changed is read again."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.is_file() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


def remove_others(folder: Path, pages: set[Path]) -> None:
    """Remove pages of names that are gone."""
    for path in folder.glob("*"):
        if path.is_file() and path not in pages:
            path.unlink()
