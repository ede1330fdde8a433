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

_MICRONS = 1e6
_REMEMBERED = 3  # steps of which a velocity is the mean


class Found(Protocol):
    """What is tracked, of one volume: `Points` or `Regions`."""

    @property
    def positions(self) -> Vector: ...
    @property
    def peaks(self) -> Vector: ...
    @property
    def snr(self) -> Vector: ...


@dataclass(frozen=True, eq=False, repr=False)
class Tracks:
    """Where points were over time, sorted by track and frame.

    Attributes
    ----------
    ids : numpy.ndarray
        int64, shape (n,): number of the track from 0, in the order of their first frames.
    frames : numpy.ndarray
        int64, shape (n,): number of the volume from 0; each at most once a track.
    positions : numpy.ndarray
        float64, shape (n, 3): (z, y, x).
    peaks, snr : numpy.ndarray
        float64, shape (n,): of the points, as `Points` has them.
    unit : {"m", "voxel"}
        Of the positions.

    Raises
    ------
    ShapeError
        If the arrays do not fit each other.
    ValueError
        If the unit is another one.

    Examples
    --------
    >>> z, y, x = np.indices((9, 24, 24))
    >>> series = [np.exp(-((z - 4) ** 2 + (y - 8 - t) ** 2 + (x - 12.5) ** 2) / 3)
    ...           for t in range(3)]
    >>> tracks = clplen.microscopy.track_points(
    ...     [clplen.microscopy.find_points(volume) for volume in series], step=2)
    >>> tracks
    <Tracks: 1 of 3 points in 3 frames>
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
        shapes = [np.shape(one) for one in (self.ids, self.frames, self.peaks, self.snr)]
        if np.shape(self.positions) != (count, 3) or any(one != (count,) for one in shapes):
            raise ShapeError(
                f"Tracks of {count} points have positions of shape ({count}, 3) and a frame, a "
                f"peak and an snr each, not shapes {np.shape(self.positions)} and {shapes}."
            )
        check_unit(self.unit)

    def __len__(self) -> int:
        return len(np.unique(self.ids))

    def __repr__(self) -> str:
        last = int(self.frames.max()) + 1 if len(self.frames) else 0
        return f"<Tracks: {len(self)} of {len(self.ids)} points in {last} frames>"

    def napari(self) -> Vector:
        """Return the array that the layer Tracks of napari takes, float64, shape (n, 5).

        Columns are track, frame, z, y, x; positions in micrometres, or in voxels where the unit is
        "voxel". An image layer fits them with ``scale`` the size of a voxel in micrometres and
        ``translate`` (z of plane 0, 0, 0).
        """
        scale = _MICRONS if self.unit == "m" else 1.0
        return np.column_stack([self.ids, self.frames, scale * self.positions])

    def to_csv(self, path: PathLike) -> None:
        """Write a table: track, frame, z_m, y_m, x_m (or z_voxel, ...), peak, snr."""
        places = dict(zip(position_columns(self.unit), self.positions.T, strict=True))
        head = {"track": self.ids, "frame": self.frames}
        write_table(path, {**head, **places, "peak": self.peaks, "snr": self.snr})

    @classmethod
    def from_csv(cls, path: PathLike) -> Tracks:
        """Read a table that `to_csv` wrote, its columns in any order."""
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
    found: Iterable[Found],
    *,
    step: float | Sequence[float],
    gaps: int = 0,
    motion: Motion = "random",
    shortest: int = 1,
    unit: Literal["m", "voxel"] = "voxel",
) -> Tracks:
    """Link the points of successive volumes to tracks.

    The points of a frame are assigned to the tracks at once, so that the sum of the squares of all
    steps is least, where a link that is not made counts as a largest step (Crocker and Grier 1996,
    J. Colloid Interface Sci. 179, 298). Points that continue no track begin their own; a track
    ends where it misses more frames than ``gaps``.

    Parameters
    ----------
    found : iterable of Points or Regions
        Of each volume in turn, in units of their axes. A generator is taken, so that one volume at
        a time is in memory.
    step : float or sequence of float
        Largest step from frame to frame, in units of the positions: one number, or the half axes
        (z, y, x) of an ellipsoid. After k missed frames sqrt(k + 1) times that: the distance of
        random motion grows as the square root of time.
    gaps : int
        Frames that a track may miss.
    motion : {"random", "straight"}
        Where a point is expected: at its last place, or as far on as the mean of its last three
        steps leads, for flows and for points that cross. A new track is expected to move as the
        median of the others.
    shortest : int
        Points that a track has at least; shorter ones are left out, and tracks numbered anew.
    unit : {"m", "voxel"}
        Of the positions; "m" where axes in metres were given to `find_points`.

    Returns
    -------
    Tracks
        Numbered from 0 on.

    Raises
    ------
    TypeError
        If something in ``found`` has no positions.
    ValueError
        If a number is out of range, a position is not finite, there are fewer than two volumes, or
        the step is so long that thousands of points could be exchanged.

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
    for frame, each in enumerate(found):
        positions = _positions(each, frame)
        ids = linker.take(positions / half_axes)
        rows.append((ids, np.full(len(ids), frame), positions, each.peaks, each.snr))
    if frame < 1:
        raise ValueError(
            f"Tracks run over at least 2 volumes, not {frame + 1}: give those of a series."
        )
    ids, frames, positions, peaks, snr = (np.concatenate(part) for part in zip(*rows, strict=True))
    counts = np.bincount(ids, minlength=1)
    kept = np.flatnonzero(counts[ids] >= shortest)
    kept = kept[np.lexsort((frames[kept], ids[kept]))]
    numbers = np.unique(ids[kept], return_inverse=True)[1].astype(np.int64).reshape(-1)
    return Tracks(
        numbers,
        frames[kept].astype(np.int64),
        positions[kept],
        peaks[kept].astype(np.float64),
        snr[kept].astype(np.float64),
        unit,
    )


