"""How much memory a file may ask for: a few bytes must not claim gigabytes."""

from __future__ import annotations

from pathlib import Path

from clplen.compute.hostmemory import free_memory
from clplen.errors import FormatError

DEFLATE = 1032.0  # largest ratio of zlib, gzip, zip and PNG (RFC 1951: 258 bytes from 2 bits)
SLACK = 1 << 20  # bytes that any file may ask for


def require_bytes(
    wanted: int, *, path: Path, what: str, stored: int, ratio: float, max_bytes: int | None
) -> None:
    """Refuse a size that a file declares but cannot hold, or that would fill the memory.

    Parameters
    ----------
    wanted : int
        Bytes that would be allocated.
    path : pathlib.Path
    what : str
        What they would be, as the subject of a sentence: "the dataset 'LF'".
    stored : int
        Bytes that the file has for it.
    ratio : float
        Largest ratio of its compression; 1 for what is not compressed.
    max_bytes : int or None
        Largest allocation; None for half of the free memory.

    Raises
    ------
    FormatError
        Naming the file, the size and the limit.
    """
    if wanted < 0 or wanted > stored * ratio + SLACK:
        raise FormatError(
            f"{path}: {what} declares {wanted:,} bytes, more than {stored:,} stored bytes can "
            "hold: the file is damaged."
        )
    limit = free_memory() // 2 if max_bytes is None else max_bytes
    if wanted > limit:
        rule = "half of the free memory" if max_bytes is None else "the given limit"
        raise FormatError(
            f"{path}: {what} needs {wanted:,} bytes, more than {limit:,} ({rule}): raise "
            "max_bytes= if that is meant."
        )
