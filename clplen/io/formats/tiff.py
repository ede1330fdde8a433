"""TIFF without more memory than it declares: one picture, one frame of many, or a stack of them."""

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

# Largest ratio of each compression (TIFF 6.0 and Adobe's supplements): none, LZW (a code of 12
# bits is at most the longest of 4096 growing strings), JPEG, deflate twice, PackBits.
_RATIO = {1: 1.0, 5: 2560.0, 7: 2048.0, 8: DEFLATE, 32946: DEFLATE, 32773: 64.0}
_BY_PILLOW = (5, 7)  # where tifffile's optional codecs are not installed
_DEFLATED = (8, 32946)
_PALETTE = 3
_MAX_COPY = 64 << 20  # bytes of a file that Pillow may copy, beside 32 for each of its picture's
_TILE = 16 << 20  # bytes by which a tile may be larger than its picture
logger = logging.getLogger("clplen.io")
SUFFIXES = (".tif", ".tiff")
_IMAGEJ = {"T": "frames", "Z": "slices", "C": "channels"}  # the slowest first
_LONGEST = 1 << 16  # characters of an OME description in which <Pixels> is looked for


def open_tiff(path: Path) -> tifffile.TiffFile:
    """A TIFF file to read, whose pages are taken one by one."""
    return tifffile.TiffFile(require_file(path, "TIFF file"), is_ome=False, is_imagej=False)


@contextmanager
def picture_errors(path: Path) -> Iterator[None]:
    """Make a FormatError of all kinds that Pillow and tifffile raise on damaged files."""
    try:
        yield
    except FormatError:
        raise
    except Exception as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise FormatError(f"The picture {path} cannot be read ({reason}).") from error


def checked_picture(values: np.ndarray[Any, Any], path: Path) -> np.ndarray[Any, Any]:
    """Return the samples of a picture in the byte order of this computer; refuse other arrays."""
    if values.dtype.kind not in "buif":
        raise FormatError(f"The picture {path} has samples of type {values.dtype}, not real ones.")
    channels = values.shape[2:]
    if values.ndim not in (2, 3) or values.size == 0 or channels not in ((), (2,), (3,), (4,)):
        raise FormatError(f"The picture {path} has shape {values.shape}, not (y, x) or (y, x, 3).")
    return np.asarray(values.astype(values.dtype.newbyteorder("="), copy=False))


def decode_tiff(
    content: bytes | mmap, path: Path, *, max_bytes: int | None, page: int | None = None
) -> np.ndarray[Any, Any]:
    """One page of a TIFF file."""
    source: Any = BytesIO(content) if isinstance(content, bytes) else content
    with tifffile.TiffFile(source, is_ome=False, is_imagej=False) as file:
        if page is None and len(file.pages) > 1:
            raise ValueError(f"it holds {len(file.pages)} pictures, one is meant")
        return _values(file.pages[page or 0], content, path, max_bytes)


@contextmanager
def _opened(path: Path) -> Iterator[tuple[Any, mmap]]:
    """The pages of a TIFF file and its bytes."""
    with (
        path.open("rb") as file,
        mmap(file.fileno(), 0, access=ACCESS_READ) as content,
        tifffile.TiffFile(file, is_ome=False, is_imagej=False) as opened,
    ):
        yield opened.pages, content


def read_tiff_stacks(
    path: Path, groups: Iterable[Iterable[int]], *, max_bytes: int | None = None
) -> Iterator[np.ndarray[Any, Any]]:
    """Several stacks of pages of one TIFF file, one after the other."""
    with _opened(path) as (pages, content):
        for group in groups:
            chosen = [pages[number] for number in group]
            shape, dtype = _stack_shape(chosen, content, path, max_bytes)
            stack = np.empty(shape, dtype)
            for number, page in enumerate(chosen):
                stack[number] = _values(page, content, path, max_bytes)
            yield stack


def read_tiff_pages(path: Path, *, max_bytes: int | None = None) -> Iterator[np.ndarray[Any, Any]]:
    """The pages of a TIFF file, one after the other."""
    with _opened(path) as (pages, content):
        for page in pages:
            yield _values(page, content, path, max_bytes)


