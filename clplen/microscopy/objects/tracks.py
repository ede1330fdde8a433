"""Tracks of points or regions over the volumes of a series."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np

from clplen.checks import float64_array, is_integer
from clplen.errors import FormatError, ShapeError
from clplen.files import PathLike
from clplen.microscopy.objects.csv_tables import (
    check_unit,
    position_columns,
    read_positions,
    whole_numbers,
    write_table,
)
from clplen.microscopy.objects.linking import link

Vector = np.ndarray[Any, Any]
Motion = Literal["random", "straight"]

_MICRONS = 1e6  # per metre
_VELOCITY_STEPS = 3  # number of steps in the mean velocity


class Detections(Protocol):
    """Detected objects of a volume: `Points` or `Regions`."""

    @property
    def positions(self) -> Vector: ...
    @property
    def peaks(self) -> Vector: ...
    @property
    def snr(self) -> Vector: ...


@dataclass(frozen=True, eq=False, repr=False)
class Tracks:
    """Positions of points over time, sorted by track and frame.

    Attributes
    ----------
    ids : numpy.ndarray
        Number of the track from 0, in the order of the first frames, int64, shape (n,).
    frames : numpy.ndarray
        Number of the volume from 0, at most once per track, int64, shape (n,).
    positions : numpy.ndarray
        Positions (z, y, x), float64, shape (n, 3).
    peaks, snr : numpy.ndarray
        Heights and signal-to-noise ratios as in `Points`, float64, shape (n,).
    unit : {"m", "voxel"}
        Unit of the positions.

    Raises
    ------
    ShapeError
        If the shapes of the arrays do not match.
    ValueError
        If the unit is unknown.

    Examples
    --------
    >>> z, y, x = np.indices((9, 24, 24))
    >>> series = [np.exp(-((z - 4) ** 2 + (y - 8 - t) ** 2 + (x - 12.5) ** 2) / 3)
    ...           for t in range(3)]
    >>> tracks = clplen.microscopy.track_points(
    ...     [clplen.microscopy.find_points(volume) for volume in series], step=2)
    >>> tracks
    <Tracks: 1 track, 3 points, 3 frames>
    >>> tracks.napari().round(1).tolist()  # track, frame, z, y, x
    [[0.0, 0.0, 4.0, 8.0, 12.5], [0.0, 1.0, 4.0, 9.0, 12.5], [0.0, 2.0, 4.0, 10.0, 12.5]]
    """

    ids: Vector
    frames: Vector
    positions: Vector
    peaks: Vector
    snr: Vector
    unit: str = "voxel"

    def __post_init__(self) -> None:
        count = len(self.ids)
        shapes = [np.shape(a) for a in (self.ids, self.frames, self.peaks, self.snr)]
        if np.shape(self.positions) != (count, 3) or any(shape != (count,) for shape in shapes):
            raise ShapeError(
                f"Tracks of {count} points must have positions of shape ({count}, 3) and frames, "
                f"peaks and snr of shape ({count},), got {np.shape(self.positions)} and {shapes}."
            )
        check_unit(self.unit)

    def __len__(self) -> int:
        return len(np.unique(self.ids))

    def __repr__(self) -> str:
        last = int(self.frames.max()) + 1 if len(self.frames) else 0
        count = f"{len(self)} track" + "s" * (len(self) != 1)
        return f"<Tracks: {count}, {len(self.ids)} points, {last} frames>"

    def napari(self) -> Vector:
        """Return the array for a Tracks layer of napari, float64, shape (n, 5).

        Columns are track, frame, z, y, x. Positions are in micrometres, or in voxels if the unit is
        "voxel". To align an image layer, set its ``scale`` to the voxel size in micrometres and its
        ``translate`` to (z of plane 0, 0, 0).
        """
        scale = _MICRONS if self.unit == "m" else 1.0
        return np.column_stack([self.ids, self.frames, scale * self.positions])

    def to_csv(self, path: PathLike) -> None:
        """Write a table: track, frame, z_m, y_m, x_m (or z_voxel, ...), peak, snr."""
        positions = dict(zip(position_columns(self.unit), self.positions.T, strict=True))
        numbers = {"track": self.ids, "frame": self.frames}
        write_table(path, {**numbers, **positions, "peak": self.peaks, "snr": self.snr})

    @classmethod
    def from_csv(cls, path: PathLike) -> Tracks:
        """Read a table written by `to_csv`, with columns in any order."""
        names = ("track", "frame", "peak", "snr")
        positions, unit, table = read_positions(path, "tracks", lambda _: names)
        ids, frames = (whole_numbers(path, table[name], name) for name in ("track", "frame"))
        order = np.lexsort((frames, ids))
        twice = (np.diff(ids[order]) == 0) & (np.diff(frames[order]) == 0)
        if twice.any():
            at = order[np.flatnonzero(twice)[0]]
            raise FormatError(f"{path}: track {ids[at]} has frame {frames[at]} twice.")
        peaks, snr = table["peak"], table["snr"]
        return cls(ids[order], frames[order], positions[order], peaks[order], snr[order], unit)


def track_points(
    points: Iterable[Detections],
    *,
    step: float | Sequence[float],
    gaps: int = 0,
    motion: Motion = "random",
    shortest: int = 1,
    unit: Literal["m", "voxel"] = "voxel",
) -> Tracks:
    """Link the points of successive volumes to tracks.

    All points of a frame are assigned together by minimizing the sum of squared steps, with a
    missing link counted as a largest step (Crocker and Grier 1996, J. Colloid Interface Sci. 179,
    298). Unlinked points begin new tracks; a track ends after more than ``gaps`` missed frames.

    Parameters
    ----------
    points : iterable of Points or Regions
        Detections of each volume in temporal order, in units of their axes. Use a generator to keep
        only a volume at a time in memory.
    step : float or sequence of float
        Largest step between successive frames in units of the positions: a number, or the half axes
        (z, y, x) of an ellipsoid. After k missed frames it is sqrt(k + 1) times larger, because the
        distance of random motion grows as the square root of time.
    gaps : int
        Maximum number of successive frames that a track may miss.
    motion : {"random", "straight"}
        Model of the expected position: the last position, or an extrapolation by the mean of the
        last three steps, for flows and crossing points. A new track is extrapolated by the median
        of the other tracks.
    shortest : int
        Minimum number of points of a track; shorter tracks are removed before numbering.
    unit : {"m", "voxel"}
        Unit of the positions; "m" if `find_points` had axes in metres.

    Returns
    -------
    Tracks
        Tracks, numbered from 0.

    Raises
    ------
    TypeError
        If an element of ``points`` has no positions.
    ValueError
        If a number is out of range, a position is not finite, there are fewer than two volumes, or
        the step is so large that thousands of points could be exchanged.

    Examples
    --------
    >>> z, y, x = np.indices((9, 24, 24))
    >>> side = 0.5e-6 * np.arange(24)
    >>> axes = (2e-6 * np.arange(9), side, side)  # metres
    >>> def volumes():
    ...     for t in range(4):
    ...         yield np.exp(-((z - 4) ** 2 + (y - 8 - t) ** 2 + (x - 12) ** 2) / 3)
    >>> points = (clplen.microscopy.find_points(volume, axes=axes) for volume in volumes())
    >>> tracks = clplen.microscopy.track_points(points, step=1e-6, unit="m")
    >>> np.round(tracks.positions[:, 1] * 1e6, 2).tolist()
    [4.0, 4.5, 5.0, 5.5]
    """
    half_axes = _checked(step, gaps, motion, shortest)
    check_unit(unit)
    linker = _Linker(half_axes, gaps, motion)
    rows, frame = [], -1
    for frame, detections in enumerate(points):
        positions = _positions(detections, frame)
        ids = linker.add(positions / half_axes)
        rows.append((ids, np.full(len(ids), frame), positions, detections.peaks, detections.snr))
    if frame < 1:
        raise ValueError(
            f"Tracks need at least 2 volumes, got {frame + 1}: give the points of a series."
        )
    ids, frames, positions, peaks, snr = (np.concatenate(part) for part in zip(*rows, strict=True))
    counts = np.bincount(ids, minlength=1)
    order = np.flatnonzero(counts[ids] >= shortest)
    order = order[np.lexsort((frames[order], ids[order]))]
    numbers = np.unique(ids[order], return_inverse=True)[1].astype(np.int64).reshape(-1)
    return Tracks(
        numbers,
        frames[order].astype(np.int64),
        positions[order],
        peaks[order].astype(np.float64),
        snr[order].astype(np.float64),
        unit,
    )


def _checked(step: Any, gaps: int, motion: str, shortest: int) -> Vector:
    """Check the options; return the half axes (z, y, x) of the largest step."""
    half_axes = float64_array(step)
    if half_axes.shape not in ((), (3,)) or not (np.isfinite(half_axes) & (half_axes > 0)).all():
        raise ValueError(f"step must be a positive number or three (z, y, x), got {step!r}.")
    if not (is_integer(gaps) and gaps >= 0):
        raise ValueError(f"gaps must be an integer from 0 on, got {gaps!r}.")
    if motion not in ("random", "straight"):
        raise ValueError(f'motion must be "random" or "straight", got {motion!r}.')
    if not (is_integer(shortest) and shortest >= 1):
        raise ValueError(f"shortest must be an integer from 1 on, got {shortest!r}.")
    return np.broadcast_to(half_axes, (3,))


def _positions(detections: Any, frame: int) -> Vector:
    """Return the positions of the detections in a volume, shape (n, 3); require finite values."""
    if not hasattr(detections, "positions"):
        raise TypeError(
            f"points must contain results of find_points or find_regions, got "
            f"{type(detections).__name__} in frame {frame}."
        )
    positions = np.asarray(detections.positions, np.float64).reshape(-1, 3)
    if not np.isfinite(positions).all():
        raise ValueError(f"A point of frame {frame} has a position that is not finite.")
    return positions


class _Linker:
    """Active tracks of the linking, in units of the largest step."""

    def __init__(self, half_axes: Vector, gaps: int, motion: str) -> None:
        self.gaps = gaps
        self.is_straight = motion == "straight"
        self.count = 0
        self.ids = np.empty(0, np.int64)
        self.last = np.empty((0, 3))
        self.missed = np.empty(0, np.int64)
        self.steps = np.empty((0, _VELOCITY_STEPS, 3))  # the newest first; NaN before the track

    def add(self, positions: Vector) -> Vector:
        """Link the positions of a frame; return the track of each position."""
        elapsed = self.missed + 1
        expected = self.last + elapsed[:, None] * self._velocity()
        pairs = link(expected, np.sqrt(elapsed), positions)
        ids = np.full(len(positions), -1, np.int64)
        ids[pairs[:, 1]] = self.ids[pairs[:, 0]]
        steps = np.full((len(positions), _VELOCITY_STEPS, 3), np.nan)
        displacements = positions[pairs[:, 1]] - self.last[pairs[:, 0]]
        steps[pairs[:, 1], 0] = displacements / elapsed[pairs[:, 0], None]
        steps[pairs[:, 1], 1:] = self.steps[pairs[:, 0], :-1]
        new = ids < 0
        ids[new] = self.count + np.arange(np.count_nonzero(new))
        self.count += int(np.count_nonzero(new))
        waiting = np.ones(len(self.ids), bool)
        waiting[pairs[:, 0]] = False
        waiting &= elapsed <= self.gaps
        self.ids = np.concatenate([ids, self.ids[waiting]])
        self.last = np.concatenate([positions, self.last[waiting]])
        self.missed = np.concatenate([np.zeros(len(positions), np.int64), elapsed[waiting]])
        self.steps = np.concatenate([steps, self.steps[waiting]])
        return ids

    def _velocity(self) -> Vector:
        """Return the velocity of each track per frame; new tracks get the median of the others."""
        if not (self.is_straight and len(self.ids)):
            return np.zeros_like(self.last)
        has_steps = np.isfinite(self.steps[:, 0, 0])
        velocity = np.zeros_like(self.last)
        if has_steps.any():
            velocity[has_steps] = np.nanmean(self.steps[has_steps], axis=1)
            velocity[~has_steps] = np.median(velocity[has_steps], axis=0)
        return velocity
