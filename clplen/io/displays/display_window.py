"""The part of every view that a display shows: of its proportions, with one depth in its plane."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from PIL import Image

Array = np.ndarray[Any, Any]

_LEAST = 0.25  # of a view's width or height that has to be left


@dataclass(frozen=True)
class DisplayWindow:
    """A rectangle of the centre view, which moves from view to view with one depth."""

    # (y, x) from the upper left corner of the centre view, in its pixels.
    centre: tuple[float, float]
    size: tuple[float, float]  # height and width in pixels of a view

    def shown(
        self,
        picture: Array,
        shift: ArrayLike,
        pixels: tuple[int, int],
        samples: tuple[int, int] | None = None,
    ) -> Array:
        """The window of one view at another number of pixels."""
        y, x = np.asarray(self.centre) + np.asarray(shift)
        height, width = self.size
        box = (x - width / 2, y - height / 2, x + width / 2, y + height / 2)
        ends = np.array((picture.shape[1], picture.shape[0]) * 2)
        left, upper, right, lower = np.clip(box, 0, ends).tolist()
        image = Image.fromarray(np.ascontiguousarray(picture))
        method, part = Image.Resampling.BICUBIC, (left, upper, right, lower)
        fewer = pixels
        if samples is not None:
            told = zip(pixels, samples, self.size, strict=True)
            rows, columns = (most if most < min(full, n) else n for n, most, full in told)
            fewer = (rows, columns)
        resized = image.resize(fewer[::-1], method, box=part)
        return np.asarray(resized if fewer == pixels else resized.resize(pixels[::-1], method))


def display_window(
    size: tuple[int, ...], shifts: ArrayLike, aspect: float | None = None
) -> DisplayWindow:
    """The largest window that lies inside every view."""
    moved = np.asarray(shifts, np.float64)
    low, high = moved.min(0), moved.max(0)
    room = np.asarray(size) - (high - low)
    for name, left, full, reach in zip("yx", room, size, high - low, strict=True):
        if left < _LEAST * full:
            raise ValueError(
                f"The depth in the display's plane moves by {reach:.3g} pixels along {name} from "
                f"the first view to the last, and a view has {full}: take a smaller part of the "
                "baseline, or a depth whose disparity is nearer to 0."
            )
    height, width = (float(n) for n in room)
    if aspect is not None:
        height, width = min(height, width / aspect), min(width, height * aspect)
    centre = (np.asarray(size) - (high + low)) / 2
    return DisplayWindow((float(centre[0]), float(centre[1])), (height, width))
