"""Figures of one field over its grid: intensity and phase, along the axes in metres."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from clplen.errors import ShapeError
from clplen.plot.base import (
    LIGHT,
    WHOLE,
    Array,
    Region,
    bar,
    cut,
    for_display,
    new_figure,
    norm_of,
    said,
    styled,
)
from clplen.wave.field.field import Field

_DECADES = 6
_DARK = 1e-6  # of the largest amplitude; what is darker has only a rounded phase
_TURN = (-np.pi, 0.0, np.pi), (r"$-\pi$", "0", r"$\pi$")
_UNITS = ((1.0, 1.0, "m"), (1e-3, 1e3, "mm"), (0.0, 1e6, "µm"))  # from so many metres on; of them


@styled
def intensity(
    field: Field,
    *,
    scale: Literal["linear", "log"] = "linear",
    title: str = "",
    region: Region | None = None,
) -> Figure:
    """Draw abs(u)^2 of one field, over the coordinates of its grid.

    Row 0 is at the top. Along an axis of length 1 nothing varies: a line is drawn over the other.

    Parameters
    ----------
    field : Field
        Shape (ny, nx), no batch.
    scale : {"linear", "log"}
        Of the values; "log" shows six decades.
    title : str
        Over the picture; default none.
    region : tuple of slice, optional
        Part (y, x) of the samples to show; one row or one column is a cut.

    Returns
    -------
    matplotlib.figure.Figure
        Axes in um, mm or m, whichever suits the farthest edge from 0; colour bar "intensity".

    Raises
    ------
    TypeError
        If ``field`` is no `Field` or ``region`` no pair of slices.
    ShapeError
        If the field is a batch.
    ValueError
        For another scale, or a region without samples or with steps.

    Examples
    --------
    >>> grid = clplen.Grid((32, 32), 2e-6)
    >>> beam = clplen.wave.gaussian_beam(grid, 20e-6, wavelength=532e-9)
    >>> figure = clplen.plot.intensity(beam, scale="log")
    >>> [axes.get_ylabel() for axes in figure.axes]
    ['y / µm', 'intensity (logarithmic)']
    """
    if scale not in ("linear", "log"):
        raise ValueError(f'The scale of an intensity is "linear" or "log", not {scale!r}.')
    part = _part_of(field, region, "intensity")
    values = np.abs(part.u) ** 2
    norm = norm_of(values, scale, _DECADES)
    label = f"intensity{said(scale)}"
    if part.line is None:
        figure, axes, drawn = _image(part, for_display(values, norm), norm, LIGHT, "data")
        bar(figure, drawn, axes, label, extend=cut(values, norm))
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

    The carrier exp(ikz), which every propagation drops, is not part of it. Samples of an amplitude
    below 1e-6 of the largest one shown are left blank. Row 0 is at the top. Along an axis of
    length 1 nothing varies: a line is drawn over the other.

    Parameters
    ----------
    field : Field
        Shape (ny, nx), no batch.
    title : str
        Over the picture; default none.
    region : tuple of slice, optional
        Part (y, x) of the samples to show; one row or one column is a cut.

    Returns
    -------
    matplotlib.figure.Figure
        Axes in um, mm or m, whichever suits the farthest edge from 0; cyclic colours, whose bar is
        in rad.

    Raises
    ------
    TypeError
        If ``field`` is no `Field` or ``region`` no pair of slices.
    ShapeError
        If the field is a batch.
    ValueError
        For a region without samples or with steps.

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
    values = np.where(size > _DARK * size.max(), np.angle(part.u), np.nan)
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
    """Samples that are shown, and where: coordinates and pitches (y, x) in one unit."""

    u: Array
    places: tuple[Array, Array]
    pitch: tuple[float, float]
    unit: str

    @property
    def line(self) -> int | None:
        """The axis that varies, if the other one is of length 1."""
        return None if min(self.u.shape) > 1 else int(self.u.shape[1] > 1)

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Left, right, bottom and top edge of the samples."""
        (top, bottom), (left, right) = (
            (at[0] - step / 2, at[-1] + step / 2)
            for at, step in zip(self.places, self.pitch, strict=True)
        )
        return (left, right, bottom, top)


def _part_of(field: Field, region: Region | None, what: str) -> _Part:
    """What is shown of a field, or the reason why it cannot be."""
    if not isinstance(field, Field):
        raise TypeError(f"plot.{what} draws a Field, not {type(field).__name__}.")
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
    factor, unit = next((factor, unit) for least, factor, unit in _UNITS if reach >= least)
    dy, dx = field.grid.pitch
    u = field.to_numpy()[rows, columns]
    return _Part(u, (y * factor, x * factor), (dy * factor, dx * factor), unit)


def _checked(region: Region | None, shape: tuple[int, ...]) -> Region:
    """A region that holds samples of an array of that shape."""
    if region is None:
        return WHOLE
    if not isinstance(region, tuple) or [type(part) for part in region] != [slice, slice]:
        raise TypeError(f"A region is a tuple of two slices of samples (y, x), not {region!r}.")
    indices = [range(*part.indices(n)) for part, n in zip(region, shape, strict=True)]
    if not all(indices) or any(part.step not in (None, 1) for part in region):
        raise ValueError(
            f"The region {region!r} takes no block of samples from a field of {shape}: give slices "
            "without steps that lie in it."
        )
    return region


def _image(
    part: _Part, values: Array, norm: Normalize, colours: str, stage: Literal["data", "rgba"]
) -> tuple[Figure, Axes, Any]:
    """An image in the right proportions, row 0 at the top; values or colours are interpolated."""
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
    """A line over the axis that varies; a lone sample is a dot."""
    figure = new_figure(5.6, 3.2)
    axes = figure.add_subplot()
    along = part.line or 0
    marker = "o" if values.size == 1 else ""
    axes.plot(part.places[along], values.ravel(), color="#0072b2", lw=1.2, marker=marker)
    axes.set(xlabel=f"{'yx'[along]} / {part.unit}", ylabel=label)
    axes.ticklabel_format(axis="x", useOffset=False)
    return figure, axes
