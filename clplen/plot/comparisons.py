"""Figures that compare plenoptic cameras, one figure per analysis."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from clplen.analysis.cameras.camera_psf import object_nyquist
from clplen.analysis.cameras.comparison import Comparison, Measured
from clplen.analysis.cameras.imaging import Rendered
from clplen.plot.base import FigureDict, bar, new_figure, styled, verbatim

COLOURS = ("#0072b2", "#cc3311", "#009e73", "#e69f00", "#cc79a7", "#56b4e9")
_MARKERS = "osD^vP"
_SEPARATIONS = 241  # samples of the two-point curve
_MIN_BRIGHTNESS = 0.05  # brightness over the maximum of the part that is drawn
_MARGIN = 3  # samples of the coarsest picture around that part
_MIN_CONTRAST = 0.02  # contrast at which the drawn frequency range ends


def comparison(comparison: Comparison) -> dict[str, Figure]:
    """Draw all figures of a comparison, by the names of their analyses.

    Parameters
    ----------
    comparison : Comparison
        Comparison, such as `clplen.analysis.compare` returns.

    Returns
    -------
    dict of str to matplotlib.figure.Figure
        A figure for each entry of ``comparison.analyses``: "sampling", "psf", "mtf", "two-points",
        "energy", "transfer", "depth", "pictures".

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=0.1, mla=clplen.MicrolensArray(150e-6, 10e-3, count=9, fill="full"),
    ...     wavelength=532e-9, pixels_per_lenslet=10)
    >>> comparison = clplen.analysis.compare({"standard": camera}, only=["sampling"])
    >>> list(clplen.plot.comparison(comparison))
    ['sampling']
    """
    makers: dict[str, Callable[[Comparison], Figure]] = {
        "sampling": sampling,
        "psf": point_spread,
        "mtf": mtf,
        "two-points": two_points,
        "energy": energy,
        "transfer": transfer,
        "depth": depth_errors,
        "pictures": pictures,
    }
    return FigureDict(
        (name, make(comparison)) for name, make in makers.items() if name in comparison.analyses
    )


@styled
def sampling(comparison: Comparison) -> Figure:
    """Draw spatial samples and independent directions along x; dotted: equal product."""
    figure = new_figure(5.2, 4.0)
    axes = figure.add_subplot()
    for measured, colour, marker in _with_styles(comparison):
        position = (measured.sampling.spatial_samples, measured.sampling.independent_views)
        axes.plot(*position, marker, color=colour, ms=9, label=verbatim(measured.name))
    (left, right), (low, high) = _widened(axes.get_xlim()), _widened(axes.get_ylim())
    samples = np.geomspace(left, right, 2)
    products = {measured.sampling.spatial_samples * measured.sampling.independent_views
                for measured in comparison.cameras}  # fmt: skip
    for product in products:
        axes.plot(samples, product / samples, ":", color="0.6", lw=0.9, zorder=0)
    axes.set(xscale="log", yscale="log", xlim=(left, right), ylim=(low, high))
    axes.minorticks_off()
    axes.set_xticks([measured.sampling.spatial_samples for measured in comparison.cameras])
    axes.set_yticks([measured.sampling.independent_views for measured in comparison.cameras])
    axes.xaxis.set_major_formatter("{x:.4g}")
    axes.yaxis.set_major_formatter("{x:.3g}")
    axes.set(
        xlabel="places along x",
        ylabel="independent directions along x",
        title="samples of place and direction; dotted: equal product",
    )
    axes.legend(frameon=False)
    return figure


@styled
def point_spread(comparison: Comparison) -> Figure:
    """Draw the picture and the profile of a point along x, a column per camera."""
    figure = new_figure(3.1 * len(comparison.cameras) + 0.8, 5.6)
    count = len(comparison.cameras)
    upper = figure.subplots(2, count, squeeze=False, height_ratios=[1.15, 1])
    reach = max(measured.separations()[-1] for measured in comparison.cameras) * 0.75
    for column, (measured, colour, _) in enumerate(_with_styles(comparison)):
        psf = measured.psf
        assert psf is not None
        y, x = psf.centroid()
        extent = [
            (psf.grid.x[0] - psf.pitch[1] / 2 - x) * 1e6,
            (psf.grid.x[-1] + psf.pitch[1] / 2 - x) * 1e6,
            (psf.grid.y[-1] + psf.pitch[0] / 2 - y) * 1e6,
            (psf.grid.y[0] - psf.pitch[0] / 2 - y) * 1e6,
        ]
        panel = upper[0][column]
        relative = np.clip(psf.values / psf.peak, 0, 1)
        drawn = panel.imshow(np.sqrt(relative), cmap="gray", vmin=0, vmax=1, extent=extent)
        sides = (-reach * 1e6, reach * 1e6)
        panel.set(xlim=sides, ylim=sides[::-1], title=verbatim(measured.name), xlabel="x / µm")
        positions, line = psf.profile(1)
        below = upper[1][column]
        below.plot((positions - x) * 1e6, line / psf.peak, color=colour, lw=1.4)
        below.set(xlim=sides, ylim=(-0.03, 1.05), xlabel="x / µm")
        below.axhline(0.5, color="0.8", lw=0.7, zorder=0)
        width = measured.fwhm(1)
        if np.isfinite(width):
            below.set_title(f"FWHM {width * 1e6:.3g} µm")
    upper[0][0].set_ylabel("y / µm")
    upper[1][0].set_ylabel("intensity / peak")
    bar(figure, drawn, list(upper[0]), "square root of intensity / peak")
    figure.supxlabel("a point's image, on the main lens' image", fontsize=8, color="0.3")
    return figure


@styled
def mtf(comparison: Comparison) -> Figure:
    """Draw contrast over frequency along x (solid) and y (dashed), with Nyquist frequencies."""
    figure = new_figure(6.4, 3.8)
    axes = figure.add_subplot()
    right = 0.0
    for measured, colour, _ in _with_styles(comparison):
        for axis, style in ((0, "--"), (1, "-")):
            curve = measured.mtf(axis)
            label = verbatim(measured.name) if axis else None
            axes.plot(curve.frequency * 1e-3, curve.value, style, color=colour, lw=1.4, label=label)
            visible = curve.frequency[curve.value > _MIN_CONTRAST]
            right = max(right, float(visible.max()) * 1.05)
        axes.axvline(measured.sampling.nyquist * 1e-3, color=colour, lw=1, ls=":")
    axes.axhline(0.5, color="0.85", lw=0.7, zorder=0)
    axes.set(
        xlim=(0, right * 1e-3),
        ylim=(0, 1.02),
        xlabel="frequency / cycles per mm of the main lens' image",
        ylabel="contrast (MTF)",
        title="along x (full) and y (dashed); dotted: half a cycle a sample",
    )
    axes.legend(frameon=False)
    return figure


@styled
def two_points(comparison: Comparison) -> Figure:
    """Draw mid/peak of two incoherent points over their separation along x."""
    figure = new_figure(6.0, 3.6)
    axes = figure.add_subplot()
    widest = [
        max(2 * measured.sampling.spatial_pitch, measured.two_point_limit())
        for measured in comparison.cameras
    ]
    s = np.linspace(0, 1.3 * np.nanmax(widest), _SEPARATIONS)
    for measured, colour, marker in _with_styles(comparison):
        axes.plot(
            s * 1e6, measured.mid_over_peak(s), color=colour, lw=1.4, label=verbatim(measured.name)
        )
        limit = measured.two_point_limit()
        if np.isfinite(limit):
            axes.plot(limit * 1e6, measured.mid_over_peak([limit])[0], marker, color=colour, ms=6)
        axes.axvline(2e6 * measured.sampling.spatial_pitch, color=colour, lw=1, ls=":")
    axes.set(
        xlim=(0, s[-1] * 1e6),
        ylim=(0, 1.04),
        xlabel="separation / µm on the main lens' image",
        ylabel="middle / lower of the two peaks",
        title="two points; marked: 8/$\\pi^2$; dotted: two samples",
    )
    axes.legend(frameon=False)
    return figure


@styled
def energy(comparison: Comparison) -> Figure:
    """Draw the share of a point's light within circles about it."""
    figure = new_figure(6.0, 3.6)
    axes = figure.add_subplot()
    for measured, colour, _ in _with_styles(comparison):
        radii, shares = measured.encircled()
        axes.plot(radii * 1e6, shares, color=colour, lw=1.4, label=verbatim(measured.name))
    axes.axhline(0.8, color="0.85", lw=0.7, zorder=0)
    axes.set(
        xlim=(0, 3e6 * max(_radius(measured) for measured in comparison.cameras)),
        ylim=(0, 1.02),
        xlabel="radius / µm on the main lens' image",
        ylabel="encircled energy",
        title="light of a point within a circle",
    )
    axes.legend(frameon=False)
    return figure


