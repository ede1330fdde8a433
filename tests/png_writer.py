"""A plain writer of PNG for tests: any depth, channels and filters, also wrong ones."""

from __future__ import annotations

import struct
import zlib

import numpy as np

SIGNATURE = b"\x89PNG\r\n\x1a\n"
_COLOURS = {1: 0, 2: 4, 3: 2, 4: 6}  # channels -> colour type


def chunk(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


def header(width: int, height: int, depth: int, colour: int, interlace: int = 0) -> bytes:
    return chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, interlace))


def predicted(kind: int, a: int, b: int, c: int) -> int:
    """What a filter of the standard takes off a byte: a left, b above, c above left."""
    if kind == 4:
        p = a + b - c
        return min((abs(p - a), 0, a), (abs(p - b), 1, b), (abs(p - c), 2, c))[2]
    return (0, a, b, (a + b) // 2)[kind]


def filtered(rows: np.ndarray, step: int, kinds: list[int]) -> bytes:
    """Rows of bytes, each by its filter, in plain loops."""
    out = bytearray()
    above = [0] * rows.shape[1]
    for y, row in enumerate(rows.tolist()):
        kind = kinds[y % len(kinds)]
        out.append(kind)
        for i, value in enumerate(row):
            a, c = (row[i - step], above[i - step]) if i >= step else (0, 0)
            out.append((value - predicted(kind, a, above[i], c)) % 256)
        above = row
    return bytes(out)


def encode(values: np.ndarray, kinds: list[int] | None = None, pieces: int = 2) -> bytes:
    """A PNG of uint8 or uint16 samples (y, x) or (y, x, c)."""
    height, width = values.shape[:2]
    channels = values.shape[2] if values.ndim == 3 else 1
    rows = values.astype(values.dtype.newbyteorder(">")).reshape(height, -1).view(np.uint8)
    flat = filtered(rows, channels * values.itemsize, kinds or [0, 1, 2, 3, 4])
    stored = zlib.compress(flat)
    cut = len(stored) // pieces
    parts = [stored[i * cut : (i + 1) * cut] for i in range(pieces)] + [stored[pieces * cut :]]
    return (
        SIGNATURE
        + header(width, height, 8 * values.itemsize, _COLOURS[channels])
        + chunk(b"tEXt", b"Comment\0hello")
        + b"".join(chunk(b"IDAT", part) for part in parts if part)
        + chunk(b"IEND", b"")
    )
