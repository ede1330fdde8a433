"""One picture of a TIFF file, or a stack of them, without more memory than it declares."""

from __future__ import annotations

import math
import zlib
from io import BytesIO
from pathlib import Path
from typing import Any

import imageio.v3 as imageio
import numpy as np
import tifffile

from clplen.io.formats.untrusted import DEFLATE, require_bytes

# Largest ratio of each compression (TIFF 6.0 and Adobe's supplements): none, LZW (a code of 12
# bits is at most the longest of 4096 growing strings), JPEG, deflate twice, PackBits.
_RATIO = {1: 1.0, 5: 2560.0, 7: 2048.0, 8: DEFLATE, 32946: DEFLATE, 32773: 64.0}
_BY_PILLOW = (5, 7)  # where tifffile's optional codecs are not installed
_DEFLATED = (8, 32946)
_PALETTE = 3
_TILE = 16 << 20  # bytes by which a tile may be larger than its picture


def decode_tiff(
    content: bytes, path: Path, *, max_bytes: int | None, page: int | None = None
) -> np.ndarray[Any, Any]:
    """One page of a TIFF file.

    Parameters
    ----------
    content : bytes
    path : pathlib.Path
        For messages.
    max_bytes : int or None
        As for `require_bytes`.
    page : int or None
        Which one; None where there must be one only.

    Returns
    -------
    numpy.ndarray
        Shape (y, x) or (y, x, c), the file's own dtype.

    Raises
    ------
    FormatError
        If it declares more than it holds, or more than ``max_bytes``.
    ValueError
        If it holds several pages, a colour table or an unknown compression; tifffile's own errors
        where it is damaged.
    """
    with tifffile.TiffFile(BytesIO(content), is_ome=False, is_imagej=False) as file:
        if page is None and len(file.pages) > 1:
            raise ValueError(f"it holds {len(file.pages)} pictures, one is meant")
        return _values(file.pages[page or 0], content, path, max_bytes)


def decode_tiff_stack(content: bytes, path: Path, *, max_bytes: int | None) -> np.ndarray[Any, Any]:
    """All pages of a TIFF file, which are alike.

    Parameters
    ----------
    content, path, max_bytes
        As of `decode_tiff`.

    Returns
    -------
    numpy.ndarray
        Shape (pages, y, x) or (pages, y, x, c), the file's own dtype.

    Raises
    ------
    FormatError, ValueError
        As `decode_tiff`, and if pages are of several shapes or types.
    """
    with tifffile.TiffFile(BytesIO(content), is_ome=False, is_imagej=False) as file:
        pages: list[Any] = list(file.pages)
        kinds = {(page.shape, page.dtype) for page in pages}
        if len(kinds) > 1:
            raise ValueError(f"its {len(pages)} pages are of {len(kinds)} shapes or types")
        _check(pages[0], content, path, max_bytes)
        require_bytes(
            len(pages) * pages[0].nbytes,
            path=path,
            what="the stack",
            stored=len(content),
            ratio=_RATIO[pages[0].compression] * _unpacked(pages[0]),
            max_bytes=max_bytes,
        )
        first = _values(pages[0], content, path, max_bytes)
        stack = np.empty((len(pages), *first.shape), first.dtype)
        for number, page in enumerate(pages):
            stack[number] = _values(page, content, path, max_bytes) if number else first
    return stack


def _values(page: Any, content: bytes, path: Path, max_bytes: int | None) -> np.ndarray[Any, Any]:
    """The samples of a page, (y, x) or (y, x, c)."""
    _check(page, content, path, max_bytes)
    try:
        values = page.asarray()
    except ValueError as error:
        if page.compression not in _BY_PILLOW or "imagecodecs" not in str(error):
            raise
        values = imageio.imread(content, plugin="pillow", index=page.index)
        if values.shape != page.shape or values.dtype != page.dtype:
            raise ValueError("a compression that needs imagecodecs: install that") from error
    return np.asarray(values.transpose(1, 2, 0) if page.axes == "SYX" else values)


def _check(page: Any, content: bytes, path: Path, max_bytes: int | None) -> None:
    """Refuse what is no single picture, or would need more memory than it says."""
    if page.compression not in _RATIO:
        raise ValueError(f"compression {page.compression}; write it with deflate or none")
    if page.photometric == _PALETTE:
        raise ValueError("it has a colour table; write it as RGB")
    if page.dtype is None or page.axes not in ("YX", "YXS", "SYX"):
        raise ValueError(f"its axes are {page.axes}, not those of a picture")
    stored = sum(page.databytecounts)
    if stored > len(content):
        raise ValueError("it is truncated, or its parts overlap")
    require_bytes(
        page.nbytes,
        path=path,
        what="the picture",
        stored=stored,
        ratio=_RATIO[page.compression] * _unpacked(page),
        max_bytes=max_bytes,
    )
    if page.is_tiled and math.prod(page.chunks) * page.dtype.itemsize > page.nbytes + _TILE:
        raise ValueError(f"its tiles, {page.chunks}, are much larger than the picture")
    if page.compression in _DEFLATED:
        _check_deflated(page, content)


def _unpacked(page: Any) -> float:
    """Bits of a sample in memory over those in the file."""
    return max(1.0, 8 * page.dtype.itemsize / page.bitspersample)


def _check_deflated(page: Any, content: bytes) -> None:
    """Refuse a strip or tile that is larger than declared: tifffile would inflate all of it."""
    whole = page.chunks if page.is_tiled else (page.rowsperstrip, *page.shape[1:])
    largest = min(math.prod(whole) * page.dtype.itemsize, page.nbytes + _TILE)
    for offset, count in zip(page.dataoffsets, page.databytecounts, strict=False):
        part = content[offset : offset + count]
        if len(zlib.decompressobj().decompress(part, largest + 1)) > largest:
            raise ValueError("a part of it inflates to more than it declares")
