"""Crop of every view for a display, with its aspect ratio and one depth in its plane."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from PIL import Image

Array = np.ndarray[Any, Any]

_MIN_FRACTION = 0.25  # of a view's width or height inside the window


@dataclass(frozen=True)
class DisplayWindow:
    """Rectangle of the centre view that moves from view to view with one depth."""

    # (y, x) from the upper left corner of the centre view, in its pixels.
    centre: tuple[float, float]
    size: tuple[float, float]  # height and width in view pixels

    def render(
        self,
        picture: Array,
        shift: ArrayLike,
        pixels: tuple[int, int],
        samples: tuple[int, int] | None = None,
    ) -> Array:
        """Return the window of a view, resampled to ``pixels``."""
        y, x = np.asarray(self.centre) + np.asarray(shift)
        height, width = self.size
        box = (x - width / 2, y - height / 2, x + width / 2, y + height / 2)
        ends = np.array((picture.shape[1], picture.shape[0]) * 2)
        left, upper, right, lower = np.clip(box, 0, ends).tolist()
        image = Image.fromarray(np.ascontiguousarray(picture))
        method, part = Image.Resampling.BICUBIC, (left, upper, right, lower)
        intermediate = pixels
        if samples is not None:
            sides = zip(pixels, samples, self.size, strict=True)
            rows, columns = (limit if limit < min(full, n) else n for n, limit, full in sides)
            intermediate = (rows, columns)
        resized = image.resize(intermediate[::-1], method, box=part)
        return np.asarray(
            resized if intermediate == pixels else resized.resize(pixels[::-1], method)
        )


def display_window(
    size: tuple[int, ...], shifts: ArrayLike, aspect: float | None = None
) -> DisplayWindow:
    """Return the largest window inside every view."""
    offsets = np.asarray(shifts, np.float64)
    low, high = offsets.min(0), offsets.max(0)
    available = np.asarray(size) - (high - low)
    for name, side, full, reach in zip("yx", available, size, high - low, strict=True):
        if side < _MIN_FRACTION * full:
            raise ValueError(
                f"The depth in the display's plane moves by {reach:.3g} of {full} pixels along "
                f"{name} from the first view to the last: use a smaller part of the baseline, or a "
                "depth with a disparity closer to 0."
            )
    height, width = (float(n) for n in available)
    if aspect is not None:
        height, width = min(height, width / aspect), min(width, height * aspect)
    centre = (np.asarray(size) - (high + low)) / 2
    return DisplayWindow((float(centre[0]), float(centre[1])), (height, width))
