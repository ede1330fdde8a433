"""Single pictures: PNG, TIFF, JPEG, BMP, PGM and PPM, with their own values; sRGB and alpha.

What the first bytes declare is known before anything is decoded: kind, size, and how far it is
compressed.
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

_LINEAR = 0.04045  # sRGB below it is a straight line (IEC 61966-2-1:1999)
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
LARGE = 1 << 26  # bytes of a file from which on they are compared with its pixels
HEAD = 1 << 16  # bytes that declare the size; of a JPEG, before longer notes
_LONG_HEAD = 1 << 20  # bytes of a large file, with the notes of a JPEG
SUFFIXES = (".png", ".tif", ".tiff", ".jpg", ".jpeg", ".bmp", ".pgm", ".ppm")
_MOST_PIXELS = 89_478_485  # from here on Pillow warns of bombs, at twice as many it refuses
CHANNEL_AXIS = "light field with a channel axis of length 1"  # description of such a picture
NOTES = 4096  # bytes in which our writers put the description
Array = np.ndarray[Any, Any]


def linear(values: Array) -> Array:
    """sRGB decoded to linear light, 0 to 1, float32 (IEC 61966-2-1:1999)."""
    if values.dtype.kind == "u":
        levels = np.linspace(0, 1, int(np.iinfo(values.dtype).max) + 1)
        return np.asarray(_from_srgb(levels).astype(np.float32)[values])
    return _from_srgb(values.astype(np.float64)).astype(np.float32)


def _from_srgb(s: Array) -> Array:
    low = s <= _LINEAR
    return np.where(low, s / 12.92, ((np.maximum(s, _LINEAR) + 0.055) / 1.055) ** 2.4)


def encoded(values: Array) -> Array:
    """The inverse of `linear`: linear light from 0 to 1, clipped, as sRGB from 0 to 1."""
    s = np.clip(values, 0, 1)
    return np.where(s <= _LINEAR / 12.92, 12.92 * s, 1.055 * s ** (1 / 2.4) - 0.055)


def without_alpha(values: Array, name: PathLike) -> Array:
    """Colours or greys without an alpha channel that says nothing."""
    if values.ndim == 2 or values.shape[2] == 3:
        return values
    alpha = values[..., -1]
    highest = np.iinfo(alpha.dtype).max if alpha.dtype.kind == "u" else 1
    if not (alpha == highest).all():
        raise FormatError(f"The picture {name} has transparent pixels: flatten first.")
    return values[..., 0] if values.shape[2] == 2 else values[..., :-1]


def read_view(path: PathLike, *, max_bytes: int | None = None) -> Array:
    """Read a picture of a light field, with a channel axis of length 1 where it was written so."""
    values = read_picture(path, max_bytes=max_bytes)
    with Path(path).open("rb") as file:
        return with_channel_axis(values, file.read(NOTES))


def with_channel_axis(values: Array, content: bytes | mmap) -> Array:
    """A grey picture with a channel axis of length 1 if its description is `CHANNEL_AXIS`."""
    has_axis = values.ndim == 2 and CHANNEL_AXIS.encode() in content[:NOTES]
    return values[..., None] if has_axis else values


@dataclass(frozen=True)
class Header:
    """What a picture declares."""

    kind: str  # {"PNG", "TIFF", "JPEG", "BMP", "PNM"}
    pixels: int = 0  # rows times columns; 0 for TIFF, whose reader finds out
    nbytes: int = 0  # of the decoded samples, at most
    ratio: float = 1.0  # largest number of decoded bytes from one stored byte
    deep: bool = False  # whether it is a PNG with 16 bits a sample and more than one channel


def header_of(content: bytes) -> Header:
    """What a picture declares."""
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
    """Of a binary PGM or PPM: (y, x, c), bytes a sample, and where the samples begin."""
    match = _PNM.match(content[:4096])
    if match is None:
        raise ValueError("its header is damaged")
    kind, width, height, highest = (int(group) for group in match.groups())
    if not 0 < highest < 2**16 or not width * height:
        raise ValueError("its header is damaged")
    return (height, width, 3 if kind == 6 else 1), 1 if highest < 256 else 2, match.end()


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

    Examples
    --------
    >>> clplen.io.write_picture("grey.png", np.full((24, 32), 1000, np.uint16))
    >>> picture = clplen.io.read_picture("grey.png")
    >>> picture.shape, picture.dtype.name, int(picture.max())
    ((24, 32), 'uint16', 1000)
    """
    return without_alpha(read_channels(path, max_bytes=max_bytes), path)


