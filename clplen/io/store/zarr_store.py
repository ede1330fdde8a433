"""Open untrusted Zarr stores, folders or zip archives, and check them while reading.

Metadata are checked when a store is opened (`clplen.io.store.zarr_metadata`), chunks when they are
read: the decoded size of a chunk is determined before it is decoded. blosc, lz4 and zstd allocate
the size declared in the first bytes; gzip, zlib, bz2 and lzma have no limit. A chunk of a few bytes
could therefore ask for gigabytes.

This module imports zarr; `clplen.io.store.zarr_files` imports it when it is needed.

Formats: blosc, a header of 16 bytes with the size in bytes 4 to 7 (c-blosc, README_CHUNK_FORMAT);
lz4 of numcodecs, a header of 4 bytes with the size; zstd, RFC 8878.
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

_PIECE_BYTES = 1 << 18  # decompressed at a time
_MAX_LZMA_MEMORY = 256 << 20  # bytes; preset 9 needs 64 MiB
_ZSTD, _SKIPPABLE = 0xFD2FB528, 0x184D2A50
_MAX_ZSTD_BLOCK = 1 << 17  # bytes of a block (RFC 8878)
_STORED, _REPEATED = 0, 1  # block types of zstd
_ROOTS = ("zarr.json", ".zgroup", ".zarray")
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_MAX_METADATA = 1 << 22  # bytes of a JSON file; parsing takes some 30 times as much memory
_MAX_INDICES = 64  # shard indices kept in memory
_MISSING = np.uint64(2**64 - 1)  # offset of a missing chunk in a shard index


def require_chunk(content: bytes, packing: Packing, key: str) -> None:
    """Raise ValueError if a chunk decodes to more than its array declares."""
    largest = packing.largest + SLACK
    name = packing.compressor
    if name is None or (name in ("gzip", "zlib") and len(content) * DEFLATE <= largest):
        return
    size = _SIZES[name](content, largest)
    if size > largest:
        raise ValueError(
            f"the chunk {key} declares at least {size:,} bytes for {packing.samples:,} samples"
        )


def _blosc(content: bytes, _: int) -> int:
    return int.from_bytes(content[4:8], "little")


def _lz4(content: bytes, _: int) -> int:
    return int.from_bytes(content[:4], "little")


def _zstd(content: bytes, _: int) -> int:
    """Return the decoded size of all frames, as declared or bounded by their blocks."""
    total = position = 0
    while position + 5 <= len(content):
        magic = int.from_bytes(content[position : position + 4], "little")
        if magic & ~0xF == _SKIPPABLE:
            position += 8 + int.from_bytes(content[position + 4 : position + 8], "little")
            continue
        if magic != _ZSTD:
            raise ValueError("a frame of zstd has a wrong magic number")
        checksum = content[position + 4] & 4  # flag; equals the checksum bytes after the blocks
        declared, position = _zstd_header(content, position)
        bound, position = _zstd_blocks(content, position)
        position += checksum
        total += bound if declared is None else declared
    return total


def _zstd_header(content: bytes, position: int) -> tuple[int | None, int]:
    """Return the declared size of a frame, or None, and the offset of its first block."""
    flags = content[position + 4]
    single, width = flags >> 5 & 1, (0, 2, 4, 8)[flags >> 6]
    width = width or single
    start = position + 5 + (1 - single) + (0, 1, 2, 4)[flags & 3]
    declared = int.from_bytes(content[start : start + width], "little") + 256 * (width == 2)
    return (declared if width else None), start + width


def _zstd_blocks(content: bytes, position: int) -> tuple[int, int]:
    """Return the largest decoded size of the blocks of a frame, and the next frame's offset."""
    bound, last = 0, False
    while not last:
        if position + 3 > len(content):
            raise ValueError("a frame of zstd is truncated")
        head = int.from_bytes(content[position : position + 3], "little")
        last, kind, size = bool(head & 1), head >> 1 & 3, head >> 3
        bound += size if kind in (_STORED, _REPEATED) else _MAX_ZSTD_BLOCK
        position += 3 + (1 if kind == _REPEATED else size)
    return bound, position


