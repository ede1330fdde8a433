"""Reject HDF5 files of unknown origin that lead to other files or loop for ever.

External links, external storage and virtual datasets may name any file of the machine; HDF5 loads
plugins to follow user-defined links. A damaged global heap puts the HDF5 library into an endless
loop. A heap collection starts with "GCOL", version 1, three zeros and its size. Its objects have an
index (2 bytes), count (2), 4 zeros, size (8) and data; index 0 is free space, whose size includes
its header (HDF5 File Format Specification 3.0, section III.E).
"""

from __future__ import annotations

import errno
import mmap
import os
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py

from clplen.errors import FormatError

MAX_OBJECTS = 20_000  # links of a file; HDF5 lists them in about a second
MAX_DEPTH = 256  # levels of groups; HDF5's time grows with their square
_SIGNATURE = b"GCOL\1\0\0\0"
_HEADER_BYTES = 16  # header of a collection and of an object
_INTERNAL_LINKS = (h5py.h5l.TYPE_HARD, h5py.h5l.TYPE_SOFT)


def require_internal(file: h5py.File, path: Path) -> None:
    """Raise FormatError if a file links to another file or stores samples in it."""
    for name, dataset in members(file, path):
        if dataset is None:
            raise FormatError(
                f"{path}: {name!r} is a link to another file: copy its data into this file."
            )
        properties = dataset.get_create_plist()
        if properties.get_layout() == h5py.h5d.VIRTUAL or properties.get_external_count():
            raise FormatError(
                f"{path}: the samples of {name!r} are stored in other files: copy them into this "
                "file."
            )


def members(file: h5py.File, path: Path) -> Iterator[tuple[str, h5py.h5d.DatasetID | None]]:
    """Yield every dataset of a file once, and None for every link to another file."""
    visited = {_address(file.id, b".")}
    groups = [(file.id, b"", 1)]  # each is opened from its parent: HDF5 limits the path length
    count = 0
    while groups:
        parent, name, depth = groups.pop()
        group = h5py.h5g.open(parent, name or b".")
        prefix = _text(h5py.h5i.get_name(group) or b"").strip("/")
        links: list[tuple[bytes, int]] = []

        def add(link: bytes, info: Any, links: list[tuple[bytes, int]] = links) -> bool | None:
            links.append((link, info.type))
            return True if len(links) > MAX_OBJECTS else None

        group.links.iterate(add, info=True)
        count += len(links)
        if count > MAX_OBJECTS or depth > MAX_DEPTH:
            limits = f"{MAX_OBJECTS:,} links or {MAX_DEPTH} levels of groups"
            raise FormatError(f"{path} has more than {limits}: copy its data to a new file.")
        for link, kind in links:
            full_name = f"{prefix}/{_text(link)}".lstrip("/")
            if kind not in _INTERNAL_LINKS:
                yield full_name, None
            if kind != h5py.h5l.TYPE_HARD or (address := _address(group, link)) in visited:
                continue
            visited.add(address)
            if address[2] == h5py.h5o.TYPE_GROUP:
                groups.append((group, link, depth + 1))
            elif address[2] == h5py.h5o.TYPE_DATASET:
                yield full_name, h5py.h5d.open(group, link)


def _address(group: Any, name: bytes) -> tuple[int, int, int]:
    """Return the file number, address and type of an object."""
    info = h5py.h5o.get_info(group, name)
    return info.fileno, info.addr, info.type


def _text(name: Any) -> str:
    return name.decode("utf-8", "replace") if isinstance(name, bytes) else str(name)


def require_heaps(path: Path) -> None:
    """Raise FormatError if the objects of a heap collection form an endless loop."""
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        for first, end in _extents(file.fileno(), len(content)):
            start = content.find(_SIGNATURE, first, end)
            while start >= 0:
                if _is_endless(content, start):
                    raise FormatError(
                        f"{path}: the strings at byte {start:,} are damaged: download or write the "
                        "file again."
                    )
                start = content.find(_SIGNATURE, start + 1, end)


def _extents(descriptor: int, size: int) -> Iterator[tuple[int, int]]:
    """Yield the first and last byte of every stored extent; holes contain zeros."""
    end = 0
    while end < size:
        try:
            start = os.lseek(descriptor, end, os.SEEK_DATA)
            end = os.lseek(descriptor, start, os.SEEK_HOLE)
        except (AttributeError, OSError) as error:  # not supported; or only a hole remains
            if getattr(error, "errno", None) == errno.ENXIO:
                return
            start, end = end, size
        yield start, min(end + len(_SIGNATURE), size)  # zeros of a signature may fall into a hole


def _is_endless(content: mmap.mmap, start: int) -> bool:
    end = len(content)
    if start + _HEADER_BYTES > end:
        return False
    (size,) = struct.unpack_from("<Q", content, start + 8)
    end = min(end, start + size)
    position = start + _HEADER_BYTES
    while position + _HEADER_BYTES <= end:
        index, size = struct.unpack_from("<H6xQ", content, position)
        step = size if index == 0 else _HEADER_BYTES + (size + 7) // 8 * 8
        if step == 0:
            return True
        position += step
    return False
