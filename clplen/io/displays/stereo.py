"""Two views as one picture: for red-cyan glasses, or side by side for the naked eye."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from clplen.checks import host_array
from clplen.errors import ShapeError
from clplen.io.formats.picture import encoded, linear

Array = np.ndarray[Any, Any]

# Matrices from linear RGB of the left and of the right view to linear RGB. Dubois: least squares
# for the primaries of a screen through red-cyan filters.
_GREY = (0.2126, 0.7152, 0.0722)  # luminance of linear sRGB (IEC 61966-2-1:1999)
_NONE = (0.0, 0.0, 0.0)
ANAGLYPHS: dict[str, tuple[Any, Any]] = {
    "dubois": (
        ((0.437, 0.449, 0.164), (-0.062, -0.062, -0.024), (-0.048, -0.050, -0.017)),
        ((-0.011, -0.032, -0.007), (0.377, 0.761, 0.009), (-0.026, -0.093, 1.234)),
    ),
    "colour": (((1.0, 0.0, 0.0), _NONE, _NONE), (_NONE, (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))),
    "grey": ((_GREY, _NONE, _NONE), (_NONE, _GREY, _GREY)),
}
ARRANGEMENTS = ("anaglyph", "side-by-side", "cross-eyed")


def anaglyph(left: ArrayLike, right: ArrayLike, *, colours: str = "dubois") -> Array:
    """Return an anaglyph for red-cyan glasses, with red in front of the left eye.

    Parameters
    ----------
    left, right : array_like
        Pictures for the left and right eye, uint8 sRGB of shape (y, x) or (y, x, 3).
    colours : {"dubois", "colour", "grey"}
        Colour method. "dubois" best approximates the colours of both eyes with the least ghosting;
        "colour" uses red of the left view and green and blue of the right view; "grey" uses the
        luminance of each.

    Returns
    -------
    numpy.ndarray
        Picture, uint8 of shape (y, x, 3). Channels are mixed in linear light and clipped.

    Raises
    ------
    ShapeError, ValueError
        If the pictures have different or other shapes; if they are not uint8, or ``colours`` is
        unknown.

    Notes
    -----
    Method: Dubois (2001), Proc. ICASSP 3, 1661. Matrices for red-cyan glasses and screens: Dubois
    (2009), "Conversion of a Stereo Pair to Anaglyph with the Least-Squares Projection Method".

    Examples
    --------
    >>> black, white = np.zeros((4, 6, 3), np.uint8), np.full((4, 6, 3), 255, np.uint8)
    >>> clplen.io.anaglyph(white, white)[0, 0].tolist()
    [255, 255, 255]
    >>> clplen.io.anaglyph(white, black, colours="colour")[0, 0].tolist()
    [255, 0, 0]
    """
    if colours not in ANAGLYPHS:
        names = ", ".join(map(repr, ANAGLYPHS))
        raise ValueError(f"colours must be {names}, got {colours!r}.")
    pair = [_as_rgb(picture) for picture in _checked_pair(left, right)]
    mixed = sum(
        linear(picture).astype(np.float64) @ np.transpose(matrix)
        for picture, matrix in zip(pair, ANAGLYPHS[colours], strict=True)
    )
    return np.rint(255 * encoded(np.asarray(mixed))).astype(np.uint8)


def combine_pair(
    left: ArrayLike, right: ArrayLike, *, arrangement: str, colours: str = "dubois"
) -> Array:
    """Return two pictures combined into one, as an anaglyph or side by side."""
    if arrangement not in ARRANGEMENTS:
        names = ", ".join(map(repr, ARRANGEMENTS))
        raise ValueError(f"arrangement must be {names}, got {arrangement!r}.")
    if arrangement == "anaglyph":
        return anaglyph(left, right, colours=colours)
    pair = _checked_pair(left, right)
    return np.concatenate(pair if arrangement == "side-by-side" else pair[::-1], axis=1)


def _checked_pair(left: ArrayLike, right: ArrayLike) -> tuple[Array, Array]:
    left, right = (host_array(picture, "A picture") for picture in (left, right))
    if left.shape != right.shape or left.ndim not in (2, 3) or left.shape[2:] not in ((), (3,)):
        raise ShapeError(
            f"Both pictures must have the same shape, (y, x) or (y, x, 3), got {left.shape} and "
            f"{right.shape}."
        )
    for picture in (left, right):
        if picture.dtype != np.uint8:
            raise ValueError(f"Both pictures must be uint8, got {picture.dtype}.")
    return left, right


def _as_rgb(picture: Array) -> Array:
    return picture if picture.ndim == 3 else np.repeat(picture[..., None], 3, axis=2)
