"""Figures of several plenoptic cameras measured alike: one for each quantity, all cameras in it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from clplen.analysis.cameras.comparison import Comparison, Measured
from clplen.analysis.cameras.imaging import Rendered
from clplen.plot.base import bar, new_figure, styled, verbatim

COLOURS = ("#0072b2", "#cc3311", "#009e73", "#e69f00", "#cc79a7", "#56b4e9")
_MARKERS = "osD^vP"
_FINE = 241  # separations
_LIT = 0.05  # of a picture's maximum: what is shown
_MARGIN = 3  # samples of the coarsest picture about that
_PARTS = 0.02  # contrast below which a curve is no more drawn


def comparison(found: Comparison) -> dict[str, Figure]:
    """Return all figures of a comparison, by the names that their files get.

    Parameters
    ----------
    found : Comparison
        As `clplen.analysis.compare` returns it.

    Returns
    -------
    dict of str to matplotlib.figure.Figure
        One figure for each analysis of ``found.analyses``: "sampling", "psf", "mtf", "two-points",
        "energy", "transfer", "depth", "pictures".

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=0.1, mla=clplen.MicrolensArray(150e-6, 10e-3, count=9, fill="full"),
    ...     wavelength=532e-9, pixels_per_lenslet=10)
    >>> found = clplen.analysis.compare({"standard": camera}, only=["sampling"])
    >>> list(clplen.plot.comparison(found))
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
    return {name: make(found) for name, make in makers.items() if name in found.analyses}


@styled
def sampling(found: Comparison) -> Figure:
    """Places and independent directions along x, a point a camera; the product on dotted lines."""
    figure = new_figure(5.2, 4.0)
    axes = figure.add_subplot()
    for one, colour, marker in _each(found):
        at = (one.sampling.spatial_samples, one.sampling.independent_views)
        axes.plot(*at, marker, color=colour, ms=9, label=verbatim(one.name))
    (left, right), (low, high) = _wider(axes.get_xlim()), _wider(axes.get_ylim())
    places = np.geomspace(left, right, 2)
    products = {one.sampling.spatial_samples * one.sampling.independent_views
                for one in found.cameras}  # fmt: skip
    for product in products:
        axes.plot(places, product / places, ":", color="0.6", lw=0.9, zorder=0)
    axes.set(xscale="log", yscale="log", xlim=(left, right), ylim=(low, high))
    axes.minorticks_off()
    axes.set_xticks([one.sampling.spatial_samples for one in found.cameras])
    axes.set_yticks([one.sampling.independent_views for one in found.cameras])
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
def point_spread(found: Comparison) -> Figure:
    """Profiles of a point's image along x and its picture, one panel a camera."""
    figure = new_figure(3.1 * len(found.cameras) + 0.8, 5.6)
    count = len(found.cameras)
    upper = figure.subplots(2, count, squeeze=False, height_ratios=[1.15, 1])
    reach = max(one.separations()[-1] for one in found.cameras) * 0.75
    for column, (one, colour, _) in enumerate(_each(found)):
        psf = one.psf
        assert psf is not None
        y, x = psf.centroid()
        extent = [
            (psf.grid.x[0] - psf.pitch[1] / 2 - x) * 1e6,
            (psf.grid.x[-1] + psf.pitch[1] / 2 - x) * 1e6,
            (psf.grid.y[-1] + psf.pitch[0] / 2 - y) * 1e6,
            (psf.grid.y[0] - psf.pitch[0] / 2 - y) * 1e6,
        ]
        panel = upper[0][column]
        shown = np.clip(psf.values / psf.peak, 0, 1)
        drawn = panel.imshow(np.sqrt(shown), cmap="gray", vmin=0, vmax=1, extent=extent)
        sides = (-reach * 1e6, reach * 1e6)
        panel.set(xlim=sides, ylim=sides[::-1], title=verbatim(one.name), xlabel="x / µm")
        places, line = psf.profile(1)
        below = upper[1][column]
        below.plot((places - x) * 1e6, line / psf.peak, color=colour, lw=1.4)
        below.set(xlim=sides, ylim=(-0.03, 1.05), xlabel="x / µm")
        below.axhline(0.5, color="0.8", lw=0.7, zorder=0)
        width = one.fwhm(1)
        if np.isfinite(width):
            below.set_title(f"FWHM {width * 1e6:.3g} µm")
    upper[0][0].set_ylabel("y / µm")
    upper[1][0].set_ylabel("intensity / peak")
    bar(figure, drawn, list(upper[0]), "square root of intensity / peak")
    figure.supxlabel("a point's image, on the main lens' image", fontsize=8, color="0.3")
    return figure