@styled
def transfer(comparison: Comparison) -> Figure:
    """Draw MTF50 of pictures focused on each depth, and contrast over frequency per depth."""
    count = len(comparison.cameras)
    figure = new_figure(max(6.4, 3.2 * count + 0.6), 6.2)
    above, below = figure.subfigures(2, 1, squeeze=False)[:, 0]
    upper = above.subplots()
    panels = below.subplots(1, count, squeeze=False, sharey=True)[0]
    for panel, (measured, colour, marker) in zip(panels, _with_styles(comparison), strict=True):
        assert measured.transfer is not None
        dz, half = measured.transfer.dz, measured.transfer.mtf50
        upper.plot(
            dz * 1e3, half * 1e-3, color=colour, marker=marker, ms=5, label=verbatim(measured.name)
        )
        limit = np.array([object_nyquist(measured.camera, float(depth)) for depth in dz])
        upper.plot(dz * 1e3, limit * 1e-3, color=colour, ls=":", lw=1.2)
        _depth_curves(panel, measured)
    upper.set(
        ylim=(0, None),
        xlabel="dz / mm (positive: farther from the lens)",
        ylabel="MTF50 / cycles per mm",
        title="focused on each depth; frequencies of the object; dotted: half a cycle a sample",
    )
    upper.axvline(0, color="0.85", lw=0.7, zorder=0)
    upper.legend(frameon=False)
    panels[0].set_ylabel("contrast")
    return figure


