"""One frame out of a TIFF with many, such as the time series of a microscope."""

from __future__ import annotations

import logging
import re
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import tifffile

from clplen.errors import FormatError
from clplen.io.formats.picture import without_alpha
from clplen.io.formats.tiff import decode_tiff
from clplen.io.formats.untrusted import require_bytes

logger = logging.getLogger("clplen.io")

SUFFIXES = (".tif", ".tiff")
_LONGEST = 1 << 16  # characters of an OME description in which <Pixels> is looked for


def read_tiff_frame(
    path: Path, *, frame: int | None = None, max_bytes: int | None = None
) -> np.ndarray[Any, Any]:
    """One page of a TIFF file; which one is logged where there are several.

    Parameters
    ----------
    path : pathlib.Path
    frame : int, optional
        Number of the page, from 0, in the file's own order; not needed where there is one only.
    max_bytes : int, optional
        Largest allocation that it may ask for; default half of the free memory.

    Returns
    -------
    numpy.ndarray
        Shape (y, x) or (y, x, c), the file's own dtype.

    Raises
    ------
    FormatError
        If the file is damaged, or holds several frames and none or one that is not there is asked
        for.
    """
    size = path.stat().st_size
    require_bytes(size, path=path, what="the picture", stored=size, ratio=1, max_bytes=max_bytes)
    content = path.read_bytes()
    try:
        with tifffile.TiffFile(BytesIO(content), is_ome=False, is_imagej=False) as file:
            count, text = len(file.pages), file.pages.first.description[:_LONGEST]
        axes = _axes(text, count)
        _require(path, frame, count, axes)
        values = decode_tiff(content, path, max_bytes=max_bytes, page=frame or 0)
    except FormatError:
        raise
    except Exception as error:  # tifffile raises all kinds on damaged files
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise FormatError(f"The picture {path} cannot be read ({reason}).") from error
    channels = values.shape[2:]
    if (
        values.dtype.kind not in "buif"
        or values.ndim not in (2, 3)
        or values.size == 0
        or channels not in ((), (2,), (3,), (4,))
    ):
        raise FormatError(
            f"The picture {path} holds {values.dtype} of shape {values.shape}, not real numbers "
            "(y, x) or (y, x, 3)."
        )
    if count > 1:
        logger.info("took frame %d of %d%s of %s", frame, count, _place(frame or 0, axes), path)
    return without_alpha(values.astype(values.dtype.newbyteorder("="), copy=False), path)


def frames_in(path: Path) -> int:
    """How many frames a picture holds; 1 where it is no TIFF or cannot be read.

    Parameters
    ----------
    path : pathlib.Path
    """
    if path.suffix.lower() not in SUFFIXES:
        return 1
    try:
        with tifffile.TiffFile(path, is_ome=False, is_imagej=False) as file:
            return max(1, len(file.pages))
    except Exception:  # reading it says why
        return 1


def _axes(text: str, count: int) -> dict[str, int]:
    """Lengths of the axes T, C and Z of an OME description, the slowest first; else empty."""
    pixels = re.search(r"<(?:\w+:)?Pixels\b[^>]*>", text)
    if pixels is None:
        return {}
    order = re.search(r'DimensionOrder="XY([CZT]{3})"', pixels[0])
    sizes = dict(re.findall(r'Size([CZT])="(\d{1,9})"', pixels[0]))
    if order is None or sorted(order[1]) != list("CTZ") or len(sizes) != 3:
        return {}
    axes = {axis: int(sizes[axis]) for axis in reversed(order[1])}
    return axes if np.prod(list(axes.values()), dtype=object) == count else {}


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
