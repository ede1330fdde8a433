"""TIFF within its declared memory: a picture, a frame of many, or a stack."""

from __future__ import annotations

import logging
import math
import re
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from io import BytesIO
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import Any

import imageio.v3 as imageio
import numpy as np
import tifffile

from clplen.errors import FormatError
from clplen.files import require_file
from clplen.io.formats.untrusted import DEFLATE, Bound

# Largest ratio of each compression (TIFF 6.0 and Adobe's supplements): none, LZW (a code of 12 bits
# stands for at most 4096 growing strings), JPEG, deflate twice, PackBits.
_MAX_RATIO = {1: 1.0, 5: 2560.0, 7: 2048.0, 8: DEFLATE, 32946: DEFLATE, 32773: 64.0}
_PILLOW_COMPRESSIONS = (5, 7)  # without tifffile's optional codecs
_DEFLATED = (8, 32946)
_PALETTE = 3
_MAX_COPY = 64 << 20  # bytes that Pillow may copy in addition to 32 per byte of the picture
_MAX_TILE_EXCESS = 16 << 20  # bytes by which a tile may exceed its picture
logger = logging.getLogger("clplen.io")
SUFFIXES = (".tif", ".tiff")
_IMAGEJ = {"T": "frames", "Z": "slices", "C": "channels"}  # slowest axis first
_MAX_SEARCH = 1 << 16  # characters of an OME description searched for <Pixels>


def open_tiff(path: Path) -> tifffile.TiffFile:
    """Open a TIFF file whose pages are read individually."""
    return tifffile.TiffFile(require_file(path, "TIFF file"), is_ome=False, is_imagej=False)


@contextmanager
def picture_errors(path: Path) -> Iterator[None]:
    """Turn the exceptions of Pillow and tifffile on damaged files into a FormatError."""
    try:
        yield
    except FormatError:
        raise
    except Exception as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise FormatError(f"The picture {path} is unreadable ({reason}).") from error


def checked_picture(values: np.ndarray[Any, Any], path: Path) -> np.ndarray[Any, Any]:
    """Return the samples of a picture in native byte order; reject other arrays."""
    if values.dtype.kind not in "buif":
        raise FormatError(f"The picture {path} must have real samples, got {values.dtype}.")
    channels = values.shape[2:]
    if values.ndim not in (2, 3) or values.size == 0 or channels not in ((), (2,), (3,), (4,)):
        raise FormatError(
            f"The picture {path} must have shape (y, x) or (y, x, 3), got {values.shape}."
        )
    return np.asarray(values.astype(values.dtype.newbyteorder("="), copy=False))


def decode_tiff(
    content: bytes | mmap, path: Path, *, max_bytes: int | None, page: int | None = None
) -> np.ndarray[Any, Any]:
    """Decode a page of a TIFF file."""
    source: Any = BytesIO(content) if isinstance(content, bytes) else content
    with tifffile.TiffFile(source, is_ome=False, is_imagej=False) as file:
        if page is None and len(file.pages) > 1:
            raise ValueError(f"it must have one picture, got {len(file.pages)}")
        return _values(file.pages[page or 0], content, path, max_bytes)


@contextmanager
def _open_pages(path: Path) -> Iterator[tuple[Any, mmap]]:
    """Open a TIFF file and yield its pages and its mapped bytes."""
    with (
        path.open("rb") as file,
        mmap(file.fileno(), 0, access=ACCESS_READ) as content,
        tifffile.TiffFile(file, is_ome=False, is_imagej=False) as tiff_file,
    ):
        yield tiff_file.pages, content


def read_tiff_stacks(
    path: Path, groups: Iterable[Iterable[int]], *, max_bytes: int | None = None
) -> Iterator[np.ndarray[Any, Any]]:
    """Yield several stacks of pages of a TIFF file."""
    with _open_pages(path) as (pages, content):
        for group in groups:
            selection = [pages[number] for number in group]
            shape, dtype = _stack_shape(selection, content, path, max_bytes)
            stack = np.empty(shape, dtype)
            for number, page in enumerate(selection):
                stack[number] = _values(page, content, path, max_bytes)
            yield stack


