"""Figures of depth: focus curves, estimates, phase space, disparity maps."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.colors import Normalize, PowerNorm
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from clplen.cameras.scenes.ground_truth import Truth
from clplen.checks import check_finite, float64_array, real_array
from clplen.lightfield.depth.alpha_estimate import AlphaEstimate
from clplen.lightfield.depth.depth_maps import DepthMap, as_depth_map
from clplen.lightfield.focused.focused_depth import FocusedMaps
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.stored_light_field import as_lightfield
from clplen.lightfield.raw.raw_image import CameraModel
from clplen.plot.base import LIGHT, Array, bar, clipped_sides, coordinates, new_figure, styled

_DISPARITY = "disparity / pixel per view step (nearer: larger)"
_MIN_CONFIDENCE = 1e-3  # smaller confidences are rounding errors
_MIN_PIXELS = 800  # drawn along the longer side; more would only take memory
_OPAQUE = 0.5  # confidence from which a pixel is opaque, as in `clplen depth`
_MIN_OPACITY = 0.35  # opacity at confidence 0
_GREY = "0.7"
_MARGIN = 0.1  # inches around a panel
_LINE, _ROW = 48, 0.2  # letters per line of a title, inches per line
_COLOURS = ("#0072b2", "#009e73", "#e69f00", "#cc3311")  # safe for colour-blind readers


@styled
def energy_curves(
    groups: Mapping[str, Sequence[tuple[str, AlphaEstimate, float]]],
) -> Figure:
    """Draw spectral energy over alpha, a panel per method.

    Triangles mark the estimates, dotted lines the true alpha. A panel has at most four curves.

    Parameters
    ----------
    groups : mapping
        Mapping of the name of a method to (label, estimate, true alpha) of each curve, with
        estimates from `clplen.estimate_alpha`. Each curve is divided by its maximum.

    Returns
    -------
    matplotlib.figure.Figure
        Panels side by side with shared axes, and one legend.

    Examples
    --------
    >>> values = np.random.default_rng(1).random((5, 5, 32, 32), np.float32)
    >>> lf = clplen.LightField.from_array(values, spacing=(-1e-3, -1e-3, 150e-6, 150e-6))
    >>> estimate = clplen.estimate_alpha(lf, method="energy")
    >>> figure = clplen.plot.energy_curves({"energy": [("0 mm", estimate, 1.0)]})
    >>> figure.axes[0].get_title()
    'energy'
    """
    figure = new_figure(3.7 * len(groups) + 0.4, 3.4)
    panels = figure.subplots(1, len(groups), squeeze=False, sharex=True, sharey=True)[0]
    for panel, (title, members) in zip(panels, groups.items(), strict=True):
        for colour, (label, estimate, truth) in zip(_COLOURS, members, strict=False):
            alphas, energy = (np.asarray(values) for values in estimate.curve)
            panel.plot(alphas, energy / energy.max(), color=colour, lw=1.4, label=label)
            check_finite(truth=truth)
            panel.axvline(truth, color=colour, lw=0.9, ls=":")
            panel.plot(estimate.alpha, 1.03, "v", color=colour, ms=5, clip_on=False)
        panel.set(xlabel=r"$\alpha$", title=title)
    panels[0].set(ylabel="spectral energy / its maximum", ylim=(0, 1.08))
    figure.legend(
        *panels[0].get_legend_handles_labels(),
        title="dz",
        frameon=False,
        loc="outside right center",
    )
    figure.supxlabel(r"triangles: estimates; dotted lines: true $\alpha$", fontsize=8, color="0.3")
    return figure


@styled
def alpha_curve(
    camera: CameraModel, estimates: Mapping[str, Sequence[tuple[float, float]]], *, reach: float
) -> Figure:
    """Draw alpha(dz) of a camera with estimates, and their errors below.

    Parameters
    ----------
    camera : CameraModel
        Camera that gives the curve, F/F' by the lens law.
    estimates : mapping
        Mapping of the name of a method to its (dz in metres, estimated alpha), at most four
        methods.
    reach : float
        Largest abs(dz) of the curve, in metres.

    Returns
    -------
    matplotlib.figure.Figure
        Two panels over dz in mm, positive farther from the lens: alpha, and the error of alpha.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=0.1, mla=clplen.MicrolensArray(150e-6, 10e-3, count=9, fill="full"),
    ...     wavelength=532e-9, pixels_per_lenslet=10)
    >>> estimates = {"energy": [(-5e-3, 0.97), (5e-3, 1.02)]}
    >>> figure = clplen.plot.alpha_curve(camera, estimates, reach=10e-3)
    >>> figure.axes[1].get_xlabel()
    'dz / mm (positive: farther from the lens)'
    """
    figure = new_figure(6.0, 5.4)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[2, 1])
    check_finite(reach=reach)
    dz = np.linspace(-reach, reach, 401)
    upper.plot(dz * 1e3, camera.alpha(dz), color="0.25", lw=1.3, label="F/F' by the lens law")
    lower.axhline(0, color="0.25", lw=1.3)
    for colour, marker, (name, points) in zip(_COLOURS, "s^ox", estimates.items(), strict=False):
        depths, alphas = (float64_array(values) for values in zip(*points, strict=True))
        style = {"color": colour, "marker": marker, "ls": "", "ms": 6, "mfc": "none", "mew": 1.4}
        upper.plot(depths * 1e3, alphas, label=name, **style)
        lower.plot(depths * 1e3, alphas - camera.alpha(depths), **style)
    upper.axhline(1, color="0.8", lw=0.7, zorder=0)
    upper.axvline(0, color="0.8", lw=0.7, zorder=0)
    upper.set(ylabel=r"$\alpha$ = F/F'", title="depth from focus")
    upper.legend(frameon=False)
    lower.set(xlabel="dz / mm (positive: farther from the lens)", ylabel=r"error of $\alpha$")
    return figure


@styled
def phase_space(
    lf: LightField | ArrayLike,
    *,
    rows: Sequence[int],
    labels: Sequence[str],
    truths: Sequence[float] = (),
) -> Figure:
    """Draw slices (x, u) of a light field: positions on the lenslets and on the main lens.

    The image of a point is a line of slope dx/du = 1 - alpha.

    Parameters
    ----------
    lf : LightField or array_like
        Light field of one channel, with spacing.
    rows : sequence of int
        Row y of each slice; each is summed over v and three rows about y.
    labels : sequence of str
        Labels of the rows.
    truths : sequence of float
        True alpha of the point in each row, drawn as a line through the slice's centroid.

    Returns
    -------
    matplotlib.figure.Figure
        A panel for each row, axes in mm; 12 samples of x on both sides of the centroid.
        Each slice is divided by its maximum.

    Raises
    ------
    ValueError
        If the light field has several channels or no spacing, or labels do not match the rows.

    Examples
    --------
    >>> values = np.random.default_rng(1).random((5, 5, 32, 32), np.float32)
    >>> lf = clplen.LightField.from_array(values, spacing=(-1e-3, -1e-3, 150e-6, 150e-6))
    >>> figure = clplen.plot.phase_space(lf, rows=[8, 16], labels=["y = 8", "y = 16"])
    >>> [axes.get_title() for axes in figure.axes[:2]]
    ['y = 8', 'y = 16']
    """
    lf = as_lightfield(lf)
    if lf.spacing is None or len(lf.shape) != 4:
        raise ValueError("lf must have one channel and a spacing in metres for a phase-space plot.")
    if not all(0 <= y < lf.shape[2] for y in rows):
        raise ValueError(f"rows must lie between 0 and {lf.shape[2] - 1}, got {rows!r}.")
    values = lf.to_numpy()
    _, du, _, dx = lf.spacing
    u, x = coordinates(lf.shape[1], du), coordinates(lf.shape[3], dx)
    figure = new_figure(3.3 * len(rows) + 0.8, 3.7)
    panels = figure.subplots(1, len(rows), squeeze=False)[0]
    drawn = None
    for index, (panel, y, label) in enumerate(zip(panels, rows, labels, strict=True)):
        part = np.maximum(values[:, :, max(y - 1, 0) : y + 2].sum(axis=(0, 2)), 0)
        extent = (x[0] - dx * 500, x[-1] + dx * 500, u[-1] + du * 500, u[0] - du * 500)
        middle = float((part**2).sum(axis=0) @ x / (part**2).sum())
        drawn = panel.imshow(
            part / part.max(), cmap=LIGHT, norm=PowerNorm(0.5, 0, 1), extent=extent, aspect="auto"
        )
        panel.set(
            xlim=(middle - 12e3 * dx, middle + 12e3 * dx),
            ylim=sorted(extent[2:]),
            title=label,
            xlabel="x on the lenslets / mm",
        )
        if truths:
            panel.plot(middle + (1 - truths[index]) * u, u, "--", color="w", lw=1)
    panels[0].set_ylabel("u on the main lens / mm")
    bar(figure, drawn, list(panels), "energy / maximum of the slice (square root)")
    figure.supxlabel(r"dashed: dx/du = 1 - $\alpha$", fontsize=8, color="0.3")
    return figure


@styled
def depth(depth_map: DepthMap | ArrayLike, *, title: str = "") -> Figure:
    """Draw a disparity map and its confidence, with colour bars.

    Colours span the 2nd to the 98th percentile of all pixels with a confidence above 0; arrows of
    the colour bar mark clipped values. Pixels with a confidence below 0.5 are paler in proportion,
    and pixels without a disparity are grey. If the confidence is 0 everywhere, a text in the
    picture says that the scene has no texture for depth.

    Parameters
    ----------
    depth_map : DepthMap or array_like
        Depth map, such as `clplen.depth_map` returns, or disparities, shape (y, x).
    title : str
        Title over the disparity; default "disparity".

    Returns
    -------
    matplotlib.figure.Figure
        The disparity in pixels a view step, nearer is larger, beside its confidence from 0 to 1;
        axes in pixels.

    Examples
    --------
    >>> values = np.random.default_rng(1).random((3, 3, 32, 32), np.float32)
    >>> disparity = clplen.depth_map(clplen.LightField.from_array(values), disparities=[-1, 0, 1])
    >>> figure = clplen.plot.depth(disparity, title="noise")
    >>> [axes.get_title() for axes in figure.axes[:2]]
    ['noise', 'confidence']
    """
    depth_map = as_depth_map(depth_map)
    return _map(depth_map.disparity, depth_map.confidence, title or "disparity", _DISPARITY)


@styled
def truth(ground_truth: Truth, *, title: str = "") -> Figure:
    """Draw the exact disparity of a synthetic scene; pixels without a surface are grey.

    Parameters
    ----------
    ground_truth : Truth
        Ground truth, such as `clplen.SurfaceScene.light_field` returns with the light field.
    title : str
        Title over the picture; default "disparity of the scene".

    Returns
    -------
    matplotlib.figure.Figure
        The disparity in pixels a view step, nearer is larger, from the smallest to the largest;
        axes in pixels.

    Examples
    --------
    >>> texture = clplen.cameras.Texture(np.random.default_rng(1).random((16, 16)))
    >>> scene = clplen.SurfaceScene([clplen.cameras.Plane(0.5, texture=texture)])
    >>> lf, ground_truth = scene.light_field(views=(3, 3), shape=(32, 32))
    >>> clplen.plot.truth(ground_truth).axes[0].get_title()
    'disparity of the scene'
    """
    values = ground_truth.disparity
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    figure = new_figure(5.6, 5.0 * min(2.0, values.shape[0] / values.shape[1]) + 0.2)
    axes = figure.add_subplot()
    axes.set_facecolor(_GREY)
    drawn = axes.imshow(values, cmap="viridis", norm=Normalize(low, high))
    bar(figure, drawn, axes, _DISPARITY)
    axes.set(xlabel="x / pixel", ylabel="y / pixel", title=title or "disparity of the scene")
    return figure


@styled
def focused_depth(maps: FocusedMaps, *, title: str = "") -> Figure:
    """Draw the magnification m = b/a of a focused camera and its confidence; see `magnification`.

    Parameters
    ----------
    maps : FocusedMaps
        Maps, such as `clplen.lightfield.focused_maps` returns.
    title : str
        Title over the map of m; default "m = b/a".

    Returns
    -------
    matplotlib.figure.Figure
        The map of m, nearer is larger, beside its confidence from 0 to 1; axes in pixels.

    Examples
    --------
    >>> m, z, confidence = np.random.default_rng(1).random((3, 16, 16))
    >>> from clplen.lightfield.focused.focused_picture import PictureGrid
    >>> grid = PictureGrid((0.0, 0.0), 1.0, (16, 16))
    >>> maps = clplen.lightfield.FocusedMaps(grid, m, z, confidence)
    >>> clplen.plot.focused_depth(maps).axes[0].get_title()
    'm = b/a'
    """
    return _magnification(maps.m, maps.confidence, title)


@styled
def magnification(m: ArrayLike, confidence: ArrayLike, *, title: str = "") -> Figure:
    """Draw a map of m = b/a of a focused camera and its confidence, as `depth` does.

    Parameters
    ----------
    m, confidence : array_like
        Maps of shape (y, x), such as the fields of `clplen.lightfield.FocusedMaps`.
    title : str
        Title over the map of m; default "m = b/a".

    Returns
    -------
    matplotlib.figure.Figure
        The map of m, nearer is larger, beside its confidence from 0 to 1; axes in pixels.

    Examples
    --------
    >>> m = np.linspace(0.2, 0.3, 256).reshape(16, 16)
    >>> figure = clplen.plot.magnification(m, np.ones((16, 16)), title="m of a ramp")
    >>> [axes.get_title() for axes in figure.axes[:2]]
    ['m of a ramp', 'confidence']
    """
    maps = real_array(m, "m"), real_array(confidence, "A confidence")
    return _magnification(*maps, title)


def _magnification(m: Array, confidence: Array, title: str) -> Figure:
    return _map(m, confidence, title or "m = b/a", "m = b/a (nearer: larger)")


def _map(values: Array, confidence: Array, title: str, label: str) -> Figure:
    """Draw a map, paler where confidence is low, beside its confidence.

    A map without any known confidence is drawn as if confidence were 1.
    """
    is_known = np.isfinite(confidence)
    confidence = np.where(is_known, confidence, 0.0 if is_known.any() else 1.0)
    norm = _colour_range(values, confidence)
    height, width = values.shape
    step = max(1, max(height, width) // _MIN_PIXELS)
    drawn_values, drawn_confidence = (a[::step, ::step] for a in (values, confidence))
    extent = {"extent": (-0.5, width - 0.5, height - 0.5, -0.5)}
    lines = textwrap.wrap(title, _LINE)
    tall = 4.0 * min(1.6, height / width) + 0.6 + _ROW * len(lines)
    figure = new_figure(9.6, tall)
    left, right = figure.subplots(1, 2)
    left.set_facecolor(_GREY)
    opacity = _MIN_OPACITY + (1 - _MIN_OPACITY) * np.clip(drawn_confidence / _OPAQUE, 0, 1)
    drawn = left.imshow(drawn_values, cmap="viridis", norm=norm, alpha=opacity, **extent)
    if confidence.max() > _MIN_CONFIDENCE:
        bar(figure, drawn, left, label, extend=clipped_sides(values, norm))
    else:
        drawn.set_visible(False)
        note = "no texture between the planes:\nnothing to tell depth by"
        left.text(0.5, 0.5, note, ha="center", va="center", transform=left.transAxes)
    if (opacity < 1).any():
        note = f"pale: confidence below {_OPAQUE:g} (the paler, the less)"
        figure.supxlabel(note, fontsize=8, color="0.3")
    drawn = right.imshow(drawn_confidence, cmap=LIGHT, vmin=0, vmax=1, **extent)
    drawn.set_visible(bool(is_known.any()))
    right.set_facecolor(_GREY)
    bar(figure, drawn, right, "confidence")
    left.set(xlabel="x / pixel", ylabel="y / pixel")
    left.set_title("\n".join(lines), pad=8)
    right.set(xlabel="x / pixel", yticks=[])
    right.set_title("confidence" if is_known.any() else "confidence: not known", pad=8)
    figure.set_layout_engine("constrained", w_pad=_MARGIN, h_pad=_MARGIN)
    return figure


def _colour_range(disparity: Array, confidence: Array) -> Normalize:
    """Return the colour range of a disparity map, from pixels with a confidence."""
    is_known = np.isfinite(disparity) & (confidence > _MIN_CONFIDENCE)
    values = disparity[is_known] if is_known.any() else np.zeros(1)
    return Normalize(*np.percentile(values, [2, 98]))


@styled
def distances(values: ArrayLike, *, title: str = "estimated distance") -> Figure:
    """Draw a map of distances in millimetres, shape (y, x), on black; NaN is unknown."""
    figure = new_figure(4.6, 4.0)
    axes = figure.subplots()
    axes.set(facecolor="black", xlabel="x / pixel", ylabel="y / pixel", title=title)
    drawn = axes.imshow(float64_array(values), cmap="turbo")
    bar(figure, drawn, axes, "distance from the main lens / mm")
    return figure
