"""What the first bytes of a picture declare: its kind, its size, and how far it is compressed."""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass

from clplen.io.formats.untrusted import DEFLATE

PNG = b"\x89PNG\r\n\x1a\n"
TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_JPEG = b"\xff\xd8\xff"
_JPEG_RATIO = 2048.0  # a bit for a block of 64 samples, colours halved twice (ITU-T T.81)
_RLE_RATIO = 512.0  # BMP: 255 pixels of 4 bytes from 2 bytes
_PNG_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
_STANDALONE = {0x01, *range(0xD0, 0xD9)}  # JPEG markers without a length
_FRAMES = set(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}  # JPEG markers with the size
_SPACE = rb"(?:\s|#[^\n]*\n)+"
_PNM = re.compile(
    rb"P([56])" + _SPACE + rb"(\d{1,9})" + _SPACE + rb"(\d{1,9})" + _SPACE + rb"(\d{1,5})\s"
)


@dataclass(frozen=True)
class Header:
    """What a picture declares.

    Attributes
    ----------
    kind : {"PNG", "TIFF", "JPEG", "BMP", "PNM"}
    pixels : int
        Rows times columns; 0 for TIFF, whose reader finds out.
    nbytes : int
        Of the decoded samples, at most.
    ratio : float
        Largest number of decoded bytes from one stored byte.
    deep : bool
        Whether it is a PNG with 16 bits a sample and more than one channel.
    """

    kind: str
    pixels: int = 0
    nbytes: int = 0
    ratio: float = 1.0
    deep: bool = False


def header_of(content: bytes) -> Header:
    """What a picture declares.

    Parameters
    ----------
    content : bytes

    Returns
    -------
    Header

    Raises
    ------
    ValueError
        If it is no picture of a known kind, or its header is damaged.
    """
    if content[:8] == PNG:
        return _png(content)
    if content[:4] in TIFF:
        return Header("TIFF")
    if content[:3] == _JPEG:
        return _jpeg(content)
    if content[:2] == b"BM":
        return _bmp(content)
    if content[:2] in (b"P5", b"P6"):
        shape, dtype_size, _ = pnm_layout(content)
        height, width, channels = shape
        return Header("PNM", height * width, height * width * channels * dtype_size)
    raise ValueError("it begins like no PNG, TIFF, JPEG, BMP, binary PGM or PPM")


def _png(content: bytes) -> Header:
    if content[12:16] != b"IHDR" or len(content) < 33:
        raise ValueError("its header is damaged")
    width, height, depth, colour = struct.unpack(">IIBB", content[16:26])
    if colour not in _PNG_CHANNELS or depth not in (1, 2, 4, 8, 16) or not width * height:
        raise ValueError("its header is damaged")
    channels = _PNG_CHANNELS[colour]
    filtered = height * (1 + -(-width * channels * depth // 8))
    nbytes = width * height * (4 if colour == 3 else channels) * (2 if depth == 16 else 1)
    ratio = DEFLATE * max(1.0, nbytes / filtered)
    return Header("PNG", width * height, nbytes, ratio, depth == 16 and channels > 1)


def _jpeg(content: bytes) -> Header:
    position = 2
    while position + 10 <= len(content):
        marker = content[position + 1]
        if content[position] != 0xFF:
            break
        if marker == 0xFF or marker in _STANDALONE:
            position += 1 if marker == 0xFF else 2
            continue
        if marker in _FRAMES:
            height, width, channels = struct.unpack(">HHB", content[position + 5 : position + 10])
            if channels not in (1, 3) or not width * height:
                raise ValueError(f"a JPEG of {height} x {width} pixels and {channels} channels")
            return Header("JPEG", width * height, width * height * channels, _JPEG_RATIO)
        position += 2 + int.from_bytes(content[position + 2 : position + 4], "big")
    raise ValueError("its header is damaged")


def _bmp(content: bytes) -> Header:
    if len(content) < 54:
        raise ValueError("it is truncated")
    width, height, _, bits, compression = struct.unpack("<iiHHI", content[18:34])
    pixels = abs(width * height)
    if int.from_bytes(content[14:18], "little") < 40 or bits not in (1, 4, 8, 16, 24, 32):
        raise ValueError("its header is damaged")
    ratio = 32 / bits if compression in (0, 3) else _RLE_RATIO
    return Header("BMP", pixels, 4 * pixels, ratio)


def pnm_layout(content: bytes) -> tuple[tuple[int, int, int], int, int]:
    """Of a binary PGM or PPM: (y, x, c), bytes a sample, and where the samples begin.

    Raises
    ------
    ValueError
        If the header is none.
    """
    match = _PNM.match(content[:4096])
    if match is None:
        raise ValueError("its header is damaged")
    kind, width, height, highest = (int(group) for group in match.groups())
    if not 0 < highest < 2**16 or not width * height:
        raise ValueError("its header is damaged")
    return (height, width, 3 if kind == 6 else 1), 1 if highest < 256 else 2, match.end()
