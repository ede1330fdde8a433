"""Single pictures: PNG, TIFF and whatever else imageio reads, with their own values."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any

import imageio.v3 as imageio
import numpy as np
import tifffile

from clplen.errors import FormatError
from clplen.files import PathLike, replacing

SUFFIXES = (".png", ".tif", ".tiff", ".jpg", ".jpeg", ".bmp", ".pgm", ".ppm")
_TIFF = (".tif", ".tiff")
# What Pillow and tifffile raise on files that are damaged or something else.
_UNREADABLE = (
    OSError,
    SyntaxError,
    ValueError,
    EOFError,
    KeyError,
    IndexError,
    struct.error,
    zlib.error,
)


def read_picture(path: PathLike) -> np.ndarray[Any, Any]:
    """Read one picture as it is stored: no gamma, no scaling.

    Parameters
    ----------
    path : path-like
        PNG, TIFF, JPEG, BMP, PGM or PPM, told by the suffix.

    Returns
    -------
    numpy.ndarray
        Shape (y, x) or (y, x, 3), the file's own dtype. An opaque alpha channel is dropped.

    Raises
    ------
    FormatError
        If it is missing, truncated, unreadable, of another shape, complex, has transparent pixels,
        or is a PNG of 16-bit colour, which imageio would cut to 8 bits.
    """
    path = Path(path)
    if not path.is_file():
        raise FormatError(f"There is no picture {path}.")
    try:
        values = tifffile.imread(path) if path.suffix.lower() in _TIFF else _imread(path)
    except _UNREADABLE as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise FormatError(f"The picture {path} cannot be read ({reason}).") from error
    if values.ndim == 3 and values.shape[2] in (2, 4):
        values = _opaque(values, path)
    if values.dtype.kind not in "buif":
        raise FormatError(f"The picture {path} has samples of type {values.dtype}, not real ones.")
    if values.ndim not in (2, 3) or values.size == 0 or values.shape[2:] not in ((), (3,)):
        raise FormatError(f"The picture {path} has shape {values.shape}, not (y, x) or (y, x, 3).")
    if values.dtype == bool:
        return values.astype(np.uint8)
    return values.astype(values.dtype.newbyteorder("="), copy=False)


def _imread(path: Path) -> np.ndarray[Any, Any]:
    with path.open("rb") as file:
        start = file.read(26)
    if start[:4] == b"\x89PNG" and start[24:26] in (b"\x10\x02", b"\x10\x06"):
        raise ValueError("a PNG of 16-bit colour; convert it to TIFF")
    return np.asarray(imageio.imread(path, plugin="pillow"))


def _opaque(values: np.ndarray[Any, Any], path: Path) -> np.ndarray[Any, Any]:
    """Colours or greys without an alpha channel that says nothing."""
    alpha = values[..., -1]
    highest = np.iinfo(alpha.dtype).max if alpha.dtype.kind == "u" else 1
    if not (alpha == highest).all():
        raise FormatError(f"The picture {path} has transparent pixels: flatten first.")
    return values[..., 0] if values.shape[2] == 2 else values[..., :-1]


def write_picture(path: PathLike, values: np.ndarray[Any, Any], *, description: str = "") -> None:
    """Write one picture with its own values.

    Parameters
    ----------
    path : path-like
        ``.png`` takes uint8 (y, x) and (y, x, 3) and uint16 (y, x); ``.tif`` any real dtype.
    values : numpy.ndarray
        Shape (y, x) or (y, x, 3).
    description : str, optional
        What the values are, in ASCII; kept by TIFF only.

    Raises
    ------
    ValueError
        If the suffix is another one, or a PNG cannot hold the values.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix in _TIFF:
        colour = "rgb" if values.ndim == 3 else "minisblack"
        with replacing(path) as temporary:
            tifffile.imwrite(
                temporary, values, photometric=colour, description=description, metadata=None
            )
        return
    fits = values.dtype == np.uint8 or (values.dtype == np.uint16 and values.ndim == 2)
    if suffix != ".png" or not fits:
        raise ValueError(
            f"{path.name} cannot hold {values.dtype} of shape {values.shape}: PNG takes uint8 and "
            "grey uint16, .tif takes everything."
        )
    with replacing(path) as temporary:
        imageio.imwrite(temporary, values, plugin="pillow", extension=".png")