def _depth_curves(panel: Axes, measured: Measured) -> None:
    assert measured.transfer is not None
    depths = measured.transfer.dz
    shades = _shades(np.linspace(0, 1, len(depths)))
    right = 0.0
    for dz, curve, shade in zip(depths, measured.transfer.curves, shades, strict=True):
        if curve is not None:
            label = f"{dz * 1e3:g} mm"
            panel.plot(curve.frequency * 1e-3, curve.value, color=shade, lw=1.2, label=label)
            right = max(right, float(curve.frequency[curve.value > 0.1].max()))
    panel.set(xlim=(0, right * 1e-3 or 1), ylim=(0, 1.02), title=verbatim(measured.name))
    panel.set_xlabel("cycles per mm of the object")
    if right:
        panel.legend(frameon=False, title="dz", fontsize=7, title_fontsize=7)


@styled
def depth_errors(comparison: Comparison) -> Figure:
    """Draw measured minus true depth at every position, and the root mean square."""
    figure = new_figure(6.4, 5.4)
    upper, lower = figure.subplots(2, 1, sharex=True)
    for measured, colour, marker in _with_styles(comparison):
        assert measured.depth is not None
        dz = measured.depth.dz * 1e3
        for errors in measured.depth.errors.T:
            upper.plot(dz, errors * 1e3, marker, color=colour, ms=4, mfc="none")
        upper.plot(dz, measured.depth.mean * 1e3, color=colour, lw=1, label=verbatim(measured.name))
        lower.plot(dz, measured.depth.rms * 1e3, color=colour, marker=marker, ms=5, lw=1.2)
    upper.axhline(0, color="0.6", lw=0.8, zorder=0)
    upper.set(ylabel="measured - true dz / mm", title="depth of a point at places under a lenslet")
    upper.legend(frameon=False)
    if any(
        np.nanmax(measured.depth.rms, initial=0) > 0
        for measured in comparison.cameras
        if measured.depth
    ):
        lower.set_yscale("log")
    lower.set(xlabel="dz / mm (positive: farther from the lens)", ylabel="rms error / mm")
    missing = [
        f"{verbatim(measured.name)}: none at dz = {_missing_depths(measured)} mm"
        for measured in comparison.cameras
        if _missing_depths(measured)
    ]
    if missing:
        figure.supxlabel("; ".join(missing), fontsize=8, color="0.3")
    return figure


