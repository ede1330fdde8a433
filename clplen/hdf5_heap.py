"""Global heaps of HDF5: damaged ones that the HDF5 library would walk through for ever.

Strings of variable length lie in collections: "GCOL", version 1, three zeros, the size of the
collection, and objects with index (2 bytes), count (2), 4 zeros, size (8) and data; index 0 is the
free space, and its size counts its head (HDF5 File Format Specification 3.0, section III.E).
"""

from __future__ import annotations

import mmap
import struct
from pathlib import Path

from clplen.errors import FormatError

_START = b"GCOL\1\0\0\0"
_HEAD = 16  # bytes, of a collection and of an object


def require_heaps(path: Path) -> None:
    """Refuse a file with a collection whose objects do not come to an end.

    Parameters
    ----------
    path : pathlib.Path

    Raises
    ------
    FormatError
        If an object takes no place (HDF5 up to 2.0 would read it again and again).
    """
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        start = content.find(_START)
        while start >= 0:
            if _is_endless(content, start):
                raise FormatError(
                    f"{path}: the texts at byte {start:,} are damaged: copy or write it again."
                )
            start = content.find(_START, start + 1)


def _is_endless(content: mmap.mmap, start: int) -> bool:
    end = len(content)
    if start + _HEAD > end:
        return False
    (size,) = struct.unpack_from("<Q", content, start + 8)
    end = min(end, start + size)
    place = start + _HEAD
    while place + _HEAD <= end:
        index, size = struct.unpack_from("<H6xQ", content, place)
        step = size if index == 0 else _HEAD + (size + 7) // 8 * 8
        if step == 0:
            return True
        place += step
    return False
