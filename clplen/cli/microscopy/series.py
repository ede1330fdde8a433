"""Frames on the command line: files, and TIFFs of several."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import click


@dataclass(frozen=True)
class Page:
    """A frame: a file, or one of several in a TIFF."""

    path: Path
    number: int | None = None

    @property
    def name(self) -> str:
        """Of its volume."""
        return self.path.stem if self.number is None else f"{self.path.stem}_{self.number:04d}"

    def __str__(self) -> str:
        return str(self.path) if self.number is None else f"{self.path}, frame {self.number}"


def pages_of(path: Path) -> list[Page]:
    """The frames of a file, in order."""
    from clplen.io.formats.tiff import frames_in
    from clplen.io.results.volume_files import is_volume

    if is_volume(path):
        raise click.UsageError(f"{path} is a volume, as clplen writes them: give raw frames.")
    count = frames_in(path)
    return [Page(path)] if count == 1 else [Page(path, number) for number in range(count)]