@styled
def pictures(comparison: Comparison) -> Figure:
    """Draw the bright part of the rendered scenes in their own samples, at one scale."""
    left, right, top, bottom = _bright_limits(comparison)
    ratio = (bottom - top) / (right - left)
    count = len(comparison.cameras)
    below = ratio < 0.7  # stack wide pictures, else place them side by side
    side = max(2.4, min(4.4, 6.6 / ratio))  # narrower panels for high pictures
    size = (7.4, (6.6 * ratio + 0.6) * count + 0.3) if below else (side * count, side * ratio + 0.8)
    figure = new_figure(*size)
    grid = (count, 1) if below else (1, count)
    panels = figure.subplots(*grid, squeeze=False, sharex=True, sharey=True).ravel()
    for panel, measured in zip(panels, comparison.cameras, strict=True):
        image = measured.picture
        assert image is not None
        ny, nx = image.values.shape
        extent = [edge * 1e3 for edge in _extent(image)]
        panel.imshow(image.values, cmap="gray", vmin=0, extent=extent)
        panel.set(title=f"{verbatim(measured.name)}: {ny} x {nx} samples", ylabel="y / mm")
        panel.set(xlim=(left * 1e3, right * 1e3), ylim=(bottom * 1e3, top * 1e3))
    panels[-1].set_xlabel("x / mm on the main lens' image")
    return figure


def _extent(image: Rendered) -> tuple[float, float, float, float]:
    """Return left, right, bottom and top edges in metres."""
    (ny, nx), (dy, dx), (y, x) = image.values.shape, image.pitch, image.origin
    left, top = x - (nx // 2 + 0.5) * dx, y - (ny // 2 + 0.5) * dy
    return left, left + nx * dx, top + ny * dy, top


def _bright_limits(comparison: Comparison) -> tuple[float, float, float, float]:
    """Return left, right, top and bottom edges in metres of the bright parts, with a margin."""
    sides = []
    for measured in comparison.cameras:
        image = measured.picture
        assert image is not None
        left, right, bottom, top = _extent(image)
        lit = np.argwhere(image.values > _MIN_BRIGHTNESS * image.values.max())
        (y0, x0), (y1, x1) = lit.min(axis=0), lit.max(axis=0)
        dy, dx = image.pitch
        margin = _MARGIN * max(dy, dx)
        sides.append((
            max(left, left + x0 * dx - margin),
            min(right, left + (x1 + 1) * dx + margin),
            max(top, top + y0 * dy - margin),
            min(bottom, top + (y1 + 1) * dy + margin),
        ))  # fmt: skip
    table = np.array(sides)
    low, high = table.min(axis=0), table.max(axis=0)
    return float(low[0]), float(high[1]), float(low[2]), float(high[3])


def _radius(measured: Measured) -> float:
    """Return the radius of 80 % of the light, or a third of the largest radius."""
    radius = measured.radius(0.8)
    return radius if np.isfinite(radius) else float(measured.encircled()[0][-1]) / 3


def _with_styles(comparison: Comparison) -> Any:
    """Return cameras with their colours and markers."""
    n = len(COLOURS)
    return [
        (measured, COLOURS[k % n], _MARKERS[k % n]) for k, measured in enumerate(comparison.cameras)
    ]


def _shades(shares: Any) -> Any:
    from matplotlib import colormaps

    return colormaps["viridis"](0.9 * np.asarray(shares))


def _widened(limits: tuple[float, float]) -> tuple[float, float]:
    return max(limits[0], 1e-3) / 2, limits[1] * 2


def _missing_depths(measured: Measured) -> str:
    """List depths without a measurement, in mm."""
    assert measured.depth is not None
    is_missing = np.isnan(measured.depth.rms)
    return ", ".join(f"{dz * 1e3:g}" for dz in measured.depth.dz[is_missing])
