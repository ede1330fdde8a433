"""Figures of fields over their grid: intensity and phase, with axes in metres."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from clplen.errors import ShapeError
from clplen.plot.base import (
    FULL_REGION,
    LIGHT,
    Array,
    Region,
    bar,
    clipped_sides,
    for_display,
    new_figure,
    norm_of,
    scale_suffix,
    styled,
)
from clplen.wave.field.field import Field

_DECADES = 6
_MIN_AMPLITUDE = 1e-6  # of the largest amplitude; below, the phase is rounding noise
_TURN = (-np.pi, 0.0, np.pi), (r"$-\pi$", "0", r"$\pi$")
# Smallest length in metres, units per metre, name.
_UNITS = ((1.0, 1.0, "m"), (1e-3, 1e3, "mm"), (0.0, 1e6, "µm"))


@styled
def intensity(
    field: Field,
    *,
    scale: Literal["linear", "log"] = "linear",
    title: str = "",
    region: Region | None = None,
) -> Figure:
    """Draw abs(u)^2 of one field, over the coordinates of its grid.

    Row 0 is at the top. A field with an axis of length 1 is drawn as a line over the other axis.

    Parameters
    ----------
    field : Field
        Shape (ny, nx), no batch.
    scale : {"linear", "log"}
        Colour scale; "log" spans six decades.
    title : str
        Title over the picture; default none.
    region : tuple of slice, optional
        Part (y, x) of the samples to show; one row or one column is a cut.

    Returns
    -------
    matplotlib.figure.Figure
        Axes in um, mm or m, by the farthest edge from 0; colour bar "intensity".

    Raises
    ------
    TypeError
        If ``field`` is not a `Field` or ``region`` is not a pair of slices.
    ShapeError
        If the field is a batch.
    ValueError
        If the scale is unknown, or the region has no samples or has steps.

    Examples
    --------
    >>> grid = clplen.Grid((32, 32), 2e-6)
    >>> beam = clplen.wave.gaussian_beam(grid, 20e-6, wavelength=532e-9)
    >>> figure = clplen.plot.intensity(beam, scale="log")
    >>> [axes.get_ylabel() for axes in figure.axes]
    ['y / µm', 'intensity (logarithmic)']
    """
    if scale not in ("linear", "log"):
        raise ValueError(f'scale must be "linear" or "log", got {scale!r}.')
    part = _part_of(field, region, "intensity")
    values = np.abs(part.u) ** 2
    norm = norm_of(values, scale, _DECADES)
    label = f"intensity{scale_suffix(scale)}"
    if part.line is None:
        figure, axes, drawn = _image(part, for_display(values, norm), norm, LIGHT, "data")
        bar(figure, drawn, axes, label, extend=clipped_sides(values, norm))
    else:
        figure, axes = _line(part, values, label)
        if scale == "log":
            axes.set(yscale="log", ylim=(norm.vmin, 2 * (norm.vmax or 1.0)))
        else:
            axes.set_ylim(bottom=0)
    axes.set_title(title)
    return figure


@styled
def phase(field: Field, *, title: str = "", region: Region | None = None) -> Figure:
    """Draw the phase of one field between -pi and pi, over the coordinates of its grid.

    The carrier exp(ikz) is not included. Samples with an amplitude below 1e-6 of the largest
    displayed amplitude are blank. Row 0 is at the top. A field with an axis of length 1 is drawn as
    a line.

    Parameters
    ----------
    field : Field
        Shape (ny, nx), no batch.
    title : str
        Title over the picture; default none.
    region : tuple of slice, optional
        Part (y, x) of the samples to show; one row or one column is a cut.

    Returns
    -------
    matplotlib.figure.Figure
        Axes in um, mm or m, by the farthest edge from 0; cyclic colours, whose bar is
        in rad.

    Raises
    ------
    TypeError
        If ``field`` is not a `Field` or ``region`` is not a pair of slices.
    ShapeError
        If the field is a batch.
    ValueError
        If the region has no samples or has steps.

    Examples
    --------
    >>> grid = clplen.Grid((32, 32), 2e-6)
    >>> beam = clplen.wave.gaussian_beam(grid, 20e-6, wavelength=532e-9)
    >>> figure = clplen.plot.phase(clplen.propagate(beam, 1e-3))
    >>> [axes.get_ylabel() for axes in figure.axes]
    ['y / µm', 'phase / rad']
    """
    part = _part_of(field, region, "phase")
    size = np.abs(part.u)
    values = np.where(size > _MIN_AMPLITUDE * size.max(), np.angle(part.u), np.nan)
    label = "phase / rad"
    if part.line is None:
        figure, axes, drawn = _image(part, values, Normalize(-np.pi, np.pi), "twilight", "rgba")
        bar(figure, drawn, axes, label)
        drawn.colorbar.set_ticks(_TURN[0], labels=_TURN[1])
    else:
        figure, axes = _line(part, values, label)
        axes.set_ylim(-3.5, 3.5)
        axes.set_yticks(_TURN[0], labels=_TURN[1])
    axes.set_title(title)
    return figure


@dataclass(frozen=True)
class _Part:
    """Displayed samples, with coordinates and pitches (y, x) in one unit."""

    u: Array
    positions: tuple[Array, Array]
    pitch: tuple[float, float]
    unit: str

    @property
    def line(self) -> int | None:
        """Axis that varies, if the other axis has length 1."""
        return None if min(self.u.shape) > 1 else int(self.u.shape[1] > 1)

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Left, right, bottom and top edges of the samples."""
        (top, bottom), (left, right) = (
            (at[0] - step / 2, at[-1] + step / 2)
            for at, step in zip(self.positions, self.pitch, strict=True)
        )
        return (left, right, bottom, top)


