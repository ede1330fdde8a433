"""Lenticular prints: views interlaced strip by strip under cylindrical lenses, and pitch tests.

Under each lens there is a strip of every view. A lens shows its left strip to an eye at the right,
so the order of views is mirrored: the leftmost viewpoint is at the right.
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
MIN_PITCH = 2  # pixels per lens, for two views
_TIE = 1e-9  # strips; a pixel centre this close to a border belongs to the right strip
_COPIES = 4  # of the print in memory: itself, a view, its source, and the file buffer
PET = 1.57  # refractive index of common sheets (PET-G); acrylic has 1.49

# Dimensions of a pitch test in millimetres.
_BAND, _GAP, _HEAD, _LABEL, _TEXT = 6.0, 1.0, 9.0, 20.0, 3.5
_MIN_BARS = 20.0
_MM = 25.4  # per inch


def lens_pitch(
    lpi: float,
    dpi: float,
    *,
    distance: float | None = None,
    thickness: float = 0.0,
    index: float = PET,
) -> float:
    """Return the pitch of the strips under a lenticular sheet in printed pixels.

    Parameters
    ----------
    lpi : float
        Lenses per inch of the sheet, measured by a pitch test; positive.
    dpi : float
        Printed pixels per inch; positive.
    distance : float, optional
        Distance from the eye to the lenses in metres; None for infinity.
    thickness : float
        Thickness of the sheet in metres; at least 0.
    index : float
        Refractive index of the sheet, at least 1.

    Returns
    -------
    float
        Pitch ``dpi/lpi (1 + thickness/(index distance))``; at least 2.

    Raises
    ------
    ValueError
        If a number is out of range, or a lens covers fewer than 2 pixels.

    Notes
    -----
    A near eye sees the outer lenses from the side. The ray to the vertex of the lens at x has the
    slope x/distance, in the sheet x/(index distance), and meets the print at
    x (1 + thickness/(index distance)). Strips of this pitch show one view across the whole print
    at this distance. ``index=1`` gives the rule (distance + thickness)/distance of a pinhole at
    each vertex.

    Examples
    --------
    >>> clplen.io.lens_pitch(60, 720)
    12.0
    >>> round(clplen.io.lens_pitch(60, 720, distance=0.4, thickness=0.6e-3), 5)
    12.01146
    """
    for value, name in ((lpi, "lpi"), (dpi, "dpi")):
        if not (is_finite(value) and value > 0):
            raise ValueError(f"{name} must be positive, got {value!r}.")
    if distance is not None and not (is_finite(distance) and distance > 0):
        raise ValueError(f"distance must be positive, in metres, got {distance!r}.")
    if not (is_finite(thickness) and thickness >= 0):
        raise ValueError(f"thickness must be at least 0, in metres, got {thickness!r}.")
    if not (is_finite(index) and index >= 1):
        raise ValueError(f"index must be at least 1, got {index!r}.")
    pitch = dpi / lpi
    if pitch < MIN_PITCH:
        raise ValueError(
            f"A lens must cover at least {MIN_PITCH} pixels, got {pitch:.3g} at {dpi:g} dpi and "
            f"{lpi:g} lpi: print at {MIN_PITCH * lpi:g} dpi or more, or use a coarser sheet."
        )
    return float(pitch if distance is None else pitch * (1 + thickness / (index * distance)))


def lens_views(pixels: int, pitch: float, views: int, *, centre: float | None = None) -> Array:
    """Return the view index of each printed column."""
    pixels = positive_integer(pixels, "The number of columns of a print")
    views = positive_integer(views, "The number of views")
    if not (is_finite(pitch) and pitch >= MIN_PITCH):
        raise ValueError(f"pitch must be at least {MIN_PITCH} pixels, got {pitch!r}.")
    if not 2 <= views <= pitch:
        raise ValueError(
            f"Lenses of {pitch:.6g} pixels must have 2 to {math.floor(pitch)} views, got {views}."
        )
    axis = pixels / 2 if centre is None else centre
    if not is_finite(axis):
        raise ValueError(f"centre must be a finite number of pixels, got {axis!r}.")
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
        Views, uint8 of the print's shape (y, x) or (y, x, 3). The leftmost viewpoint comes first,
        as in a quilt; for horizontal lenses the topmost. One view is in memory at a time.
    pitch : float
        Pitch of a lens in pixels, from `lens_pitch`: a real number, at least the number of views.
    count : int, optional
        Number of views, at least 2; default ``len(views)``.
    lenses : {"vertical", "horizontal"}
        Direction of the lenses. The view changes as the eye moves sideways in front of "vertical"
        lenses, up or down in front of "horizontal" lenses.
    centre : float, optional
        Position of a lens axis in pixels from the left (or upper) edge; default the middle.

    Returns
    -------
    numpy.ndarray
        Print, uint8, with the shape of a view. The column at x shows view ``count - 1 - k``, where
        ``k = floor(count ((x - centre)/pitch + 1/2)) mod count``.

    Raises
    ------
    ValueError, ShapeError
        If a number is out of range, views are not uint8, or ``lenses`` is unknown; if views have
        different shapes, or their number is not ``count``.

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
        names = " or ".join(map(repr, LENSES))
        raise ValueError(f"lenses must be {names}, got {lenses!r}.")
    if count is None:
        if not isinstance(views, Sized):
            raise ValueError("count= is required for views without a length.")
        count = len(views)
    picture: Array | None = None
    strip_views = np.empty(0, np.int64)
    number = 0
    for view in (host_array(view, "A view") for view in views):
        if picture is None:
            strip_views, picture = _empty_print(view, pitch, count, lenses, centre)
        if view.dtype != np.uint8:
            raise ValueError(f"The views of a lenticular print must be uint8, got {view.dtype}.")
        if view.shape != picture.shape or number >= count:
            raise ShapeError(
                f"views must be {count} views of shape {picture.shape}, got {view.shape} for view "
                f"{number}."
            )
        selection = strip_views == number
        if lenses == "vertical":
            picture[:, selection] = view[:, selection]
        else:
            picture[selection] = view[selection]
        number += 1
    if picture is None or number != count:
        raise ShapeError(f"views must contain {count} views, got {number}.")
    return picture


def _empty_print(
    view: Array, pitch: float, count: int, lenses: str, centre: float | None
) -> tuple[Array, Array]:
    """Return the view index of each strip, and an empty print of the size of a view."""
    if view.ndim not in (2, 3) or view.shape[2:] not in ((), (3,)):
        raise ShapeError(f"A view must have shape (y, x) or (y, x, 3), got {view.shape}.")
    along = view.shape[1 if lenses == "vertical" else 0]
    return lens_views(along, pitch, count, centre=centre), np.empty(view.shape, np.uint8)


def check_print(size: tuple[int, int], channels: int) -> None:
    """Raise MemoryError for a print that does not fit into memory, before it is computed."""
    needed, free = _COPIES * size[0] * size[1] * channels, free_memory()
    if needed > free:
        raise MemoryError(
            f"a print of {size[1]:,} x {size[0]:,} pixels needs {needed:,} bytes, but only "
            f"{free:,} are free: use a smaller width or fewer dpi"
        )


def pitch_test(
    lpi: float, dpi: float, width: float, *, spread: float = 1.0, bands: int = 21
) -> Array:
    """Return a test picture for measuring the pitch of a printed lenticular sheet.

    Each band has black and white bars of its own pitch and equal widths. Look at it through the
    sheet, from the viewing distance of the print. The band of the right pitch looks even; the
    others have more stripes the larger their error. Pass the number of the even band to
    `lens_pitch`.

    Parameters
    ----------
    lpi : float
        Nominal lenses per inch; positive.
    dpi : float
        Printed pixels per inch; at least 2 per lens.
    width : float
        Width of the picture in metres; at least 0.04, including labels of 0.02.
    spread : float
        Deviation of the outer bands in per cent of lpi, above 0 to 20.
    bands : int
        Number of bands, 3 to 101; an odd number has the nominal pitch in the middle.

    Returns
    -------
    numpy.ndarray
        Picture, uint8 of shape (y, x), for vertical lenses; lpi increases from top to bottom.

    Raises
    ------
    ValueError, MemoryError
        If a number is out of range; if the picture does not fit into memory.

    Notes
    -----
    A band with the relative error e has e width/pitch stripes: for 0.1 %, a third of a stripe
    across 0.15 m at 60 lpi.

    Examples
    --------
    >>> picture = clplen.io.pitch_test(60, 360, 0.05, bands=3)
    >>> picture.shape
    (425, 709)
    """
    if not (is_finite(width) and width >= (_LABEL + _MIN_BARS) / 1000):
        raise ValueError(
            f"width must be at least {(_LABEL + _MIN_BARS) / 1000:g} m, got {width!r}."
        )
    if not (is_finite(spread) and 0 < spread <= 20):
        raise ValueError(f"spread must be above 0 and at most 20 per cent, got {spread!r}.")
    if not 3 <= positive_integer(bands, "The number of bands") <= 101:
        raise ValueError(f"bands must be 3 to 101, got {bands}.")
    candidates = float(float64_array(lpi)) * (1 + np.linspace(-spread, spread, bands) / 100)
    pitches = [lens_pitch(float(value), dpi) for value in candidates]
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
    digits = max(2, math.ceil(-math.log10(candidates[1] - candidates[0])) + 1)
    labels = [f"{value:.{digits}f}" for value in candidates]
    _label(picture, labels, pixels, f"{lpi:g} lpi, {dpi:g} dpi: the even band is right")
    return picture


def _label(picture: Array, labels: list[str], pixels: Any, title: str) -> None:
    """Draw a label at the left of each band and a title above, as large as possible."""
    image = Image.fromarray(picture)
    draw = ImageDraw.Draw(image)
    height = pixels(_TEXT)
    for number, label in enumerate(labels):
        middle = pixels(_HEAD) + number * pixels(_BAND + _GAP) + pixels(_BAND) / 2
        font = _font(draw, label, height, pixels(_LABEL) - pixels(2 * _GAP))
        draw.text((pixels(_LABEL) - pixels(_GAP), middle), label, fill=0, font=font, anchor="rm")
    font = _font(draw, title, height, picture.shape[1] - pixels(2 * _GAP))
    draw.text((pixels(_GAP), pixels(_HEAD) / 2), title, fill=0, font=font, anchor="lm")
    picture[...] = np.asarray(image)


def _font(draw: ImageDraw.ImageDraw, text: str, height: int, width: int) -> Any:
    """Return Pillow's default font, scaled so that a text fits into height and width."""
    font = ImageFont.load_default(max(height, 1))
    long = draw.textlength(text, font)
    return font if long <= width else ImageFont.load_default(max(height * width / long, 1))
