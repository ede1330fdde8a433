"""A frame with its dark frame subtracted, rectified, and what became of its pixels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from clplen.checks import host_array
from clplen.errors import ShapeError
from clplen.reprs import OneLine

Vector = np.ndarray[Any, Any]


@dataclass(frozen=True, eq=False, repr=False)
class Prepared(OneLine):
    """A frame as `deconvolve` takes it.

    Attributes
    ----------
    counts, white : numpy.ndarray
        float32, shape (rows n, columns n); white 0 where pixels are left out.
    negative, left_out : int
        How many pixels of the raw frame were below 0 and are 0; how many were saturated or not
        finite.
    deep : int
        How many were further below 0 than the noise of the dark frame explains.
    size : int
        Pixels of the raw frame.
    hot : int
        How many stood out as no light does, and were left out; see `hot_pixels`.
    masked : int
        How many the mask left out.
    doubtful : int
        How many stood out where they were too many to be hot pixels: none was left out.

    Examples
    --------
    >>> wave = 1 + np.cos(2 * np.pi * np.arange(60) / 9.6)  # lenslets 9.6 pixels apart
    >>> white = 1000 * np.outer(wave, wave)
    >>> frame = (0.5 * white).astype(np.uint16)
    >>> frame[30, 30] = 65535  # saturated
    >>> found = clplen.microscopy.preparation(10, white=white)(frame)
    >>> found.counts.shape, found.left_out, found.negative
    ((50, 50), 1, 0)
    """

    counts: Vector
    white: Vector
    negative: int
    left_out: int
    deep: int = 0
    size: int = 0
    hot: int = 0
    masked: int = 0
    doubtful: int = 0


def samples(frame: Any) -> Vector:
    """Those of an array or of a `RawImage`."""
    return host_array(frame.to_numpy() if hasattr(frame, "to_numpy") else frame, "A frame")


def unknown(values: Vector, saturation: float | None) -> Vector:
    """Pixels that are saturated or not finite."""
    if saturation is None and values.dtype.kind in "ui":
        saturation = np.iinfo(values.dtype).max
    bad = ~np.isfinite(values)
    return bad if saturation is None else bad | (values >= saturation)


def mask_of(mask: Any, shape: tuple[int, ...] | None) -> Vector:
    """Pixels that a mask leaves out: those that are not 0."""
    values = samples(mask)
    if values.ndim != 2 or (shape is not None and values.shape != shape):
        wanted = "(ny, nx)" if shape is None else str(shape)
        raise ShapeError(f"The mask has shape {values.shape}, frames have {wanted}: give theirs.")
    if values.dtype.kind not in "biuf" or not (np.isfinite(values) & (values >= 0)).all():
        raise ValueError(
            "A mask holds 0 where a pixel counts and positive numbers where it is left out, "
            "and this one holds others."
        )
    out = np.asarray(values > 0)
    if out.all():
        raise ValueError(
            "The mask leaves out every pixel: it is 0 where a pixel counts, is it inverted?"
        )
    return out
