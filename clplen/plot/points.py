"""Figures of what a point gives: its image, the modulation, curves of contrast."""

from __future__ import annotations

import numpy as np
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from clplen.analysis.point.otf import OTF, Curve
from clplen.analysis.point.psf import PSF
from clplen.plot.base import LIGHT, Scale, bar, draw, new_figure, styled

_PER_MM = 1e-3  # of cycles a metre
_MICRONS = 1e6


@styled
def psf(found: PSF, *, title: str = "", scale: Scale = "root") -> Figure:
    """Draw a point spread function over its coordinates in micrometres.

    Parameters
    ----------
    found : PSF
        Intensities on a grid.
    title : str
        Over the picture; default "point spread function".
    scale : {"linear", "log", "root"}
        Of the values.

    Returns
    -------
    matplotlib.figure.Figure
        Axes in um, row 0 at the top; colour bar "intensity".

    Examples
    --------
    >>> y, x = np.mgrid[-16:17, -16:17] * 1e-6
    >>> found = clplen.analysis.PSF(np.exp(-(x**2 + y**2) / 2e-11), 1e-6)
    >>> figure = clplen.plot.psf(found)
    >>> [round(float(edge), 3) for edge in figure.axes[0].images[0].get_extent()]
    [-16.5, 16.5, 16.5, -16.5]
    """
    y, x = found.grid.y * _MICRONS, found.grid.x * _MICRONS
    dy, dx = (pitch * _MICRONS / 2 for pitch in found.pitch)
    figure = new_figure(5.6, 4.6)
    axes = figure.add_subplot()
    extent = (x[0] - dx, x[-1] + dx, y[-1] + dy, y[0] - dy)
    draw(figure, axes, found.values, scale, "intensity", extent=extent, interpolation=None)
    axes.set(xlabel="x / µm", ylabel="y / µm", title=title or "point spread function")
    return figure


@styled
def modulation(found: OTF, *, title: str = "") -> Figure:
    """Draw the modulus of an optical transfer function over both frequencies, in cycles/mm.

    Parameters
    ----------
    found : OTF
        As `clplen.analysis.OTF.of` returns it.
    title : str
        Over the picture; default "modulation transfer".

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
    fy, fx = found.fy * _PER_MM, found.fx * _PER_MM
    dy, dx = (f[1] - f[0] for f in (fy, fx))
    figure = new_figure(5.6, 4.6)
    axes = figure.add_subplot()
    drawn = axes.imshow(
        np.abs(found.values),
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
def curve(found: Curve, *, title: str = "") -> Figure:
    """Draw contrast against spatial frequency in cycles/mm.

    Parameters
    ----------
    found : Curve
        Such as a section of an `clplen.analysis.OTF` along one axis.
    title : str
        Over the curve; default none.

    Returns
    -------
    matplotlib.figure.Figure
        One line over the frequencies of the curve.

    Examples
    --------
    >>> f = np.linspace(0, 1e5, 101)
    >>> found = clplen.analysis.Curve(f, clplen.analysis.pixel_mtf(f, width=10e-6))
    >>> figure = clplen.plot.curve(found, title="pixel of 10 um")
    >>> [round(float(end), 3) for end in figure.axes[0].get_xlim()]
    [0.0, 100.0]
    """
    figure = new_figure(5.6, 3.6)
    axes = figure.add_subplot()
    axes.plot(found.frequency * _PER_MM, found.value, color="#0072b2")
    axes.set(xlabel="frequency / (cycles/mm)", ylabel="contrast", title=title)
    axes.set_xlim(found.frequency[0] * _PER_MM, found.frequency[-1] * _PER_MM)
    axes.set_ylim(bottom=min(0.0, float(found.value.min())))
    axes.grid(color="0.9")
    return figure
