"""Maximum projections and orthogonal slices of volumes, with scale bars."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from clplen.checks import is_finite, is_integer, real_array
from clplen.errors import ShapeError
from clplen.microscopy.objects.tracks import Tracks
from clplen.plot.base import Array, Scale, Shades, new_figure, styled
from clplen.plot.scale_bars import scale_bar

Voxel = tuple[float, float, float]

_MICRONS = 1e6
_WIDTH = 6.4  # inches of the pictures
_GAP = 0.03  # distance between pictures, over their width
_MAX_HEIGHT = 9.0  # inches
_COLUMNS = 5  # columns of a montage
_FOR_BAR, _FOR_TITLE = 1.1, 0.5  # inches
_TRACK = "#56b4e9"
_AXES = {"z": 0, "y": 1, "x": 2}


@styled
def orthogonal_views(
    volume: Any,
    *,
    voxel: Voxel,
    at: tuple[int, int, int] | None = None,
    scale: Scale = "linear",
    limits: tuple[float, float] | None = None,
    tracks: Tracks | None = None,
    frame: int | None = None,
    origin: float = 0.0,
    title: str = "",
) -> Figure:
    """Draw a volume from three sides: along z, and along x and y beside and below it.

    All three pictures have equal length scales, so that a cube looks cubic, and a common colour
    scale. Each has a scale bar of a round length.

    Parameters
    ----------
    volume : array_like
        Real volume, shape (planes, y, x).
    voxel : tuple of float
        Sides (dz, dy, dx) of a voxel in metres, positive.
    at : tuple of int, optional
        Indices (plane, row, column) of slices, marked by lines; default maximum projections.
    scale : {"linear", "log", "root"}
        Colour scale.
    limits : tuple of float, optional
        Values at both ends of the colours; default the range of the volume.
    tracks : Tracks, optional
        Tracks to draw over projections, in metres or voxels according to their unit.
    frame : int, optional
        Last frame of the tracks, with a circle at its positions; default all frames.
    origin : float
        Position z of plane 0 in metres, for tracks in metres.
    title : str
        Title over the picture along z; default a description.

    Returns
    -------
    matplotlib.figure.Figure
        Three pictures and a colour bar.

    Raises
    ------
    ShapeError
        If the volume does not have three axes, or is empty.
    ValueError
        If a voxel is not positive, a slice is outside the volume, a scale is unknown, or no sample
        is finite.

    Examples
    --------
    >>> volume = np.random.default_rng(1).random((5, 16, 24), np.float32)
    >>> figure = clplen.plot.orthogonal_views(volume, voxel=(2e-6, 0.5e-6, 0.5e-6))
    >>> [text.get_text() for axes in figure.axes[:3] for text in axes.texts]
    ['2 µm', 'x, y', '2 µm', 'z, y', '2 µm', 'x, z']
    """
    values, sides = _checked(volume, voxel)
    indices = None if at is None else _slices(at, values.shape)
    parts = _projections(values) if indices is None else _sections(values, indices)
    deep, high, wide = (n * side for n, side in zip(values.shape, sides, strict=True))
    figure, panels, bar_axes = _three_panels(deep, high, wide)
    shades = _shades(parts, scale, limits)
    extents = ((0, wide, high, 0), (0, deep, high, 0), (0, wide, deep, 0))
    for panel, part, extent in zip(panels, (parts[0], parts[2].T, parts[1]), extents, strict=True):
        shades.show(panel, part, extent=extent)
        panel.set_axis_off()
        if indices is None and tracks is not None:
            axes = {panels[0]: "yx", panels[1]: "yz", panels[2]: "zx"}[panel]
            _draw_tracks(panel, tracks, axes, sides, origin, frame)
    if indices is not None:
        z, y, x = ((k + 0.5) * side for k, side in zip(indices, sides, strict=True))
        for panel, (down, right) in zip(panels, ((y, x), (y, z), (z, x)), strict=True):
            panel.axhline(down, color="white", lw=0.5, alpha=0.6)
            panel.axvline(right, color="white", lw=0.5, alpha=0.6)
    for panel, names in zip(panels, ("x, y", "z, y", "x, z"), strict=True):
        scale_bar(panel, 1 / _MICRONS)
        _name(panel, names)
    description = (
        "largest along z, y and x" if indices is None else f"slices at {_index_text(indices)}"
    )
    panels[0].set_title(title or description, loc="left")
    shades.bar(figure, "value of a voxel", cax=bar_axes)
    return figure


@styled
def maximum_projection(
    volumes: Any,
    *,
    voxel: Voxel,
    axis: Literal["z", "y", "x"] = "z",
    scale: Scale = "linear",
    max_frames: int = 15,
    title: str = "",
) -> Figure:
    """Draw maximum projections along an axis, of a volume or of a series of volumes.

    Parameters
    ----------
    volumes : array_like
        Real volume, shape (planes, y, x), or series, shape (t, planes, y, x).
    voxel : tuple of float
        Sides (dz, dy, dx) of a voxel in metres, positive.
    axis : {"z", "y", "x"}
        Axis of the projection.
    scale : {"linear", "log", "root"}
        Colour scale.
    max_frames : int
        Maximum number of frames of a series, in even steps.
    title : str
        Title over a single picture; frames of a series are numbered.

    Returns
    -------
    matplotlib.figure.Figure
        A picture per frame, at most five in a row, the first with a scale bar, and a colour bar.

    Raises
    ------
    ShapeError
        If the volumes do not have three or four axes, or are empty.
    ValueError
        If a voxel is not positive, an axis or a scale is unknown, or no sample is finite.

    Examples
    --------
    >>> series = np.random.default_rng(1).random((3, 5, 16, 24), np.float32)
    >>> figure = clplen.plot.maximum_projection(series, voxel=(2e-6, 0.5e-6, 0.5e-6))
    >>> [axes.get_title() for axes in figure.axes[:3]]
    ['frame 0', 'frame 1', 'frame 2']
    """
    if axis not in _AXES:
        raise ValueError(f'axis must be "z", "y" or "x", got {axis!r}.')
    if not (is_integer(max_frames) and max_frames >= 1):
        raise ValueError(f"max_frames must be an integer of at least 1, got {max_frames!r}.")
    values = real_array(volumes, "A volume")
    series = values[None] if values.ndim == 3 else values
    if series.ndim != 4 or not series.size:
        raise ShapeError(
            f"volumes must have shape (planes, y, x) or (t, planes, y, x), got {values.shape}."
        )
    along = _AXES[axis]
    sides = np.delete(_checked(series[0], voxel)[1], along)
    times = np.unique(
        np.linspace(0, len(series) - 1, min(max_frames, len(series))).round().astype(int)
    )
    parts = [series[t].max(axis=along) for t in times]
    columns = min(_COLUMNS, len(parts))
    rows = -(-len(parts) // columns)
    high, wide = (n * side for n, side in zip(parts[0].shape, sides, strict=True))
    width = _WIDTH / max(columns, 2)
    tall = min(width * high / wide, _MAX_HEIGHT / rows)
    figure = new_figure(columns * tall * wide / high + 1.2, rows * (tall + 0.3) + 0.1)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    shades = _shades(parts, scale, None)
    for panel in panels:
        panel.set_axis_off()
    for panel, part, t in zip(panels, parts, times, strict=False):
        shades.show(panel, part, extent=(0, wide, high, 0))
        panel.set_title(title or f"largest along {axis}" if len(times) == 1 else f"frame {t}")
    scale_bar(panels[0], 1 / _MICRONS)
    shades.bar(figure, "value of a voxel", ax=list(panels))
    return figure


def _checked(volume: Any, voxel: Voxel) -> tuple[Array, Array]:
    """Return a volume and the sides of its voxels in micrometres."""
    values = real_array(volume, "A volume")
    if values.ndim != 3 or not values.size:
        raise ShapeError(f"volume must have shape (planes, y, x), got {values.shape}.")
    if np.shape(voxel) != (3,) or not all(is_finite(side) and side > 0 for side in voxel):
        raise ValueError(f"voxel must be (dz, dy, dx) in metres, positive, got {voxel!r}.")
    return values, np.asarray(voxel, np.float64) * _MICRONS


def _slices(at: tuple[int, int, int], shape: tuple[int, ...]) -> tuple[int, ...]:
    if np.shape(at) != (3,) or not all(
        is_integer(k) and 0 <= k < n for k, n in zip(at, shape, strict=True)
    ):
        raise ValueError(f"at must be (plane, row, column) within {shape}, got {at!r}.")
    return tuple(int(k) for k in at)


def _projections(values: Array) -> list[Array]:
    """Return the maximum projections along z, y and x."""
    return [values.max(axis=axis) for axis in range(3)]


def _sections(values: Array, at: tuple[int, ...]) -> list[Array]:
    """Return the slices across z, y and x."""
    return [np.take(values, k, axis=axis) for axis, k in enumerate(at)]


def _shades(parts: list[Array], scale: Scale, limits: tuple[float, float] | None) -> Shades:
    values = np.concatenate([part.ravel() for part in parts])
    if not np.isfinite(values).any():
        raise ValueError("The volume must have finite samples to draw, got none.")
    shades = Shades(values, scale)
    if limits is not None:
        shades.norm.vmin, shades.norm.vmax = limits
    return shades


def _three_panels(deep: float, high: float, wide: float) -> tuple[Figure, list[Axes], Axes]:
    """Create a figure with panels along z, x and y at equal scales, and axes for a colour bar.

    The panels have fixed positions, since a layout would stretch them.
    """
    gap = _GAP * max(deep + wide, deep + high)
    inch = min(_WIDTH / (wide + gap + deep), _MAX_HEIGHT / (high + gap + deep))
    width, height = ((side + gap + deep) * inch for side in (wide, high))
    total = (width + _FOR_BAR, height + _FOR_TITLE)
    figure = new_figure(*total)
    figure.set_layout_engine("none")

    def panel(x: float, y: float, across: float, down: float) -> Axes:
        """Add axes on a rectangle in inches."""
        box = (x / total[0], y / total[1], across / total[0], down / total[1])
        return figure.add_axes(box)

    lower, middle, upper = 0.1, 0.1 + wide * inch, 0.1 + deep * inch
    step = gap * inch
    panels = [
        panel(0.1, upper + step, wide * inch, high * inch),
        panel(middle + step, upper + step, deep * inch, high * inch),
        panel(0.1, lower, wide * inch, deep * inch),
    ]
    return figure, panels, panel(width + 0.2, upper + step, 0.12, high * inch)


def _name(panel: Axes, names: str) -> None:
    """Write the axes across and down into the upper left corner."""
    edge = [withStroke(linewidth=1.5, foreground="black")]
    panel.annotate(
        names, (0, 1), (4, -4), xycoords="axes fraction", textcoords="offset points", va="top",
        color="white", path_effects=edge,
    )  # fmt: skip


def _draw_tracks(
    panel: Axes, tracks: Tracks, axes: str, sides: Array, origin: float, frame: int | None
) -> None:
    """Draw tracks as projected along an axis, with circles at a frame's positions."""
    positions = tracks.positions * _MICRONS
    if tracks.unit == "voxel":
        positions = tracks.positions * sides
    else:
        positions = positions - (origin * _MICRONS, 0, 0)
    positions = positions + sides / 2  # the middle of voxel 0
    down, right = (positions[:, _AXES[axis]] for axis in axes)
    is_visible = np.ones(len(positions), bool) if frame is None else tracks.frames <= frame
    lines = [
        np.stack([right, down], axis=1)[is_visible & (tracks.ids == track)]
        for track in np.unique(tracks.ids)
    ]
    panel.add_collection(
        LineCollection([line for line in lines if len(line) > 1], colors=_TRACK, linewidths=0.9),
        autolim=False,
    )
    if frame is not None:
        is_current = tracks.frames == frame
        panel.plot(
            right[is_current],
            down[is_current],
            "o",
            mfc="none",
            mec=_TRACK,
            ms=5,
            scalex=False,
            scaley=False,
        )


def _index_text(at: tuple[int, ...]) -> str:
    return ", ".join(f"{axis} = {k}" for axis, k in zip("zyx", at, strict=True))
