"""Hot pixels: those that stand out of their neighbours as no light of the microscope does.

Let S_k(p) be the light of the eight neighbours of a pixel and of the same pixel of the eight
adjacent lenslets, without the k brightest of these sixteen, k = 0, 1, 2. A sum less its largest
parts is superadditive, S(A + B) >= S(A) + S(B), so that what every point image obeys,
h(p) <= c_k S_k(p), every volume obeys too, however sharp, dim or crowded: c_k is taken from the
point images themselves (`sharpness`), and what is beyond one of the c_k S_k and the noise is no
light. So up to three hot pixels side by side are found.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from scipy.ndimage import convolve, median_filter

from clplen.checks import check_finite, positive_integer, real_array
from clplen.lightfield.raw.lenslet_lattice import Lattice

Vector = np.ndarray[Any, Any]
Step = tuple[int, int]

AROUND = [(i, k) for i in (-1, 0, 1) for k in (-1, 0, 1) if (i, k) != (0, 0)]
# Lenslets nearest to one, in rows and columns; every other row of a hexagonal lattice is moved.
HEXAGONAL = [(i, k) for i in (-1, 1) for k in (-0.5, 0.5)] + [(0, -1), (0, 1), (-2, 0), (2, 0)]
BRIGHTEST = 2  # that are left out of a sum, at most

MARGIN = 1.25  # times the sharpness, for pixels that lie otherwise and optics that differ a little
DEVIATIONS = 6  # of noise
ROUNDING = 1e-5  # of the brightest pixel: of simulated frames without noise
BLOCK = 8  # pixels, in which noise is measured where there are no lenslets of one lattice
UNEVEN = 1.6  # times all sixteen around it, in a white frame, which is smooth
DARK = 1  # per cent of the pixels, which only background is in
MANY = 0.01  # of a frame: so many outliers are no hot pixels
_SECOND = np.outer([1, -2, 1], [1, -2, 1]) / 6  # keeps the variance of white noise


def hot_pixels(
    frame: Vector, sharpest: tuple[float, float, float], lattice: Lattice | int | None
) -> Vector:
    """Find pixels that no light explains.

    Parameters
    ----------
    frame : numpy.ndarray
        Raw frame less its dark frame, shape (ny, nx), finite, not negative.
    sharpest : tuple of float
        Of `sharpness`.
    lattice : Lattice, int or None
        Of the frame, or pixels a lenslet of a rectified one; None for a Fourier microscope.

    Returns
    -------
    numpy.ndarray
        bool, shape (ny, nx).
    """
    light = real_array(frame, "A frame")
    check_finite(sharpest=sharpest)
    floor, gain = noise(light, _across(lattice))
    found, least = np.zeros(light.shape, bool), ROUNDING * light.max(initial=0)
    steps, z = steps_around(lattice), DEVIATIONS
    around = sums_around(light, steps, beyond=True)
    for k, (c, total) in enumerate(zip(sharpest, around, strict=True)):
        c = np.float32(MARGIN * max(c, 1 / (len(steps) - k)))
        sure = total + z * np.sqrt((len(steps) - k) * floor + gain * total)
        found |= light > c * sure + z * np.sqrt(floor + gain * c * sure) + z**2 * gain + least
    return found


def without_hot_pixels(stack: Vector, sharpest: tuple[float, float, float]) -> tuple[Vector, int]:
    """Frames of a Fourier microscope with the median around each hot pixel in its place."""
    found, count = np.array(stack, np.float64), 0
    for frame in found:
        dark = np.percentile(frame, DARK)
        hot = hot_pixels(np.maximum(frame - dark, 0), sharpest, None)
        if 0 < np.count_nonzero(hot) <= MANY * frame.size:
            count += int(np.count_nonzero(hot))
            frame[hot] = median_filter(frame, 3)[hot]
    return found, count


def uneven_pixels(white: Vector, lattice: Lattice) -> Vector:
    """Hot and dead pixels of a white frame."""
    light = np.asarray(white, np.float32)
    floor, gain = noise(light, _across(lattice))
    high, low = np.zeros_like(light), np.full_like(light, np.inf)
    for one in moved(light, steps_around(lattice), np.nan):
        np.fmax(high, one, out=high)
        np.fmin(low, one, out=low)
    above = light > UNEVEN * high + DEVIATIONS * np.sqrt(floor + gain * UNEVEN * high)
    below = UNEVEN * light + DEVIATIONS * np.sqrt(floor + gain * low) < low
    return np.asarray(above | below)


def noise(frame: Vector, across: int) -> tuple[float, float]:
    """Variance of the darkest quarter of a frame, and what it rises by with each count above 0.

    The second differences along y and x hold hardly any light (Immerkaer 1996): their mean squares
    in blocks of a lenslet over the blocks' means. Detail only adds to it, so that the lower
    quartile of the brighter half of the blocks is taken, on which what stands out has no bearing.
    """
    rows, columns = (max(1, size // across) for size in frame.shape)
    inside = frame[: rows * across, : columns * across].astype(np.float32)
    rough = np.square(convolve(inside, _SECOND, mode="nearest"))
    means, squares = (
        np.array([
            block.mean(dtype=np.float64)
            for band in np.array_split(one, rows) for block in np.array_split(band, columns, axis=1)
        ])
        for one in (inside, rough)
    )  # fmt: skip
    order = means.argsort()
    floor = float(np.median(squares[order[: max(1, len(order) // 4)]]))
    bright = order[len(order) // 2 :]
    bright = bright[means[bright] > 0]
    if not bright.size:
        return floor, 0.0
    rise = np.maximum(squares[bright] - floor, 0) / means[bright]
    return floor, float(np.percentile(rise, 25))


def _across(lattice: Lattice | int | None) -> int:
    if lattice is None:
        return BLOCK
    if isinstance(lattice, int):
        return positive_integer(lattice, "Pixels a lenslet")
    return max(1, round(min(lattice.pitch)))


def steps_around(lattice: Lattice | int | None) -> list[Step]:
    """Steps to the pixels around one, and to the same pixel of adjacent lenslets."""
    if lattice is None:
        return list(AROUND)
    if isinstance(lattice, int):
        return [*AROUND, *((i * lattice, k * lattice) for i, k in AROUND)]
    along, across = np.array(lattice.row), np.array(lattice.column)
    adjacent: list[tuple[float, float]] = list(AROUND)
    if lattice.kind == "hexagonal":
        adjacent = [(k, i) for i, k in HEXAGONAL] if lattice.turned else list(HEXAGONAL)
    far = [np.round(i * along + k * across).astype(int) for i, k in adjacent]
    return [*AROUND, *((int(y), int(x)) for y, x in far)]


def moved(light: Vector, steps: list[Step], fill: float) -> Iterable[Vector]:
    """The pictures at these steps from each pixel, with ``fill`` beyond the border."""
    reach = max(max(abs(y), abs(x)) for y, x in steps)
    wide = np.pad(light, reach, constant_values=fill)
    ny, nx = light.shape
    for y, x in steps:
        yield wide[reach + y : reach + y + ny, reach + x : reach + x + nx]


def sums_around(light: Vector, steps: list[Step], *, beyond: bool) -> tuple[Vector, Vector, Vector]:
    """Sum the pixels at these steps: all, without the brightest, without the two brightest."""
    total, first, second, third = (np.zeros_like(light) for _ in range(4))
    missing = np.zeros_like(light)
    for one in moved(light, steps, np.nan):
        outside = np.isnan(one)
        missing += outside
        here = np.where(outside, np.float32(0), one)
        total += here
        third = np.maximum(third, np.minimum(second, here))
        second = np.maximum(second, np.minimum(first, here))
        first = np.maximum(first, here)
    if beyond:
        total += missing * third
    one = np.maximum(total - first, 0)
    return total, one, np.maximum(one - second, 0)
