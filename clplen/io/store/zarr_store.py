"""Zarr stores of unknown origin, a folder or a zip archive, opened to read and checked on the way.

Metadata are checked when a store is opened (`clplen.io.store.zarr_metadata`), chunks when they are
read: how large a packed chunk becomes is found before it is decoded. blosc, lz4 and zstd allocate
what a chunk declares in its first bytes; gzip, zlib, bz2 and lzma give what comes out, without a
limit. A chunk of a few bytes could so ask for gigabytes.

This module imports zarr; `clplen.io.store.zarr_files` imports it when it is needed.

Formats: blosc, 16 bytes of which 4 to 7 are the size (c-blosc, README_CHUNK_FORMAT); lz4 by
numcodecs, 4 bytes of size; zstd, RFC 8878.
"""

from __future__ import annotations

import bz2
import gzip
import lzma
import os
import warnings
import zipfile
import zlib
from collections.abc import AsyncGenerator, Callable, Iterable, Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any, Literal

import numpy as np
import zarr
from zarr.abc.store import OffsetByteRequest, RangeByteRequest, SuffixByteRequest
from zarr.storage import LocalStore, WrapperStore, ZipStore

from clplen.errors import FormatError
from clplen.files import require_file
from clplen.io.formats.untrusted import DEFLATE, SLACK, Bound, reading
from clplen.io.store.zarr_metadata import Packing, checked_arrays, is_metadata

_PIECE = 1 << 18
_LZMA_MEMORY = 256 << 20  # bytes of the largest dictionary; that of preset 9 is 64 MiB
_ZSTD, _SKIPPED = 0xFD2FB528, 0x184D2A50
_ZSTD_BLOCK = 1 << 17  # bytes of a block, at most
_STORED, _REPEATED = 0, 1  # kinds of a block of zstd
_ROOTS = ("zarr.json", ".zgroup", ".zarray")
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_MAX_METADATA = 1 << 22  # bytes of a file of JSON, which takes some 30 times as much when parsed
_KEPT = 64  # shards whose index is kept
_MISSING = np.uint64(2**64 - 1)  # place of a chunk that a shard does not hold


def require_chunk(content: bytes, packing: Packing, key: str) -> None:
    """Refuse a chunk that becomes larger than its array declares."""
    largest = packing.largest + SLACK
    name = packing.compressor
    if name is None or (name in ("gzip", "zlib") and len(content) * DEFLATE <= largest):
        return
    size = _SIZES[name](content, largest)
    if size > largest:
        raise ValueError(
            f"the chunk {key} declares {size:,} bytes or more for {packing.samples:,} samples"
        )


def _blosc(content: bytes, _: int) -> int:
    return int.from_bytes(content[4:8], "little")


def _lz4(content: bytes, _: int) -> int:
    return int.from_bytes(content[:4], "little")


def _zstd(content: bytes, _: int) -> int:
    """The sum over all frames of what each declares, or of the most that its blocks can hold."""
    total = place = 0
    while place + 5 <= len(content):
        magic = int.from_bytes(content[place : place + 4], "little")
        if magic & ~0xF == _SKIPPED:
            place += 8 + int.from_bytes(content[place + 4 : place + 8], "little")
            continue
        if magic != _ZSTD:
            raise ValueError("no frame of zstd")
        checksum = content[place + 4] & 4  # a flag, and its bytes behind the blocks
        declared, place = _zstd_header(content, place)
        held, place = _zstd_blocks(content, place)
        place += checksum
        total += held if declared is None else declared
    return total


def _zstd_header(content: bytes, place: int) -> tuple[int | None, int]:
    """What a frame declares, None for nothing; and where its first block begins."""
    flags = content[place + 4]
    single, width = flags >> 5 & 1, (0, 2, 4, 8)[flags >> 6]
    width = width or single
    start = place + 5 + (1 - single) + (0, 1, 2, 4)[flags & 3]
    declared = int.from_bytes(content[start : start + width], "little") + 256 * (width == 2)
    return (declared if width else None), start + width


def _zstd_blocks(content: bytes, place: int) -> tuple[int, int]:
    """The most that the blocks of a frame hold, and where the next frame begins."""
    held, last = 0, False
    while not last:
        if place + 3 > len(content):
            raise ValueError("a frame of zstd is truncated")
        head = int.from_bytes(content[place : place + 3], "little")
        last, kind, size = bool(head & 1), head >> 1 & 3, head >> 3
        held += size if kind in (_STORED, _REPEATED) else _ZSTD_BLOCK
        place += 3 + (1 if kind == _REPEATED else size)
    return held, place


def _counted(opened: Callable[[BytesIO], Any]) -> Callable[[bytes, int], int]:
    """A function that decompresses piece by piece and counts, up to a limit."""

    def size_of(content: bytes, largest: int) -> int:
        total = 0
        with opened(BytesIO(content)) as stream:
            while total <= largest and (piece := stream.read(_PIECE)):
                total += len(piece)
        return total

    return size_of


