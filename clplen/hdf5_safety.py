"""HDF5 files of unknown origin: refused where they lead to other files, or nowhere.

External links, external storage and virtual datasets name any file of the machine; links of user's
own classes are followed by programs that HDF5 loads. Damaged global heaps keep the HDF5 library in
an endless loop: strings of variable length lie in collections, "GCOL", version 1, three zeros, the
size of the collection, and objects with index (2 bytes), count (2), 4 zeros, size (8) and data;
index 0 is the free space, and its size counts its head (HDF5 File Format Specification 3.0,
section III.E).
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

MAX_OBJECTS = 20_000  # links of a file: listed in about a second
MAX_DEPTH = 256  # levels of groups: HDF5's time grows with their square
_START = b"GCOL\1\0\0\0"
_HEAD = 16  # bytes, of a collection and of an object
_INSIDE = (h5py.h5l.TYPE_HARD, h5py.h5l.TYPE_SOFT)


def require_own(file: h5py.File, path: Path) -> None:
    """Refuse a file that holds a link to another file, or samples that lie in one."""
    for name, dataset in members(file, path):
        if dataset is None:
            raise FormatError(f"{path}: {name!r} is a link to another file: bring them into one.")
        made = dataset.get_create_plist()
        if made.get_layout() == h5py.h5d.VIRTUAL or made.get_external_count():
            raise FormatError(
                f"{path}: the samples of {name!r} lie in other files: bring them into one."
            )


def members(file: h5py.File, path: Path) -> Iterator[tuple[str, h5py.h5d.DatasetID | None]]:
    """Every dataset of a file once, and every link that leads out of it."""
    seen = {_address(file.id, b".")}
    groups = [(file.id, b"", 1)]  # opened from their own group: HDF5 resolves no long path
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
            raise FormatError(f"{path} holds more than {limits}: copy its data to a new file.")
        for link, kind in links:
            whole = f"{prefix}/{_text(link)}".lstrip("/")
            if kind not in _INSIDE:
                yield whole, None
            if kind != h5py.h5l.TYPE_HARD or (address := _address(group, link)) in seen:
                continue
            seen.add(address)
            if address[2] == h5py.h5o.TYPE_GROUP:
                groups.append((group, link, depth + 1))
            elif address[2] == h5py.h5o.TYPE_DATASET:
                yield whole, h5py.h5d.open(group, link)


def _address(group: Any, name: bytes) -> tuple[int, int, int]:
    """Where an object lies, and its type."""
    info = h5py.h5o.get_info(group, name)
    return info.fileno, info.addr, info.type


def _text(name: Any) -> str:
    return name.decode("utf-8", "replace") if isinstance(name, bytes) else str(name)


def require_heaps(path: Path) -> None:
    """Refuse a file with a collection whose objects do not come to an end."""
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        for first, end in _stored(file.fileno(), len(content)):
            start = content.find(_START, first, end)
            while start >= 0:
                if _is_endless(content, start):
                    raise FormatError(
                        f"{path}: the texts at byte {start:,} are damaged: copy or write it again."
                    )
                start = content.find(_START, start + 1, end)


def _stored(descriptor: int, size: int) -> Iterator[tuple[int, int]]:
    """First and last byte of what a file stores, without its holes, which hold zeros."""
    end = 0
    while end < size:
        try:
            start = os.lseek(descriptor, end, os.SEEK_DATA)
            end = os.lseek(descriptor, start, os.SEEK_HOLE)
        except (AttributeError, OSError) as error:  # unknown to the system; only a hole is left
            if getattr(error, "errno", None) == errno.ENXIO:
                return
            start, end = end, size
        yield start, min(end + len(_START), size)  # zeros of a mark may lie in a hole


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
