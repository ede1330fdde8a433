"""Points of light, such as beads, in a focal stack or a volume: where they lie between its samples.

A stack is smoothed to the size of a point, and its background, smoothed over a wider Gaussian in
each plane, is taken off (difference of Gaussians; Marr and Hildreth 1980). A point is a maximum
over planes, rows and columns that stands out of the noise of its plane. Its place is that of the
Gaussian through the maximum and its neighbours along each axis, a parabola of the logarithms.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy.ndimage import gaussian_filter, maximum_filter
from scipy.spatial import cKDTree

from clplen.checks import check_finite, host_array, real_array
from clplen.errors import ShapeError
from clplen.files import PathLike
from clplen.lightfield.refocusing.focal_stacks import FocalStack
from clplen.microscopy.objects.csv_tables import (
    check_unit,
    position_columns,
    read_positions,
    write_table,
)

Vector = np.ndarray[Any, Any]

WIDER = 3.0  # sigma of the background over that of a point
DEVIATION = 1.4826  # standard deviation of normal noise over its median absolute deviation


@dataclass(frozen=True, eq=False, repr=False)
class Points:
    """What `find_points` found, brightest first after smoothing.

    Attributes
    ----------
    positions : numpy.ndarray
        float64, shape (n, 3): (plane, y, x) in units of the axes.
    peaks : numpy.ndarray
        float64, shape (n,): height of the brightest sample above the background, in units of the
        stack.
    snr : numpy.ndarray
        float64, shape (n,): height over the noise of its plane, both after smoothing.
    widths : numpy.ndarray
        float64, shape (n, 3): full width at half height along each axis, in its units, not
        negative; NaN where the stack ends before.

    Examples
    --------
    >>> z, y, x = np.indices((16, 32, 32))
    >>> bead = 100 * np.exp(-((z - 5.3) ** 2 + (y - 8.5) ** 2 + (x - 20.2) ** 2) / 3)
    >>> points = clplen.microscopy.find_points(bead)
    >>> len(points), np.round(points.widths).tolist()
    (1, [[3.0, 3.0, 3.0]])
    """

    positions: Vector
    peaks: Vector
    snr: Vector
    widths: Vector

    def __len__(self) -> int:
        return len(self.positions)

    def __repr__(self) -> str:
        return f"<Points: {len(self)}>"

    def to_csv(self, path: PathLike, *, unit: Literal["m", "voxel"] = "m") -> None:
        """Write a table: point, z_m, y_m, x_m (or z_voxel, ...), peak, snr, width_z_m, ....

        ``unit`` is that of the positions, for the names of the columns.
        """
        check_unit(unit)
        names = position_columns(unit)
        columns = {"point": np.arange(len(self)), **dict(zip(names, self.positions.T, strict=True))}
        columns |= {"peak": self.peaks, "snr": self.snr}
        write_table(path, columns | dict(zip(_width_columns(unit), self.widths.T, strict=True)))

    @classmethod
    def from_csv(cls, path: PathLike) -> Points:
        """Read a table that `to_csv` wrote, its columns in any order."""
        positions, _, table = read_positions(
            path, "points", lambda unit: ("peak", "snr", *_width_columns(unit))
        )
        peak, snr, *widths = table.values()
        return cls(positions, peak, snr, np.stack(widths, axis=1))


def _width_columns(unit: str) -> list[str]:
    """Names of the columns of widths along z, y and x."""
    return [f"width_{name}" for name in position_columns(unit)]


def find_points(
    stack: Any,
    *,
    axes: Sequence[Any] | None = None,
    size: tuple[float, float] = (1.0, 1.0),
    snr: float = 6.0,
    distance: tuple[float, float] = (2.0, 3.0),
) -> Points:
    """Find points of light in a stack of planes, with places finer than its samples.

    Parameters
    ----------
    stack : FocalStack or array_like
        Real and finite, shape (planes, y, x): refocused pictures, or a volume. With one plane,
        points are maxima of that picture.
    axes : sequence, optional
        Coordinates of planes, rows and columns, each rising or falling, or None for 0, 1, ...;
        default the disparities of a `FocalStack`.
    size : tuple of float
        (planes, samples of y and x), sigma of the smoothing, at least 0.5 samples: best that of a
        point, its width at half height over 2.35.
    snr : float
        Least height over noise. The noise of a plane is 1.4826 times the median absolute deviation
        of its smoothed samples, which a few points do not change; light out of focus counts as
        noise.
    distance : tuple of float
        (planes, samples of y and x), half axes of the ellipsoid about a point in which no dimmer
        one is taken.

    Returns
    -------
    Points
        Without maxima in the first or the last plane, row or column: their places are not known.

    Raises
    ------
    ShapeError
        If the stack is not (planes, y, x) of 1 or at least 3 planes and at least 3 rows and
        columns, or an axis does not fit it.
    ValueError
        If a sample is NaN or infinite, an axis neither rises nor falls, or a number is out of
        range.

    Examples
    --------
    >>> z, y, x = np.indices((16, 32, 32))
    >>> bead = 100 * np.exp(-((z - 5.3) ** 2 + (y - 8.4) ** 2 + (x - 20.2) ** 2) / 3)
    >>> planes, side = 1e-6 * (np.arange(16) - 8), 0.5e-6 * np.arange(32)
    >>> points = clplen.microscopy.find_points(bead, axes=(planes, side, side))
    >>> np.round(points.positions * 1e6, 1).tolist()  # (z, y, x) in um
    [[-2.7, 4.2, 10.1]]
    """
    if axes is None and isinstance(stack, FocalStack):
        axes = (stack.disparities, None, None)
    values = checked_stack(stack)
    planes, across = size
    if not (planes >= 0 and across >= 0.5 and snr > 0 and min(distance) > 0):
        raise ValueError(
            "size is at least 0 planes and 0.5 samples, snr and distance are positive, not "
            f"{size!r}, {snr!r}, {distance!r}."
        )
    places = coordinates_of(axes, values.shape)
    raised = _smoothed(values, planes, across) - _smoothed(values, planes, WIDER * across)
    _, noise = level_and_noise(raised, axis=(1, 2))
    found = _apart(_maxima(raised, snr * noise), distance)
    positions = [[_top(raised, places, tuple(at), axis) for axis in range(3)] for at in found]
    above = values - _smoothed(values, 0.0, WIDER * across)
    widths = [[_width(above, places, tuple(at), axis) for axis in range(3)] for at in found]
    index = tuple(found.T)
    return Points(
        np.array(positions, np.float64).reshape(-1, 3),
        above[index],
        over_noise(raised[index], noise[index[0]]),
        np.array(widths, np.float64).reshape(-1, 3),
    )


def match_points(first: Vector, second: Vector, *, tolerance: Sequence[float]) -> Vector:
    """Match the positions of two lists that are nearest neighbours of each other.

    Parameters
    ----------
    first, second : array_like
        Positions (plane, y, x), shapes (n, 3) and (m, 3).
    tolerance : sequence of float
        (plane, y, x) in the units of the positions, half axes of the ellipsoid in which the other
        one lies; they also are the units of distance.

    Returns
    -------
    numpy.ndarray
        Pairs of the same point, int, shape (matched, 2): index in the first list, rising, and in
        the second.

    Examples
    --------
    >>> found = [(0.0, 5.0, 5.0), (10e-6, 9.0, 1.0), (20e-6, 3.0, 9.0)]
    >>> expected = [(21e-6, 3.2, 9.0), (0.5e-6, 5.1, 4.8)]
    >>> clplen.microscopy.match_points(found, expected, tolerance=(2e-6, 0.5, 0.5)).tolist()
    [[0, 1], [2, 0]]
    """
    check_finite(first=first, second=second, tolerance=tolerance)
    one, other = (
        real_array(points, "positions", np.float64).reshape(-1, 3) / tolerance
        for points in (first, second)
    )
    if not (len(one) and len(other)):
        return np.empty((0, 2), int)
    far, there = (np.asarray(found) for found in cKDTree(other).query(one))
    back = np.asarray(cKDTree(one).query(other)[1])
    mutual = (back[there] == np.arange(len(one))) & (far <= 1)
    return np.stack([np.flatnonzero(mutual), there[mutual]], axis=1)


def checked_stack(stack: Any) -> Vector:
    """Samples (planes, y, x) that are finite, float64."""
    values = host_array(stack, "A stack")
    shape = values.shape
    few = values.ndim != 3 or shape[0] in (0, 2) or min(shape[1:]) < 3
    if few or values.dtype.kind not in "buif":
        raise ShapeError(
            "Points are found in real samples of shape (planes, y, x), 1 or at least 3 planes of "
            f"at least 3 x 3, not {values.dtype} of {shape}."
        )
    bad = int(np.count_nonzero(~np.isfinite(values)))
    if bad:
        raise ValueError(
            f"{bad} samples are NaN or infinite: replace them before looking for points, for "
            "example by the mean of their neighbours."
        )
    return values.astype(np.float64)


def coordinates_of(axes: Sequence[Any] | None, shape: tuple[int, ...]) -> list[Vector]:
    """Coordinates of the samples along each axis, float64."""
    given = (None, None, None) if axes is None else axes
    if len(given) != 3:
        raise ShapeError(f"axes are those of planes, y and x, not {len(given)}.")
    found = []
    for axis, count in zip(given, shape, strict=True):
        places = np.arange(count) if axis is None else real_array(axis, "An axis", None)
        if places.shape != (count,):
            raise ShapeError(f"An axis of {count} samples has shape {places.shape}.")
        places = places.astype(np.float64)
        steps = np.diff(places)
        if not (np.isfinite(places).all() and ((steps > 0).all() or (steps < 0).all())):
            raise ValueError(f"Coordinates along an axis rise or fall all the way, not {axis!r}.")
        found.append(places)
    return found


def level_and_noise(values: Vector, axis: tuple[int, ...] | None = None) -> tuple[Any, Any]:
    """Median, and standard deviation of normal noise by the median absolute deviation."""
    level = np.median(values, axis=axis, keepdims=True)
    noise = DEVIATION * np.median(np.abs(values - level), axis=axis)
    return np.squeeze(level, axis), noise


def over_noise(heights: Vector, noise: Vector | float) -> Vector:
    """Heights over the noise, infinite where there is none."""
    with np.errstate(over="ignore"):
        return np.asarray(heights / np.maximum(noise, np.finfo(np.float64).tiny))


def _smoothed(values: Vector, planes: float, across: float) -> Vector:
    """Smoothed by a Gaussian, the edges repeated."""
    return np.asarray(gaussian_filter(values, (planes, across, across), mode="nearest"))


def _maxima(raised: Vector, level: Vector) -> Vector:
    """Indices of the samples not below their neighbours, above the level, brightest first."""
    highest = maximum_filter(raised, size=3, mode="nearest")
    is_one = (raised == highest) & (raised > level[:, None, None])
    planes = slice(1, -1) if len(raised) > 1 else slice(None)
    inner = np.zeros_like(is_one)
    inner[planes, 1:-1, 1:-1] = is_one[planes, 1:-1, 1:-1]
    found = np.argwhere(inner)
    return found[np.argsort(-raised[tuple(found.T)], kind="stable")]


def _apart(found: Vector, distance: tuple[float, float]) -> Vector:
    """Those of which no brighter one lies within the ellipsoid; brightest first."""
    if not len(found):
        return found
    tree = cKDTree(found / (distance[0], distance[1], distance[1]))
    kept = np.ones(len(found), bool)
    for brighter, other in sorted(tree.query_pairs(1.0)):
        if kept[brighter]:
            kept[other] = False
    return found[kept]


def _top(raised: Vector, places: list[Vector], at: tuple[int, ...], axis: int) -> float:
    """Where the Gaussian through a maximum and its neighbours along an axis is highest."""
    x, line, k = places[axis], _line(raised, at, axis), at[axis]
    if len(x) == 1:
        return float(x[0])
    low, high, best = (max(float(line[i]), 1e-3 * float(line[k])) for i in (k - 1, k + 1, k))
    left = math.log(best / low) / (x[k] - x[k - 1])
    right = math.log(high / best) / (x[k + 1] - x[k])
    if left == right:
        return float(x[k])
    step = (x[k + 1] - x[k - 1]) / 2
    return float((x[k - 1] + x[k]) / 2 + left * step / (left - right))


def _width(above: Vector, places: list[Vector], at: tuple[int, ...], axis: int) -> float:
    """Distance of the places on both sides where a line falls to half, linear between samples."""
    x, line, k = places[axis], _line(above, at, axis), at[axis]
    half, ends = line[k] / 2, []
    if half <= 0:
        return math.nan
    for step in (-1, 1):
        beyond = np.flatnonzero(line[k::step] < half)
        if not len(beyond):
            return math.nan
        i = k + step * int(beyond[0])
        share = (line[i - step] - half) / (line[i - step] - line[i])
        ends.append(x[i - step] + share * (x[i] - x[i - step]))
    return float(abs(ends[1] - ends[0]))


def _line(values: Vector, at: tuple[int, ...], axis: int) -> Vector:
    """Samples along an axis through a sample."""
    return np.asarray(values[tuple(slice(None) if k == axis else i for k, i in enumerate(at))])