def pixels_of(path: Path) -> int:
    """How many pixels a picture declares; 0 where it cannot be told, which reading explains."""
    try:
        if not path.is_file():
            return 0
        with path.open("rb") as file:
            head = file.read(HEAD)
        if head[:4] not in TIFF:
            return header_of(head).pixels
        with tiff.open_tiff(path) as opened:
            return int(opened.pages.first.imagelength * opened.pages.first.imagewidth)
    except Exception:  # tifffile raises all kinds on damaged files
        return 0


def require_pixels(file: IO[bytes], size: int, path: Path) -> None:
    """Refuse a picture whose file is far larger than the pixels that its first bytes declare."""
    if size <= LARGE or (head := file.read(_LONG_HEAD))[:4] in TIFF:
        return
    try:
        pixels = header_of(head).pixels
    except ValueError as error:
        raise FormatError(f"The picture {path} cannot be read ({error}).") from error
    if 32 * pixels < size:
        raise FormatError(f"The picture {path} has {size:,} bytes, far more than its pixels need.")


def read_channels(path: PathLike, *, max_bytes: int | None = None) -> Array:
    """Read one picture with its alpha channel, if it has one."""
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
        raise FormatError(f"The picture {path} cannot be read ({error.strerror}).") from error
    return decode_picture(content, path, max_bytes=max_bytes)


def decode_picture(content: bytes | mmap, name: PathLike, *, max_bytes: int | None = None) -> Array:
    """Decode one picture from memory, with its alpha channel, if it has one."""
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


def write_picture(
    path: PathLike,
    values: ArrayLike,
    *,
    description: str = "",
    durable: bool = False,
    dpi: float | None = None,
) -> None:
    """Write one picture with its own values.

    Parameters
    ----------
    path : path-like
        ``.png`` takes uint8 (y, x) and (y, x, 3) and uint16 (y, x); ``.tif`` any real dtype, of
        which bool becomes uint8.
    values : Image or array_like
        Shape (y, x) or (y, x, 3).
    description : str, optional
        What the values are, in ASCII.
    durable : bool
        Whether to wait until the disk has the file, as in `clplen.files.replacing`.
    dpi : float, optional
        Pixels an inch, for printers; positive. PNG keeps whole numbers of pixels a metre.

    Raises
    ------
    ShapeError, ValueError
        If the values have another shape; if the suffix is another one, a PNG cannot hold the
        values, or dpi is not positive.

    Examples
    --------
    >>> phase = np.linspace(-np.pi, np.pi, 24 * 32).reshape(24, 32)
    >>> clplen.io.write_picture("phase.tif", phase, description="phase in radians")
    >>> found = clplen.io.read_picture("phase.tif")
    >>> found.dtype.name, bool((found == phase).all())
    ('float64', True)
    """
    path = Path(path)
    values = host_array(values, "A picture")
    suffix = path.suffix.lower()
    if values.size == 0 or values.ndim not in (2, 3) or values.shape[2:] not in ((), (3,)):
        raise ShapeError(f"A picture has shape (y, x) or (y, x, 3), not {values.shape}.")
    if values.dtype.kind not in "buif":
        raise ValueError(f"A picture holds real numbers, not {values.dtype}.")
    if values.dtype == bool:  # tifffile does not read all of the bits that it writes
        values = values.astype(np.uint8)
    if dpi is not None and not (is_finite(dpi) and dpi > 0):
        raise ValueError(f"The dpi of a picture is positive, not {dpi!r}.")
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
            f"{path.name} cannot hold {values.dtype} of shape {values.shape}: PNG takes uint8 and "
            "grey uint16, .tif takes everything."
        )
    about = PngInfo()
    about.add_text("Software", MARK)
    if description:
        about.add_text("Description", description)
    with replacing(path, durable) as temporary:
        words: Any = {"pnginfo": about} | ({} if dpi is None else {"dpi": (dpi, dpi)})
        imageio.imwrite(temporary, values, plugin="pillow", extension=".png", **words)
