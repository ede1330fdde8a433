"""Figures of plenoptic cameras: pupil, lenslets and pixels to scale."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle, RegularPolygon

from clplen.cameras.camera_base import Plenoptic
from clplen.plot.base import new_figure, styled
from clplen.plot.scale_bars import length_text

_GLASS, _RIM, _PIXEL, _LIGHT, _AIRY = "#d7e8f4", "#33536b", "0.75", "#009e73", "#cc3311"
_LENSLETS = 5  # across the middle panel
_CORNERS = 6  # of a hexagonal lenslet


@styled
def camera(cam: Plenoptic, *, title: str = "") -> Figure:
    """Draw the pupil, the lenslets and the pixels of a plenoptic camera from the front, to scale.

    Parameters
    ----------
    cam : Plenoptic1 or Plenoptic2
        Camera, as `clplen.PlenopticCamera` builds it.
    title : str
        Title of the figure; default the kind of the camera.

    Returns
    -------
    matplotlib.figure.Figure
        Three panels: the exit pupil of the main lens with the part that one pixel sees; lenslets
        with the images of the pupil behind them; pixels behind one lenslet with the image of the
        pupil, and the diameter 2.44 lam N of the Airy disc (Goodman 2005, section 4.4.2).

    Raises
    ------
    TypeError
        If ``cam`` is no plenoptic camera.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=0.1, mla=clplen.MicrolensArray(150e-6, 10e-3, count=9, fill="full"),
    ...     wavelength=532e-9, pixels_per_lenslet=10)
    >>> figure = clplen.plot.camera(camera)
    >>> [axes.get_title() for axes in figure.axes]
    ['pupil: 3 mm', 'lenslets: 9 x 9, 150 µm', 'pixels: 10 x 10 a lenslet, 15 µm']
    """
    if not isinstance(cam, Plenoptic):
        raise TypeError(f"cam must be a plenoptic camera, got {type(cam).__name__}.")
    figure = new_figure(9.6, 4.1)
    figure.suptitle(title or cam.describe().title)
    pupil, array, pixels = figure.subplots(1, 3)
    _draw_pupil(pupil, cam)
    _draw_lenslets(array, cam)
    _draw_pixels(pixels, cam)
    return figure


def _draw_pupil(axes: Axes, cam: Plenoptic) -> None:
    """Draw the pupil, cut into the parts that the pixels of a lenslet see."""
    D = cam.aperture_diameter
    step = cam.pixel_pitch * cam.array_distance / cam.sensor_distance
    axes.add_patch(Circle((0, 0), D / 2, fc=_GLASS, ec=_RIM, lw=1.5))
    rim = axes.patches[0]
    edges = _edges(cam, step, D / 2)
    for draw in (axes.vlines, axes.hlines):
        draw(edges, -D / 2, D / 2, color=_RIM, lw=0.4, alpha=0.6).set_clip_path(rim)
    corner = (edges[(len(edges) - 1) // 2],) * 2
    axes.add_patch(Rectangle(corner, step, step, fc=_LIGHT, lw=0))
    axes.set_title(f"pupil: {length_text(D)}")
    _frame(axes, 0.6 * D, f"square: {length_text(step)}, seen by one pixel")


def _draw_lenslets(axes: Axes, cam: Plenoptic) -> None:
    """Draw lenslets about the axis, and the images of the pupil behind them."""
    p = cam.mla.pitch
    ny, nx = cam.mla.count
    centres = _centres(cam)
    for draw in (_lenslet, _pupil_image):  # images above all lenslets, so that overlaps show
        for y, x in centres:
            axes.add_patch(draw(cam, y, x))
    axes.set_title(f"lenslets: {nx} x {ny}, {length_text(p)}")
    _frame(axes, _LENSLETS * p / 2, "green: image of the pupil behind each")


def _draw_pixels(axes: Axes, cam: Plenoptic) -> None:
    """Draw the pixels behind the lenslet on the axis."""
    p, pixel = cam.mla.pitch, cam.pixel_pitch
    half = 0.75 * p
    edges = _edges(cam, pixel, half)
    for draw in (axes.vlines, axes.hlines):
        draw(edges, -half, half, color=_PIXEL, lw=0.6, zorder=0)
    axes.add_patch(_lenslet(cam, 0.0, 0.0, fc="none"))
    axes.add_patch(_pupil_image(cam, 0.0, 0.0))
    airy = 2.44 * cam.wavelength * cam.sensor_distance / cam.mla.diameter
    axes.add_patch(Circle((0, 0), airy / 2, fc="none", ec=_AIRY, lw=1.5))
    count = f"{cam.pixels_per_lenslet:.3g}"
    axes.set_title(f"pixels: {count} x {count} a lenslet, {length_text(pixel)}")
    _frame(axes, half, f"red: Airy disc of a lenslet, {length_text(airy)}")


def _edges(cam: Plenoptic, step: float, half: float) -> Any:
    """Return the edges of cells up to a half width; an odd number of pixels has one on the axis."""
    shift = 0.5 * (round(cam.pixels_per_lenslet) % 2)
    count = int(half / step)
    edges = (np.arange(-count - 1, count + 2) + shift) * step
    return edges[np.abs(edges) <= half]


def _centres(cam: Plenoptic) -> list[tuple[float, float]]:
    """Return the centres (y, x) of the lenslets about the axis in metres."""
    p, hexagonal = cam.mla.pitch, cam.mla.lattice == "hexagonal"
    row = p * np.sqrt(3) / 2 if hexagonal else p
    indices = range(-_LENSLETS // 2 - 1, _LENSLETS // 2 + 2)
    return [(k * row, (i + 0.5 * (hexagonal and k % 2)) * p) for k in indices for i in indices]


def _lenslet(cam: Plenoptic, y: float, x: float, *, fc: str = _GLASS) -> Any:
    """Return the outline of a lenslet."""
    mla = cam.mla
    style: dict[str, Any] = {"fc": fc, "ec": _RIM, "lw": 1.0}
    if mla.fill == "circular":
        return Circle((x, y), mla.diameter / 2, **style)
    if mla.lattice == "hexagonal":
        return RegularPolygon((x, y), _CORNERS, radius=mla.pitch / np.sqrt(3), **style)
    return Rectangle((x - mla.pitch / 2, y - mla.pitch / 2), mla.pitch, mla.pitch, **style)


def _pupil_image(cam: Plenoptic, y: float, x: float) -> Circle:
    """Return the image of the pupil behind a lenslet at (y, x)."""
    scale = cam.sensor_distance / cam.array_distance
    centre = (x * (1 + scale), y * (1 + scale))
    return Circle(centre, scale * cam.aperture_diameter / 2, fc=_LIGHT, alpha=0.35, lw=0)


def _frame(axes: Axes, half: float, caption: str) -> None:
    """Set equal axes, and write a caption below."""
    axes.set(xlim=(-half, half), ylim=(-half, half), xticks=[], yticks=[])
    axes.set_aspect("equal", adjustable="box")
    axes.set_xlabel(caption)
