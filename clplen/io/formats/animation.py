"""Pictures to look at, never to measure: 8 bits, and films as GIF and MP4."""

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
_STEPS = 31  # of a colour, from black to full
Array = np.ndarray[Any, Any]
_MOST = 99.9  # per cent of the values
FILMS = (".gif", ".mp4")
_SHORTEST, _LONGEST = 0.02, 3600  # seconds of a picture
_GLINT = 3  # times that percentile: a larger maximum is cut


def write_animation(path: PathLike, pictures: Iterable[ArrayLike], *, seconds: float = 0.1) -> None:
    """Write pictures as an animated GIF that repeats for ever, or as a film.

    Parameters
    ----------
    path : path-like
        ``.gif``, or ``.mp4`` with ``pip install "clplen[video]"``.
    pictures : iterable of array_like
        Of uint8, all of one shape (y, x) or (y, x, 3), at least one. A GIF keeps 256
        colours a picture: colours are dithered to 32 levels of each first, greys stay.
        MP4 is H.264 in yuv420p, BT.709; of an odd number of rows or columns the last one stands
        twice there.
    seconds : float
        For how long each picture is shown, 0.02 to 3600.

    Raises
    ------
    ValueError, OSError
        If the suffix is another one, there is no picture, they differ, or imageio-ffmpeg is
        missing; if the file cannot be written.

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
        raise ValueError(f"An animation is written as .gif or .mp4, not as {path}.")
    if not frames or len({frame.shape for frame in frames}) != 1:
        raise ValueError("An animation has at least one picture, all of one shape.")
    if any(frame.dtype != np.uint8 or frame.ndim not in (2, 3) for frame in frames):
        raise ValueError("The pictures of an animation are uint8, (y, x) or (y, x, 3).")
    if not _SHORTEST <= seconds <= _LONGEST:
        raise ValueError(
            f"A picture is shown for at least {_SHORTEST} and at most {_LONGEST} seconds, not "
            f"{seconds!r}."
        )
    if suffix == ".mp4":
        encoder()  # refused before a file is begun
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
    """A picture of few colours, whose palette is found soon; smooth slopes keep their means."""
    rows, columns = (np.arange(n) % 4 for n in frame.shape[:2])
    thresholds = (_BAYER[rows[:, None], columns] + 0.5) / 16
    levels = np.floor(frame * (_STEPS / 255) + thresholds[..., None])
    return np.rint(levels * (255 / _STEPS)).astype(np.uint8)


def white_level(values: Array, dtype: np.dtype[Any], *, srgb: bool = False) -> float:
    """The value that is shown as white."""
    if srgb:
        return 1.0
    if dtype == np.uint8:
        return 255.0
    largest, most = float(np.max(values)), float(np.percentile(values, _MOST))
    white = most if 0 < _GLINT * most < largest else largest
    return white if white > 0 else 1.0


CURVES = ("linear", "srgb", "log")
_DECADES = 3  # of the logarithmic curve


def toned(values: Array, black: float, white: float, curve: str | float = "linear") -> Array:
    """A picture as uint8, its values between black and white brought through a curve."""
    if not white > black:
        raise ValueError(f"Black lies below white, not at {black:g} and {white:g}.")
    part = np.clip((np.asarray(values, np.float64) - black) / (white - black), 0, 1)
    if curve == "srgb":
        part = encoded(part)
    elif curve == "log":
        part = np.log10(1 + (10**_DECADES - 1) * part) / _DECADES
    elif curve != "linear":
        if isinstance(curve, str) or not curve > 0:
            known = ", ".join(map(repr, CURVES))
            raise ValueError(f"The curve is {known} or a positive number, not {curve!r}.")
        part = part ** (1 / curve)
    return np.rint(255 * part).astype(np.uint8)


def to_eight_bits(values: Array, white: float, *, srgb: bool = False) -> Array:
    """A picture as uint8: values over white, cut to 0 to 1, encoded as sRGB where asked."""
    return toned(values, 0.0, white, "srgb" if srgb else "linear")
