"""Display pictures of 8 bits, and films as GIF and MP4; not for measurements."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import imageio.v3 as imageio
import numpy as np
from numpy.typing import ArrayLike

from clplen.checks import host_array
from clplen.files import PathLike, replacing
from clplen.io.formats.picture import encoded
from clplen.io.formats.video import encoder, write_mp4
from clplen.outputs import MARK

# Thresholds of ordered dithering (Bayer 1973), in sixteenths.
_BAYER = np.array([[0, 8, 2, 10], [12, 4, 14, 6], [3, 11, 1, 9], [15, 7, 13, 5]])
_STEPS = 31  # levels of a colour above black
Array = np.ndarray[Any, Any]
_WHITE_PERCENTILE = 99.9  # of the values
FILMS = (".gif", ".mp4")
MIN_SECONDS, MAX_SECONDS = 0.02, 3600  # per picture; GIF players ignore shorter times
_GLINT_RATIO = 3  # a maximum above this multiple of the percentile is clipped


def write_animation(path: PathLike, pictures: Iterable[ArrayLike], *, seconds: float = 0.1) -> None:
    """Write pictures as an endlessly repeating GIF, or as a film.

    Parameters
    ----------
    path : path-like
        ``.gif``, or ``.mp4`` with ``pip install "clplen[video]"``.
    pictures : iterable of array_like
        Pictures (one or more), all uint8 of equal shape (y, x) or (y, x, 3). A GIF has 256 colours
        per picture: colours are dithered to 32 levels each, greys are kept. MP4 is H.264 in
        yuv420p, BT.709; an odd number of rows or columns is made even by repeating the last one.
    seconds : float
        Display time of a picture in seconds, 0.02 to 3600.

    Raises
    ------
    ValueError, OSError
        If the suffix is unknown, pictures are missing or differ, or imageio-ffmpeg is missing; if
        the file cannot be written.

    Examples
    --------
    >>> frames = [np.full((16, 24), level, np.uint8) for level in (0, 128, 255)]
    >>> clplen.io.write_animation("fade.gif", frames, seconds=0.5)
    >>> with open("fade.gif", "rb") as file:
    ...     file.read(6)
    b'GIF89a'
    """
    frames = [host_array(picture, "A picture") for picture in pictures]
    suffix = Path(path).suffix.lower()
    if suffix not in FILMS:
        raise ValueError(f"path must end in .gif or .mp4 for an animation, got {path}.")
    if not frames or len({frame.shape for frame in frames}) != 1:
        raise ValueError("pictures must contain at least one picture, all of equal shape.")
    if any(frame.dtype != np.uint8 or frame.ndim not in (2, 3) for frame in frames):
        raise ValueError("The pictures of an animation must be uint8 of shape (y, x) or (y, x, 3).")
    if not MIN_SECONDS <= seconds <= MAX_SECONDS:
        raise ValueError(f"seconds must be {MIN_SECONDS} to {MAX_SECONDS}, got {seconds!r}.")
    if suffix == ".mp4":
        encoder()  # raises an error before the file is created
    with replacing(path) as temporary:
        if suffix == ".mp4":
            write_mp4(temporary, frames, seconds)
            return
        imageio.imwrite(
            temporary,
            np.stack([_dithered(frame) if frame.ndim == 3 else frame for frame in frames]),
            plugin="pillow",
            extension=".gif",
            duration=1000 * seconds,
            loop=0,
            comment=MARK.encode(),
        )


def _dithered(frame: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Dither a picture to few colours, which keeps the means of smooth slopes."""
    rows, columns = (np.arange(n) % 4 for n in frame.shape[:2])
    thresholds = (_BAYER[rows[:, None], columns] + 0.5) / 16
    levels = np.floor(frame * (_STEPS / 255) + thresholds[..., None])
    return np.rint(levels * (255 / _STEPS)).astype(np.uint8)


def white_level(values: Array, dtype: np.dtype[Any], *, srgb: bool = False) -> float:
    """Return the value displayed as white."""
    if srgb:
        return 1.0
    if dtype == np.uint8:
        return 255.0
    largest, percentile = float(np.max(values)), float(np.percentile(values, _WHITE_PERCENTILE))
    white = percentile if 0 < _GLINT_RATIO * percentile < largest else largest
    return white if white > 0 else 1.0


CURVES = ("linear", "srgb", "log")
_DECADES = 3  # range of the logarithmic curve


def toned(values: Array, black: float, white: float, curve: str | float = "linear") -> Array:
    """Return a picture as uint8 with the values from black to white mapped through a curve."""
    if not white > black:
        raise ValueError(f"black must be less than white, got {black:g} and {white:g}.")
    fraction = np.clip((np.asarray(values, np.float64) - black) / (white - black), 0, 1)
    if curve == "srgb":
        fraction = encoded(fraction)
    elif curve == "log":
        fraction = np.log10(1 + (10**_DECADES - 1) * fraction) / _DECADES
    elif curve != "linear":
        if isinstance(curve, str) or not curve > 0:
            names = ", ".join(map(repr, CURVES))
            raise ValueError(f"curve must be {names} or a positive number, got {curve!r}.")
        fraction = fraction ** (1 / curve)
    return np.rint(255 * fraction).astype(np.uint8)


def to_eight_bits(values: Array, white: float, *, srgb: bool = False) -> Array:
    """Return a picture as uint8: values divided by white, clipped, optionally sRGB-encoded."""
    return toned(values, 0.0, white, "srgb" if srgb else "linear")