@styled
def mtf(found: Comparison) -> Figure:
    """Contrast against frequency along x (full) and y (dashed), with Nyquist's frequencies."""
    figure = new_figure(6.4, 3.8)
    axes = figure.add_subplot()
    right = 0.0
    for one, colour, _ in _each(found):
        for axis, style in ((0, "--"), (1, "-")):
            curve = one.mtf(axis)
            label = verbatim(one.name) if axis else None
            axes.plot(curve.frequency * 1e-3, curve.value, style, color=colour, lw=1.4, label=label)
            seen = curve.frequency[curve.value > _PARTS]
            right = max(right, float(seen.max()) * 1.05)
        axes.axvline(one.sampling.nyquist * 1e-3, color=colour, lw=1, ls=":")
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
def two_points(found: Comparison) -> Figure:
    """Mid/peak of two incoherent points against their separation along x."""
    figure = new_figure(6.0, 3.6)
    axes = figure.add_subplot()
    widest = [max(2 * one.sampling.spatial_pitch, one.two_point_limit()) for one in found.cameras]
    s = np.linspace(0, 1.3 * np.nanmax(widest), _FINE)
    for one, colour, marker in _each(found):
        axes.plot(s * 1e6, one.mid_over_peak(s), color=colour, lw=1.4, label=verbatim(one.name))
        limit = one.two_point_limit()
        if np.isfinite(limit):
            axes.plot(limit * 1e6, one.mid_over_peak([limit])[0], marker, color=colour, ms=6)
        axes.axvline(2e6 * one.sampling.spatial_pitch, color=colour, lw=1, ls=":")
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
def energy(found: Comparison) -> Figure:
    """Share of a point's light within circles about it."""
    figure = new_figure(6.0, 3.6)
    axes = figure.add_subplot()
    for one, colour, _ in _each(found):
        radii, shares = one.encircled()
        axes.plot(radii * 1e6, shares, color=colour, lw=1.4, label=verbatim(one.name))
    axes.axhline(0.8, color="0.85", lw=0.7, zorder=0)
    axes.set(
        xlim=(0, 3e6 * max(_radius(one) for one in found.cameras)),
        ylim=(0, 1.02),
        xlabel="radius / µm on the main lens' image",
        ylabel="encircled energy",
        title="light of a point within a circle",
    )
    axes.legend(frameon=False)
    return figure


@styled
def transfer(found: Comparison) -> Figure:
    """MTF50 of pictures focused on each depth, and contrast against frequency for each depth."""
    count = len(found.cameras)
    figure = new_figure(max(6.4, 3.2 * count + 0.6), 6.2)
    above, below = figure.subfigures(2, 1, squeeze=False)[:, 0]
    upper = above.subplots()
    panels = below.subplots(1, count, squeeze=False, sharey=True)[0]
    for panel, (one, colour, marker) in zip(panels, _each(found), strict=True):
        assert one.transfer is not None
        dz, half = one.transfer.dz, one.transfer.mtf50
        upper.plot(
            dz * 1e3, half * 1e-3, color=colour, marker=marker, ms=5, label=verbatim(one.name)
        )
        _depth_curves(panel, one)
    upper.set(
        ylim=(0, None),
        xlabel="dz / mm (positive: farther from the lens)",
        ylabel="MTF50 / cycles per mm",
        title="picture focused on its depth; frequencies of the object",
    )
    upper.axvline(0, color="0.85", lw=0.7, zorder=0)
    upper.legend(frameon=False)
    panels[0].set_ylabel("contrast")
    return figure


def _depth_curves(panel: Axes, one: Measured) -> None:
    assert one.transfer is not None
    depths = one.transfer.dz
    shades = _shades(np.linspace(0, 1, len(depths)))
    right = 0.0
    for dz, curve, shade in zip(depths, one.transfer.curves, shades, strict=True):
        if curve is not None:
            label = f"{dz * 1e3:g} mm"
            panel.plot(curve.frequency * 1e-3, curve.value, color=shade, lw=1.2, label=label)
            right = max(right, float(curve.frequency[curve.value > 0.1].max()))
    panel.set(xlim=(0, right * 1e-3 or 1), ylim=(0, 1.02), title=verbatim(one.name))
    panel.set_xlabel("cycles per mm of the object")
    if right:
        panel.legend(frameon=False, title="dz", fontsize=7, title_fontsize=7)