def _checked(step: Any, gaps: int, motion: str, shortest: int) -> Vector:
    """The half axes (z, y, x) of the largest step."""
    half_axes = float64_array(step)
    if half_axes.shape not in ((), (3,)) or not (np.isfinite(half_axes) & (half_axes > 0)).all():
        raise ValueError(f"A step is one positive number or three (z, y, x), not {step!r}.")
    if not (is_integer(gaps) and gaps >= 0):
        raise ValueError(f"gaps is a whole number of frames from 0 on, not {gaps!r}.")
    if motion not in ("random", "straight"):
        raise ValueError(f'A motion is "random" or "straight", not {motion!r}.')
    if not (is_integer(shortest) and shortest >= 1):
        raise ValueError(f"shortest is a whole number of points from 1 on, not {shortest!r}.")
    return np.broadcast_to(half_axes, (3,))


def _positions(found: Any, frame: int) -> Vector:
    """Of one volume, (n, 3), finite."""
    if not hasattr(found, "positions"):
        raise TypeError(
            f"Tracks link what find_points or find_regions gives of each volume, not a "
            f"{type(found).__name__} as in frame {frame}."
        )
    positions = np.asarray(found.positions, np.float64).reshape(-1, 3)
    if not np.isfinite(positions).all():
        raise ValueError(f"A point of frame {frame} has a position that is not finite.")
    return positions


class _Linker:
    """The tracks that may go on, in units of the largest step."""

    def __init__(self, half_axes: Vector, gaps: int, motion: str) -> None:
        self.gaps = gaps
        self.is_straight = motion == "straight"
        self.count = 0
        self.ids = np.empty(0, np.int64)
        self.last = np.empty((0, 3))
        self.missed = np.empty(0, np.int64)
        self.steps = np.empty((0, _REMEMBERED, 3))  # the newest first; NaN where there is none

    def take(self, found: Vector) -> Vector:
        """Add a frame; the track of each of its positions."""
        passed = self.missed + 1
        expected = self.last + passed[:, None] * self._velocity()
        pairs = link(expected, np.sqrt(passed), found)
        ids = np.full(len(found), -1, np.int64)
        ids[pairs[:, 1]] = self.ids[pairs[:, 0]]
        steps = np.full((len(found), _REMEMBERED, 3), np.nan)
        moved = found[pairs[:, 1]] - self.last[pairs[:, 0]]
        steps[pairs[:, 1], 0] = moved / passed[pairs[:, 0], None]
        steps[pairs[:, 1], 1:] = self.steps[pairs[:, 0], :-1]
        new = ids < 0
        ids[new] = self.count + np.arange(np.count_nonzero(new))
        self.count += int(np.count_nonzero(new))
        alone = np.ones(len(self.ids), bool)
        alone[pairs[:, 0]] = False
        alone &= passed <= self.gaps
        self.ids = np.concatenate([ids, self.ids[alone]])
        self.last = np.concatenate([found, self.last[alone]])
        self.missed = np.concatenate([np.zeros(len(found), np.int64), passed[alone]])
        self.steps = np.concatenate([steps, self.steps[alone]])
        return ids

    def _velocity(self) -> Vector:
        """Of each track a frame; that of a new one is the median of the others."""
        if not (self.is_straight and len(self.ids)):
            return np.zeros_like(self.last)
        known = np.isfinite(self.steps[:, 0, 0])
        velocity = np.zeros_like(self.last)
        if known.any():
            velocity[known] = np.nanmean(self.steps[known], axis=1)
            velocity[~known] = np.median(velocity[known], axis=0)
        return velocity