def stack_shape(path: Path, *, max_bytes: int | None) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Shape (pages, y, x[, c]) and type of all pages of a TIFF file, which are alike."""
    with _opened(path) as (pages, content):
        return _stack_shape(list(pages), content, path, max_bytes)


def stack_axes(path: Path) -> dict[str, int]:
    """Lengths of the axes T, C and Z of the pages of a TIFF, the slowest first.

    They are those of OME and ImageJ; pages of other programs are planes Z.
    """
    with open_tiff(path) as file:
        return _axes(file.pages) or {"T": 1, "Z": len(file.pages), "C": 1}


def _axes(pages: Any) -> dict[str, int]:
    """The axes that OME or ImageJ wrote, the slowest first; empty where neither did."""
    first, count = pages.first, len(pages)
    text = first.description[:_LONGEST]
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
                axes["C"] //= first.samplesperpixel  # which one page holds
    return axes if axes and math.prod(axes.values()) == count else {}


def _stack_shape(
    pages: list[Any], content: mmap, path: Path, max_bytes: int | None
) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Shape (pages, y, x[, c]) and type of pages, which have to be alike and to fit in memory."""
    kinds = {(page.shape, page.dtype) for page in pages}
    if len(kinds) > 1:
        raise ValueError(f"its {len(pages)} pages are of {len(kinds)} shapes or types")
    first = pages[0]
    _check(first, content, path, max_bytes)
    Bound(path, len(content), _RATIO[first.compression] * _unpacked(first), max_bytes).require(
        len(pages) * first.nbytes, "the stack"
    )
    shape = (*first.shape[1:], first.shape[0]) if first.axes == "SYX" else first.shape
    return (len(pages), *shape), np.dtype(first.dtype)


def _values(
    page: Any, content: bytes | mmap, path: Path, max_bytes: int | None
) -> np.ndarray[Any, Any]:
    """The samples of a page, (y, x) or (y, x, c)."""
    _check(page, content, path, max_bytes)
    try:
        values = page.asarray()
    except ValueError as error:
        if page.compression not in _BY_PILLOW or "imagecodecs" not in str(error):
            raise
        if len(content) > 32 * page.nbytes + _MAX_COPY:
            raise ValueError(f"it has {len(content):,} bytes, far more than it needs") from error
        values = imageio.imread(bytes(content), plugin="pillow", index=page.index)
        if values.shape != page.shape or values.dtype != page.dtype:
            raise ValueError("a compression that needs imagecodecs: install that") from error
    return np.asarray(values.transpose(1, 2, 0) if page.axes == "SYX" else values)


def _check(page: Any, content: bytes | mmap, path: Path, max_bytes: int | None) -> None:
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
    Bound(path, stored, _RATIO[page.compression] * _unpacked(page), max_bytes).require(
        page.nbytes, "the picture"
    )
    if page.is_tiled and math.prod(page.chunks) * page.dtype.itemsize > page.nbytes + _TILE:
        raise ValueError(f"its tiles, {page.chunks}, are much larger than the picture")
    if page.compression in _DEFLATED:
        _check_deflated(page, content)


def _unpacked(page: Any) -> float:
    """Bits of a sample in memory over those in the file."""
    return max(1.0, 8 * page.dtype.itemsize / page.bitspersample)


def _check_deflated(page: Any, content: bytes | mmap) -> None:
    """Refuse a strip or tile that is larger than declared: tifffile would inflate all of it."""
    whole = page.chunks if page.is_tiled else (page.rowsperstrip, *page.shape[1:])
    largest = min(math.prod(whole) * page.dtype.itemsize, page.nbytes + _TILE)
    for offset, count in zip(page.dataoffsets, page.databytecounts, strict=False):
        part = content[offset : offset + count]
        if len(zlib.decompressobj().decompress(part, largest + 1)) > largest:
            raise ValueError("a part of it inflates to more than it declares")


def read_tiff_frame(
    path: Path, *, frame: int | None = None, max_bytes: int | None = None
) -> np.ndarray[Any, Any]:
    """One page of a TIFF file; which one is logged where there are several.

    Of the file only this page is read, however many it has.
    """
    with picture_errors(path), _opened(path) as (pages, content):
        count, axes = len(pages), _axes(pages)
        _require(path, frame, count, axes)
        values = checked_picture(_values(pages[frame or 0], content, path, max_bytes), path)
    if count > 1:
        logger.info("took frame %d of %d%s of %s", frame, count, _place(frame or 0, axes), path)
    return values


def frames_in(path: Path) -> int:
    """How many frames a picture holds; 1 where it is no TIFF or cannot be read."""
    if path.suffix.lower() not in SUFFIXES:
        return 1
    try:
        with open_tiff(path) as file:
            return max(1, len(file.pages))
    except Exception:  # reading it says why
        return 1


def _require(path: Path, frame: int | None, count: int, axes: dict[str, int]) -> None:
    held = f"{count} frames"
    if axes:
        held += f" ({', '.join(f'{axis} = {size}' for axis, size in axes.items())})"
    if frame is None and count > 1:
        raise FormatError(f"{path} holds {held}: give frame=, from 0 to {count - 1}.")
    if frame is not None and not 0 <= frame < count:
        raise FormatError(f"frame={frame} is not in {path}, which holds {held}.")


def _place(frame: int, axes: dict[str, int]) -> str:
    """Where in the series a frame lies."""
    if not axes:
        return ""
    places = np.unravel_index(frame, list(axes.values()))
    said = ", ".join(f"{axis} = {place}" for axis, place in zip(axes, places, strict=True))
    return f" ({said})"