def read_tiff_pages(path: Path, *, max_bytes: int | None = None) -> Iterator[np.ndarray[Any, Any]]:
    """Yield the pages of a TIFF file."""
    with _open_pages(path) as (pages, content):
        for page in pages:
            yield _values(page, content, path, max_bytes)


def stack_shape(path: Path, *, max_bytes: int | None) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Return shape (pages, y, x[, c]) and dtype of the pages of a TIFF file."""
    with _open_pages(path) as (pages, content):
        return _stack_shape(list(pages), content, path, max_bytes)


def stack_axes(path: Path) -> dict[str, int]:
    """Return the lengths of the axes T, C and Z of the pages of a TIFF, slowest axis first.

    Axes are read from OME or ImageJ metadata; pages of other programs are planes Z.
    """
    with open_tiff(path) as file:
        return _axes(file.pages) or {"T": 1, "Z": len(file.pages), "C": 1}


def _axes(pages: Any) -> dict[str, int]:
    """Return the axes that OME or ImageJ wrote, slowest axis first; empty for other files."""
    first, count = pages.first, len(pages)
    text = first.description[:_MAX_SEARCH]
    axes: dict[str, int] = {}
    if text.startswith("ImageJ="):
        sizes = dict(re.findall(r"^(frames|slices|channels)=(\d{1,9})", text, re.M))
        axes = {axis: int(sizes.get(name, 1)) for axis, name in _IMAGEJ.items()}
    elif pixels := re.search(r"<(?:\w+:)?Pixels\b[^>]*>", text):
        order = re.search(r'DimensionOrder="XY([CZT]{3})"', pixels[0])
        sizes = dict(re.findall(r'Size([CZT])="(\d{1,9})"', pixels[0]))
        if order is not None and sorted(order[1]) == sorted(sizes) == list("CTZ"):
            axes = {axis: int(sizes[axis]) for axis in reversed(order[1])}
            if axes["C"] % first.samplesperpixel == 0:
                axes["C"] //= first.samplesperpixel  # channels within a page
    return axes if axes and math.prod(axes.values()) == count else {}


def _stack_shape(
    pages: list[Any], content: mmap, path: Path, max_bytes: int | None
) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Return shape (pages, y, x[, c]) and dtype of pages of equal shape that fit in memory."""
    kinds = {(page.shape, page.dtype) for page in pages}
    if len(kinds) > 1:
        raise ValueError(f"its {len(pages)} pages have {len(kinds)} different shapes or types")
    first = pages[0]
    _check(first, content, path, max_bytes)
    Bound(path, len(content), _MAX_RATIO[first.compression] * _expansion(first), max_bytes).require(
        len(pages) * first.nbytes, "the stack"
    )
    shape = (*first.shape[1:], first.shape[0]) if first.axes == "SYX" else first.shape
    return (len(pages), *shape), np.dtype(first.dtype)


def _values(
    page: Any, content: bytes | mmap, path: Path, max_bytes: int | None
) -> np.ndarray[Any, Any]:
    """Return the samples of a page, (y, x) or (y, x, c)."""
    _check(page, content, path, max_bytes)
    try:
        values = page.asarray()
    except ValueError as error:
        if page.compression not in _PILLOW_COMPRESSIONS or "imagecodecs" not in str(error):
            raise
        if len(content) > 32 * page.nbytes + _MAX_COPY:
            raise ValueError(
                f"its {len(content):,} bytes far exceed the size of the picture"
            ) from error
        values = imageio.imread(bytes(content), plugin="pillow", index=page.index)
        if values.shape != page.shape or values.dtype != page.dtype:
            raise ValueError("its compression needs imagecodecs: install it") from error
    return np.asarray(values.transpose(1, 2, 0) if page.axes == "SYX" else values)


