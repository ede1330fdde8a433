"""PNG with 16 bits per sample and several channels, which Pillow would reduce to 8 bits.

Chunks, zlib and the five filters of PNG (ISO/IEC 15948:2004, 9.2): with a to the left, b above and
c above to the left, byte by byte modulo 256,

    none 0,  sub a,  up b,  average (a + b) // 2,  Paeth: the nearest of a, b, c to a + b - c

are added to the stored value. A pixel depends on pixels to the left and above only, so all pixels
of a diagonal x + y are computed at once.
"""

from __future__ import annotations

import struct
import zlib
from typing import Any

import numpy as np

_CHANNELS = {2: 3, 4: 2, 6: 4}
_BAND_ROWS = 1024  # rows in a band of diagonals

Array = np.ndarray[Any, Any]


def decode_png16(content: bytes) -> Array:
    """Decode a PNG of 16-bit grey with alpha, RGB or RGBA."""
    header, stored = _chunks(content)
    width, height, depth, colour, _, _, interlaced = struct.unpack(">IIBBBBB", header)
    if depth != 16 or colour not in _CHANNELS:
        raise ValueError("it is not a PNG of 16 bits and several channels")
    if interlaced:
        raise ValueError("an interlaced PNG of 16-bit colour; write it without interlacing")
    step = 2 * _CHANNELS[colour]
    row = 1 + width * step
    flat = zlib.decompressobj().decompress(stored, height * row)
    if len(flat) < height * row:
        raise ValueError("it is truncated")
    rows = np.frombuffer(flat, np.uint8).reshape(height, row)
    if rows[:, 0].max() > 4:
        raise ValueError("it has an unknown filter")
    out = np.empty((height, width, step), np.uint8)
    above = np.zeros((width, step), np.uint8)
    for start in range(0, height, _BAND_ROWS):
        band = rows[start : start + _BAND_ROWS]
        pixels = band[:, 1:].reshape(len(band), width, step)
        out[start : start + _BAND_ROWS] = _unfiltered(pixels, band[:, 0], above)
        above = out[start + len(band) - 1]
    return out.view(">u2").astype(np.uint16)


def _chunks(content: bytes) -> tuple[bytes, bytes]:
    """Return the header and the compressed samples after a check of the checksums."""
    header, stored, position = b"", [], 8
    while position + 12 <= len(content):
        length = int.from_bytes(content[position : position + 4], "big")
        name, end = content[position + 4 : position + 8], position + 8 + length
        data = content[position + 8 : end]
        if content[end : end + 4] != struct.pack(">I", zlib.crc32(name + data)):
            raise ValueError("it is truncated or damaged")
        if name == b"IHDR":
            header = data
        elif name == b"IDAT":
            stored.append(data)
        elif name == b"IEND":
            break
        position = end + 4
    if len(header) != 13:
        raise ValueError("its header is damaged")
    return header, b"".join(stored)


def _unfiltered(pixels: Array, filters: Array, above: Array) -> Array:
    """Remove the filters of rows (n, x, byte); ``above`` is the row before them."""
    count, width, step = pixels.shape
    skewed = np.zeros((count + width - 1, count, step), np.int16)  # [x + y, y]
    for y in range(count):
        skewed[y : y + width, y] = pixels[y]
    sub, up, average, paeth = (
        (filters == kind).astype(np.int16).reshape(count, 1) for kind in range(1, 5)
    )
    before = np.zeros((count + 1, step), np.int16)  # previous diagonal, starting with the row above
    before[0] = above[0]
    earlier = np.zeros_like(before)
    for diagonal, values in enumerate(skewed):
        a, b, c = before[1:], before[:-1], earlier[:-1]
        predicted = sub * a + up * b + average * ((a + b) >> 1) + paeth * _paeth(a, b, c)
        values += predicted
        values &= 255
        earlier, before = before, np.zeros_like(before)
        before[1:] = values
        if diagonal + 1 < width:
            before[0] = above[diagonal + 1]
    out = np.empty((count, width, step), np.uint8)
    for y in range(count):
        out[y] = skewed[y : y + width, y]
    return out


def _paeth(a: Array, b: Array, c: Array) -> Array:
    """Return the nearest of a, b, c to a + b - c, the first of them in a tie."""
    to_a, to_b = np.abs(b - c), np.abs(a - c)
    to_c = np.abs(a + b - 2 * c)
    upper = np.where(to_b <= to_c, b, c)
    return np.where((to_a <= to_b) & (to_a <= to_c), a, upper)