def _stream_counter(opened: Callable[[BytesIO], Any]) -> Callable[[bytes, int], int]:
    """Return a function that decompresses piece by piece and counts bytes up to a limit."""

    def size_of(content: bytes, largest: int) -> int:
        total = 0
        with opened(BytesIO(content)) as stream:
            while total <= largest and (piece := stream.read(_PIECE_BYTES)):
                total += len(piece)
        return total

    return size_of


def _zlib(content: bytes, largest: int) -> int:
    return _count_inflated(zlib.decompressobj(), content, largest)[0]


def _lzma(content: bytes, largest: int) -> int:
    total = 0
    while content.strip(b"\0") and total <= largest:
        stream = lzma.LZMADecompressor(memlimit=_MAX_LZMA_MEMORY)
        count, content = _count_inflated(stream, content, largest - total)
        total += count
    return total


def _count_inflated(stream: Any, content: bytes, largest: int) -> tuple[int, bytes]:
    """Return the number of decompressed bytes, up to a limit, and the remaining input."""
    total, data = 0, content
    while not stream.eof and total <= largest:
        piece = stream.decompress(data, _PIECE_BYTES)
        data = getattr(stream, "unconsumed_tail", b"")
        total += len(piece)
        if not piece:
            break
    return total, stream.unused_data


_SIZES: dict[str, Callable[[bytes, int], int]] = {
    "blosc": _blosc,
    "lz4": _lz4,
    "zstd": _zstd,
    "gzip": _stream_counter(lambda file: gzip.GzipFile(fileobj=file)),
    "bz2": _stream_counter(bz2.BZ2File),
    "zlib": _zlib,
    "lzma": _lzma,
}


@contextmanager
def open_store(path: Path, max_bytes: int | None = None) -> Iterator[Any]:
    """Check the metadata of a store, open it to read and yield its root."""
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
            raise FormatError(f"{path} is not a Zarr store: it has none of {', '.join(_ROOTS)}.")
        store = CheckedStore(inner, sizes, arrays)
        root = _root(store)
    try:
        yield root
    finally:
        store.close()


def _format(sizes: dict[str, int]) -> Literal[2, 3]:
    """Return the format of a store, by the file in its root."""
    return 3 if "zarr.json" in sizes else 2


def _root(store: CheckedStore) -> Any:
    """Return the root, read from its own metadata instead of consolidated copies."""
    form = _format(store.sizes)
    with warnings.catch_warnings():  # about types and extensions unused in light fields
        warnings.simplefilter("ignore")
        if "" in store.arrays:
            return zarr.open_array(store, mode="r", zarr_format=form)
        return zarr.open_group(store, mode="r", zarr_format=form, use_consolidated=False)


def _files(root: Path) -> dict[str, int]:
    """Return the size in bytes of every file of a folder, by its key."""
    inside, sizes, folders = root.resolve(), {}, [root]
    while folders:
        with os.scandir(folders.pop()) as entries:
            for entry in entries:
                if entry.is_symlink() and not Path(entry.path).resolve().is_relative_to(inside):
                    raise FormatError(
                        f"{root}: {entry.name!r} is a link to a file outside the store: replace "
                        "it by a copy."
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
    for item in archive.infolist():  # each of several members of equal name
        if is_metadata(item.filename):
            _require_metadata(item.filename, item.file_size, Path(archive.filename or ""))
            yield item.filename, archive.read(item)


def _require_metadata(key: str, size: int, path: Path) -> None:
    """Raise FormatError for metadata larger than the limit."""
    if size > _MAX_METADATA:
        raise FormatError(
            f"{path}: its member {key[:200]!r} declares {size:,} bytes, but metadata have at most "
            f"{_MAX_METADATA:,}: the file is damaged."
        )


def _members(archive: zipfile.ZipFile, path: Path, max_bytes: int | None) -> dict[str, int]:
    """Return the size of every member of an archive; reject impossible compression ratios."""
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
                f"{path}: {what} is compressed with method {item.compress_type}: write the "
                "archive with deflate."
            )
        Bound(path, item.compress_size, DEFLATE, max_bytes).require(item.file_size, what)
        sizes[item.filename] = item.file_size
    return sizes


