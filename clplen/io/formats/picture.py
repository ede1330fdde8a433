"""Single pictures: PNG, TIFF, JPEG, BMP, PGM and PPM, with their own values."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import imageio.v3 as imageio
import numpy as np
import tifffile
from PIL.PngImagePlugin import PngInfo

from clplen.errors import FormatError
from clplen.files import PathLike, replacing
from clplen.io.formats.header import Header, header_of, pnm_layout
from clplen.io.formats.png16 import decode_png16
from clplen.io.formats.tiff import decode_tiff
from clplen.io.formats.untrusted import require_bytes
from clplen.outputs import MARK

SUFFIXES = (".png", ".tif", ".tiff", ".jpg", ".jpeg", ".bmp", ".pgm", ".ppm")
_TIFF = (".tif", ".tiff")
_MOST_PIXELS = 89_478_485  # from here on Pillow warns of bombs, at twice as many it refuses

Array = np.ndarray[Any, Any]


def read_picture(path: PathLike, *, max_bytes: int | None = None) -> Array:
    """Read one picture as it is stored: no gamma, no scaling.

    Parameters
    ----------
    path : path-like
        PNG, TIFF, JPEG, BMP, PGM or PPM, told by its first bytes.
    max_bytes : int, optional
        Largest allocation that it may ask for; default half of the free memory.

    Returns
    -------
    numpy.ndarray
        Shape (y, x) or (y, x, 3), the file's own dtype. An opaque alpha channel is dropped.

    Raises
    ------
    FormatError
        If it is missing, truncated, unreadable, declares more than it can hold or ``max_bytes``
        allow, has another shape, is complex, or has transparent pixels.
    """
    return without_alpha(read_channels(path, max_bytes=max_bytes), path)


def read_channels(path: PathLike, *, max_bytes: int | None = None) -> Array:
    """Read one picture with its alpha channel, if it has one.

    Parameters
    ----------
    path, max_bytes
        As for `read_picture`.

    Returns
    -------
    numpy.ndarray
        Shape (y, x) or (y, x, c), c = 2, 3 or 4; the last of 2 or 4 is alpha.

    Raises
    ------
    FormatError
        As `read_picture`, save for transparent pixels.
    """
    path = Path(path)
    if not path.is_file():
        raise FormatError(f"There is no picture {path}.")
    size = path.stat().st_size
    require_bytes(size, path=path, what="the picture", stored=size, ratio=1, max_bytes=max_bytes)
    try:
        content = path.read_bytes()
    except OSError as error:
        raise FormatError(f"The picture {path} cannot be read ({error.strerror}).") from error
    return decode_picture(content, path, max_bytes=max_bytes)


def decode_picture(content: bytes, name: PathLike, *, max_bytes: int | None = None) -> Array:
    """Decode one picture from memory, with its alpha channel, if it has one.

    Parameters
    ----------
    content : bytes
    name : path-like
        For messages.
    max_bytes : int, optional
        As for `read_picture`.

    Returns
    -------
    numpy.ndarray
        As `read_channels`.

    Raises
    ------
    FormatError
        As `read_channels`.
    """
    path = Path(name)
    try:
        values = _decoded(content, path, max_bytes)
    except FormatError:
        raise
    except Exception as error:  # Pillow and tifffile raise all kinds on damaged files
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise FormatError(f"The picture {path} cannot be read ({reason}).") from error
    if values.dtype.kind not in "buif":
        raise FormatError(f"The picture {path} has samples of type {values.dtype}, not real ones.")
    channels = values.shape[2:]
    if values.ndim not in (2, 3) or values.size == 0 or channels not in ((), (2,), (3,), (4,)):
        raise FormatError(f"The picture {path} has shape {values.shape}, not (y, x) or (y, x, 3).")
    if values.dtype == bool:
        return values.astype(np.uint8)
    return values.astype(values.dtype.newbyteorder("="), copy=False)


def _decoded(content: bytes, path: Path, max_bytes: int | None) -> Array:
    if not content:
        raise ValueError("it is empty")
    header = header_of(content)
    if header.kind == "TIFF":
        return decode_tiff(content, path, max_bytes=max_bytes)
    require_bytes(
        header.nbytes,
        path=path,
        what="the picture",
        stored=len(content),
        ratio=header.ratio,
        max_bytes=max_bytes,
    )
    if header.kind == "PNM":
        return _pnm(content)
    if header.deep:
        return decode_png16(content)
    return _by_pillow(content, header)


def _pnm(content: bytes) -> Array:
    shape, size, start = pnm_layout(content)
    count = shape[0] * shape[1] * shape[2]
    if len(content) - start < count * size:
        raise ValueError("it is truncated")
    values = np.frombuffer(content, ">u2" if size == 2 else "u1", count, start).reshape(shape)
    return values[..., 0] if shape[2] == 1 else values


def _by_pillow(content: bytes, header: Header) -> Array:
    if header.pixels > _MOST_PIXELS:
        raise ValueError(
            f"{header.pixels:,} pixels, of which Pillow reads {_MOST_PIXELS:,}: write it as TIFF"
        )
    return np.asarray(imageio.imread(content, plugin="pillow", index=0))


def without_alpha(values: Array, name: PathLike) -> Array:
    """Colours or greys without an alpha channel that says nothing.

    Parameters
    ----------
    values : numpy.ndarray
        As `read_channels` gives them.
    name : path-like
        For messages.

    Returns
    -------
    numpy.ndarray
        Shape (y, x) or (y, x, 3).

    Raises
    ------
    FormatError
        If a pixel is transparent.
    """
    if values.ndim == 2 or values.shape[2] == 3:
        return values
    alpha = values[..., -1]
    highest = np.iinfo(alpha.dtype).max if alpha.dtype.kind == "u" else 1
    if not (alpha == highest).all():
        raise FormatError(f"The picture {name} has transparent pixels: flatten first.")
    return values[..., 0] if values.shape[2] == 2 else values[..., :-1]


def write_picture(
    path: PathLike, values: Array, *, description: str = "", durable: bool = False
) -> None:
    """Write one picture with its own values.

    Parameters
    ----------
    path : path-like
        ``.png`` takes uint8 (y, x) and (y, x, 3) and uint16 (y, x); ``.tif`` any real dtype.
    values : numpy.ndarray
        Shape (y, x) or (y, x, 3).
    description : str, optional
        What the values are, in ASCII; kept by TIFF only.
    durable : bool
        Whether to wait until the disk has the file, as in `clplen.files.replacing`.

    Raises
    ------
    ValueError
        If the suffix is another one, or a PNG cannot hold the values.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix in _TIFF:
        colour = "rgb" if values.ndim == 3 else "minisblack"
        with replacing(path, durable) as temporary:
            tifffile.imwrite(
                temporary,
                values,
                photometric=colour,
                description=description,
                metadata=None,
                software=MARK,
            )
        return
    fits = values.dtype == np.uint8 or (values.dtype == np.uint16 and values.ndim == 2)
    if suffix != ".png" or not fits:
        raise ValueError(
            f"{path.name} cannot hold {values.dtype} of shape {values.shape}: PNG takes uint8 and "
            "grey uint16, .tif takes everything."
        )
    about = PngInfo()
    about.add_text("Software", MARK)
    with replacing(path, durable) as temporary:
        imageio.imwrite(temporary, values, plugin="pillow", extension=".png", pnginfo=about)
