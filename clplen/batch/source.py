"""Where the light field of an item comes from, in names and numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Source:
    """One light field of a job.

    Attributes
    ----------
    name : str
        Of its item.
    words : dict
        ``kind`` and all that decides the light field, but for the content of the files.
    files : tuple of str
        What is read, seen from the folder of the job.
    """

    name: str
    words: dict[str, Any]
    files: tuple[str, ...] = ()
