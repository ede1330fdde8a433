"""Single pictures: PNG, TIFF, JPEG, BMP, PGM and PPM with unscaled values; sRGB and alpha.

The first bytes declare kind, size and compression; they are checked before decoding.
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import IO, Any

import imageio.v3 as imageio
import numpy as np
import tifffile
from numpy.typing import ArrayLike
from PIL.PngImagePlugin import PngInfo

from clplen.checks import host_array, is_finite
from clplen.errors import FormatError, ShapeError
from clplen.files import PathLike, replacing
from clplen.io.formats import tiff
from clplen.io.formats.png16 import decode_png16
from clplen.io.formats.tiff import checked_picture, decode_tiff, picture_errors
from clplen.io.formats.untrusted import DEFLATE, Bound, require_room
from clplen.outputs import MARK

_LINEAR = 0.04045  # sRGB is linear below it (IEC 61966-2-1:1999)
PNG = b"\x89PNG\r\n\x1a\n"
TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_JPEG = b"\xff\xd8\xff"
_JPEG_RATIO = 2048.0  # 1 bit for a block of 64 samples, chroma halved twice (ITU-T T.81)
_RLE_RATIO = 512.0  # BMP: 255 pixels of 4 bytes from 2 bytes
_PNG_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
_STANDALONE = {0x01, *range(0xD0, 0xD9)}  # JPEG markers without a length
_FRAMES = set(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}  # JPEG markers with the size
_SPACE = rb"(?:\s|#[^\n]*\n)+"
_PNM = re.compile(
    rb"P([56])" + _SPACE + rb"(\d{1,9})" + _SPACE + rb"(\d{1,9})" + _SPACE + rb"(\d{1,5})\s"
)
LARGE = 1 << 26  # bytes; larger files are compared with their number of pixels
HEAD = 1 << 16  # bytes with the size of a picture, without long JPEG metadata
_LONG_HEAD = 1 << 20  # bytes with the size of a large picture, with JPEG metadata
SUFFIXES = (".png", ".tif", ".tiff", ".jpg", ".jpeg", ".bmp", ".pgm", ".ppm")
_MAX_PILLOW_PIXELS = 89_478_485  # Pillow warns above it and raises at twice as many
CHANNEL_AXIS = "light field with a channel axis of length 1"  # marks such a picture
NOTES = 4096  # bytes searched for a description of our writers
Array = np.ndarray[Any, Any]


def linear(values: Array) -> Array:
    """Decode sRGB to linear light, 0 to 1, float32 (IEC 61966-2-1:1999)."""
    if values.dtype.kind == "u":
        levels = np.linspace(0, 1, int(np.iinfo(values.dtype).max) + 1)
        return np.asarray(_from_srgb(levels).astype(np.float32)[values])
    return _from_srgb(values.astype(np.float64)).astype(np.float32)


def _from_srgb(s: Array) -> Array:
    low = s <= _LINEAR
    return np.where(low, s / 12.92, ((np.maximum(s, _LINEAR) + 0.055) / 1.055) ** 2.4)


def encoded(values: Array) -> Array:
    """Encode linear light from 0 to 1, clipped, as sRGB from 0 to 1; inverse of `linear`."""
    s = np.clip(values, 0, 1)
    return np.where(s <= _LINEAR / 12.92, 12.92 * s, 1.055 * s ** (1 / 2.4) - 0.055)


def without_alpha(values: Array, name: PathLike) -> Array:
    """Return colours or grey values without an opaque alpha channel."""
    if values.ndim == 2 or values.shape[2] == 3:
        return values
    alpha = values[..., -1]
    highest = np.iinfo(alpha.dtype).max if alpha.dtype.kind == "u" else 1
    if not (alpha == highest).all():
        raise FormatError(f"The picture {name} has transparent pixels: flatten it first.")
    return values[..., 0] if values.shape[2] == 2 else values[..., :-1]


def read_view(path: PathLike, *, max_bytes: int | None = None) -> Array:
    """Read a picture of a light field, restoring a channel axis of length 1."""
    values = read_picture(path, max_bytes=max_bytes)
    with Path(path).open("rb") as file:
        return with_channel_axis(values, file.read(NOTES))


def with_channel_axis(values: Array, content: bytes | mmap) -> Array:
    """Add a channel axis of length 1 to a grey picture described by `CHANNEL_AXIS`."""
    has_axis = values.ndim == 2 and CHANNEL_AXIS.encode() in content[:NOTES]
    return values[..., None] if has_axis else values


@dataclass(frozen=True)
class Header:
    """Properties declared in the first bytes of a picture."""

    kind: str  # {"PNG", "TIFF", "JPEG", "BMP", "PNM"}
    pixels: int = 0  # rows times columns; 0 for TIFF, determined by its reader
    nbytes: int = 0  # largest size of the decoded samples
    ratio: float = 1.0  # largest number of decoded bytes per stored byte
    deep: bool = False  # True for a PNG of 16 bits and several channels


def header_of(content: bytes) -> Header:
    """Return the header of a picture from its first bytes."""
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
    raise ValueError("it is not PNG, TIFF, JPEG, BMP, binary PGM or PPM")


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
    """Return (y, x, c), bytes per sample and offset of the samples of a binary PGM or PPM."""
    match = _PNM.match(content[:4096])
    if match is None:
        raise ValueError("its header is damaged")
    kind, width, height, highest = (int(group) for group in match.groups())
    if not 0 < highest < 2**16 or not width * height:
        raise ValueError("its header is damaged")
    return (height, width, 3 if kind == 6 else 1), 1 if highest < 256 else 2, match.end()


def read_picture(path: PathLike, *, max_bytes: int | None = None) -> Array:
    """Read a picture as stored, without gamma or scaling.

    Parameters
    ----------
    path : path-like
        PNG, TIFF, JPEG, BMP, PGM or PPM, detected by its first bytes.
    max_bytes : int, optional
        Largest allocation that the file may cause; default half of the free memory.

    Returns
    -------
    numpy.ndarray
        Picture of shape (y, x) or (y, x, 3), in the dtype of the file. An opaque alpha channel is
        dropped.

    Raises
    ------
    FormatError
        If the file is missing, truncated or unreadable; if it declares more than it can hold or
        ``max_bytes`` allow; if it has another shape, complex values or transparent pixels.

    Examples
    --------
    >>> clplen.io.write_picture("grey.png", np.full((24, 32), 1000, np.uint16))
    >>> picture = clplen.io.read_picture("grey.png")
    >>> picture.shape, picture.dtype.name, int(picture.max())
    ((24, 32), 'uint16', 1000)
    """
    return without_alpha(read_channels(path, max_bytes=max_bytes), path)


def pixels_of(path: Path) -> int:
    """Return the number of pixels a picture declares; 0 if unreadable."""
    try:
        if not path.is_file():
            return 0
        with path.open("rb") as file:
            head = file.read(HEAD)
        if head[:4] not in TIFF:
            return header_of(head).pixels
        with tiff.open_tiff(path) as tiff_file:
            return int(tiff_file.pages.first.imagelength * tiff_file.pages.first.imagewidth)
    except Exception:  # tifffile raises any exception on damaged files
        return 0


def require_pixels(file: IO[bytes], size: int, path: Path) -> None:
    """Raise FormatError for a file far larger than the pixels that it declares."""
    if size <= LARGE or (head := file.read(_LONG_HEAD))[:4] in TIFF:
        return
    try:
        pixels = header_of(head).pixels
    except ValueError as error:
        raise FormatError(f"The picture {path} is unreadable ({error}).") from error
    if 32 * pixels < size:
        raise FormatError(f"The picture {path} has {size:,} bytes, far more than its pixels need.")


def read_channels(path: PathLike, *, max_bytes: int | None = None) -> Array:
    """Read a picture with its alpha channel, if any."""
    path = Path(path)
    if not path.is_file():
        raise FormatError(f"There is no picture {path}.")
    size = path.stat().st_size
    require_room(size, path=path, what="the picture", max_bytes=max_bytes)
    try:
        with path.open("rb") as file:
            if size and file.read(4) in TIFF:  # mapped, without a second copy of its samples
                with mmap(file.fileno(), 0, access=ACCESS_READ) as mapped:
                    return decode_picture(mapped, path, max_bytes=max_bytes)
            file.seek(0)
            require_pixels(file, size, path)
            file.seek(0)
            content = file.read()
    except OSError as error:
        raise FormatError(f"The picture {path} is unreadable ({error.strerror}).") from error
    return decode_picture(content, path, max_bytes=max_bytes)


def decode_picture(content: bytes | mmap, name: PathLike, *, max_bytes: int | None = None) -> Array:
    """Decode a picture in memory with its alpha channel, if any."""
    path = Path(name)
    with picture_errors(path):
        values = checked_picture(_decoded(content, path, max_bytes), path)
    return values.astype(np.uint8) if values.dtype == bool else values


def _decoded(content: bytes | mmap, path: Path, max_bytes: int | None) -> Array:
    if not content:
        raise ValueError("it is empty")
    if isinstance(content, mmap):
        return decode_tiff(content, path, max_bytes=max_bytes)
    header = header_of(content)
    if header.kind == "TIFF":
        return decode_tiff(content, path, max_bytes=max_bytes)
    Bound(path, len(content), header.ratio, max_bytes).require(header.nbytes, "the picture")
    if header.kind == "PNM":
        return _pnm(content)
    if header.deep:
        return decode_png16(content)
    return _decode_with_pillow(content, header)


def _pnm(content: bytes) -> Array:
    shape, size, start = pnm_layout(content)
    count = shape[0] * shape[1] * shape[2]
    if len(content) - start < count * size:
        raise ValueError("it is truncated")
    values = np.frombuffer(content, ">u2" if size == 2 else "u1", count, start).reshape(shape)
    return values[..., 0] if shape[2] == 1 else values


def _decode_with_pillow(content: bytes, header: Header) -> Array:
    if header.pixels > _MAX_PILLOW_PIXELS:
        raise ValueError(
            f"{header.pixels:,} pixels exceed Pillow's limit of {_MAX_PILLOW_PIXELS:,}: write it "
            "as TIFF"
        )
    return np.asarray(imageio.imread(content, plugin="pillow", index=0))


def write_picture(
    path: PathLike,
    values: ArrayLike,
    *,
    description: str = "",
    durable: bool = False,
    dpi: float | None = None,
) -> None:
    """Write a picture with unscaled values.

    Parameters
    ----------
    path : path-like
        ``.png`` for uint8 (y, x) and (y, x, 3) and uint16 (y, x); ``.tif`` for any real dtype, with
        bool stored as uint8.
    values : Image or array_like
        Picture of shape (y, x) or (y, x, 3).
    description : str, optional
        Meaning of the values, in ASCII.
    durable : bool
        True to wait until the file is on disk, as in `clplen.files.replacing`.
    dpi : float, optional
        Pixels per inch for printers, positive. PNG rounds to integer pixels per metre.

    Raises
    ------
    ShapeError, ValueError
        If the shape is wrong; if the suffix is unknown, a PNG cannot hold the values, or dpi is not
        positive.

    Examples
    --------
    >>> phase = np.linspace(-np.pi, np.pi, 24 * 32).reshape(24, 32)
    >>> clplen.io.write_picture("phase.tif", phase, description="phase in radians")
    >>> stored = clplen.io.read_picture("phase.tif")
    >>> stored.dtype.name, bool((stored == phase).all())
    ('float64', True)
    """
    path = Path(path)
    values = host_array(values, "A picture")
    suffix = path.suffix.lower()
    if values.size == 0 or values.ndim not in (2, 3) or values.shape[2:] not in ((), (3,)):
        raise ShapeError(f"A picture must have shape (y, x) or (y, x, 3), got {values.shape}.")
    if values.dtype.kind not in "buif":
        raise ValueError(f"A picture must hold real numbers, got {values.dtype}.")
    if values.dtype == bool:  # tifffile does not read back all bits that it writes
        values = values.astype(np.uint8)
    if dpi is not None and not (is_finite(dpi) and dpi > 0):
        raise ValueError(f"dpi must be positive, got {dpi!r}.")
    if suffix in tiff.SUFFIXES:
        sizes: Any = {} if dpi is None else {"resolution": (dpi, dpi), "resolutionunit": "INCH"}
        colour = "rgb" if values.ndim == 3 else "minisblack"
        with replacing(path, durable) as temporary:
            tifffile.imwrite(
                temporary,
                values,
                photometric=colour,
                description=description,
                metadata=None,
                software=MARK,
                **sizes,
            )
        return
    fits = values.dtype == np.uint8 or (values.dtype == np.uint16 and values.ndim == 2)
    if suffix != ".png" or not fits:
        raise ValueError(
            f"{path.name} cannot hold {values.dtype} of shape {values.shape}: PNG stores uint8 and "
            "grey uint16; use .tif for other types."
        )
    about = PngInfo()
    about.add_text("Software", MARK)
    if description:
        about.add_text("Description", description)
    with replacing(path, durable) as temporary:
        options: Any = {"pnginfo": about} | ({} if dpi is None else {"dpi": (dpi, dpi)})
        imageio.imwrite(temporary, values, plugin="pillow", extension=".png", **options)
