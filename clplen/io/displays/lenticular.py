"""Prints under a sheet of cylindrical lenses: views interlaced strip by strip, and pitch tests.

Under each lens lie strips of all views. A lens shows the strip at its left to an eye at the right,
so that the views stand mirrored: the leftmost viewpoint at the right.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sized
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from PIL import Image, ImageDraw, ImageFont

from clplen.checks import check_finite, float64_array, host_array, is_finite, positive_integer
from clplen.compute.memory import free_memory
from clplen.errors import ShapeError

Array = np.ndarray[Any, Any]

LENSES = ("vertical", "horizontal")
LEAST_PITCH = 2  # pixels a lens: one for each of two views
_TIE = 1e-9  # of a strip: a pixel's middle this near to the border of two belongs to the right one
_COPIES = 4  # of the print: itself, a view, what that is made of, and while it is written
PET = 1.57  # refractive index of the usual sheets, PET-G; acrylic has 1.49

# Of a pitch test, in millimetres.
_BAND, _GAP, _HEAD, _LABEL, _TEXT = 6.0, 1.0, 9.0, 20.0, 3.5
_LEAST_BARS = 20.0
_MM = 25.4  # an inch


def lens_pitch(
    lpi: float,
    dpi: float,
    *,
    distance: float | None = None,
    thickness: float = 0.0,
    index: float = PET,
) -> float:
    """Return the pitch of the strips under a lenticular sheet, in printed pixels.

    Parameters
    ----------
    lpi : float
        Lenses an inch of the sheet, as a pitch test finds them; positive.
    dpi : float
        Printed pixels an inch; positive.
    distance : float, optional
        From the eye to the lenses, metres; None is infinitely far.
    thickness : float
        Of the sheet, metres; at least 0.
    index : float
        Refractive index of the sheet, at least 1.

    Returns
    -------
    float
        ``dpi/lpi (1 + thickness/(index distance))``; at least 2.

    Raises
    ------
    ValueError
        If a number is out of range, or a lens covers fewer than 2 pixels.

    Notes
    -----
    A near eye looks at the outer lenses from the side: the ray to the vertex of the lens at x has
    the slope x/distance, in the sheet x/(index distance), and meets the print at
    x (1 + thickness/(index distance)). Strips of this pitch show one view across the whole print
    at this distance. With ``index=1`` it is the rule (distance + thickness)/distance of a pinhole
    at each vertex.

    Examples
    --------
    >>> clplen.io.lens_pitch(60, 720)
    12.0
    >>> round(clplen.io.lens_pitch(60, 720, distance=0.4, thickness=0.6e-3), 5)
    12.01146
    """
    for value, name in ((lpi, "lpi"), (dpi, "dpi")):
        if not (is_finite(value) and value > 0):
            raise ValueError(f"The {name} of a lenticular print is positive, not {value!r}.")
    if distance is not None and not (is_finite(distance) and distance > 0):
        raise ValueError(f"The distance of the eye is positive, in metres, not {distance!r}.")
    if not (is_finite(thickness) and thickness >= 0):
        raise ValueError(f"The thickness is at least 0, in metres, not {thickness!r}.")
    if not (is_finite(index) and index >= 1):
        raise ValueError(f"The refractive index is at least 1, not {index!r}.")
    pitch = dpi / lpi
    if pitch < LEAST_PITCH:
        raise ValueError(
            f"At {dpi:g} dpi a sheet of {lpi:g} lpi has {pitch:.3g} pixels a lens, and two views "
            f"need {LEAST_PITCH}: print at {LEAST_PITCH * lpi:g} dpi or more, or take a coarser "
            "sheet."
        )
    return float(pitch if distance is None else pitch * (1 + thickness / (index * distance)))


def lens_views(pixels: int, pitch: float, views: int, *, centre: float | None = None) -> Array:
    """Which view each printed column belongs to."""
    pixels = positive_integer(pixels, "The number of columns of a print")
    views = positive_integer(views, "The number of views")
    if not (is_finite(pitch) and pitch >= LEAST_PITCH):
        raise ValueError(f"A lens is at least {LEAST_PITCH} pixels wide, not {pitch!r}.")
    if not 2 <= views <= pitch:
        raise ValueError(
            f"Under lenses of {pitch:.6g} pixels lie 2 to {math.floor(pitch)} views, not {views}."
        )
    axis = pixels / 2 if centre is None else centre
    if not is_finite(axis):
        raise ValueError(f"The axis of a lens is a finite number of pixels, not {axis!r}.")
    lenses = (np.arange(pixels) + 0.5 - axis) / pitch + 0.5
    strips = np.floor(lenses * views + _TIE).astype(np.int64)
    return views - 1 - strips % views


def interlace(
    views: Iterable[ArrayLike],
    pitch: float,
    *,
    count: int | None = None,
    lenses: str = "vertical",
    centre: float | None = None,
) -> Array:
    """Return the print that shows views through a lenticular sheet.

    Parameters
    ----------
    views : iterable of array_like
        uint8, each of the print's shape (y, x) or (y, x, 3). The leftmost viewpoint comes first,
        as in a quilt; for horizontal lenses the topmost. One is held at a time.
    pitch : float
        Of the strips of one view, in pixels, as `lens_pitch` gives it: any real number that is at
        least the number of views.
    count : int, optional
        How many views there are, at least 2; None takes ``len(views)``.
    lenses : {"vertical", "horizontal"}
        "vertical" lenses run from top to bottom and show other views to an eye further right;
        "horizontal" ones to an eye further down.
    centre : float, optional
        Where a lens has its axis, in pixels from the left (or upper) edge; None is the middle.

    Returns
    -------
    numpy.ndarray
        uint8, the shape of a view. The column whose middle is at x belongs to the view
        ``count - 1 - floor(count ((x - centre)/pitch + 1/2)) mod count``.

    Raises
    ------
    ValueError, ShapeError
        If a number is out of range, views are not uint8, or the lenses are none of these; if views
        have different shapes, or there are more or fewer than ``count``.

    See Also
    --------
    LightField.view : Views at any viewpoint.

    Examples
    --------
    >>> views = [np.full((2, 12), 10 * n, np.uint8) for n in range(3)]
    >>> clplen.io.interlace(views, 6, centre=3)[0].tolist()
    [20, 20, 10, 10, 0, 0, 20, 20, 10, 10, 0, 0]
    """
    if lenses not in LENSES:
        known = " or ".join(map(repr, LENSES))
        raise ValueError(f"The lenses of a sheet are {known}, not {lenses!r}.")
    if count is None:
        if not isinstance(views, Sized):
            raise ValueError("Give count=, the number of views, where views have no length.")
        count = len(views)
    made: Array | None = None
    owner = np.empty(0, np.int64)
    seen = 0
    for view in (host_array(view, "A view") for view in views):
        if made is None:
            owner, made = _empty(view, pitch, count, lenses, centre)
        if view.dtype != np.uint8:
            raise ValueError(f"The views of a lenticular print are uint8, not {view.dtype}.")
        if view.shape != made.shape or seen >= count:
            raise ShapeError(
                f"This print has {count} views of shape {made.shape}; view {seen} has {view.shape}."
            )
        own = owner == seen
        if lenses == "vertical":
            made[:, own] = view[:, own]
        else:
            made[own] = view[own]
        seen += 1
    if made is None or seen != count:
        raise ShapeError(f"This print has {count} views, and {seen} were given.")
    return made


def _empty(
    view: Array, pitch: float, count: int, lenses: str, centre: float | None
) -> tuple[Array, Array]:
    """The view of each strip, and a print of the size of a view."""
    if view.ndim not in (2, 3) or view.shape[2:] not in ((), (3,)):
        raise ShapeError(f"A view has shape (y, x) or (y, x, 3), not {view.shape}.")
    along = view.shape[1 if lenses == "vertical" else 0]
    return lens_views(along, pitch, count, centre=centre), np.empty(view.shape, np.uint8)


def check_print(size: tuple[int, int], channels: int) -> None:
    """Refuse a print that does not fit into memory, before anything is computed for it."""
    needed, free = _COPIES * size[0] * size[1] * channels, free_memory()
    if needed > free:
        raise MemoryError(
            f"a print of {size[1]:,} x {size[0]:,} pixels takes {needed:,} bytes while it is "
            f"made, of which {free:,} are free: give a smaller width or fewer dpi"
        )


def pitch_test(
    lpi: float, dpi: float, width: float, *, spread: float = 1.0, bands: int = 21
) -> Array:
    """Return a picture that finds the pitch of a lenticular sheet as it is printed.

    Each band has black and white bars of its own pitch, half and half. Under the sheet, seen from
    the distance at which the print will be seen, the band of the right pitch is even, and the
    others have the more stripes the further they are off. Its number is what `lens_pitch` takes.

    Parameters
    ----------
    lpi : float
        Nominal lenses an inch; positive.
    dpi : float
        Printed pixels an inch; at least 2 a lens.
    width : float
        Of the picture, metres; at least 0.04, of which the labels take 0.02.
    spread : float
        How far the outer bands are off, per cent of lpi, above 0 to 20.
    bands : int
        How many there are, 3 to 101; an odd number has the nominal one in the middle.

    Returns
    -------
    numpy.ndarray
        uint8, shape (y, x): lpi rises from top to bottom. Bars are for vertical lenses.

    Raises
    ------
    ValueError, MemoryError
        If a number is out of range; if the picture does not fit into memory.

    Notes
    -----
    A band that is off by the fraction e has e width/pitch stripes: of 0.1 %, a third of a stripe
    across 0.15 m at 60 lpi.

    Examples
    --------
    >>> picture = clplen.io.pitch_test(60, 360, 0.05, bands=3)
    >>> picture.shape
    (425, 709)
    """
    if not (is_finite(width) and width >= (_LABEL + _LEAST_BARS) / 1000):
        raise ValueError(
            f"A pitch test is at least {(_LABEL + _LEAST_BARS) / 1000:g} m wide, not {width!r}."
        )
    if not (is_finite(spread) and 0 < spread <= 20):
        raise ValueError(f"The spread is above 0 and at most 20 per cent, not {spread!r}.")
    if not 3 <= positive_integer(bands, "The number of bands") <= 101:
        raise ValueError(f"A pitch test has 3 to 101 bands, not {bands}.")
    tried = float(float64_array(lpi)) * (1 + np.linspace(-spread, spread, bands) / 100)
    pitches = [lens_pitch(float(one), dpi) for one in tried]
    check_finite(pixels=1000 * width * dpi)

    def pixels(millimetres: float) -> int:
        return max(round(millimetres / _MM * dpi), 1)

    left, across = pixels(_LABEL), pixels(1000 * width)
    size = (pixels(_HEAD) + bands * pixels(_BAND + _GAP), across)
    check_print(size, 1)
    picture = np.full(size, 255, np.uint8)
    for number, pitch in enumerate(pitches):
        top = pixels(_HEAD) + number * pixels(_BAND + _GAP)
        dark = lens_views(across - left, pitch, 2) == 1
        picture[top : top + pixels(_BAND), left:] = np.where(dark, 0, 255)
    digits = max(2, math.ceil(-math.log10(tried[1] - tried[0])) + 1)
    words = [f"{one:.{digits}f}" for one in tried]
    _label(picture, words, pixels, f"{lpi:g} lpi, {dpi:g} dpi: the even band is right")
    return picture


def _label(picture: Array, words: list[str], pixels: Any, title: str) -> None:
    """Draw a word at the left of each band, and a title above, as large as fits."""
    image = Image.fromarray(picture)
    draw = ImageDraw.Draw(image)
    height = pixels(_TEXT)
    for number, word in enumerate(words):
        middle = pixels(_HEAD) + number * pixels(_BAND + _GAP) + pixels(_BAND) / 2
        font = _font(draw, word, height, pixels(_LABEL) - pixels(2 * _GAP))
        draw.text((pixels(_LABEL) - pixels(_GAP), middle), word, fill=0, font=font, anchor="rm")
    font = _font(draw, title, height, picture.shape[1] - pixels(2 * _GAP))
    draw.text((pixels(_GAP), pixels(_HEAD) / 2), title, fill=0, font=font, anchor="lm")
    picture[...] = np.asarray(image)


def _font(draw: ImageDraw.ImageDraw, word: str, height: int, width: int) -> Any:
    """Pillow's own font, so that a word is at most so high and wide."""
    font = ImageFont.load_default(max(height, 1))
    long = draw.textlength(word, font)
    return font if long <= width else ImageFont.load_default(max(height * width / long, 1))