@styled
def depth_errors(found: Comparison) -> Figure:
    """Measured minus true depth: every place, and the root mean square."""
    figure = new_figure(6.4, 5.4)
    upper, lower = figure.subplots(2, 1, sharex=True)
    for one, colour, marker in _each(found):
        assert one.depth is not None
        dz = one.depth.dz * 1e3
        for place in one.depth.errors.T:
            upper.plot(dz, place * 1e3, marker, color=colour, ms=4, mfc="none")
        upper.plot(dz, one.depth.mean * 1e3, color=colour, lw=1, label=verbatim(one.name))
        lower.plot(dz, one.depth.rms * 1e3, color=colour, marker=marker, ms=5, lw=1.2)
    upper.axhline(0, color="0.6", lw=0.8, zorder=0)
    upper.set(ylabel="measured - true dz / mm", title="depth of a point at places under a lenslet")
    upper.legend(frameon=False)
    if any(np.nanmax(one.depth.rms, initial=0) > 0 for one in found.cameras if one.depth):
        lower.set_yscale("log")
    lower.set(xlabel="dz / mm (positive: farther from the lens)", ylabel="rms error / mm")
    missing = [
        f"{verbatim(one.name)}: none at dz = {_list(one)} mm" for one in found.cameras if _list(one)
    ]
    if missing:
        figure.supxlabel("; ".join(missing), fontsize=8, color="0.3")
    return figure


@styled
def pictures(found: Comparison) -> Figure:
    """The lit part of the scenes as rendered in focus, in their own samples, at one scale."""
    left, right, top, bottom = _lit(found)
    ratio = (bottom - top) / (right - left)
    count = len(found.cameras)
    below = ratio < 0.7  # each other, else side by side
    size = (7.4, (6.6 * ratio + 0.6) * count + 0.3) if below else (4.4 * count, 4.4 * ratio + 0.8)
    figure = new_figure(*size)
    grid = (count, 1) if below else (1, count)
    panels = figure.subplots(*grid, squeeze=False, sharex=True, sharey=True).ravel()
    for panel, one in zip(panels, found.cameras, strict=True):
        image = one.picture
        assert image is not None
        ny, nx = image.values.shape
        extent = [edge * 1e3 for edge in _extent(image)]
        panel.imshow(image.values, cmap="gray", vmin=0, extent=extent)
        panel.set(title=f"{verbatim(one.name)}: of {ny} x {nx} samples", ylabel="y / mm")
        panel.set(xlim=(left * 1e3, right * 1e3), ylim=(bottom * 1e3, top * 1e3))
    panels[-1].set_xlabel("x / mm on the main lens' image")
    return figure


def _extent(image: Rendered) -> tuple[float, float, float, float]:
    """Left, right, bottom and top edges in metres."""
    (ny, nx), (dy, dx), (y, x) = image.values.shape, image.pitch, image.origin
    left, top = x - (nx // 2 + 0.5) * dx, y - (ny // 2 + 0.5) * dy
    return left, left + nx * dx, top + ny * dy, top


def _lit(found: Comparison) -> tuple[float, float, float, float]:
    """Left, right, top and bottom in metres of what is bright in any picture, and a margin."""
    sides = []
    for one in found.cameras:
        image = one.picture
        assert image is not None
        left, right, bottom, top = _extent(image)
        lit = np.argwhere(image.values > _LIT * image.values.max())
        (y0, x0), (y1, x1) = lit.min(axis=0), lit.max(axis=0)
        dy, dx = image.pitch
        more = _MARGIN * max(dy, dx)
        sides.append((
            max(left, left + x0 * dx - more),
            min(right, left + (x1 + 1) * dx + more),
            max(top, top + y0 * dy - more),
            min(bottom, top + (y1 + 1) * dy + more),
        ))  # fmt: skip
    every = np.array(sides)
    low, high = every.min(axis=0), every.max(axis=0)
    return float(low[0]), float(high[1]), float(low[2]), float(high[3])


def _radius(one: Measured) -> float:
    """Of 80 % of the light, or of all that is known."""
    found = one.radius(0.8)
    return found if np.isfinite(found) else float(one.encircled()[0][-1]) / 3


def _each(found: Comparison) -> Any:
    """Cameras with their colours and markers."""
    n = len(COLOURS)
    return [(one, COLOURS[k % n], _MARKERS[k % n]) for k, one in enumerate(found.cameras)]


def _shades(shares: Any) -> Any:
    from matplotlib import colormaps

    return colormaps["viridis"](0.9 * np.asarray(shares))


def _wider(limits: tuple[float, float]) -> tuple[float, float]:
    return max(limits[0], 1e-3) / 2, limits[1] * 2


def _list(one: Measured) -> str:
    """Depths without a measurement, in mm."""
    assert one.depth is not None
    wrong = np.isnan(one.depth.rms)
    return ", ".join(f"{dz * 1e3:g}" for dz in one.depth.dz[wrong])
