"""Detection of points of light, such as beads, in a focal stack or a volume.

A stack is smoothed to the size of a point, and its background, smoothed by a wider Gaussian in each
plane, is subtracted (difference of Gaussians; Marr and Hildreth 1980). A point is a maximum over
planes, rows and columns above the noise of its plane. Its position is the centre of the Gaussian
through the maximum and its neighbours along each axis, a parabola of the logarithms.
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

BACKGROUND_RATIO = 3.0  # sigma of the background over sigma of a point
MAD_TO_SIGMA = 1.4826  # standard deviation of normal noise over its median absolute deviation


@dataclass(frozen=True, eq=False, repr=False)
class Points:
    """Points detected by `find_points`, sorted by decreasing brightness after smoothing.

    Attributes
    ----------
    positions : numpy.ndarray
        Positions (plane, y, x) in units of the axes, float64, shape (n, 3).
    peaks : numpy.ndarray
        Height of the brightest sample above the background in units of the stack, float64, shape
        (n,).
    snr : numpy.ndarray
        Height over the noise of its plane, both after smoothing; infinite if the noise is 0,
        float64, shape (n,).
    widths : numpy.ndarray
        Full width at half maximum along each axis in its units, float64, shape (n, 3); NaN if the
        stack ends before the half height.

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

        ``unit`` is the unit of the positions in the names of the columns.
        """
        check_unit(unit)
        names = position_columns(unit)
        columns = {"point": np.arange(len(self)), **dict(zip(names, self.positions.T, strict=True))}
        columns |= {"peak": self.peaks, "snr": self.snr}
        write_table(path, columns | dict(zip(_width_columns(unit), self.widths.T, strict=True)))

    @classmethod
    def from_csv(cls, path: PathLike) -> Points:
        """Read a table written by `to_csv`, with columns in any order."""
        positions, _, table = read_positions(
            path, "points", lambda unit: ("peak", "snr", *_width_columns(unit))
        )
        peak, snr, *widths = table.values()
        return cls(positions, peak, snr, np.stack(widths, axis=1))


def _width_columns(unit: str) -> list[str]:
    """Return the names of the columns of widths along z, y and x."""
    return [f"width_{name}" for name in position_columns(unit)]


def find_points(
    stack: Any,
    *,
    axes: Sequence[Any] | None = None,
    size: tuple[float, float] = (1.0, 1.0),
    snr: float = 6.0,
    distance: tuple[float, float] = (2.0, 3.0),
) -> Points:
    """Detect points of light in a stack of planes with subsample precision.

    Parameters
    ----------
    stack : FocalStack or array_like
        Refocused pictures or a volume, real and finite, shape (planes, y, x). In a single plane,
        points are maxima of the picture.
    axes : sequence, optional
        Coordinates of planes, rows and columns, each rising or falling, or None for 0, 1, ...;
        default the disparities of a `FocalStack`.
    size : tuple of float
        Sigma of the smoothing in planes and in samples of y and x (at least 0.5). Best is the sigma
        of a point, its full width at half maximum over 2.35.
    snr : float
        Minimum ratio of height to noise. The noise of a plane is 1.4826 times the median absolute
        deviation of its smoothed samples, robust to a few points; out-of-focus light counts as
        noise.
    distance : tuple of float
        Half axes, in planes and in samples of y and x, of an ellipsoid about each point in which
        dimmer points are rejected.

    Returns
    -------
    Points
        Detected points. Maxima in the first or last plane, row or column have no precise position
        and are excluded.

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
            "size must be at least 0 planes and 0.5 samples, snr and distance positive, got "
            f"{size!r}, {snr!r}, {distance!r}."
        )
    coordinates = coordinates_of(axes, values.shape)
    background = _smoothed(values, planes, BACKGROUND_RATIO * across)
    raised = _smoothed(values, planes, across) - background
    _, noise = level_and_noise(raised, axis=(1, 2))
    peaks = _separated(_maxima(raised, snr * noise), distance)
    positions = [
        [_peak(raised, coordinates, tuple(peak), axis) for axis in range(3)] for peak in peaks
    ]
    above = values - _smoothed(values, 0.0, BACKGROUND_RATIO * across)
    widths = [
        [_width(above, coordinates, tuple(peak), axis) for axis in range(3)] for peak in peaks
    ]
    index = tuple(peaks.T)
    return Points(
        np.array(positions, np.float64).reshape(-1, 3),
        above[index],
        over_noise(raised[index], noise[index[0]]),
        np.array(widths, np.float64).reshape(-1, 3),
    )


def match_points(first: Vector, second: Vector, *, tolerance: Sequence[float]) -> Vector:
    """Match positions of two lists that are mutual nearest neighbours.

    Parameters
    ----------
    first, second : array_like
        Positions (plane, y, x), shapes (n, 3) and (m, 3).
    tolerance : sequence of float
        Maximum distance (plane, y, x) of a match in units of the positions: half axes of an
        ellipsoid, which also scale the distances.

    Returns
    -------
    numpy.ndarray
        Pairs of indices in the first list (rising) and the second list, int, shape (matched, 2).

    Examples
    --------
    >>> detected = [(0.0, 5.0, 5.0), (10e-6, 9.0, 1.0), (20e-6, 3.0, 9.0)]
    >>> expected = [(21e-6, 3.2, 9.0), (0.5e-6, 5.1, 4.8)]
    >>> clplen.microscopy.match_points(detected, expected, tolerance=(2e-6, 0.5, 0.5)).tolist()
    [[0, 1], [2, 0]]
    """
    check_finite(first=first, second=second, tolerance=tolerance)
    a, b = (
        real_array(points, "positions", np.float64).reshape(-1, 3) / tolerance
        for points in (first, second)
    )
    if not (len(a) and len(b)):
        return np.empty((0, 2), int)
    distances, nearest = (np.asarray(values) for values in cKDTree(b).query(a))
    back = np.asarray(cKDTree(a).query(b)[1])
    mutual = (back[nearest] == np.arange(len(a))) & (distances <= 1)
    return np.stack([np.flatnonzero(mutual), nearest[mutual]], axis=1)


