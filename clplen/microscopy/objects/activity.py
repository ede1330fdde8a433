"""Brightness of regions over a series: F, F0 and dF/F."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.ndimage import distance_transform_edt

from clplen.checks import host_array, is_finite, is_integer
from clplen.errors import ShapeError
from clplen.files import PathLike
from clplen.microscopy.objects.csv_tables import read_table, whole_numbers, write_table
from clplen.microscopy.objects.points import coordinates_of
from clplen.reprs import OneLine

Vector = np.ndarray[Any, Any]

PERCENTILE = 8.0  # default percentile of F0 (Dombeck et al. 2007)
NEUROPIL = 0.7  # default share of the ring's light in a region (Chen et al. 2013)
_COLUMNS = ("region", "frame", "mean", "surround", "baseline", "dff")


@dataclass(frozen=True, eq=False, repr=False)
class Traces(OneLine):
    """Brightness of regions over time.

    Attributes
    ----------
    regions : numpy.ndarray
        Labels of the regions, int64, shape (n,).
    means : numpy.ndarray
        Mean of the voxels of each region, float64, shape (n, frames).
    surround : numpy.ndarray
        Median of the ring about each region, float64, shape (n, frames); NaN without a ring.
    baseline : numpy.ndarray
        Baseline F0, float64, shape (n, frames).
    dff : numpy.ndarray
        dF/F = (F - F0)/F0, float64, shape (n, frames); NaN if F0 is not positive.

    Raises
    ------
    ShapeError
        If the shapes of the arrays do not match.

    Examples
    --------
    >>> labels = np.zeros((3, 8, 8), int)
    >>> labels[1, 2:5, 2:5] = 4
    >>> series = [np.where(labels == 4, 10.0 + 5 * (t == 3), 1.0) for t in range(6)]
    >>> traces = clplen.microscopy.traces(series, labels, window=5)
    >>> traces.regions.tolist(), traces.dff.round(2).tolist()
    ([4], [[0.0, 0.0, 0.0, 0.5, 0.0, 0.0]])
    """

    regions: Vector
    means: Vector
    surround: Vector
    baseline: Vector
    dff: Vector

    def __post_init__(self) -> None:
        shapes = {np.shape(a) for a in (self.means, self.surround, self.baseline, self.dff)}
        if len(shapes) != 1 or np.shape(self.means)[:1] != np.shape(self.regions):
            raise ShapeError(
                f"Traces of {len(self.regions)} regions must have shape ({len(self.regions)}, "
                f"frames), got {sorted(shapes)}."
            )

    def __len__(self) -> int:
        return len(self.regions)

    def to_csv(self, path: PathLike) -> None:
        """Write a row per region and frame: region, frame, mean, surround, baseline, dff."""
        count, frames = self.means.shape
        numbers = (np.repeat(self.regions, frames), np.tile(np.arange(frames), count))
        values = (self.means, self.surround, self.baseline, self.dff)
        columns = (*numbers, *(column.ravel() for column in values))
        write_table(path, dict(zip(_COLUMNS, columns, strict=True)))

    @classmethod
    def from_csv(cls, path: PathLike) -> Traces:
        """Read a table written by `to_csv`, with columns in any order."""
        table = read_table(path, "traces", _COLUMNS)
        ids, frames = (whole_numbers(path, table[name], name) for name in _COLUMNS[:2])
        order = np.lexsort((frames, ids))
        regions = np.unique(ids)
        count = len(ids) // max(len(regions), 1)
        is_complete = np.array_equal(ids[order], np.repeat(regions, count)) and np.array_equal(
            frames[order], np.tile(np.arange(count), len(regions))
        )
        if not is_complete:
            raise ShapeError(f"{path}: every region must have each frame from 0 on exactly once.")
        means, surround, baseline, dff = (
            table[name][order].reshape(len(regions), count) for name in _COLUMNS[2:]
        )
        return cls(regions, means, surround, baseline, dff)


def traces(
    series: Iterable[Any],
    labels: Any,
    *,
    window: int = 300,
    percentile: float = PERCENTILE,
    ring: tuple[float, float] | None = None,
    axes: Sequence[Any] | None = None,
    neuropil: float = NEUROPIL,
) -> Traces:
    """Measure the brightness of regions over a series, and dF/F.

    F is the mean of a region in each volume. With a ring, r times the median of the ring is
    subtracted (Chen et al. 2013, Nature 499, 295: r = 0.7 for the neuropil about a cell). F0 is a
    low percentile of F in a window about each frame, truncated at the ends of the series (Dombeck
    et al. 2007, Neuron 56, 43: the 8th in +-15 s), and dF/F = (F - F0)/F0. Background light, such
    as a camera offset or haze, increases F0 and decreases dF/F; the ring removes it.

    The 8th percentile of pure noise with standard deviation s is 1.41 s below the mean, so that
    dF/F at rest is 1.41 s/F0 instead of 0. Use ``percentile=50`` if activity is rare.

    Parameters
    ----------
    series : iterable of array_like
        Volumes (planes, y, x) of equal shape in temporal order, an array (t, planes, y, x), or a
        lazy reader such as `clplen.io.open_volumes`.
    labels : Regions or array_like
        Integers, shape (planes, y, x): number of each voxel's region, 0 for background, such as
        from `find_regions` or `sphere_labels`.
    window : int
        Number of frames of the window of F0.
    percentile : float
        Percentile of F0, from 0 to 100.
    ring : tuple of float, optional
        Inner and outer distance of the ring from the region's voxels, in units of the axes. Voxels
        of all regions are excluded from it.
    axes : sequence, optional
        Equidistant coordinates of planes, rows and columns for the ring, or None for 0, 1, ...
    neuropil : float
        Share r of the ring's light in the region, from 0 to 1.

    Returns
    -------
    Traces
        Traces of each region over all frames.

    Raises
    ------
    ShapeError
        If labels or a volume have another shape.
    ValueError
        If a sample in a region is not finite, there is no region or only one volume, a ring has no
        voxel, or a number is out of range.

    Examples
    --------
    >>> z, y, x = np.indices((5, 16, 16))
    >>> cell = np.exp(-((z - 2) ** 2 + (y - 8) ** 2 + (x - 8) ** 2) / 4)
    >>> series = [2 + 10 * cell * (1 + 0.5 * (t in (4, 5))) for t in range(9)]
    >>> labels = clplen.microscopy.find_regions(series[0])
    >>> traces = clplen.microscopy.traces(series, labels, window=9, ring=(3, 5), neuropil=1)
    >>> traces.dff.round(2).tolist()
    [[0.0, 0.0, 0.0, 0.0, 0.5, 0.5, 0.0, 0.0, 0.0]]
    """
    _check(window, percentile, ring, neuropil)
    numbers = _integers(getattr(labels, "labels", labels))
    regions = np.unique(numbers[numbers > 0])
    if not len(regions):
        raise ValueError("labels must contain a region, got only 0.")
    inside = [np.flatnonzero(numbers == region) for region in regions]
    rings = [] if ring is None else _rings(numbers, regions, ring, axes)
    signals, surrounds = [], []
    for frame, volume in enumerate(series):
        values = host_array(volume, "A volume")
        if values.shape != numbers.shape or values.dtype.kind not in "buif":
            raise ShapeError(
                f"Volumes must be real with the shape {numbers.shape} of the labels, got "
                f"{values.dtype} of shape {values.shape} in frame {frame}."
            )
        flat = values.reshape(-1)
        signals.append([float(flat[part].mean(dtype=np.float64)) for part in inside])
        surrounds.append([float(np.median(flat[part])) for part in rings])
        if not np.isfinite([*signals[-1], *surrounds[-1]]).all():
            raise ValueError(f"A region or ring has samples that are not finite in frame {frame}.")
    if len(signals) < 2:
        raise ValueError(f"A trace needs at least 2 frames, got {len(signals)}.")
    means = np.array(signals).T
    surround = np.array(surrounds).T if rings else np.full(means.shape, np.nan)
    light = means
    if rings:
        light = means - neuropil * surround
    baseline = rolling_percentile(light, window, percentile)
    with np.errstate(divide="ignore", invalid="ignore"):
        dff = np.where(baseline > 0, (light - baseline) / baseline, np.nan)
    return Traces(regions.astype(np.int64), means, surround, baseline, dff)


def rolling_percentile(values: Vector, window: int, percentile: float) -> Vector:
    """Return the percentile in a window about each sample of the last axis, cut at its ends."""
    frames = values.shape[1]
    baseline = np.empty(values.shape)
    for k in range(frames):
        part = values[:, max(k - window // 2, 0) : k - window // 2 + window]
        baseline[:, k] = np.percentile(part, percentile, axis=1)
    return baseline


def _check(window: int, percentile: float, ring: Any, neuropil: float) -> None:
    if not (is_integer(window) and window >= 1):
        raise ValueError(f"window must be an integer from 1 on, got {window!r}.")
    if not (is_finite(percentile) and 0 <= percentile <= 100):
        raise ValueError(f"percentile must be a number from 0 to 100, got {percentile!r}.")
    if not (is_finite(neuropil) and 0 <= neuropil <= 1):
        raise ValueError(f"neuropil must be a share from 0 to 1, got {neuropil!r}.")
    if ring is not None and not (
        np.shape(ring) == (2,) and all(map(is_finite, ring)) and 0 <= ring[0] < ring[1]
    ):
        raise ValueError(f"ring must be (inner, outer) with 0 <= inner < outer, got {ring!r}.")


def _integers(labels: Any) -> Vector:
    """Return labels as int64, (planes, y, x)."""
    values = host_array(labels, "Labels")
    if values.ndim != 3 or values.dtype.kind not in "buif" or not values.size:
        raise ShapeError(
            f"labels must be real with shape (planes, y, x), got {values.dtype} of shape "
            f"{values.shape}."
        )
    if values.dtype.kind == "f" and not (np.isfinite(values) & (values == np.floor(values))).all():
        raise ValueError("labels must be integers: this volume contains brightness, not regions.")
    return values.astype(np.int64)


def _rings(
    numbers: Vector, regions: Vector, ring: tuple[float, float], axes: Sequence[Any] | None
) -> list[Vector]:
    """Return the flat indices of the background voxels in the ring about each region."""
    coordinates = coordinates_of(axes, numbers.shape)
    steps = [float(np.abs(np.diff(x)).mean()) if len(x) > 1 else 1.0 for x in coordinates]
    is_free = numbers == 0
    rings = []
    for region in regions:
        region_voxels = np.nonzero(numbers == region)
        box = tuple(
            slice(max(int(k.min() - ring[1] / step), 0), int(k.max() + ring[1] / step) + 2)
            for k, step in zip(region_voxels, steps, strict=True)
        )
        distance = distance_transform_edt(numbers[box] != region, sampling=steps)
        local = np.nonzero((distance > ring[0]) & (distance <= ring[1]) & is_free[box])
        if not len(local[0]):
            raise ValueError(
                f"The ring of region {region} from {ring[0]:g} to {ring[1]:g} has no voxel outside "
                "of regions: give a wider ring, in units of the axes."
            )
        indices = tuple(k + part.start for k, part in zip(local, box, strict=True))
        rings.append(np.ravel_multi_index(indices, numbers.shape))
    return rings
