"""Sensor frames on the host: checks, dark frame subtraction, repair of bad pixels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from clplen.checks import host_array
from clplen.errors import ShapeError
from clplen.lightfield.raw.demosaicing import COLOURS, positions_of, scaled_colours, tile_of

Frame = np.ndarray[Any, np.dtype[np.float32]]
Mask = np.ndarray[Any, np.dtype[np.bool_]]

_MIN_DEVIATIONS = 12.0  # robust standard deviations of the dark frame
_LEVELS = (8, 10, 12, 14, 16)  # bits of a sample


def as_frame(values: Any, label: str) -> Any:
    """Return a finite real array (ny, nx) of unchanged dtype."""
    array = host_array(values, f"The {label}")
    if array.ndim != 2 or array.size == 0:
        raise ShapeError(
            f"The {label} must have shape (ny, nx), got {array.shape}; pass raw pixels."
        )
    if array.dtype.kind not in "buif":
        raise ValueError(f"The {label} must be real, got {array.dtype}.")
    if array.dtype.kind == "f":
        bad = array.size - int(np.isfinite(array).sum())
        if bad:
            raise ValueError(
                f"The {label} has {bad} pixels that are NaN or infinite; replace them, for example "
                "by the mean of their neighbours."
            )
    return array


def subtract_dark(frame: Any, dark: Any) -> Frame:
    """Return a frame less the dark frame as float32, including negative values."""
    picture = np.array(host_array(frame, "The frame"), np.float32)
    if dark is None:
        return picture
    dark_frame = as_frame(dark, "dark frame")
    if dark_frame.shape != picture.shape:
        raise ShapeError(
            f"The dark frame must have the picture's shape, {picture.shape}, got "
            f"{dark_frame.shape}; pass the dark frame of this camera."
        )
    picture -= dark_frame.astype(np.float32, copy=False)
    return picture


Mosaic = str | Sequence[Sequence[str]]  # accepted by `tile_of`


def balance_colours(picture: Frame, bayer: Mosaic) -> Frame:
    """Scale the colours of a mosaic to an equal mean."""
    tile = tile_of(bayer)
    down, across = len(tile), len(tile[0])
    means = {
        colour: float(
            np.mean(
                [
                    picture[y::down, x::across].mean(dtype=np.float64)
                    for y, x in positions_of(tile, colour)
                ]
            )
        )
        for colour in COLOURS
    }
    factors = {colour: means["G"] / mean if mean > 0 else 1.0 for colour, mean in means.items()}
    return scaled_colours(picture, tile, factors)


def saturated_pixels(frame: Any) -> Mask:
    """Return a mask of pixels at full scale of 8, 10, 12, 14 or 16 bits, if it is reached."""
    if frame.dtype.kind != "u":
        return np.zeros(frame.shape, bool)
    top = int(frame.max())
    if top not in [2**n - 1 for n in _LEVELS]:
        return np.zeros(frame.shape, bool)
    return np.asarray(frame == top)


def hot_pixels(dark: Any) -> Mask:
    """Return a mask of pixels of a dark frame 12 robust standard deviations above its median.

    The deviation is at least one level for integers; for floats, 0 falls back to the plain one.
    """
    dark_frame = host_array(dark, "The dark frame")
    values = np.asarray(dark_frame, np.float32)
    if values.min() == values.max():  # a constant black level
        return np.zeros(values.shape, bool)
    middle = np.median(values)
    spread = 1.4826 * float(np.median(np.abs(values - middle)))
    if dark_frame.dtype.kind != "f":
        spread = max(spread, 1.0)
    return np.asarray(values > middle + _MIN_DEVIATIONS * (spread or float(values.std())))


def fill_pixels(picture: Frame, bad: Mask, *, step: int = 1) -> Frame:
    """Replace bad pixels by the mean of their good neighbours among eight, ``step`` away.

    A bad pixel with mostly bad neighbours stays, so that highlights keep their level.
    """
    out = picture
    y, x = np.nonzero(bad)
    if y.size == 0:
        return out
    out = picture.copy()
    total, count = np.zeros(y.size), np.zeros(y.size)
    ny, nx = picture.shape
    for dy in (-step, 0, step):
        for dx in (-step, 0, step):
            a, b = y + dy, x + dx
            inside = (a >= 0) & (a < ny) & (b >= 0) & (b < nx)
            a, b = np.clip(a, 0, ny - 1), np.clip(b, 0, nx - 1)
            good = inside & ~bad[a, b]
            total += np.where(good, picture[a, b], 0.0)
            count += good
    enough = count >= 4
    out[y[enough], x[enough]] = (total[enough] / count[enough]).astype(np.float32)
    return out