def checked_stack(stack: Any) -> Vector:
    """Check a stack; return its samples (planes, y, x) as float64."""
    values = host_array(stack, "A stack")
    shape = values.shape
    is_small = values.ndim != 3 or shape[0] in (0, 2) or min(shape[1:]) < 3
    if is_small or values.dtype.kind not in "buif":
        raise ShapeError(
            "A stack must be real with shape (planes, y, x), 1 or at least 3 planes of at least "
            f"3 x 3 samples, got {values.dtype} of shape {shape}."
        )
    bad = int(np.count_nonzero(~np.isfinite(values)))
    if bad:
        raise ValueError(
            f"{bad} samples are NaN or infinite: replace them first, for example by the mean of "
            "their neighbours."
        )
    return values.astype(np.float64)


def coordinates_of(axes: Sequence[Any] | None, shape: tuple[int, ...]) -> list[Vector]:
    """Return the coordinates of the samples along each axis, float64."""
    axes = (None, None, None) if axes is None else axes
    if len(axes) != 3:
        raise ShapeError(f"axes must have 3 entries, for planes, y and x, got {len(axes)}.")
    coordinates = []
    for axis, count in zip(axes, shape, strict=True):
        values = np.arange(count) if axis is None else real_array(axis, "An axis", None)
        if values.shape != (count,):
            raise ShapeError(
                f"An axis of {count} samples must have shape ({count},), got {values.shape}."
            )
        values = values.astype(np.float64)
        steps = np.diff(values)
        if not (np.isfinite(values).all() and ((steps > 0).all() or (steps < 0).all())):
            raise ValueError(f"Coordinates along an axis must rise or fall, got {axis!r}.")
        coordinates.append(values)
    return coordinates


def level_and_noise(values: Vector, axis: tuple[int, ...] | None = None) -> tuple[Any, Any]:
    """Return the median, and the standard deviation by the median absolute deviation."""
    level = np.median(values, axis=axis, keepdims=True)
    noise = MAD_TO_SIGMA * np.median(np.abs(values - level), axis=axis)
    return np.squeeze(level, axis), noise


def over_noise(heights: Vector, noise: Vector | float) -> Vector:
    """Divide heights by the noise; infinite without noise."""
    with np.errstate(over="ignore"):
        return np.asarray(heights / np.maximum(noise, np.finfo(np.float64).tiny))


def _smoothed(values: Vector, planes: float, across: float) -> Vector:
    """Smooth a stack by a Gaussian with repeated edges."""
    return np.asarray(gaussian_filter(values, (planes, across, across), mode="nearest"))


def _maxima(raised: Vector, level: Vector) -> Vector:
    """Return the indices of the local maxima above the level, brightest first."""
    highest = maximum_filter(raised, size=3, mode="nearest")
    is_maximum = (raised == highest) & (raised > level[:, None, None])
    planes = slice(1, -1) if len(raised) > 1 else slice(None)
    inner = np.zeros_like(is_maximum)
    inner[planes, 1:-1, 1:-1] = is_maximum[planes, 1:-1, 1:-1]
    maxima = np.argwhere(inner)
    return maxima[np.argsort(-raised[tuple(maxima.T)], kind="stable")]


def _separated(maxima: Vector, distance: tuple[float, float]) -> Vector:
    """Reject maxima with a brighter maximum within the ellipsoid; keep the order."""
    if not len(maxima):
        return maxima
    tree = cKDTree(maxima / (distance[0], distance[1], distance[1]))
    is_separate = np.ones(len(maxima), bool)
    for brighter, other in sorted(tree.query_pairs(1.0)):
        if is_separate[brighter]:
            is_separate[other] = False
    return maxima[is_separate]


def _peak(raised: Vector, coordinates: list[Vector], index: tuple[int, ...], axis: int) -> float:
    """Return the centre of the Gaussian through a maximum and its neighbours along an axis."""
    x, line, k = coordinates[axis], _line(raised, index, axis), index[axis]
    if len(x) == 1:
        return float(x[0])
    low, high, best = (max(float(line[i]), 1e-3 * float(line[k])) for i in (k - 1, k + 1, k))
    left = math.log(best / low) / (x[k] - x[k - 1])
    right = math.log(high / best) / (x[k + 1] - x[k])
    if left == right:
        return float(x[k])
    step = (x[k + 1] - x[k - 1]) / 2
    return float((x[k - 1] + x[k]) / 2 + left * step / (left - right))


def _width(above: Vector, coordinates: list[Vector], index: tuple[int, ...], axis: int) -> float:
    """Return the full width at half maximum along an axis, linear between samples."""
    x, line, k = coordinates[axis], _line(above, index, axis), index[axis]
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


def _line(values: Vector, index: tuple[int, ...], axis: int) -> Vector:
    """Return the samples along an axis through a sample."""
    return np.asarray(values[tuple(slice(None) if k == axis else i for k, i in enumerate(index))])
