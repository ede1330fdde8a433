"""Figures of raw images, views, focal stacks, phase space and depth (matplotlib, no display).

Every function returns a `matplotlib.figure.Figure`; `save` writes it. Values are shown linearly
unless the colour bar says otherwise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize, PowerNorm
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from clplen.io.files import PathLike, replacing

if TYPE_CHECKING:
    from clplen.compute.image import Image
    from clplen.lightfield.depth import DepthMap
    from clplen.lightfield.estimate import AlphaEstimate
    from clplen.lightfield.lightfield import LightField
    from clplen.lightfield.raw import CameraModel, RawImage
    from clplen.lightfield.refocus import FocalStack

Array = np.ndarray[Any, Any]
Scale = Literal["linear", "log", "root"]
Region = tuple[slice, slice]

LIGHT = "inferno"  # perceptually uniform: brightness follows the value
DEPTH = "viridis"
_COLOURS = ("#0072b2", "#009e73", "#e69f00", "#cc3311")  # told apart by the colour-blind too
_WHOLE = (slice(None), slice(None))
_RAW_DECADES = 5
_DECADES = 3
_styled = matplotlib.rc_context({
    "font.size": 9, "axes.titlesize": 9, "legend.fontsize": 8, "xtick.labelsize": 8, "ytick.labelsize": 8,
    "image.interpolation": "nearest",
})


def save(figure: Figure, path: PathLike, *, dpi: int = 150) -> None:
    """Write a figure as PNG, whole or not at all.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
    path : path-like
        ``.png``.
    dpi : int
        Dots an inch.
    """
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=dpi, format="png")


@_styled
def raw_image(
    raw: RawImage, *, details: Mapping[str, tuple[float, float]] | None = None
) -> Figure:
    """A raw lenslet image on a logarithmic scale, with magnified details beside it.

    Parameters
    ----------
    raw : RawImage
    details : mapping, optional
        From a name to (y, x) in metres from the middle of the sensor; each becomes a panel of
        9 x 9 lenslets.
    """
    details = details or {}
    values = raw.to_numpy()
    mm = raw.pixel_pitch * 1e3
    columns = 2 if details else 1
    figure = _figure(6.2 * (1.36 if details else 1), 5.4)
    grid = figure.add_gridspec(max(len(details), 1), columns, width_ratios=[3, 1][:columns])
    axes = figure.add_subplot(grid[:, 0])
    norm = LogNorm(values.max() * 10.0**-_RAW_DECADES, values.max())
    extent = _centred(values.shape, mm)
    drawn = axes.imshow(np.maximum(values, norm.vmin), cmap=LIGHT, norm=norm, extent=extent,
                        interpolation="antialiased", interpolation_stage="data")
    axes.set(xlabel="x on the sensor / mm", ylabel="y on the sensor / mm", title="raw image")
    _bar(figure, drawn, axes, "energy per pixel (logarithmic)", extend="min")
    for row, (name, (y, x)) in enumerate(details.items()):
        panel = figure.add_subplot(grid[row, 1])
        _detail(axes, panel, values, raw, (y * 1e3, x * 1e3), norm, name)
    return figure


def _detail(
    axes: Axes, panel: Axes, values: Array, raw: RawImage, centre: tuple[float, float],
    norm: Normalize, name: str,
) -> None:
    """A magnified part of the raw image, framed in both."""
    mm = raw.pixel_pitch * 1e3
    half = 4.5 * raw.cells.column_step[1] * mm
    y, x = centre
    panel.imshow(np.maximum(values, norm.vmin), cmap=LIGHT, norm=norm,
                 extent=_centred(values.shape, mm))
    panel.set(xlim=(x - half, x + half), ylim=(y + half, y - half), xticks=[], yticks=[])
    panel.set_title(f"{name}: 9 x 9 lenslets, with their borders", fontsize=8)
    cells = raw.cells
    for axis, draw in enumerate((panel.axhline, panel.axvline)):
        step = (cells.row_step, cells.column_step)[axis][axis]
        middle = (raw.shape[axis] - 1) / 2
        for edge in cells.first[axis] + (np.arange(cells.count[axis] + 1) - 0.5) * step - middle:
            draw(edge * mm, color="w", lw=0.3, alpha=0.4)
    frame = Rectangle((x - half, y - half), 2 * half, 2 * half, fill=False, color="w", lw=0.8)
    axes.add_patch(frame)
    axes.annotate(name, (x + half, y - half), color="w", xytext=(2, 2), fontsize=8,
                  textcoords="offset points")


@_styled
def views(
    lf: LightField, *, shown: int = 8, scale: Scale = "linear", region: Region | None = None
) -> Figure:
    """A mosaic of views, spread evenly over the aperture.

    Parameters
    ----------
    lf : LightField
    shown : int
        At most this many rows and columns of views.
    scale : {"linear", "log", "root"}
        Of the values; colour pictures are always linear.
    region : tuple of slice, optional
        Part (y, x) of every view to show.
    """
    vs, us = (_spread(count, shown) for count in lf.shape[:2])
    values = lf.to_numpy()[np.ix_(vs, us)][:, :, *(region or _WHOLE)]
    height, width = values.shape[2:4]
    figure = _figure(7.4, max(2.5, 6.4 * len(vs) * height / (len(us) * width) + 0.4))
    axes = figure.add_subplot()
    mosaic = np.moveaxis(values, 1, 2).reshape(len(vs) * height, len(us) * width, *values.shape[4:])
    _picture(figure, axes, mosaic, scale, "energy per sample" if values.ndim == 4 else "")
    for y in range(1, len(vs)):
        axes.axhline(y * height - 0.5, color="0.6", lw=0.5)
    for x in range(1, len(us)):
        axes.axvline(x * width - 0.5, color="0.6", lw=0.5)
    axes.set_xticks(np.arange(len(us)) * width + (width - 1) / 2, [str(u) for u in us])
    axes.set_yticks(np.arange(len(vs)) * height + (height - 1) / 2, [str(v) for v in vs])
    some = f"{len(vs)} x {len(us)} of " if (len(vs), len(us)) != lf.shape[:2] else ""
    axes.set(xlabel="column u of the view", ylabel="row v of the view",
             title=f"views: {some}{lf.shape[0]} x {lf.shape[1]}")
    return figure


@_styled
def picture(image: Image, *, title: str = "", scale: Scale = "linear") -> Figure:
    """One image: a view, a rendering, a refocus.

    Parameters
    ----------
    image : Image
        Shape (y, x) or (y, x, 3).
    title : str
    scale : {"linear", "log", "root"}
        Of the values; colour pictures are always linear.
    """
    values = image.to_numpy()
    figure = _figure(5.6, 5.0 * min(2.0, values.shape[0] / values.shape[1]) + 0.2)
    axes = figure.add_subplot()
    _picture(figure, axes, values, scale, "value" if values.ndim == 2 else "")
    axes.set(xlabel="x / pixel", ylabel="y / pixel", title=title)
    return figure


@_styled
def refocused(
    images: Sequence[Image],
    titles: Sequence[str],
    *,
    scale: Scale = "linear",
    region: Region | None = None,
) -> Figure:
    """Several refocused images side by side, on one scale of values.

    Parameters
    ----------
    images : sequence of Image
        All of one shape.
    titles : sequence of str
        One for each.
    scale : {"linear", "log", "root"}
    region : tuple of slice, optional
        Part (y, x) to show.
    """
    region = region or _WHOLE
    values = [image.to_numpy()[region] for image in images]
    ratio = values[0].shape[0] / values[0].shape[1]
    figure = _figure(3.2 * len(values) + 0.8, 3.2 * ratio + 0.5)
    panels = figure.subplots(1, len(values), squeeze=False)[0]
    norm = _norm(np.stack(values), scale)
    drawn = None
    for panel, shown, title in zip(panels, values, titles, strict=True):
        drawn = panel.imshow(_for_display(shown, norm), cmap=LIGHT, norm=norm,
                             extent=_place(region, images[0].shape))
        panel.set(title=title, xlabel="x / pixel")
    panels[0].set_ylabel("y / pixel")
    if values[0].ndim == 2:
        _bar(figure, drawn, list(panels), f"value{_said(scale)}")
    return figure


@_styled
def montage(
    stack: FocalStack, *, shown: int = 15, scale: Scale = "linear", region: Region | None = None
) -> Figure:
    """Planes of a focal stack, spread evenly over it, on one scale of values.

    Parameters
    ----------
    stack : FocalStack
    shown : int
        At most this many planes.
    scale : {"linear", "log", "root"}
    region : tuple of slice, optional
        Part (y, x) to show.
    """
    planes = _spread(len(stack.disparities), shown)
    values = stack.to_numpy()[planes][:, *(region or _WHOLE)]
    columns = min(5, len(planes))
    rows = -(-len(planes) // columns)
    figure = _figure(8.0, rows * (1.37 * min(2.0, values.shape[1] / values.shape[2]) + 0.24))
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    norm = _norm(values, scale)
    drawn = None
    for panel in panels:
        panel.set_axis_off()
    for panel, plane, shown_values in zip(panels, planes, values, strict=False):
        drawn = panel.imshow(_for_display(shown_values, norm), cmap=LIGHT, norm=norm)
        alpha, d = stack.alphas[plane], stack.disparities[plane]
        title = rf"$\alpha$ = {alpha:.3f}" if np.isfinite(alpha) else f"d = {d:+.3f}"
        panel.set_title(title, fontsize=8)
    if values.ndim == 3:
        _bar(figure, drawn, list(panels), f"value{_said(scale)}")
    return figure


@_styled
def energy_curves(
    groups: Mapping[str, Sequence[tuple[str, AlphaEstimate, float]]],
) -> Figure:
    """Spectral energy against alpha, a panel for each method.

    Parameters
    ----------
    groups : mapping
        From the name of a method to its (label, estimate, true alpha); each curve is divided by
        its maximum.
    """
    figure = _figure(3.7 * len(groups) + 0.4, 3.4)
    panels = figure.subplots(1, len(groups), squeeze=False, sharex=True, sharey=True)[0]
    for panel, (title, members) in zip(panels, groups.items(), strict=True):
        for colour, (label, estimate, truth) in zip(_COLOURS, members, strict=False):
            alphas, energy = (np.asarray(values) for values in estimate.curve)
            panel.plot(alphas, energy / energy.max(), color=colour, lw=1.4, label=label)
            panel.axvline(truth, color=colour, lw=0.9, ls=":")
            panel.plot(estimate.alpha, 1.03, "v", color=colour, ms=5, clip_on=False)
        panel.set(xlabel=r"$\alpha$", title=title)
    panels[0].set(ylabel="spectral energy / its maximum", ylim=(0, 1.08))
    figure.legend(*panels[0].get_legend_handles_labels(), title="dz", frameon=False,
                  loc="outside right center")
    figure.supxlabel(r"triangles: estimates; dotted lines: true $\alpha$", fontsize=8, color="0.3")
    return figure


@_styled
def alpha_curve(
    camera: CameraModel, estimates: Mapping[str, Sequence[tuple[float, float]]], *, reach: float
) -> Figure:
    """alpha(dz) of a camera with estimates on it, and their errors below.

    Parameters
    ----------
    camera : CameraModel
    estimates : mapping
        From the name of a method to its (dz in metres, estimated alpha).
    reach : float
        The curve is drawn for abs(dz) up to this, in metres.
    """
    figure = _figure(6.0, 5.4)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[2, 1])
    dz = np.linspace(-reach, reach, 401)
    upper.plot(dz * 1e3, camera.alpha(dz), color="0.25", lw=1.3, label="F/F' by the lens law")
    lower.axhline(0, color="0.25", lw=1.3)
    for colour, marker, (name, points) in zip(_COLOURS, "s^ox", estimates.items(), strict=False):
        at, found = (np.array(values) for values in zip(*points, strict=True))
        style = {"color": colour, "marker": marker, "ls": "", "ms": 6, "mfc": "none", "mew": 1.4}
        upper.plot(at * 1e3, found, label=name, **style)
        lower.plot(at * 1e3, found - camera.alpha(at), **style)
    upper.axhline(1, color="0.8", lw=0.7, zorder=0)
    upper.axvline(0, color="0.8", lw=0.7, zorder=0)
    upper.set(ylabel=r"$\alpha$ = F/F'", title="depth from focus")
    upper.legend(frameon=False)
    lower.set(xlabel="dz / mm (positive: farther from the lens)", ylabel=r"error of $\alpha$")
    return figure


@_styled
def phase_space(
    lf: LightField, *, rows: Sequence[int], labels: Sequence[str], truths: Sequence[float] = ()
) -> Figure:
    """Slices (x, u) of a light field in metres: position on the lenslets, place on the main lens.

    A point is a line of slope dx/du = 1 - alpha.

    Parameters
    ----------
    lf : LightField
        One channel, with spacing.
    rows : sequence of int
        Row y of each slice; each is summed over v and three rows about y.
    labels : sequence of str
        One for each row.
    truths : sequence of float
        alpha of the point in each row, drawn as a line through the slice's centre of light.
    """
    if lf.spacing is None or len(lf.shape) != 4:
        raise ValueError("A phase-space plot needs one channel and the spacing in metres.")
    values = lf.to_numpy()
    _, du, _, dx = lf.spacing
    u, x = _coordinates(lf.shape[1], du), _coordinates(lf.shape[3], dx)
    figure = _figure(3.3 * len(rows) + 0.8, 3.7)
    panels = figure.subplots(1, len(rows), squeeze=False)[0]
    drawn = None
    for index, (panel, y, label) in enumerate(zip(panels, rows, labels, strict=True)):
        part = np.maximum(values[:, :, max(y - 1, 0) : y + 2].sum(axis=(0, 2)), 0)
        extent = (x[0] - dx * 500, x[-1] + dx * 500, u[-1] + du * 500, u[0] - du * 500)
        middle = float((part**2).sum(axis=0) @ x / (part**2).sum())
        drawn = panel.imshow(part / part.max(), cmap=LIGHT, norm=PowerNorm(0.5, 0, 1),
                             extent=extent, aspect="auto")
        panel.set(xlim=(middle - 12e3 * dx, middle + 12e3 * dx), ylim=sorted(extent[2:]), title=label,
                  xlabel="x on the lenslets / mm")
        if truths:
            panel.plot(middle + (1 - truths[index]) * u, u, "--", color="w", lw=1)
    panels[0].set_ylabel("u on the main lens / mm")
    _bar(figure, drawn, list(panels), "energy / maximum of the slice (square root)")
    figure.supxlabel(r"dashed: dx/du = 1 - $\alpha$", fontsize=8, color="0.3")
    return figure


@_styled
def depth(found: DepthMap, *, title: str = "") -> Figure:
    """A disparity map and its confidence, with colour bars.

    Disparities outside the range of the surer half of the pixels are cut in the colours (the
    arrows of the bar say so), never in the data.

    Parameters
    ----------
    found : DepthMap
    title : str
    """
    sure = found.confidence >= np.median(found.confidence)
    low, high = np.nanpercentile(found.disparity[sure], [1, 99])
    height, width = found.disparity.shape
    figure = _figure(9.6, 4.0 * min(1.6, height / width) + 0.4)
    left, right = figure.subplots(1, 2)
    drawn = left.imshow(found.disparity, cmap=DEPTH, vmin=low, vmax=high)
    _bar(figure, drawn, left, "disparity / pixel per view step (nearer: larger)", extend="both")
    drawn = right.imshow(found.confidence, cmap="gray", vmin=0, vmax=1)
    _bar(figure, drawn, right, "confidence")
    left.set(title=title or "disparity", xlabel="x / pixel", ylabel="y / pixel")
    right.set(title="confidence", xlabel="x / pixel", yticks=[])
    return figure


def _figure(width: float, height: float) -> Figure:
    return Figure(figsize=(width, height), layout="constrained")


def _spread(count: int, shown: int) -> list[int]:
    """At most ``shown`` of ``count`` indices, first and last among them."""
    return sorted({round(i) for i in np.linspace(0, count - 1, min(count, shown))})


def _coordinates(count: int, step: float) -> Array:
    """Millimetres from the middle of an axis."""
    return (np.arange(count) - (count - 1) / 2) * step * 1e3


def _place(region: Region, shape: tuple[int, ...]) -> tuple[float, float, float, float]:
    """Extent of a part of an image in its own pixels."""
    y, x = (part.indices(n) for part, n in zip(region, shape, strict=False))
    return (x[0] - 0.5, x[1] - 0.5, y[1] - 0.5, y[0] - 0.5)


def _centred(shape: tuple[int, ...], step: float) -> tuple[float, float, float, float]:
    """Extent of an image about its middle, row 0 at the top."""
    y, x = shape[0] * step / 2, shape[1] * step / 2
    return (-x, x, y, -y)


def _norm(values: Array, scale: Scale) -> Normalize:
    highest = float(values.max()) or 1.0
    if scale == "log":
        return LogNorm(highest * 10.0**-_DECADES, highest)
    if scale == "root":
        return PowerNorm(0.5, 0, highest)
    return Normalize(min(0.0, float(values.min())), highest)


def _said(scale: Scale) -> str:
    return {"linear": "", "log": " (logarithmic)", "root": " (square root)"}[scale]


def _for_display(values: Array, norm: Normalize) -> Array:
    """Values that the colour scale can show; colours become 0 to 1, linearly."""
    if values.ndim == 3:
        return np.clip(values / norm.vmax, 0, 1)
    return np.clip(values, norm.vmin, None)


def _picture(figure: Figure, axes: Axes, values: Array, scale: Scale, label: str) -> None:
    norm = _norm(values, scale)
    drawn = axes.imshow(_for_display(values, norm), cmap=LIGHT, norm=norm,
                        interpolation="antialiased")
    if label:
        _bar(figure, drawn, axes, label + _said(scale))


def _bar(figure: Figure, drawn: Any, axes: Any, label: str, *, extend: str = "neither") -> None:
    figure.colorbar(drawn, ax=axes, label=label, extend=extend, shrink=0.9, pad=0.02)
