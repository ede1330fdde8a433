"""Two views as one picture: for red-cyan glasses, or side by side for the eyes as they are."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from clplen.checks import host_array
from clplen.errors import ShapeError
from clplen.io.formats.picture import encoded, linear

Array = np.ndarray[Any, Any]

# Eye by eye, linear red, green and blue in, the same out. Dubois: least squares for the primaries
# of a screen through red-cyan filters.
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
    """Return one picture for red-cyan glasses, red before the left eye.

    Parameters
    ----------
    left, right : array_like
        uint8, sRGB as a screen shows it, shape (y, x) or (y, x, 3): what each eye is to see.
    colours : {"dubois", "colour", "grey"}
        "dubois" comes nearest to the colours of both eyes through the filters, and has the least
        ghosts; "colour" gives red to the left eye, green and blue to the right one; "grey" the
        luminance to each.

    Returns
    -------
    numpy.ndarray
        uint8, shape (y, x, 3). Channels are mixed in linear light and clipped.

    Raises
    ------
    ShapeError, ValueError
        If the pictures have different shapes, or others than these; if they are not uint8, or the
        colours are none of these.

    Notes
    -----
    The method is that of Dubois (2001), Proc. ICASSP 3, 1661; the matrices for red-cyan glasses
    and screens are his (2009), "Conversion of a Stereo Pair to Anaglyph with the Least-Squares
    Projection Method".

    Examples
    --------
    >>> black, white = np.zeros((4, 6, 3), np.uint8), np.full((4, 6, 3), 255, np.uint8)
    >>> clplen.io.anaglyph(white, white)[0, 0].tolist()
    [255, 255, 255]
    >>> clplen.io.anaglyph(white, black, colours="colour")[0, 0].tolist()
    [255, 0, 0]
    """
    if colours not in ANAGLYPHS:
        known = ", ".join(map(repr, ANAGLYPHS))
        raise ValueError(f"The colours of an anaglyph are {known}, not {colours!r}.")
    pair = [_in_colour(picture) for picture in _checked(left, right)]
    mixed = sum(
        linear(picture).astype(np.float64) @ np.transpose(matrix)
        for picture, matrix in zip(pair, ANAGLYPHS[colours], strict=True)
    )
    return np.rint(255 * encoded(np.asarray(mixed))).astype(np.uint8)


def paired(
    left: ArrayLike, right: ArrayLike, *, arrangement: str, colours: str = "dubois"
) -> Array:
    """Return two pictures as one."""
    if arrangement not in ARRANGEMENTS:
        known = ", ".join(map(repr, ARRANGEMENTS))
        raise ValueError(f"Two views are arranged as {known}, not {arrangement!r}.")
    if arrangement == "anaglyph":
        return anaglyph(left, right, colours=colours)
    pair = _checked(left, right)
    return np.concatenate(pair if arrangement == "side-by-side" else pair[::-1], axis=1)


def _checked(left: ArrayLike, right: ArrayLike) -> tuple[Array, Array]:
    left, right = (host_array(picture, "A picture") for picture in (left, right))
    if left.shape != right.shape or left.ndim not in (2, 3) or left.shape[2:] not in ((), (3,)):
        raise ShapeError(
            f"The pictures for two eyes have one shape, (y, x) or (y, x, 3), not {left.shape} and "
            f"{right.shape}."
        )
    for picture in (left, right):
        if picture.dtype != np.uint8:
            raise ValueError(f"The pictures for two eyes are uint8, not {picture.dtype}.")
    return left, right


def _in_colour(picture: Array) -> Array:
    return picture if picture.ndim == 3 else np.repeat(picture[..., None], 3, axis=2)
