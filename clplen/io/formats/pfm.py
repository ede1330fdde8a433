"""PFM, the portable float map, a common exchange format for disparity maps.

A header of three lines (``Pf`` grey or ``PF`` colour; width and height; a scale, negative for
little endian) is followed by float32 rows from the bottom of the picture upwards.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from clplen.checks import host_array
from clplen.errors import FormatError, ShapeError
from clplen.files import PathLike, replacing
from clplen.io.formats.untrusted import require_room
from clplen.outputs import PFM_SCALE

SUFFIXES = (".pfm",)
MAGICS = (b"Pf", b"PF")
_SPACE = rb"(?:\s|#[^\n]*\n)+"  # comments end with their line
_HEADER = re.compile(
    rb"(P[Ff])"
    + _SPACE
    + rb"(\d{1,9})"
    + _SPACE
    + rb"(\d{1,9})"
    + _SPACE
    # a decimal number, at the end of its line
    + rb"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)[ \t\r]*\n"
)
_MAX_HEADER_BYTES = 1 << 12


def read_pfm(path: PathLike) -> np.ndarray[Any, np.dtype[np.float32]]:
    """Read a PFM file.

    Parameters
    ----------
    path : path-like
        PFM file, grey or colour, of either byte order.

    Returns
    -------
    numpy.ndarray
        Array of shape (y, x) or (y, x, 3), float32, row 0 at the top. The magnitude of the scale is
        ignored, as in other readers.

    Raises
    ------
    FormatError
        If the file is missing, truncated or not PFM.

    Examples
    --------
    >>> clplen.io.write_pfm("disparity.pfm", np.tile(np.linspace(-1, 1, 32), (24, 1)))
    >>> values = clplen.io.read_pfm("disparity.pfm")
    >>> values.shape, values.dtype.name, values[0, [0, -1]].tolist()
    ((24, 32), 'float32', [-1.0, 1.0])
    """
    path = Path(path)
    if not path.is_file():
        raise FormatError(f"There is no file {path}.")
    try:
        with path.open("rb") as file:
            header = _HEADER.match(file.read(_MAX_HEADER_BYTES))
    except OSError as error:
        raise FormatError(f"Cannot read {path} ({error.strerror}).") from error
    if header is None:
        raise FormatError(f"{path} is not a PFM file: it must begin with Pf or PF and a size.")
    kind, width, height, scale = header.groups()
    shape = (int(height), int(width)) + ((3,) if kind == b"PF" else ())
    needed, available = 4 * math.prod(shape), path.stat().st_size - header.end()
    if not needed:
        raise FormatError(f"{path} must declare a nonempty picture, got {shape}.")
    if available < needed:
        raise FormatError(
            f"{path} is truncated: {shape} samples need {needed} bytes, got {available}."
        )
    order = "<f4" if float(scale) < 0 else ">f4"
    require_room(2 * needed, path=path, what="the map", max_bytes=None)
    rows = np.fromfile(path, order, needed // 4, offset=header.end()).reshape(shape)
    return rows[::-1].astype(np.float32)


def write_pfm(path: PathLike, values: ArrayLike, *, durable: bool = False) -> None:
    """Write a PFM file, little endian.

    Parameters
    ----------
    path : path-like
        Output file, such as ``disparity.pfm``.
    values : Image or array_like
        Array of shape (y, x) or (y, x, 3), row 0 at the top; written as float32.
    durable : bool
        True to wait until the file is on disk, as in `clplen.files.replacing`.

    Raises
    ------
    ShapeError
        If the array has another shape.

    Examples
    --------
    >>> disparity = np.tile(np.linspace(-1, 1, 32), (24, 1))
    >>> clplen.io.write_pfm("disparity.pfm", disparity)
    >>> clplen.io.read_disparity("disparity.pfm").shape
    (24, 32)
    """
    values = host_array(values, "A picture")
    if values.ndim not in (2, 3) or values.shape[2:] not in ((), (3,)):
        raise ShapeError(
            f"Values of a PFM must have shape (y, x) or (y, x, 3), got {values.shape}."
        )
    kind = "Pf" if values.ndim == 2 else "PF"
    height, width = values.shape[:2]
    with replacing(path, durable) as temporary, temporary.open("wb") as file:
        file.write(f"{kind}\n{width} {height}\n{PFM_SCALE}\n".encode())
        file.write(values[::-1].astype("<f4").tobytes())
