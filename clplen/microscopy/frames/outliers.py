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
from scipy.ndimage import convolve

from clplen.lightfield.raw.lenslet_lattice import Lattice
from clplen.microscopy.model.images import PointImages

Vector = np.ndarray[Any, Any]
Step = tuple[int, int]

AROUND = [(i, k) for i in (-1, 0, 1) for k in (-1, 0, 1) if (i, k) != (0, 0)]
COUNT = 2 * len(AROUND)
BRIGHTEST = 2  # that are left out of a sum, at most
PLANES = 9  # of the point images that are looked at, both ends among them
DIMMEST = 1e-3  # of the brightest pixel of an image: below it point images are cut short
MARGIN = 1.25  # times the sharpness, for pixels that lie otherwise and optics that differ a little
DEVIATIONS = 6  # of noise
UNEVEN = 1.6  # times all sixteen around it, in a white frame, which is smooth
MANY = 0.01  # of a frame: so many outliers are no hot pixels
_SECOND = np.outer([1, -2, 1], [1, -2, 1]) / 6  # keeps the variance of white noise


def sharpness(images: PointImages) -> tuple[float, float, float]:
    """Return the most that a pixel of a point image stands out of those around it.

    Parameters
    ----------
    images : PointImages
        Of which nine planes are looked at.

    Returns
    -------
    tuple of float
        c_0, c_1, c_2: over the sum of the sixteen pixels around without the 0, 1, 2 brightest.

    Examples
    --------
    >>> about = {"magnification": 20.0, "na": 0.5, "medium_index": 1.0, "lenslet_pitch": 125e-6}
    >>> spots = (np.full((1, 15, 15), 1 / 225, np.float32),)  # 3 x 3 lenslets, evenly lit
    >>> images = clplen.microscopy.PointImages(about, np.array([20e-6]), 1, 5, spots, np.ones(1))
    >>> [round(c, 3) for c in clplen.microscopy.sharpness(images)]  # six around that of a corner
    [0.167, 0.2, 0.25]
    """
    steps = neighbours((images.pixels, 0), (0, images.pixels))
    chosen = np.unique(np.linspace(0, len(images.stored) - 1, PLANES).astype(int))
    most = np.zeros(BRIGHTEST + 1)
    for stored in (images.stored[k] for k in chosen):
        for image in stored:
            light = image.astype(np.float32)
            seen = light > DIMMEST * light.max()
            around = (one[seen] for one in _around(light, steps, beyond=False))
            found = [float((light[seen] / np.maximum(one, 1e-30)).max()) for one in around]
            most = np.maximum(most, found)
    return (float(most[0]), float(most[1]), float(most[2]))


def neighbours(row: tuple[float, float], column: tuple[float, float]) -> list[Step]:
    """Steps to the pixels around one, and to the same pixel of adjacent lenslets.

    Parameters
    ----------
    row, column : tuple of float
        (y, x) from lenslet to lenslet, in pixels.

    Returns
    -------
    list of (int, int)
        Sixteen.
    """
    along, across = np.array(row), np.array(column)
    far = [np.round(i * along + k * across).astype(int) for i, k in AROUND]
    return [*AROUND, *((int(y), int(x)) for y, x in far)]


def hot_pixels(
    frame: Vector, sharpest: tuple[float, float, float], lattice: Lattice | int
) -> Vector:
    """Find pixels that no light explains.

    Parameters
    ----------
    frame : numpy.ndarray
        Raw frame less its dark frame, shape (ny, nx), finite, not negative.
    sharpest : tuple of float
        Of `sharpness`.
    lattice : Lattice or int
        Of the frame, or pixels a lenslet of a rectified one.

    Returns
    -------
    numpy.ndarray
        bool, shape (ny, nx).

    Examples
    --------
    >>> frame = np.random.default_rng(1).poisson(100, (60, 60)).astype(float)
    >>> frame[20, 31] = 5000
    >>> np.argwhere(clplen.microscopy.hot_pixels(frame, (0.3, 0.4, 0.5), 10)).tolist()
    [[20, 31]]
    """
    light = np.asarray(frame, np.float32)
    floor, gain = noise(light, _across(lattice))
    found = np.zeros(light.shape, bool)
    around, z = _around(light, _steps(lattice), beyond=True), DEVIATIONS
    for k, (c, total) in enumerate(zip(sharpest, around, strict=True)):
        c = np.float32(MARGIN * max(c, 1 / (COUNT - k)))
        sure = total + z * np.sqrt((COUNT - k) * floor + gain * total)
        found |= light > c * sure + z * np.sqrt(floor + gain * c * sure) + z**2 * gain
    return found


def uneven_pixels(white: Vector, lattice: Lattice) -> Vector:
    """Hot and dead pixels of a white frame.

    Parameters
    ----------
    white : numpy.ndarray
        White frame less the dark frame, shape (ny, nx), finite, not negative.
    lattice : Lattice
        Of it.

    Returns
    -------
    numpy.ndarray
        bool: more than 1.6 times as bright as the brightest of the pixels around and of the same
        pixel of adjacent lenslets, or 1.6 times as dark as the darkest, by more than noise.
    """
    light = np.asarray(white, np.float32)
    floor, gain = noise(light, _across(lattice))
    high, low = np.zeros_like(light), np.full_like(light, np.inf)
    for one in _moved(light, _steps(lattice), np.nan):
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

    Parameters
    ----------
    frame : numpy.ndarray
        Shape (ny, nx).
    across : int
        Pixels a lenslet.

    Returns
    -------
    float, float
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


def _steps(lattice: Lattice | int) -> list[Step]:
    if isinstance(lattice, int):
        return neighbours((lattice, 0), (0, lattice))
    return neighbours(lattice.row, lattice.column)


def _across(lattice: Lattice | int) -> int:
    return lattice if isinstance(lattice, int) else max(1, round(min(lattice.pitch)))


def _moved(light: Vector, steps: list[Step], fill: float) -> Iterable[Vector]:
    """The pictures at these steps from each pixel, with ``fill`` beyond the border."""
    reach = max(max(abs(y), abs(x)) for y, x in steps)
    wide = np.pad(light, reach, constant_values=fill)
    ny, nx = light.shape
    for y, x in steps:
        yield wide[reach + y : reach + y + ny, reach + x : reach + x + nx]


def _around(light: Vector, steps: list[Step], *, beyond: bool) -> tuple[Vector, Vector, Vector]:
    """Sums of the pixels at these steps, of all, without the brightest, without the two brightest.

    ``beyond``: pixels beyond the border are as bright as the third brightest that is on the frame;
    else they are dark.
    """
    total, first, second, third = (np.zeros_like(light) for _ in range(4))
    missing = np.zeros_like(light)
    for one in _moved(light, steps, np.nan):
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