def _zlib(content: bytes, largest: int) -> int:
    return _inflated(zlib.decompressobj(), content, largest)[0]


def _lzma(content: bytes, largest: int) -> int:
    total = 0
    while content.strip(b"\0") and total <= largest:
        stream = lzma.LZMADecompressor(memlimit=_LZMA_MEMORY)
        held, content = _inflated(stream, content, largest - total)
        total += held
    return total


def _inflated(stream: Any, content: bytes, largest: int) -> tuple[int, bytes]:
    """Bytes that come out of a stream, up to a limit, and what lies behind it."""
    total, data = 0, content
    while not stream.eof and total <= largest:
        piece = stream.decompress(data, _PIECE)
        data = getattr(stream, "unconsumed_tail", b"")
        total += len(piece)
        if not piece:
            break
    return total, stream.unused_data


_SIZES: dict[str, Callable[[bytes, int], int]] = {
    "blosc": _blosc,
    "lz4": _lz4,
    "zstd": _zstd,
    "gzip": _counted(lambda file: gzip.GzipFile(fileobj=file)),
    "bz2": _counted(bz2.BZ2File),
    "zlib": _zlib,
    "lzma": _lzma,
}


@contextmanager
def open_store(path: Path, max_bytes: int | None = None) -> Iterator[Any]:
    """The root of a store to read, a group or an array, after a look at its metadata."""
    require_file(path, "Zarr store", folder=True)
    with reading(path):
        if path.is_dir():
            sizes = _files(path)
            arrays = checked_arrays(_metadata_of_folder(path, sizes), path, _format(sizes))
            inner: Any = LocalStore(path, read_only=True)
        else:
            with zipfile.ZipFile(path) as archive:
                sizes = _members(archive, path, max_bytes)
                arrays = checked_arrays(_metadata_of_archive(archive), path, _format(sizes))
            inner = ZipStore(path, mode="r")
        _require_members(sizes, arrays, path)
        if not any(root in sizes for root in _ROOTS):
            raise FormatError(f"{path} is no Zarr store: it holds none of {', '.join(_ROOTS)}.")
        store = CheckedStore(inner, sizes, arrays)
        root = _root(store)
    try:
        yield root
    finally:
        store.close()


def _format(sizes: dict[str, int]) -> Literal[2, 3]:
    """The format of a store, by its root."""
    return 3 if "zarr.json" in sizes else 2


def _root(store: CheckedStore) -> Any:
    """The root, by its own metadata and not by the copies in those of a group."""
    form = _format(store.sizes)
    with warnings.catch_warnings():  # about types and extensions that no light field has
        warnings.simplefilter("ignore")
        if "" in store.arrays:
            return zarr.open_array(store, mode="r", zarr_format=form)
        return zarr.open_group(store, mode="r", zarr_format=form, use_consolidated=False)


def _files(root: Path) -> dict[str, int]:
    """Bytes of every file of a folder, by its key."""
    inside, sizes, folders = root.resolve(), {}, [root]
    while folders:
        with os.scandir(folders.pop()) as entries:
            for entry in entries:
                if entry.is_symlink() and not Path(entry.path).resolve().is_relative_to(inside):
                    raise FormatError(
                        f"{root}: {entry.name!r} is a link to something outside of it: copy what "
                        "it leads to."
                    )
                if entry.is_dir():
                    if entry.is_symlink():
                        raise FormatError(f"{root}: {entry.name!r} is a link to a folder: copy it.")
                    folders.append(Path(entry.path))
                elif not entry.is_file():
                    raise FormatError(f"{root}: {entry.name!r} is neither a file nor a folder.")
                else:
                    sizes[Path(entry.path).relative_to(root).as_posix()] = entry.stat().st_size
    return sizes


def _metadata_of_folder(root: Path, sizes: dict[str, int]) -> Iterator[tuple[str, bytes]]:
    for key in filter(is_metadata, sizes):
        _require_metadata(key, sizes[key], root)
        yield key, (root / key).read_bytes()


def _metadata_of_archive(archive: zipfile.ZipFile) -> Iterator[tuple[str, bytes]]:
    for item in archive.infolist():  # of the same name, each one
        if is_metadata(item.filename):
            _require_metadata(item.filename, item.file_size, Path(archive.filename or ""))
            yield item.filename, archive.read(item)


def _require_metadata(key: str, size: int, path: Path) -> None:
    """Refuse metadata that are larger than those of any store."""
    if size > _MAX_METADATA:
        raise FormatError(
            f"{path}: its member {key[:200]!r} declares {size:,} bytes, metadata have at most "
            f"{_MAX_METADATA:,}: the file is damaged."
        )