def _check(page: Any, content: bytes | mmap, path: Path, max_bytes: int | None) -> None:
    """Raise ValueError for a page that is not a picture or exceeds its declared memory."""
    if page.compression not in _MAX_RATIO:
        raise ValueError(
            f"unsupported compression {page.compression}; write it with deflate or none"
        )
    if page.photometric == _PALETTE:
        raise ValueError("it has a colour table; write it as RGB")
    if page.dtype is None or page.axes not in ("YX", "YXS", "SYX"):
        raise ValueError(f"its axes must be those of a picture, got {page.axes}")
    stored = sum(page.databytecounts)
    if stored > len(content):
        raise ValueError("it is truncated, or its strips overlap")
    Bound(path, stored, _MAX_RATIO[page.compression] * _expansion(page), max_bytes).require(
        page.nbytes, "the picture"
    )
    if (
        page.is_tiled
        and math.prod(page.chunks) * page.dtype.itemsize > page.nbytes + _MAX_TILE_EXCESS
    ):
        raise ValueError(f"its tiles of {page.chunks} are much larger than the picture")
    if page.compression in _DEFLATED:
        _check_deflated(page, content)


def _expansion(page: Any) -> float:
    """Return the ratio of bits per sample in memory to bits in the file."""
    return max(1.0, 8 * page.dtype.itemsize / page.bitspersample)


def _check_deflated(page: Any, content: bytes | mmap) -> None:
    """Raise ValueError for a strip or tile that inflates to more than it declares."""
    part_shape = page.chunks if page.is_tiled else (page.rowsperstrip, *page.shape[1:])
    largest = min(math.prod(part_shape) * page.dtype.itemsize, page.nbytes + _MAX_TILE_EXCESS)
    for offset, count in zip(page.dataoffsets, page.databytecounts, strict=False):
        data = content[offset : offset + count]
        if len(zlib.decompressobj().decompress(data, largest + 1)) > largest:
            raise ValueError("a strip or tile inflates to more than it declares")


def read_tiff_frame(
    path: Path, *, frame: int | None = None, max_bytes: int | None = None
) -> np.ndarray[Any, Any]:
    """Read a page of a TIFF file; log its index if there are several.

    Only this page is read.
    """
    with picture_errors(path), _open_pages(path) as (pages, content):
        count, axes = len(pages), _axes(pages)
        _require(path, frame, count, axes)
        values = checked_picture(_values(pages[frame or 0], content, path, max_bytes), path)
    if count > 1:
        logger.info("read frame %d of %d%s of %s", frame, count, _position(frame or 0, axes), path)
    return values


def frames_in(path: Path) -> int:
    """Return the number of frames of a picture; 1 for other files or unreadable ones."""
    if path.suffix.lower() not in SUFFIXES:
        return 1
    try:
        with open_tiff(path) as file:
            return max(1, len(file.pages))
    except Exception:  # reading it reports the reason
        return 1


def _require(path: Path, frame: int | None, count: int, axes: dict[str, int]) -> None:
    listing = f"{count} frames"
    if axes:
        listing += f" ({', '.join(f'{axis} = {size}' for axis, size in axes.items())})"
    if frame is None and count > 1:
        raise FormatError(f"{path} has {listing}: give frame=, 0 to {count - 1}.")
    if frame is not None and not 0 <= frame < count:
        raise FormatError(
            f"frame must be 0 to {count - 1} in {path}, got {frame}: it has {listing}."
        )


def _position(frame: int, axes: dict[str, int]) -> str:
    """Return the position of a frame in the series as text."""
    if not axes:
        return ""
    indices = np.unravel_index(frame, list(axes.values()))
    listing = ", ".join(f"{axis} = {index}" for axis, index in zip(axes, indices, strict=True))
    return f" ({listing})"
