"""PFM, the portable float map: how disparity maps are exchanged.

Three lines of text (``Pf`` grey or ``PF`` colour; width and height; a scale whose sign tells the
byte order, negative for little endian), then float32 rows from the bottom of the picture upwards.
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
_SPACE = rb"(?:\s|#[^\n]*\n)+"  # comments run to the end of their line
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
_LONGEST = 1 << 12  # bytes of a header


def read_pfm(path: PathLike) -> np.ndarray[Any, np.dtype[np.float32]]:
    """Read a PFM file.

    Parameters
    ----------
    path : path-like
        PFM, grey or in colour, of either byte order.

    Returns
    -------
    numpy.ndarray
        Shape (y, x) or (y, x, 3), float32, row 0 at the top. The size of the scale is ignored,
        as other readers do.

    Raises
    ------
    FormatError
        If there is no such file, it is not PFM or it is truncated.

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
            header = _HEADER.match(file.read(_LONGEST))
    except OSError as error:
        raise FormatError(f"{path} cannot be read ({error.strerror}).") from error
    if header is None:
        raise FormatError(f"{path} is not a PFM file: it does not begin with Pf or PF and a size.")
    kind, width, height, scale = header.groups()
    shape = (int(height), int(width)) + ((3,) if kind == b"PF" else ())
    needed, found = 4 * math.prod(shape), path.stat().st_size - header.end()
    if not needed:
        raise FormatError(f"{path} declares {shape} samples, which is no picture.")
    if found < needed:
        raise FormatError(
            f"{path} is truncated: {shape} samples need {needed} bytes, {found} are there."
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
        The file, such as ``disparity.pfm``.
    values : Image or array_like
        Shape (y, x) or (y, x, 3), row 0 at the top; written as float32.
    durable : bool
        Whether to wait until the disk has the file, as in `clplen.files.replacing`.

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
        raise ShapeError(f"PFM holds (y, x) or (y, x, 3), not {values.shape}.")
    kind = "Pf" if values.ndim == 2 else "PF"
    height, width = values.shape[:2]
    with replacing(path, durable) as temporary, temporary.open("wb") as file:
        file.write(f"{kind}\n{width} {height}\n{PFM_SCALE}\n".encode())
        file.write(values[::-1].astype("<f4").tobytes())