def _members(archive: zipfile.ZipFile, path: Path, max_bytes: int | None) -> dict[str, int]:
    """Bytes of every member of an archive, none of which inflates to more than it can hold."""
    size, sizes = path.stat().st_size, {}
    for item in archive.infolist():
        what = f"its member {item.filename[:200]!r}"
        if item.compress_size > size:
            raise FormatError(
                f"{path}: {what} of {item.compress_size:,} bytes is larger than the file of "
                f"{size:,}: the file is damaged."
            )
        if item.compress_type not in _METHODS:
            raise FormatError(
                f"{path}: {what} is compressed by method {item.compress_type}: write the archive "
                "with deflate."
            )
        Bound(path, item.compress_size, DEFLATE, max_bytes).require(item.file_size, what)
        sizes[item.filename] = item.file_size
    return sizes


def _require_members(sizes: dict[str, int], arrays: dict[str, Packing], path: Path) -> None:
    """Refuse members that are larger than the chunks that they hold."""
    for key, size in sizes.items():
        packing = None if is_metadata(key) else _packing_of(key, arrays)
        if packing is None:
            continue
        largest = max(packing.shard, 1) * packing.largest + packing.index_bytes
        if size > largest + SLACK:
            raise FormatError(
                f"{path}: its member {key[:200]!r} declares {size:,} bytes, a chunk there has at "
                f"most {largest:,}: the file is damaged."
            )


def _packing_of(key: str, arrays: dict[str, Packing]) -> Packing | None:
    """The packing of the array that a chunk belongs to."""
    folder = key
    while folder:
        folder = folder.rpartition("/")[0]
        if folder in arrays:
            return arrays[folder]
    return None


class CheckedStore(WrapperStore[Any]):
    """A store that gives no chunk that would become larger than its array declares.

    Attributes
    ----------
    sizes, arrays
        As given.
    """

    def __init__(self, store: Any, sizes: dict[str, int], arrays: dict[str, Packing]) -> None:
        super().__init__(store)
        self.sizes = sizes
        self.arrays = arrays
        self._indices: dict[str, np.ndarray[Any, Any]] = {}

    def _with_store(self, store: Any) -> CheckedStore:
        return CheckedStore(store, self.sizes, self.arrays)

    async def get(self, key: str, prototype: Any, byte_range: Any = None) -> Any:
        """What lies under a key, after a look at its chunks."""
        found = await super().get(key, prototype, byte_range)
        packing = None if is_metadata(key) else _packing_of(key, self.arrays)
        if found is None or packing is None or packing.compressor is None:
            return found
        content = found.to_bytes()
        if not packing.shard:
            require_chunk(content, packing, key)
            return found
        start = self._start(key, byte_range)
        end = start + len(content)
        places, sizes = (await self._index(key, packing, prototype)).T
        inside = (places >= start) & (places < end) & (sizes <= len(content))
        inside &= places + sizes <= end
        for place, size in zip(places[inside].tolist(), sizes[inside].tolist(), strict=True):
            require_chunk(content[place - start : place - start + size], packing, key)
        return found

    async def get_partial_values(
        self, prototype: Any, key_ranges: Iterable[tuple[str, Any]]
    ) -> list[Any]:
        """Parts of several keys, each as `get` gives it."""
        return [await self.get(key, prototype, part) for key, part in key_ranges]

    async def _get_many(
        self, requests: Iterable[tuple[str, Any, Any]]
    ) -> AsyncGenerator[tuple[str, Any], None]:
        for key, prototype, part in requests:
            yield key, await self.get(key, prototype, part)

    def _start(self, key: str, byte_range: Any) -> int:
        """The first byte of a range."""
        if isinstance(byte_range, RangeByteRequest):
            return int(byte_range.start)
        if isinstance(byte_range, OffsetByteRequest):
            return int(byte_range.offset)
        if isinstance(byte_range, SuffixByteRequest):
            return max(self.sizes.get(key, 0) - int(byte_range.suffix), 0)
        return 0

    async def _index(self, key: str, packing: Packing, prototype: Any) -> np.ndarray[Any, Any]:
        """Place and size of the chunks that a shard holds, shape (chunks, 2)."""
        if key not in self._indices:
            size = packing.index_bytes
            if size > self.sizes.get(key, 0):
                raise ValueError(f"the shard {key} is shorter than its index of {size:,} bytes")
            wanted = RangeByteRequest(0, size) if packing.index_first else SuffixByteRequest(size)
            found: Any = await super().get(key, prototype, wanted)
            pairs = np.frombuffer(found.to_bytes(), "<u8", 2 * packing.shard).reshape(-1, 2)
            if len(self._indices) >= _KEPT:
                self._indices.clear()
            self._indices[key] = pairs[(pairs != _MISSING).any(axis=1)]
        return self._indices[key]
