"""Figures of fields over their grid: intensity and phase, with axes in metres."""

from __future__ import annotations

from collections.abc import Sequence
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
    spread,
    styled,
)
from clplen.wave.field.field import Field

_DECADES = 6
_MAX_PANELS, _COLUMNS = 15, 5  # panels of a batch in all and in a row
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
    """Draw abs(u)^2 of a field over the coordinates of its grid; a panel per item of a batch.

    Row 0 is at the top. A field with an axis of length 1 is drawn as a line over the other axis.
    Panels have a common scale; of more than 15 items, even steps are drawn.

    Parameters
    ----------
    field : Field
        Field, shape (..., ny, nx); leading axes are a batch.
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
    is_batch = values.ndim > 2
    figure, panels = _panels(part, values.shape[:-2], title)
    for index, axes in panels.items():
        if part.line is None:
            picture = for_display(values[index], norm)
            drawn = _draw_image(axes, part, picture, norm, LIGHT, "data")
        else:
            _draw_line(axes, part, values[index], label)
            if scale == "log":
                axes.set(yscale="log", ylim=(norm.vmin, 2 * (norm.vmax or 1.0)))
            elif is_batch:
                axes.set_ylim(0, 1.05 * (norm.vmax or 1.0))
            else:
                axes.set_ylim(bottom=0)
    if is_batch:
        _hide_inner_labels(list(panels.values()))
    if part.line is None:
        parents = list(panels.values()) if is_batch else axes
        bar(figure, drawn, parents, label, extend=clipped_sides(values, norm))
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
        Field, shape (ny, nx).
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
    if part.u.ndim != 2:
        first = ", ".join("0" * (part.u.ndim - 2))
        raise ShapeError(
            f"plot.phase needs a field of shape (ny, nx), got a batch of shape {field.shape}: "
            f"choose an item, such as field[{first}]."
        )
    figure, panels = _panels(part, (), title)
    axes = panels[()]
    size = np.abs(part.u)
    values = np.where(size > _MIN_AMPLITUDE * size.max(), np.angle(part.u), np.nan)
    label = "phase / rad"
    if part.line is None:
        drawn = _draw_image(axes, part, values, Normalize(-np.pi, np.pi), "twilight", "rgba")
        bar(figure, drawn, axes, label)
        drawn.colorbar.set_ticks(_TURN[0], labels=_TURN[1])
    else:
        _draw_line(axes, part, values, label)
        axes.set_ylim(-3.5, 3.5)
        axes.set_yticks(_TURN[0], labels=_TURN[1])
    return figure


@dataclass(frozen=True)
class _Part:
    """Displayed samples (..., y, x), with coordinates and pitches (y, x) in one unit."""

    u: Array
    positions: tuple[Array, Array]
    pitch: tuple[float, float]
    unit: str

    @property
    def line(self) -> int | None:
        """Axis that varies, if the other axis has length 1."""
        ny, nx = self.u.shape[-2:]
        return None if min(ny, nx) > 1 else int(nx > 1)

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Left, right, bottom and top edges of the samples."""
        (top, bottom), (left, right) = (
            (at[0] - step / 2, at[-1] + step / 2)
            for at, step in zip(self.positions, self.pitch, strict=True)
        )
        return (left, right, bottom, top)

    @property
    def ratio(self) -> float:
        """Height of a panel over its width, between 0.25 and 2."""
        left, right, bottom, top = self.extent
        return min(2.0, max(0.25, (bottom - top) / (right - left)))


def _part_of(field: Field, region: Region | None, function: str) -> _Part:
    """Return the displayed part of a field or of a batch; raise for another type."""
    if not isinstance(field, Field):
        raise TypeError(f"plot.{function} needs a Field, got {type(field).__name__}.")
    rows, columns = _checked(region, field.shape[-2:])
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
    u = field.to_numpy()[..., rows, columns]
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


def _panels(
    part: _Part, batch: tuple[int, ...], title: str
) -> tuple[Figure, dict[tuple[int, ...], Axes]]:
    """Create a figure with axes by index of the batch; a single field has the index ()."""
    if not batch:
        figure = new_figure(5.6, 4.4 * part.ratio + 0.8 if part.line is None else 3.2)
        axes = figure.add_subplot()
        axes.set_title(title)
        return figure, {(): axes}
    indices = list(np.ndindex(batch))
    chosen = [indices[k] for k in spread(len(indices), _MAX_PANELS)]
    count = len(chosen)
    columns = batch[-1] if count == len(indices) and 1 < batch[-1] <= _COLUMNS < count else 0
    columns = columns or -(-count // -(-count // _COLUMNS))  # rows of nearly equal length
    rows = -(-count // columns)
    height = 2.2 * part.ratio + 0.3 if part.line is None else 2.0
    figure = new_figure(2.4 * columns + 1.0, height * rows + 0.6)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for panel in panels[count:]:
        panel.set_axis_off()
    for panel, index in zip(panels, chosen, strict=False):
        panel.set_title(f"item {', '.join(map(str, index))}")
    if title:
        figure.suptitle(title)
    return figure, dict(zip(chosen, panels, strict=False))


def _hide_inner_labels(panels: Sequence[Axes]) -> None:
    """Keep labels of y in the first column, and of x in panels with no panel below."""
    for k, axes in enumerate(panels):
        columns = axes.get_subplotspec().get_gridspec().ncols  # type: ignore[union-attr]
        if k % columns:
            axes.set_ylabel("")
            axes.tick_params(labelleft=False)
        if k + columns < len(panels):
            axes.set_xlabel("")
            axes.tick_params(labelbottom=False)


def _draw_image(
    axes: Axes,
    part: _Part,
    values: Array,
    norm: Normalize,
    colours: str,
    stage: Literal["data", "rgba"],
) -> Any:
    """Draw an image in true proportions, row 0 at the top; interpolate values or colours."""
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
    return drawn


def _draw_line(axes: Axes, part: _Part, values: Array, label: str) -> None:
    """Draw a line over the axis that varies; a single sample is a dot."""
    along = part.line or 0
    marker = "o" if values.size == 1 else ""
    axes.plot(part.positions[along], values.ravel(), color="#0072b2", lw=1.2, marker=marker)
    axes.set(xlabel=f"{'yx'[along]} / {part.unit}", ylabel=label)
    axes.ticklabel_format(axis="x", useOffset=False)