def _require_members(sizes: dict[str, int], arrays: dict[str, Packing], path: Path) -> None:
    """Raise FormatError for members larger than the chunks that they hold."""
    for key, size in sizes.items():
        packing = None if is_metadata(key) else _packing_of(key, arrays)
        if packing is None:
            continue
        largest = max(packing.shard, 1) * packing.largest + packing.index_bytes
        if size > largest + SLACK:
            raise FormatError(
                f"{path}: its member {key[:200]!r} declares {size:,} bytes, but a chunk has at "
                f"most {largest:,}: the file is damaged."
            )


def _packing_of(key: str, arrays: dict[str, Packing]) -> Packing | None:
    """Return the packing of the array that a chunk belongs to."""
    folder = key
    while folder:
        folder = folder.rpartition("/")[0]
        if folder in arrays:
            return arrays[folder]
    return None


class CheckedStore(WrapperStore[Any]):
    """Store that rejects chunks that decode to more than their array declares.

    Attributes
    ----------
    sizes, arrays
        Size of every file in bytes, and packing of every array, by key.
    """

    def __init__(self, store: Any, sizes: dict[str, int], arrays: dict[str, Packing]) -> None:
        super().__init__(store)
        self.sizes = sizes
        self.arrays = arrays
        self._indices: dict[str, np.ndarray[Any, Any]] = {}

    def _with_store(self, store: Any) -> CheckedStore:
        return CheckedStore(store, self.sizes, self.arrays)

    async def get(self, key: str, prototype: Any, byte_range: Any = None) -> Any:
        """Return the value of a key after a check of its chunks."""
        value = await super().get(key, prototype, byte_range)
        packing = None if is_metadata(key) else _packing_of(key, self.arrays)
        if value is None or packing is None or packing.compressor is None:
            return value
        content = value.to_bytes()
        if not packing.shard:
            require_chunk(content, packing, key)
            return value
        start = self._start(key, byte_range)
        end = start + len(content)
        offsets, sizes = (await self._index(key, packing, prototype)).T
        inside = (offsets >= start) & (offsets < end) & (sizes <= len(content))
        inside &= offsets + sizes <= end
        for offset, size in zip(offsets[inside].tolist(), sizes[inside].tolist(), strict=True):
            require_chunk(content[offset - start : offset - start + size], packing, key)
        return value

    async def get_partial_values(
        self, prototype: Any, key_ranges: Iterable[tuple[str, Any]]
    ) -> list[Any]:
        """Return parts of several keys, each through `get`."""
        return [await self.get(key, prototype, part) for key, part in key_ranges]

    async def _get_many(
        self, requests: Iterable[tuple[str, Any, Any]]
    ) -> AsyncGenerator[tuple[str, Any], None]:
        for key, prototype, part in requests:
            yield key, await self.get(key, prototype, part)

    def _start(self, key: str, byte_range: Any) -> int:
        """Return the first byte of a range."""
        if isinstance(byte_range, RangeByteRequest):
            return int(byte_range.start)
        if isinstance(byte_range, OffsetByteRequest):
            return int(byte_range.offset)
        if isinstance(byte_range, SuffixByteRequest):
            return max(self.sizes.get(key, 0) - int(byte_range.suffix), 0)
        return 0

    async def _index(self, key: str, packing: Packing, prototype: Any) -> np.ndarray[Any, Any]:
        """Return offset and size of the chunks of a shard, shape (chunks, 2)."""
        if key not in self._indices:
            size = packing.index_bytes
            if size > self.sizes.get(key, 0):
                raise ValueError(f"the shard {key} is shorter than its index of {size:,} bytes")
            part = RangeByteRequest(0, size) if packing.index_first else SuffixByteRequest(size)
            content: Any = await super().get(key, prototype, part)
            pairs = np.frombuffer(content.to_bytes(), "<u8", 2 * packing.shard).reshape(-1, 2)
            if len(self._indices) >= _MAX_INDICES:
                self._indices.clear()
            self._indices[key] = pairs[(pairs != _MISSING).any(axis=1)]
        return self._indices[key]
