"""How large a packed chunk of a Zarr array becomes, found before it is decoded.

blosc, lz4 and zstd allocate what a chunk declares in its first bytes; gzip, zlib, bz2 and lzma give
what comes out, without a limit. A chunk of a few bytes could so ask for gigabytes.

Formats: blosc, 16 bytes of which 4 to 7 are the size (c-blosc, README_CHUNK_FORMAT); lz4 by
numcodecs, 4 bytes of size; zstd, RFC 8878.
"""

from __future__ import annotations

import bz2
import gzip
import lzma
import zlib
from collections.abc import Callable
from io import BytesIO
from typing import Any

from clplen.io.formats.untrusted import DEFLATE, SLACK
from clplen.io.store.zarr_metadata import Packing

_PIECE = 1 << 18
_LZMA_MEMORY = 256 << 20  # bytes of the largest dictionary; that of preset 9 is 64 MiB
_ZSTD, _SKIPPED = 0xFD2FB528, 0x184D2A50
_ZSTD_BLOCK = 1 << 17  # bytes of a block, at most
_STORED, _REPEATED = 0, 1  # kinds of a block of zstd


def require_chunk(content: bytes, packing: Packing, key: str) -> None:
    """Refuse a chunk that becomes larger than its array declares.

    Parameters
    ----------
    content : bytes
        As stored.
    packing : Packing
    key : str
        Of the chunk, for the message.

    Raises
    ------
    ValueError
        Naming the chunk and its size; what the decompressors say of damaged ones.
    """
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
