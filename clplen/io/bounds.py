"""How much memory a file may ask for: a few bytes must not claim gigabytes."""

from __future__ import annotations

import os
from pathlib import Path

from clplen.errors import FormatError

DEFLATE = 1032.0  # largest ratio of zlib, gzip, zip and PNG (RFC 1951: 258 bytes from 2 bits)
SLACK = 1 << 20  # bytes that any file may ask for
_UNKNOWN = 4 << 30  # where a system does not say how much memory is free


def free_memory() -> int:
    """Bytes of host memory that are free now."""
    try:
        with Path("/proc/meminfo").open(encoding="ascii") as file:
            for line in file:
                if line.startswith("MemAvailable:"):
                    return 1024 * int(line.split()[1])
    except (OSError, ValueError):
        pass
    try:
        return os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):
        return _UNKNOWN


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
