"""Figures of point spread functions, modulation transfer and curves of contrast."""

from __future__ import annotations

import numpy as np
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from clplen.analysis.point.otf import OTF, Curve
from clplen.analysis.point.psf import PSF
from clplen.plot.base import LIGHT, Scale, bar, draw, new_figure, styled

_PER_MM = 1e-3  # cycles/mm per cycle/m
_MICRONS = 1e6


@styled
def psf(point_spread: PSF, *, title: str = "", scale: Scale = "root") -> Figure:
    """Draw a point spread function over its coordinates in micrometres.

    Parameters
    ----------
    point_spread : PSF
        Point spread function, intensities on a grid.
    title : str
        Title over the picture; default "point spread function".
    scale : {"linear", "log", "root"}
        Colour scale.

    Returns
    -------
    matplotlib.figure.Figure
        Axes in um, row 0 at the top; colour bar "intensity".

    Examples
    --------
    >>> y, x = np.mgrid[-16:17, -16:17] * 1e-6
    >>> gaussian = clplen.analysis.PSF(np.exp(-(x**2 + y**2) / 2e-11), 1e-6)
    >>> figure = clplen.plot.psf(gaussian)
    >>> [round(float(edge), 3) for edge in figure.axes[0].images[0].get_extent()]
    [-16.5, 16.5, 16.5, -16.5]
    """
    y, x = point_spread.grid.y * _MICRONS, point_spread.grid.x * _MICRONS
    dy, dx = (pitch * _MICRONS / 2 for pitch in point_spread.pitch)
    figure = new_figure(5.6, 4.6)
    axes = figure.add_subplot()
    extent = (x[0] - dx, x[-1] + dx, y[-1] + dy, y[0] - dy)
    draw(figure, axes, point_spread.values, scale, "intensity", extent=extent, interpolation=None)
    axes.set(xlabel="x / µm", ylabel="y / µm", title=title or "point spread function")
    return figure


@styled
def modulation(otf: OTF, *, title: str = "") -> Figure:
    """Draw the modulus of an optical transfer function over both frequencies in cycles/mm.

    Parameters
    ----------
    otf : OTF
        Transfer function, such as `clplen.analysis.OTF.of` returns.
    title : str
        Title over the picture; default "modulation transfer".

    Returns
    -------
    matplotlib.figure.Figure
        Contrast from 0 to 1 over (fy, fx), row 0 at the top.

    Examples
    --------
    >>> y, x = np.mgrid[-16:17, -16:17] * 1e-6
    >>> psf = clplen.analysis.PSF(np.exp(-(x**2 + y**2) / 2e-11), 1e-6)
    >>> figure = clplen.plot.modulation(clplen.analysis.OTF.of(psf))
    >>> [axes.get_ylabel() for axes in figure.axes]
    ['fy / (cycles/mm)', 'contrast']
    """
    fy, fx = otf.fy * _PER_MM, otf.fx * _PER_MM
    dy, dx = (f[1] - f[0] for f in (fy, fx))
    figure = new_figure(5.6, 4.6)
    axes = figure.add_subplot()
    drawn = axes.imshow(
        np.abs(otf.values),
        cmap=LIGHT,
        norm=Normalize(0, 1),
        extent=(fx[0] - dx / 2, fx[-1] + dx / 2, fy[-1] + dy / 2, fy[0] - dy / 2),
    )
    axes.set(
        xlabel="fx / (cycles/mm)", ylabel="fy / (cycles/mm)", title=title or "modulation transfer"
    )
    bar(figure, drawn, axes, "contrast")
    return figure


@styled
def curve(mtf: Curve, *, title: str = "") -> Figure:
    """Draw contrast over spatial frequency in cycles/mm.

    Parameters
    ----------
    mtf : Curve
        Curve of contrast, such as `clplen.analysis.OTF.mtf` returns.
    title : str
        Title over the curve; default none.

    Returns
    -------
    matplotlib.figure.Figure
        A line over the frequencies of the curve.

    Examples
    --------
    >>> f = np.linspace(0, 1e5, 101)
    >>> mtf = clplen.analysis.Curve(f, clplen.analysis.pixel_mtf(f, width=10e-6))
    >>> figure = clplen.plot.curve(mtf, title="pixel of 10 um")
    >>> [round(float(end), 3) for end in figure.axes[0].get_xlim()]
    [0.0, 100.0]
    """
    figure = new_figure(5.6, 3.6)
    axes = figure.add_subplot()
    axes.plot(mtf.frequency * _PER_MM, mtf.value, color="#0072b2")
    axes.set(xlabel="frequency / (cycles/mm)", ylabel="contrast", title=title)
    axes.set_xlim(mtf.frequency[0] * _PER_MM, mtf.frequency[-1] * _PER_MM)
    axes.set_ylim(bottom=min(0.0, float(mtf.value.min())))
    axes.grid(color="0.9")
    return figure