def _part_of(field: Field, region: Region | None, what: str) -> _Part:
    """Return the displayed part of a field; raise for a batch or another type."""
    if not isinstance(field, Field):
        raise TypeError(f"plot.{what} needs a Field, got {type(field).__name__}.")
    if len(field.shape) != 2:
        first = ", ".join("0" * (len(field.shape) - 2))
        raise ShapeError(
            f"plot.{what} draws one field of shape (ny, nx), not a batch of shape {field.shape}: "
            f"choose one, such as field.with_data(field.data[{first}].copy())."
        )
    rows, columns = _checked(region, field.shape)
    y, x = field.grid.y[rows], field.grid.x[columns]
    edges = [
        float(np.abs(at).max()) + step / 2
        for at, step in zip((y, x), field.grid.pitch, strict=True)
        if at.size > 1
    ]
    reach = max(edges, default=0.0)
    factor, unit = next(
        (factor, unit) for min_length, factor, unit in _UNITS if reach >= min_length
    )
    dy, dx = field.grid.pitch
    u = field.to_numpy()[rows, columns]
    return _Part(u, (y * factor, x * factor), (dy * factor, dx * factor), unit)


def _checked(region: Region | None, shape: tuple[int, ...]) -> Region:
    """Return the region; raise if it has no samples of an array of this shape."""
    if region is None:
        return FULL_REGION
    if not isinstance(region, tuple) or [type(part) for part in region] != [slice, slice]:
        raise TypeError(f"region must be a tuple of two slices of samples (y, x), got {region!r}.")
    indices = [range(*part.indices(n)) for part, n in zip(region, shape, strict=True)]
    if not all(indices) or any(part.step not in (None, 1) for part in region):
        raise ValueError(
            f"region must select samples of a field of {shape} by slices without steps, got "
            f"{region!r}."
        )
    return region


def _image(
    part: _Part, values: Array, norm: Normalize, colours: str, stage: Literal["data", "rgba"]
) -> tuple[Figure, Axes, Any]:
    """Draw an image in true proportions, row 0 at the top; interpolate values or colours."""
    left, right, bottom, top = part.extent
    ratio = min(2.0, max(0.25, (bottom - top) / (right - left)))
    figure = new_figure(5.6, 4.4 * ratio + 0.8)
    axes = figure.add_subplot()
    drawn = axes.imshow(
        values,
        cmap=colours,
        norm=norm,
        extent=part.extent,
        interpolation="antialiased",
        interpolation_stage=stage,
    )
    axes.set(xlabel=f"x / {part.unit}", ylabel=f"y / {part.unit}")
    axes.ticklabel_format(useOffset=False)
    return figure, axes, drawn


def _line(part: _Part, values: Array, label: str) -> tuple[Figure, Axes]:
    """Draw a line over the axis that varies; a single sample is a dot."""
    figure = new_figure(5.6, 3.2)
    axes = figure.add_subplot()
    along = part.line or 0
    marker = "o" if values.size == 1 else ""
    axes.plot(part.positions[along], values.ravel(), color="#0072b2", lw=1.2, marker=marker)
    axes.set(xlabel=f"{'yx'[along]} / {part.unit}", ylabel=label)
    axes.ticklabel_format(axis="x", useOffset=False)
    return figure, axes
