"""Segmentation of bright regions of a volume, such as cells: position, size and brightness.

The volume is smoothed and a threshold is applied. Each voxel above it belongs to the maximum at the
end of its steepest ascent (the catchment basins of the watershed of the negative volume; Meyer
1994, Signal Processing 38, 113). Basins are merged if their saddle is nearly as high as the lower
of their maxima.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy.ndimage import gaussian_filter

from clplen.checks import real_array
from clplen.errors import ShapeError
from clplen.files import PathLike
from clplen.microscopy.objects.csv_tables import check_unit, position_columns, write_table
from clplen.microscopy.objects.points import (
    checked_stack,
    coordinates_of,
    level_and_noise,
    over_noise,
)
from clplen.reprs import OneLine

Vector = np.ndarray[Any, Any]

_BINS = 256  # of the histogram for Otsu's threshold
_ROUNDING = 1e-9  # relative tolerance of distances
_AROUND = [step for step in itertools.product((-1, 0, 1), repeat=3) if any(step)]


@dataclass(frozen=True, eq=False, repr=False)
class Regions(OneLine):
    """Regions detected by `find_regions`, sorted by decreasing size.

    Attributes
    ----------
    labels : numpy.ndarray
        Number of each voxel's region from 1, 0 for background, int32, shape of the volume.
    positions : numpy.ndarray
        Centroids (z, y, x) in units of the axes, float64, shape (n, 3).
    volumes : numpy.ndarray
        Volumes in cubed units of the axes, or in voxels without axes, float64, shape (n,).
    means, peaks : numpy.ndarray
        Mean and maximum of the unsmoothed samples, float64, shape (n,).
    snr : numpy.ndarray
        Maximum of the smoothed samples above the median, over the noise, float64, shape (n,).
    threshold : float
        Threshold of the smoothed volume.

    Examples
    --------
    >>> z, y, x = np.indices((12, 32, 32))
    >>> cell = np.exp(-(((z - 5) / 2) ** 2 + ((y - 8) / 4) ** 2 + ((x - 20) / 4) ** 2))
    >>> regions = clplen.microscopy.find_regions(cell)
    >>> len(regions), regions.positions.tolist()
    (1, [[5.0, 8.0, 20.0]])
    """

    labels: Vector
    positions: Vector
    volumes: Vector
    means: Vector
    peaks: Vector
    snr: Vector
    threshold: float

    def __len__(self) -> int:
        return len(self.positions)

    def to_csv(self, path: PathLike, *, unit: Literal["m", "voxel"] = "m") -> None:
        """Write a table: region, z_m, y_m, x_m, volume_m3 (or z_voxel, ...), mean, peak, snr.

        ``unit`` is the unit of the positions in the names of the columns.
        """
        check_unit(unit)
        columns = {"region": np.arange(1, len(self) + 1)}
        columns |= dict(zip(position_columns(unit), self.positions.T, strict=True))
        columns[f"volume_{unit}3"] = self.volumes
        write_table(path, columns | {"mean": self.means, "peak": self.peaks, "snr": self.snr})


def find_regions(
    volume: Any,
    *,
    axes: Sequence[Any] | None = None,
    size: tuple[float, float] = (1.0, 1.0),
    threshold: float | None = None,
    snr: float = 6.0,
    split: float = 0.9,
    min_voxels: int = 8,
) -> Regions:
    """Segment bright regions of a volume, and separate touching regions.

    Parameters
    ----------
    volume : array_like
        Volume, real and finite, shape (planes, y, x).
    axes : sequence, optional
        Coordinates of planes, rows and columns, each rising or falling, or None for 0, 1, ...
    size : tuple of float
        Sigma of the smoothing in planes and in samples of y and x, well below the size of a region.
    threshold : float, optional
        Threshold of the smoothed volume. Default: Otsu's threshold (1979, IEEE Trans. Syst. Man
        Cybern. 9, 62), which maximizes the variance between the classes, but at least ``snr`` times
        the noise above the median. The noise is 1.4826 times the median absolute deviation.
    snr : float
        Minimum signal-to-noise ratio of the default threshold.
    split : float
        Maximum saddle between two regions as a share of the lower maximum, both above the median:
        0 splits no touching regions, 1 splits all maxima.
    min_voxels : int
        Minimum number of voxels of a region.

    Returns
    -------
    Regions
        Regions, numbered from 1.

    Raises
    ------
    ShapeError
        If the volume is not (planes, y, x) of 1 or at least 3 planes and at least 3 rows and
        columns, or an axis does not fit it.
    ValueError
        If a sample is NaN or infinite, an axis neither rises nor falls, or a number is out of
        range.

    Examples
    --------
    >>> z, y, x = np.indices((12, 32, 32))
    >>> def cell(row, column):
    ...     return np.exp(-(((z - 5) / 2) ** 2 + ((y - row) / 4) ** 2 + ((x - column) / 4) ** 2))
    >>> side = 0.5e-6 * np.arange(32)
    >>> axes = (2e-6 * np.arange(12), side, side)  # metres
    >>> regions = clplen.microscopy.find_regions(cell(10, 10) + cell(10, 19), axes=axes)
    >>> np.round(np.sort(regions.positions[:, 2]) * 1e6, 1).tolist()
    [5.1, 9.4]
    """
    values = checked_stack(volume)
    planes, across = size
    if not (planes >= 0 and across >= 0 and snr > 0 and 0 <= split <= 1 and min_voxels >= 1):
        raise ValueError(
            "size must not be negative, snr positive, split from 0 to 1 and min_voxels at least 1, "
            f"got {size!r}, {snr!r}, {split!r}, {min_voxels!r}."
        )
    if threshold is not None and not np.isfinite(threshold):
        raise ValueError(f"threshold must be a finite number, got {threshold!r}.")
    coordinates = coordinates_of(axes, values.shape)
    smooth = np.asarray(gaussian_filter(values, (planes, across, across), mode="nearest"))
    middle, noise = map(float, level_and_noise(smooth))
    if threshold is None:
        threshold = max(_otsu(smooth), middle + snr * noise)
    labels = _basins(smooth, float(threshold), middle, split)
    labels = _renumbered(labels, np.bincount(labels.ravel()), min_voxels)
    return _measured(labels, values, smooth - middle, noise, coordinates, float(threshold))


def sphere_labels(positions: Any, radius: float, axes: Sequence[Any]) -> Vector:
    """Label the voxels in spheres about points, in overlaps by the nearest point.

    Parameters
    ----------
    positions : array_like
        Centres (z, y, x) of the spheres in units of the axes, shape (n, 3).
    radius : float
        Radius of the spheres in units of the axes, positive.
    axes : sequence
        Coordinates of planes, rows and columns, each rising or falling.

    Returns
    -------
    numpy.ndarray
        Number of the sphere of each voxel from 1, 0 outside, int32, shape (planes, rows, columns).
        The voxel nearest to a point inside the volume is always in its sphere.

    Raises
    ------
    ShapeError
        If positions do not have shape (n, 3) with n > 0, or there are not three axes.
    ValueError
        If the radius is not positive, a position not finite, or an axis neither rises nor falls.

    Examples
    --------
    >>> side = 0.5e-6 * np.arange(32)
    >>> axes = (2e-6 * np.arange(9), side, side)
    >>> labels = clplen.microscopy.sphere_labels([(8e-6, 5e-6, 5e-6)], 1e-6, axes)
    >>> [int(np.count_nonzero(plane)) for plane in labels]
    [0, 0, 0, 0, 13, 0, 0, 0, 0]
    """
    centres = real_array(positions, "positions", np.float64)
    if centres.ndim != 2 or centres.shape[1] != 3 or not len(centres):
        raise ShapeError(f"positions must have shape (n, 3) with n > 0, got {centres.shape}.")
    if not (np.isfinite(radius) and radius > 0):
        raise ValueError(f"radius must be positive and finite, got {radius!r}.")
    if not np.isfinite(centres).all():
        raise ValueError("A position is not finite.")
    shape = tuple(len(np.asarray(axis)) for axis in axes)
    coordinates = coordinates_of(axes, shape)
    nearest = np.full(shape, np.inf)
    labels = np.zeros(shape, np.int32)
    reach = radius * (1 + _ROUNDING)  # samples on the surface are inside
    for number, centre in enumerate(centres, 1):
        offsets = [np.abs(x - c) for x, c in zip(coordinates, centre, strict=True)]
        box = np.ix_(*(np.flatnonzero(d <= max(reach, d.min())) for d in offsets))
        distance = np.sqrt(sum(np.square(d[k]) for d, k in zip(offsets, box, strict=True)))
        is_inside = distance <= reach
        pairs = zip(offsets, coordinates, strict=True)
        if all(d.min() <= _half_step(x, int(d.argmin())) for d, x in pairs):
            is_inside.flat[distance.argmin()] = True
        is_nearest = is_inside & (distance < nearest[box])
        nearest[box] = np.where(is_nearest, distance, nearest[box])
        labels[box] = np.where(is_nearest, number, labels[box])
    return labels


def _half_step(coordinates: Vector, k: int) -> float:
    """Return half of the larger distance of a sample to its neighbours."""
    steps = np.abs(np.diff(coordinates))
    neighbouring = steps[max(k - 1, 0) : k + 1]
    return float(neighbouring.max()) / 2 * (1 + _ROUNDING) if len(neighbouring) else np.inf


def _otsu(values: Vector) -> float:
    """Return the threshold that maximizes the variance between the classes."""
    counts, edges = np.histogram(values, _BINS)
    middles = (edges[1:] + edges[:-1]) / 2
    below = np.cumsum(counts)[:-1]
    above = below[-1] + counts[-1] - below
    sums = np.cumsum(counts * middles)
    means = sums[:-1] / np.maximum(below, 1), (sums[-1] - sums[:-1]) / np.maximum(above, 1)
    between = below * above.astype(np.float64) * (means[1] - means[0]) ** 2
    return float(edges[1 + int(between.argmax())])


def _basins(smooth: Vector, threshold: float, middle: float, split: float) -> Vector:
    """Return the number of the region of each voxel, int32 from 1; 0 below the threshold."""
    labels = np.zeros(smooth.shape, np.int32)
    padded = np.pad(smooth, 1, constant_values=-np.inf)
    inside = np.flatnonzero(padded > threshold)
    if not len(inside):
        return labels
    flat = padded.ravel()
    strides = np.array([padded.shape[1] * padded.shape[2], padded.shape[2], 1])
    around = [int(np.dot(step, strides)) for step in _AROUND]
    index = np.full(flat.shape, -1, np.int64)
    index[inside] = np.arange(len(inside))
    basin = _ascended(flat, inside, around, index)
    merged = _merged(flat, inside, around, index, basin, middle, split)
    indices = inside // strides[0], inside // strides[1] % padded.shape[1], inside % padded.shape[2]
    labels[tuple(k - 1 for k in indices)] = merged + 1
    return labels


def _ascended(flat: Vector, inside: Vector, around: list[int], index: Vector) -> Vector:
    """Return the maximum at the end of each voxel's ascent, numbered from the highest.

    Ties are broken by the order in memory: the first voxel counts as higher.
    """
    rank = np.empty(len(inside), np.int64)
    order = np.lexsort((-inside, flat[inside]))
    rank[order] = np.arange(len(inside))
    highest = np.arange(len(inside))
    for step in around:
        other = index[inside + step]
        is_higher = (other >= 0) & (rank[other] > rank[highest])
        highest[is_higher] = other[is_higher]
    while (highest[highest] != highest).any():
        highest = highest[highest]
    tops = np.unique(highest)
    number = np.empty(len(inside), np.int64)
    number[tops[np.argsort(-rank[tops])]] = np.arange(len(tops))
    return number[highest]


def _merged(
    flat: Vector,
    inside: Vector,
    around: list[int],
    index: Vector,
    basin: Vector,
    middle: float,
    split: float,
) -> Vector:
    """Merge basins with a saddle nearly as high as the lower maximum, from the highest saddle down.

    See Edelsbrunner, Letscher and Zomorodian 2002, Discrete Comput. Geom. 28, 511 (persistence).
    """
    height = flat[inside]
    tops = np.full(basin.max() + 1, -np.inf)
    np.maximum.at(tops, basin, height)
    edges, saddles = [], []
    for step in around:
        other = index[inside + step]
        border = np.flatnonzero((other >= 0) & (basin < basin[other]))
        edges.append(np.stack([basin[border], basin[other[border]]], axis=1))
        saddles.append(np.minimum(height[border], height[other[border]]))
    pairs, saddle = np.concatenate(edges), np.concatenate(saddles)
    parent = np.arange(len(tops))

    def root(node: int) -> int:
        while parent[node] != node:
            parent[node] = parent[parent[node]]
            node = int(parent[node])
        return node

    pairs, pair_number = np.unique(pairs, axis=0, return_inverse=True)
    highest = np.full(len(pairs), -np.inf)
    np.maximum.at(highest, pair_number.reshape(-1), saddle)
    for k in np.argsort(-highest, kind="stable"):
        first, second = sorted((root(int(pairs[k, 0])), root(int(pairs[k, 1]))))
        if first != second and highest[k] - middle >= split * (tops[second] - middle):
            parent[second] = first
    return np.array([root(node) for node in range(len(tops))])[basin]


def _renumbered(labels: Vector, counts: Vector, min_voxels: int) -> Vector:
    """Remove small regions; number the others by decreasing size."""
    numbers = np.flatnonzero(counts >= min_voxels)
    numbers = numbers[numbers > 0]
    numbers = numbers[np.argsort(-counts[numbers], kind="stable")]
    mapping = np.zeros(len(counts), np.int32)
    mapping[numbers] = np.arange(1, len(numbers) + 1)
    return mapping[labels]


def _measured(
    labels: Vector,
    values: Vector,
    raised: Vector,
    noise: float,
    coordinates: list[Vector],
    threshold: float,
) -> Regions:
    """Measure position, size and brightness of each region."""
    voxels = np.nonzero(labels)
    number = labels[voxels] - 1
    count = int(labels.max(initial=0))
    sides = [np.abs(np.gradient(x)) if len(x) > 1 else np.ones(1) for x in coordinates]
    weights = np.prod([side[k] for side, k in zip(sides, voxels, strict=True)], axis=0)
    volumes = np.bincount(number, weights, count)
    centres = [
        np.bincount(number, weights * x[k], count) / volumes
        for x, k in zip(coordinates, voxels, strict=True)
    ]
    peaks, heights = np.full(count, -np.inf), np.full(count, -np.inf)
    np.maximum.at(peaks, number, values[voxels])
    np.maximum.at(heights, number, raised[voxels])
    return Regions(
        labels,
        np.stack(centres, axis=1).reshape(-1, 3),
        volumes,
        np.bincount(number, values[voxels], count) / np.bincount(number, minlength=count),
        peaks,
        over_noise(heights, noise),
        threshold,
    )
