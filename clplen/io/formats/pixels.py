"""Values of pixels: sRGB, linear light and alpha."""

from __future__ import annotations

from typing import Any

import numpy as np

from clplen.errors import FormatError
from clplen.files import PathLike

Array = np.ndarray[Any, Any]

_LINEAR = 0.04045  # sRGB below it is a straight line (IEC 61966-2-1:1999)


def linear(values: Array) -> Array:
    """sRGB decoded to linear light, 0 to 1, float32 (IEC 61966-2-1:1999).

    Parameters
    ----------
    values : numpy.ndarray
        uint8 or uint16 of the full range, or floats from 0 to 1.

    Returns
    -------
    numpy.ndarray
    """
    if values.dtype.kind == "u":
        levels = np.linspace(0, 1, int(np.iinfo(values.dtype).max) + 1)
        return np.asarray(_decoded(levels).astype(np.float32)[values])
    return _decoded(values.astype(np.float64)).astype(np.float32)


def _decoded(s: Array) -> Array:
    low = s <= _LINEAR
    return np.where(low, s / 12.92, ((np.maximum(s, _LINEAR) + 0.055) / 1.055) ** 2.4)


def encoded(values: Array) -> Array:
    """The inverse of `linear`: linear light from 0 to 1, clipped, as sRGB from 0 to 1."""
    s = np.clip(values, 0, 1)
    return np.where(s <= _LINEAR / 12.92, 12.92 * s, 1.055 * s ** (1 / 2.4) - 0.055)


def without_alpha(values: Array, name: PathLike) -> Array:
    """Colours or greys without an alpha channel that says nothing.

    Parameters
    ----------
    values : numpy.ndarray
        As `read_channels` gives them.
    name : path-like
        For messages.

    Returns
    -------
    numpy.ndarray
        Shape (y, x) or (y, x, 3).

    Raises
    ------
    FormatError
        If a pixel is transparent.
    """
    if values.ndim == 2 or values.shape[2] == 3:
        return values
    alpha = values[..., -1]
    highest = np.iinfo(alpha.dtype).max if alpha.dtype.kind == "u" else 1
    if not (alpha == highest).all():
        raise FormatError(f"The picture {name} has transparent pixels: flatten first.")
    return values[..., 0] if values.shape[2] == 2 else values[..., :-1]
