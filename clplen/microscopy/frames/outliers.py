"""Detection of hot pixels, brighter beside their neighbours than any light of the microscope.

A pixel p has sixteen neighbours: eight adjacent pixels, and the corresponding pixels of the eight
adjacent lenslets. S_k(p) is their sum without the k brightest, k = 0, 1, 2. Such sums are
superadditive, S(A + B) >= S(A) + S(B). If h(p) <= c_k S_k(p) holds for every point image h, it
therefore holds for every volume. The c_k are computed from the point images (`sharpness`); a pixel
above any c_k S_k by more than noise is hot. Up to three adjacent hot pixels are detected.
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
# Nearest lenslets in rows and columns; every other row of a hexagonal lattice is offset.
HEXAGONAL = [(i, k) for i in (-1, 1) for k in (-0.5, 0.5)] + [(0, -1), (0, 1), (-2, 0), (2, 0)]
MAX_EXCLUDED = 2  # brightest neighbours excluded from a sum, hence three adjacent hot pixels

SHARPNESS_MARGIN = 1.25  # for other pixel positions and small differences of the optics
NOISE_SIGMAS = 6  # threshold above the noise
ROUNDING = 1e-5  # rounding of simulated frames without noise, over the brightest pixel
BLOCK_PIXELS = 8  # blocks in which noise is measured without a lenslet lattice
UNEVENNESS = 1.6  # ratio to all sixteen neighbours; a white frame is smooth
BACKGROUND_PERCENTILE = 1  # of the pixels, which contain only background
MAX_HOT_SHARE = 0.01  # of a frame; more outliers have another cause than hot pixels
_SECOND = np.outer([1, -2, 1], [1, -2, 1]) / 6  # preserves the variance of white noise


def hot_pixels(
    frame: Vector, sharpest: tuple[float, float, float], lattice: Lattice | int | None
) -> Vector:
    """Detect hot pixels, brighter than the point images allow.

    Parameters
    ----------
    frame : numpy.ndarray
        Raw frame minus its dark frame, shape (ny, nx), finite, not negative.
    sharpest : tuple of float
        Bounds from `sharpness`.
    lattice : Lattice, int or None
        Lattice of the frame, or the pixels per lenslet of a rectified frame; None for a Fourier
        microscope.

    Returns
    -------
    numpy.ndarray
        Mask of the hot pixels, bool, shape (ny, nx).
    """
    light = real_array(frame, "A frame")
    check_finite(sharpest=sharpest)
    floor, gain = noise(light, _across(lattice))
    hot, rounding = np.zeros(light.shape, bool), ROUNDING * light.max(initial=0)
    steps, z = steps_around(lattice), NOISE_SIGMAS
    around = sums_around(light, steps, beyond=True)
    for k, (c, total) in enumerate(zip(sharpest, around, strict=True)):
        c = np.float32(SHARPNESS_MARGIN * max(c, 1 / (len(steps) - k)))
        bound = total + z * np.sqrt((len(steps) - k) * floor + gain * total)
        hot |= light > c * bound + z * np.sqrt(floor + gain * c * bound) + z**2 * gain + rounding
    return hot


def without_hot_pixels(stack: Vector, sharpest: tuple[float, float, float]) -> tuple[Vector, int]:
    """Replace hot pixels of a Fourier microscope's frames by medians; return their number, too."""
    frames, count = np.array(stack, np.float64), 0
    for frame in frames:
        dark = np.percentile(frame, BACKGROUND_PERCENTILE)
        hot = hot_pixels(np.maximum(frame - dark, 0), sharpest, None)
        if 0 < np.count_nonzero(hot) <= MAX_HOT_SHARE * frame.size:
            count += int(np.count_nonzero(hot))
            frame[hot] = median_filter(frame, 3)[hot]
    return frames, count


def uneven_pixels(white: Vector, lattice: Lattice) -> Vector:
    """Detect the hot and dead pixels of a white frame."""
    light = np.asarray(white, np.float32)
    floor, gain = noise(light, _across(lattice))
    high, low = np.zeros_like(light), np.full_like(light, np.inf)
    for neighbour in shifted(light, steps_around(lattice), np.nan):
        np.fmax(high, neighbour, out=high)
        np.fmin(low, neighbour, out=low)
    above = light > UNEVENNESS * high + NOISE_SIGMAS * np.sqrt(floor + gain * UNEVENNESS * high)
    below = UNEVENNESS * light + NOISE_SIGMAS * np.sqrt(floor + gain * low) < low
    return np.asarray(above | below)


def noise(frame: Vector, across: int) -> tuple[float, float]:
    """Estimate the variance of the darkest quarter of a frame, and its rise per count of light.

    Second differences along y and x contain almost no light (Immerkaer 1996): their mean squares
    in blocks of a lenslet are compared with the means of the blocks. Detail only adds variance, so
    the rise is the lower quartile over the brighter half of the blocks, robust to hot pixels.
    """
    rows, columns = (max(1, size // across) for size in frame.shape)
    inside = frame[: rows * across, : columns * across].astype(np.float32)
    rough = np.square(convolve(inside, _SECOND, mode="nearest"))
    means, squares = (
        np.array([
            block.mean(dtype=np.float64)
            for band in np.array_split(values, rows)
            for block in np.array_split(band, columns, axis=1)
        ])
        for values in (inside, rough)
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
        return BLOCK_PIXELS
    if isinstance(lattice, int):
        return positive_integer(lattice, "Pixels a lenslet")
    return max(1, round(min(lattice.pitch)))


def steps_around(lattice: Lattice | int | None) -> list[Step]:
    """Return the steps to adjacent pixels, and to the same pixel of adjacent lenslets."""
    if lattice is None:
        return list(AROUND)
    if isinstance(lattice, int):
        return [*AROUND, *((i * lattice, k * lattice) for i, k in AROUND)]
    along, across = np.array(lattice.row), np.array(lattice.column)
    adjacent: list[tuple[float, float]] = list(AROUND)
    if lattice.kind == "hexagonal":
        adjacent = [(k, i) for i, k in HEXAGONAL] if lattice.turned else list(HEXAGONAL)
    steps = [np.round(i * along + k * across).astype(int) for i, k in adjacent]
    return [*AROUND, *((int(y), int(x)) for y, x in steps)]


def shifted(light: Vector, steps: list[Step], fill: float) -> Iterable[Vector]:
    """Yield the picture shifted by each step, with ``fill`` outside the border."""
    reach = max(max(abs(y), abs(x)) for y, x in steps)
    wide = np.pad(light, reach, constant_values=fill)
    ny, nx = light.shape
    for y, x in steps:
        yield wide[reach + y : reach + y + ny, reach + x : reach + x + nx]


def sums_around(light: Vector, steps: list[Step], *, beyond: bool) -> tuple[Vector, Vector, Vector]:
    """Sum the pixels at the steps: all, without the brightest, without the two brightest."""
    total, first, second, third = (np.zeros_like(light) for _ in range(4))
    missing = np.zeros_like(light)
    for neighbour in shifted(light, steps, np.nan):
        outside = np.isnan(neighbour)
        missing += outside
        values = np.where(outside, np.float32(0), neighbour)
        total += values
        third = np.maximum(third, np.minimum(second, values))
        second = np.maximum(second, np.minimum(first, values))
        first = np.maximum(first, values)
    if beyond:
        total += missing * third
    without_first = np.maximum(total - first, 0)
    return total, without_first, np.maximum(without_first - second, 0)
