"""Values of pictures brought into 8 bits, to look at."""

from __future__ import annotations

from typing import Any

import numpy as np

from clplen.io.layout import encoded

Array = np.ndarray[Any, Any]


def white_of(values: Array, dtype: np.dtype[Any], *, srgb: bool = False) -> float:
    """The value that is shown as white.

    Parameters
    ----------
    values : numpy.ndarray
        All pictures that are shown alike.
    dtype : dtype
        Of the light field: 255 is white for uint8, so that its views look as their files do.
    srgb : bool
        Whether its values were decoded from sRGB: 1 is white then.

    Returns
    -------
    float
        Otherwise the largest value, or 1 where none is positive.
    """
    if srgb:
        return 1.0
    if dtype == np.uint8:
        return 255.0
    largest = float(np.max(values))
    return largest if largest > 0 else 1.0


def to_look_at(values: Array, white: float, *, srgb: bool = False) -> Array:
    """A picture as uint8: values over white, cut to 0 to 1, encoded as sRGB where asked.

    Parameters
    ----------
    values : numpy.ndarray
        Shape (..., y, x[, c]).
    white : float
        Positive.
    srgb : bool
        Whether the values are linear light that a screen is to show as such.

    Returns
    -------
    numpy.ndarray
        uint8, same shape.
    """
    part = np.clip(np.asarray(values, np.float64) / white, 0, 1)
    return np.rint(255 * (encoded(part) if srgb else part)).astype(np.uint8)
