"""Figures of raw images, views, renderings and focal stacks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import ArrayLike

from clplen.checks import check_finite, is_array, real_array
from clplen.compute.arrays import Image
from clplen.errors import ShapeError
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.phase_space import PhaseSpace, phase_space
from clplen.lightfield.model.stored_light_field import as_lightfield
from clplen.lightfield.raw.raw_image import RawImage
from clplen.lightfield.refocusing.focal_stacks import FocalStack
from clplen.plot.base import (
    FULL_REGION,
    Array,
    Region,
    Scale,
    Shades,
    centred,
    draw,
    new_figure,
    placed,
    spread,
    styled,
)
from clplen.wave.field.field import Field

_RAW_DECADES = 5
_MAX_PIXELS = 1000  # pixels of a raw image that a figure resolves
_MILLI = {"m": 1e3, "rad": 1e3}


@styled
def raw_image(raw: RawImage, *, details: Mapping[str, tuple[float, float]] | None = None) -> Figure:
    """Draw a raw lenslet image on a logarithmic scale, with magnified details.

    The scale spans five decades. Images of 2000 pixels or more along the longer side are binned.

    Parameters
    ----------
    raw : RawImage
        Raw image of one channel, shape (ny, nx), with a pixel pitch.
    details : mapping, optional
        Positions (y, x) in metres from the middle of the sensor, by name; each becomes a panel of 9
        x 9 lenslets with their borders.

    Returns
    -------
    matplotlib.figure.Figure
        Axes in mm on the sensor, 0 in its middle, row 0 at the top.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=0.1, mla=clplen.MicrolensArray(150e-6, 10e-3, count=9, fill="full"),
    ...     wavelength=532e-9, pixels_per_lenslet=10)
    >>> raw = camera.expose(clplen.PointSources([(0.0, 0.0, 0.0)]))
    >>> figure = clplen.plot.raw_image(raw, details={"point": (0.0, 0.0)})
    >>> [axes.get_title() for axes in figure.axes if axes.images]
    ['raw image', 'point: 9 x 9 lenslets']
    """
    details = details or {}
    values = raw.to_numpy()
    mm = raw.pixel_pitch * 1e3
    columns = 2 if details else 1
    figure = new_figure(6.2 * (1.36 if details else 1), 5.4)
    grid = figure.add_gridspec(max(len(details), 1), columns, width_ratios=[3, 1][:columns])
    axes = figure.add_subplot(grid[:, 0])
    coarse, step = _coarser(values)
    shades = Shades(values, "log", _RAW_DECADES)
    left, _, _, top = centred(values.shape, mm)
    extent = (left, left + coarse.shape[1] * step * mm, top + coarse.shape[0] * step * mm, top)
    options: Any = {"interpolation": "antialiased", "interpolation_stage": "data"}
    shades.show(axes, coarse, extent=extent, **options)
    axes.set(xlabel="x on the sensor / mm", ylabel="y on the sensor / mm", title="raw image")
    shades.bar(figure, "value of a pixel", ax=axes)
    check_finite(details=list(details.values()))
    for row, (name, (y, x)) in enumerate(details.items()):
        panel = figure.add_subplot(grid[row, 1])
        _detail(axes, panel, values, raw, (y * 1e3, x * 1e3), shades, name)
    return figure


def _coarser(values: Array) -> tuple[Array, int]:
    """Bin pixels to the resolution of a figure; return the means and the block size."""
    step = max(1, max(values.shape) // _MAX_PIXELS)
    ny, nx = (n // step for n in values.shape)
    blocks = values[: ny * step, : nx * step].reshape(ny, step, nx, step)
    return blocks.mean(axis=(1, 3)), step


def _detail(
    axes: Axes,
    panel: Axes,
    values: Array,
    raw: RawImage,
    centre: tuple[float, float],
    shades: Shades,
    name: str,
) -> None:
    """Draw a magnified part of the raw image; ``centre`` and axes are in millimetres."""
    mm = raw.pixel_pitch * 1e3
    half = 4.5 * raw.cells.column_step[1] * mm
    y, x = centre
    middles = [(n - 1) / 2 for n in values.shape]
    rows, columns = (
        slice(
            max(0, int((coordinate - half) / mm + middle)),
            int((coordinate + half) / mm + middle) + 2,
        )
        for coordinate, middle in zip(centre, middles, strict=True)
    )
    region = (rows, columns)
    left, right, bottom, top = placed(region, values.shape)
    extent = (
        (left - middles[1]) * mm,
        (right - middles[1]) * mm,
        (bottom - middles[0]) * mm,
        (top - middles[0]) * mm,
    )
    shades.show(panel, values[region], extent=extent)
    cells = raw.cells
    for axis, line in enumerate((panel.axhline, panel.axvline)):
        step = (cells.row_step, cells.column_step)[axis][axis]
        edges = cells.first[axis] + (np.arange(cells.count[axis] + 1) - 0.5) * step
        edges = (edges - middles[axis]) * mm
        for edge in edges[np.abs(edges - centre[axis]) < half]:
            line(edge, color="w", lw=0.3, alpha=0.4)
    panel.set(xlim=(x - half, x + half), ylim=(y + half, y - half), xticks=[], yticks=[])
    panel.set_title(f"{name}: 9 x 9 lenslets", fontsize=8)
    frame = Rectangle((x - half, y - half), 2 * half, 2 * half, fill=False, color="w", lw=0.8)
    axes.add_patch(frame)
    axes.annotate(
        name, (x + half, y - half), color="w", xytext=(2, 2), fontsize=8, textcoords="offset points"
    )


@styled
def views(
    lf: LightField | ArrayLike,
    *,
    max_views: int = 8,
    scale: Scale = "linear",
    region: Region | None = None,
) -> Figure:
    """Draw a mosaic of views in even steps, symmetric about the centre view.

    Parameters
    ----------
    lf : LightField or array_like
        Light field, shape (v, u, y, x) or (v, u, y, x, 3).
    max_views : int
        Maximum number of rows and columns of views.
    scale : {"linear", "log", "root"}
        Colour scale; colour pictures are always linear.
    region : tuple of slice, optional
        Part (y, x) of every view to show.

    Returns
    -------
    matplotlib.figure.Figure
        One mosaic whose ticks are the numbers of the views, u across and v down.

    Examples
    --------
    >>> values = np.random.default_rng(1).random((5, 5, 32, 32), np.float32)
    >>> lf = clplen.LightField.from_array(values)
    >>> figure = clplen.plot.views(lf, max_views=3)
    >>> figure.axes[0].get_title()
    'views: 3 x 3 of 5 x 5'
    """
    lf = as_lightfield(lf)
    vs, us = (spread(count, max_views) for count in lf.shape[:2])
    values = lf.to_numpy()[np.ix_(vs, us)][FULL_REGION + (region or FULL_REGION)]
    height, width = values.shape[2:4]
    figure = new_figure(7.4, max(2.5, 6.4 * len(vs) * height / (len(us) * width) + 0.4))
    axes = figure.add_subplot()
    mosaic = np.moveaxis(values, 1, 2).reshape(len(vs) * height, len(us) * width, *values.shape[4:])
    draw(figure, axes, mosaic, scale, "value of a sample" if values.ndim == 4 else "")
    for y in range(1, len(vs)):
        axes.axhline(y * height - 0.5, color="0.6", lw=0.5)
    for x in range(1, len(us)):
        axes.axvline(x * width - 0.5, color="0.6", lw=0.5)
    axes.set_xticks(np.arange(len(us)) * width + (width - 1) / 2, [str(u) for u in us])
    axes.set_yticks(np.arange(len(vs)) * height + (height - 1) / 2, [str(v) for v in vs])
    selection = f"{len(vs)} x {len(us)} of " if (len(vs), len(us)) != lf.shape[:2] else ""
    axes.set(
        xlabel="column u of the view",
        ylabel="row v of the view",
        title=f"views: {selection}{lf.shape[0]} x {lf.shape[1]}",
    )
    return figure


@styled
def picture(image: Image | ArrayLike, *, title: str = "", scale: Scale = "linear") -> Figure:
    """Draw one image: a view, a rendering, a refocus.

    Parameters
    ----------
    image : Image or array_like
        Picture, shape (y, x) or (y, x, 3).
    title : str
        Title over the picture; default none.
    scale : {"linear", "log", "root"}
        Colour scale; colour pictures are always linear.

    Returns
    -------
    matplotlib.figure.Figure
        Axes in pixels, row 0 at the top; a colour bar unless the image has colours.

    Raises
    ------
    TypeError
        If ``image`` is not a real picture; `intensity` and `phase` draw a field.
    ShapeError
        If the shape is another.

    Examples
    --------
    >>> lf = clplen.LightField.from_array(np.ones((3, 3, 16, 24), np.float32))
    >>> figure = clplen.plot.picture(lf.view(1, 1), title="centre view")
    >>> [axes.get_ylabel() for axes in figure.axes]
    ['y / pixel', 'value']
    """
    if isinstance(image, Field) or not is_array(image):
        hint = " (plot.intensity draws a field)" * isinstance(image, Field)
        raise TypeError(f"image must be an Image or an array, got {type(image).__name__}{hint}.")
    values = real_array(image, "A picture", None)
    if values.ndim not in (2, 3) or values.shape[2:] not in ((), (3,)):
        raise ShapeError(
            f"image must have shape (y, x) or (y, x, 3), got {values.shape}: choose one plane."
        )
    figure = new_figure(5.6, 5.0 * min(2.0, values.shape[0] / values.shape[1]) + 0.2)
    axes = figure.add_subplot()
    label = "value" if values.ndim == 2 else ""
    draw(figure, axes, values, scale, label)
    axes.set(xlabel="x / pixel", ylabel="y / pixel", title=title)
    return figure


@styled
def refocused(
    images: Sequence[Image | ArrayLike],
    titles: Sequence[str],
    *,
    scale: Scale = "linear",
    region: Region | None = None,
) -> Figure:
    """Draw several refocused images side by side, on a common colour scale.

    Parameters
    ----------
    images : sequence of Image or array_like
        Images of equal shape, (y, x) or (y, x, 3).
    titles : sequence of str
        Titles of the images.
    scale : {"linear", "log", "root"}
        Colour scale; colour pictures are always linear.
    region : tuple of slice, optional
        Part (y, x) to show.

    Returns
    -------
    matplotlib.figure.Figure
        A panel for each image, axes in pixels.

    Raises
    ------
    ValueError
        If the numbers of titles and images differ.

    Examples
    --------
    >>> values = np.random.default_rng(1).random((5, 5, 32, 32), np.float32)
    >>> lf = clplen.LightField.from_array(values)
    >>> images = [clplen.refocus(lf, disparity=d) for d in (-1.0, 1.0)]
    >>> figure = clplen.plot.refocused(images, ["far", "near"])
    >>> [axes.get_title() for axes in figure.axes[:2]]
    ['far', 'near']
    """
    region = region or FULL_REGION
    pictures = [real_array(image, "A picture", None) for image in images]
    values = [picture[region] for picture in pictures]
    ratio = values[0].shape[0] / values[0].shape[1]
    has_bar = values[0].ndim == 2  # narrows the panels to 2.6 inches
    height = max(2.6 * ratio + 0.8, 2.4) if has_bar else 3.2 * ratio + 0.5
    figure = new_figure(3.2 * len(values) + 0.8, height)
    panels = figure.subplots(1, len(values), squeeze=False)[0]
    shades = Shades(np.stack(values), scale)
    for panel, part, title in zip(panels, values, titles, strict=True):
        shades.show(panel, part, extent=placed(region, pictures[0].shape))
        panel.set(title=title, xlabel="x / pixel")
    panels[0].set_ylabel("y / pixel")
    if has_bar:  # as high as the panels, if its label fits
        shrink = min(max(2.6 * ratio / height, 0.7), 0.9)
        shades.bar(figure, "mean of the views", ax=list(panels), shrink=shrink)
    return figure


@styled
def montage(
    stack: FocalStack,
    *,
    max_planes: int = 15,
    scale: Scale = "linear",
    region: Region | None = None,
) -> Figure:
    """Draw planes of a focal stack in even steps, on a common colour scale.

    Parameters
    ----------
    stack : FocalStack
        Focal stack, such as `clplen.focal_stack` returns.
    max_planes : int
        Maximum number of planes.
    scale : {"linear", "log", "root"}
        Colour scale; colour pictures are always linear.
    region : tuple of slice, optional
        Part (y, x) to show.

    Returns
    -------
    matplotlib.figure.Figure
        A panel for each plane, at most five in a row, titled with its alpha or, without a camera,
        its disparity d in pixels a view step.

    Examples
    --------
    >>> values = np.random.default_rng(1).random((5, 5, 32, 32), np.float32)
    >>> lf = clplen.LightField.from_array(values)
    >>> stack = clplen.focal_stack(lf, disparities=[-1, 0, 1])
    >>> figure = clplen.plot.montage(stack)
    >>> [axes.get_title() for axes in figure.axes[:3]]
    ['d = -1.000', 'd = +0.000', 'd = +1.000']
    """
    planes = spread(len(stack.disparities), max_planes)
    values = stack.to_numpy()[planes][FULL_REGION[:1] + (region or FULL_REGION)]
    columns = min(5, len(planes))
    rows = -(-len(planes) // columns)
    figure = new_figure(8.0, rows * (1.37 * min(2.0, values.shape[1] / values.shape[2]) + 0.24))
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    shades = Shades(values, scale)
    for panel in panels:
        panel.set_axis_off()
    for panel, plane, part in zip(panels, planes, values, strict=False):
        shades.show(panel, part)
        alpha, d = stack.alphas[plane], stack.disparities[plane]
        title = rf"$\alpha$ = {alpha:.3f}" if np.isfinite(alpha) else f"d = {d:+.3f}"
        panel.set_title(title, fontsize=8)
    if values.ndim == 3:
        shades.bar(figure, "mean of the views", ax=list(panels))
    return figure


@styled
def epi(
    source: PhaseSpace | LightField | ArrayLike, *, title: str = "", scale: Scale = "linear"
) -> Figure:
    """Draw an epipolar slice or phase space: position across, position on the main lens down.

    With a camera, a second axis gives the angle theta = -u/F of the rays at the middle of the
    picture, in milliradians.

    Parameters
    ----------
    source : PhaseSpace, LightField or array_like
        Phase space, such as `clplen.lightfield.phase_space` returns; for a light field, the middle
        slice along x.
    title : str
        Title over the slice; default "epipolar slice" and its two axes.
    scale : {"linear", "log", "root"}
        Colour scale; colour slices are always linear.

    Returns
    -------
    matplotlib.figure.Figure
        Axes in mm, mrad, views or pixels, according to the units of the slice.

    Examples
    --------
    >>> values = np.random.default_rng(1).random((5, 5, 32, 32), np.float32)
    >>> lf = clplen.LightField.from_array(values)
    >>> figure = clplen.plot.epi(clplen.lightfield.phase_space(lf, y=16, v=2))
    >>> figure.axes[0].get_title(), figure.axes[0].get_ylabel()
    ('epipolar slice (x, u)', 'u from the middle / view')
    """
    if not isinstance(source, PhaseSpace):
        lf = as_lightfield(source)
        source = phase_space(lf, y=lf.shape[2] // 2, v=lf.shape[0] // 2)
    figure = new_figure(7.4, 3.2)
    axes = figure.add_subplot()
    down, across = (
        values * _MILLI.get(unit, 1.0)
        for values, unit in zip((source.direction, source.position), source.units, strict=True)
    )
    ends = (*_ends(across), *_ends(down)[::-1])
    label = "value of a sample" if source.values.ndim == 2 else ""
    options = {"extent": ends, "aspect": "auto", "interpolation": None}
    draw(figure, axes, source.values, scale, label, **options)
    views, pixels = source.axes
    labels = {"m": f"{views} on the main lens / mm", "view": f"{views} from the middle / view"}
    label_down = labels.get(source.units[0], rf"$\{views}$ / mrad")
    suffix = "on the image plane / mm" if source.units[1] == "m" else "from the middle / pixel"
    axes.set(
        xlabel=f"{pixels} {suffix}",
        ylabel=label_down,
        title=title or f"epipolar slice ({pixels}, {views.replace('_', ' ')})",
    )
    if source.theta is not None and source.units[0] == "m":
        ratio = _milliradians(source)
        other = axes.secondary_yaxis(
            "right",
            functions=(lambda u: np.asarray(u) * ratio, lambda theta: np.asarray(theta) / ratio),
        )
        other.set_ylabel(rf"$\theta = -{views}/F$ at {pixels} = 0 / mrad")
    return figure


def _ends(values: Array) -> tuple[float, float]:
    """Return the outer edges of the samples of an axis."""
    half = (values[1] - values[0]) / 2 if len(values) > 1 else 0.5
    return float(values[0] - half), float(values[-1] + half)


def _milliradians(source: PhaseSpace) -> float:
    """Return the angle per millimetre on the main lens in mrad, negative."""
    if source.theta is None or len(source.direction) < 2:
        return -1.0
    step = source.direction[1] - source.direction[0]
    return float((source.theta[1, 0] - source.theta[0, 0]) / step)
