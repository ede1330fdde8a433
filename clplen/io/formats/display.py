"""Values of pictures brought into 8 bits, to look at."""

from __future__ import annotations

from typing import Any

import numpy as np

from clplen.io.lightfields.layout import encoded

Array = np.ndarray[Any, Any]

_MOST = 99.9  # per cent of the values
_GLINT = 3  # times that percentile: a larger maximum is cut


def white_of(values: Array, dtype: np.dtype[Any], *, srgb: bool = False) -> float:
    """The value that is shown as white.

    Parameters
    ----------
    values : numpy.ndarray
        All pictures that are shown alike.
    dtype : dtype
        Of the light field: 255 is white for uint8, so that its views look as their files do. Give
        float32 for what is no brightness, such as a variance.
    srgb : bool
        Whether its values were decoded from sRGB: 1 is white then.

    Returns
    -------
    float
        Otherwise the largest value; where that is more than 3 times the 99.9th percentile of the
        values, this percentile, so that a few glints do not darken all. 1 where none is positive.
    """
    if srgb:
        return 1.0
    if dtype == np.uint8:
        return 255.0
    largest, most = float(np.max(values)), float(np.percentile(values, _MOST))
    white = most if 0 < _GLINT * most < largest else largest
    return white if white > 0 else 1.0


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
