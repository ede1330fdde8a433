"""HDF5 files of unknown origin: refused where they lead to other files, or nowhere.

External links, external storage and virtual datasets name any file of the machine; links of user's
own classes are followed by programs that HDF5 loads. Damaged global heaps keep the HDF5 library in
an endless loop: strings of variable length lie in collections, "GCOL", version 1, three zeros, the
size of the collection, and objects with index (2 bytes), count (2), 4 zeros, size (8) and data;
index 0 is the free space, and its size counts its head (HDF5 File Format Specification 3.0,
section III.E).
"""

from __future__ import annotations

import mmap
import struct
from pathlib import Path
from typing import Any

import h5py

from clplen.errors import FormatError

_START = b"GCOL\1\0\0\0"
_HEAD = 16  # bytes, of a collection and of an object
_INSIDE = (h5py.h5l.TYPE_HARD, h5py.h5l.TYPE_SOFT)


def require_own(file: h5py.File, path: Path) -> None:
    """Refuse a file that holds a link to another file, or samples that lie in one.

    Parameters
    ----------
    file : h5py.File
        Open.
    path : pathlib.Path
        For the message.

    Raises
    ------
    FormatError
        Naming the link or dataset.
    """

    def foreign_link(name: Any, info: Any) -> str | None:
        return None if info.type in _INSIDE else _text(name)

    named = file.id.links.visit(foreign_link, info=True)
    if named is not None:
        raise FormatError(f"{path}: {named!r} is a link to another file: bring them into one.")

    def foreign_samples(name: str, item: Any) -> str | None:
        is_foreign = isinstance(item, h5py.Dataset) and (item.is_virtual or item.external)
        return name if is_foreign else None

    named = file.visititems(foreign_samples)
    if named is not None:
        raise FormatError(
            f"{path}: the samples of {named!r} lie in other files: bring them into one."
        )


def _text(name: Any) -> str:
    return name.decode("utf-8", "replace") if isinstance(name, bytes) else str(name)


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
