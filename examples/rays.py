"""Plenoptic cameras drawn to scale from their objects, with thin-lens rays: schematic figures.

Drawings are in millimetres, z from the main lens, heights larger than lengths by a factor that is
said. Points are (x, dz) in metres, as for `PointSources`.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from common import PAPER, Run
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from clplen import MicrolensArray, PlenopticCamera

PURPLE = "#882288"
GLASS, RIM = "#d7e8f4", "#33536b"
LARGER = 40.0  # heights in oblique drawings
FAR = 1e3  # metres: an object at infinity
SCALE = 7 / 6  # sub-images to lenslets of the sketched camera, 1 + f_mu/F


def standard(run: Run, *, pixels: int = 3, distant: bool = False) -> Any:
    """A small 1.0 camera whose parts can be told apart: 11 lenslets, F = 30 mm, f_mu = 5 mm.

    Its sub-images touch one another and are 60 um wide, a whole number of pixels.
    """
    array = MicrolensArray(60e-6 / SCALE, 5e-3, count=11, fill="full")
    lens = {"focal_length": 30e-3, "object_distance": FAR} if distant else {"focal_length": 15e-3}
    return PlenopticCamera.type1(**lens, mla=array, wavelength=532e-9, aperture_diameter=360e-6,
                                 pixels_per_lenslet=pixels / SCALE, device=run.device)


def focused(run: Run, m: float, *, pixels: int = 9, **changes: Any) -> Any:
    """A small 2.0 camera with the same main lens: 11 lenslets of 60 um, f_mu = 5 mm."""
    array = MicrolensArray(60e-6, 5e-3, count=11, fill="full")
    given = {"focal_length": 15e-3, "match": "cone"} | changes
    return PlenopticCamera.type2(**given, m=m, mla=array, wavelength=532e-9,
                                 pixels_per_lenslet=pixels, device=run.device)


def centres(camera: Any) -> np.ndarray:
    """x of the lenslets in metres."""
    count = camera.mla.count[1]
    return (np.arange(count) - (count - 1) / 2) * camera.mla.pitch


def planes(camera: Any, dz: float = 0.0) -> np.ndarray:
    """z of object, main lens, array and sensor in metres."""
    z2 = camera.array_distance
    return np.array([-camera.object_distance - dz, 0, z2, z2 + camera.sensor_distance])


def trace(camera: Any, point: Sequence[float], u: Any) -> np.ndarray:
    """Heights in metres, shape (4, n): of rays of a point through u, at each of `planes`.

    Thin lenses: a height y adds -y/f to the slope (Saleh and Teich 1991, section 1.4). Each ray
    takes the lenslet that it meets; those beside the array end there, NaN on the sensor.
    """
    (x0, dz), u = point, np.atleast_1d(np.asarray(u, float))
    slope = (u - x0) / (camera.object_distance + dz) - u / camera.focal_length
    x = u + camera.array_distance * slope
    c = centres(camera)[np.abs(x[:, None] - centres(camera)).argmin(axis=1)]
    passes = np.abs(x - c) <= camera.mla.diameter / 2 * (1 + 1e-9)
    slope = np.where(passes, slope - (x - c) / camera.mla.f, np.nan)
    return np.array([np.full(u.shape, x0), u, x, x + camera.sensor_distance * slope])


def through(camera: Any, point: Sequence[float], lenslets: Any, at: float = 0.0) -> np.ndarray:
    """u of the rays of a point out of focus that meet lenslets ``at`` so much from their centres.

    Of u (1 - beta) + X = x, with beta and X of `RayOptics`.
    """
    X = camera.on_array([(point[0], 0, point[1])])[0, 0]
    return (centres(camera)[np.atleast_1d(lenslets)] + at - X) / (1 - camera.array_alpha(point[1]))


def image(camera: Any, point: Sequence[float]) -> tuple[float, float]:
    """(z, x) in metres of a point's image by the main lens."""
    z = camera.image_distance / camera.alpha(point[1])
    return z, -point[0] * z / (camera.object_distance + point[1])


def draw_lens(axes: Axes, z: float, middle: float, half: float, thick: float) -> None:
    """A biconvex lens, ``thick`` as a share of the drawing's width."""
    shape = _outline(z, middle, half, thick * float(np.ptp(axes.get_xlim())))
    axes.add_collection(PolyCollection([shape], facecolor=GLASS, edgecolor=RIM, lw=0.8, alpha=0.95,
                                       zorder=4), autolim=False)


def stage(axes: Axes, zlim: Sequence[float], xlim: Sequence[float], title: str = "") -> None:
    """A drawing with its optical axis; limits in mm."""
    axes.set(xlim=zlim, ylim=xlim, xticks=[], ylabel="x / mm", title=title)
    for side in ("top", "right", "bottom"):
        axes.spines[side].set_visible(False)
    axes.spines["left"].set_color("0.6")
    axes.tick_params(color="0.6", labelcolor="0.3")
    axes.axhline(0, color="0.5", lw=0.7, ls=(0, (14, 3, 2, 3)), zorder=1)


def draw_camera(axes: Axes, camera: Any, *, pixels: bool = True, lenslets: bool = True) -> None:
    """Main lens, lenslets, sensor with its pixels, in their places and heights.

    Without lenslets the sensor takes their place.
    """
    wide = np.ptp(axes.get_xlim())
    _, lens, array, sensor = planes(camera) * 1e3
    D, d = camera.aperture_diameter * 1e3, camera.mla.diameter * 1e3
    glass = [(lens, 0.0, D / 2, 0.011 * wide)]
    if lenslets:
        glass += [(array, c, d / 2, 0.006 * wide) for c in centres(camera) * 1e3]
    else:
        sensor = array
    axes.add_collection(PolyCollection([_outline(*one) for one in glass], facecolor=GLASS,
                                       edgecolor=RIM, lw=0.8, alpha=0.95, zorder=4),
                        autolim=False)
    high = axes.get_ylim()[1]
    axes.vlines([lens, lens], [-high, D / 2], [-D / 2, high], color="0.15", lw=2.5, zorder=4)
    if pixels:
        n, dx = camera.grid.shape[1], camera.pixel_pitch * 1e3
        for i in range(n):
            low = (i - n / 2) * dx
            axes.add_patch(Rectangle((sensor, low), 0.012 * wide, dx, lw=0.4, ec="0.25", zorder=4,
                                     fc="0.8" if i % 2 else "0.92"))
    else:
        edge = camera.grid.extent[1] * 500
        axes.vlines(sensor, -edge, edge, color="k", lw=2.5, zorder=4)


def light_pixel(axes: Axes, camera: Any, s: float, colour: str) -> int:
    """Colour the pixel that a ray meets at s metres; its number along x, from 0."""
    n, dx = camera.grid.shape[1], camera.pixel_pitch
    i = int(np.floor(s / dx + n / 2 + 1e-9))
    z, wide = planes(camera)[3] * 1e3, 0.012 * np.ptp(axes.get_xlim())
    axes.add_patch(Rectangle((z, (i - n / 2) * dx * 1e3), wide, dx * 1e3, fc=colour, ec="k", lw=0.6,
                             zorder=5))
    return i


def draw_rays(axes: Axes, camera: Any, point: Sequence[float], u: Any, colours: Any, *,
              lenslets: bool = True, **style: Any) -> np.ndarray:
    """Rays of a point in one colour or one each, to the sensor or the array; their heights."""
    heights, z = trace(camera, point, u), planes(camera, point[1]) * 1e3
    each = [colours] * heights.shape[1] if isinstance(colours, str) else colours
    last = 4 if lenslets else 3
    for line, colour in zip(heights.T * 1e3, each, strict=True):
        axes.plot(z[:last], line[:last], color=colour, **({"lw": 1.1, "zorder": 3} | style))
    return heights


def go_on(axes: Axes, camera: Any, point: Sequence[float], u: Any, colours: Any) -> None:
    """Dotted: rays behind the array as if it were not there, to the main lens' image."""
    heights, (z, x) = trace(camera, point, u), image(camera, point)
    each = [colours] * heights.shape[1] if isinstance(colours, str) else colours
    start = planes(camera)[2]
    for at, colour in zip(heights[2], each, strict=True):
        axes.plot([start * 1e3, z * 1e3], [at * 1e3, x * 1e3], color=colour, lw=0.8, ls=":",
                  zorder=2)


def mark_plane(axes: Axes, z: float, reach: float, colour: str = "0.4") -> None:
    """A dashed plane at z, from -reach to reach, in mm."""
    axes.vlines(z, -reach, reach, color=colour, lw=1, ls=(0, (4, 2)), zorder=2)


def names(axes: Axes, words: dict[float, str], row: float = 0.0) -> None:
    """Words above places along z in mm."""
    for z, text in words.items():
        axes.text(z, 1.02 + row, text, ha="center", va="bottom", size=8,
                  transform=axes.get_xaxis_transform())


def distance(axes: Axes, start: float, end: float, text: str, row: float = 0.0) -> None:
    """A length along z as on a technical drawing, below it; in mm."""
    low = -0.04 - row
    style = {"arrowstyle": "<|-|>", "color": "0.25", "lw": 0.8, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", (end, low), (start, low), xycoords=axes.get_xaxis_transform(),
                  textcoords=axes.get_xaxis_transform(), annotation_clip=False,
                  arrowprops=style | {"mutation_scale": 7})
    axes.text((start + end) / 2, low - 0.015, text, ha="center", va="top", size=8,
              transform=axes.get_xaxis_transform())


def note(axes: Axes, z: float, x: float, text: str, **style: Any) -> None:
    """Words on paper that hides the lines behind, at a place in mm."""
    axes.text(z, x, text, **({"size": 8, "va": "center", "bbox": PAPER, "zorder": 6} | style))


def say_scale(figure: Figure, axes: Axes, words: str = "", *, where: str = "") -> None:
    """Write below a figure how much larger heights than lengths are drawn, from its layout."""
    label = figure.supxlabel("drawn to scale")
    figure.draw_without_rendering()
    box = axes.get_window_extent()
    factor = (box.height / np.ptp(axes.get_ylim())) / (box.width / np.ptp(axes.get_xlim()))
    label.set_text(f"{words}{'; ' if words else ''}{where}{' ' if where else ''}drawn to scale, "
                   f"heights {factor:.0f} times larger than lengths")


def in_space(z: Any, x: Any, y: Any) -> tuple[np.ndarray, np.ndarray]:
    """Where places in mm lie in an oblique drawing: z to the right, x to the viewer, y up."""
    z, x, y = np.broadcast_arrays(*(np.asarray(v, float) for v in (z, x, y)))
    return z - 0.5 * LARGER * x, LARGER * (y - 0.35 * x)


def plane_in_space(axes: Axes, z: float, half: float, colour: str) -> None:
    """The square frame of a plane at z in an oblique drawing, with its two axes; mm."""
    x, y = half * np.array([[-1, 1, 1, -1, -1], [-1, -1, 1, 1, -1]])
    axes.fill(*in_space(z, x, y), color=colour, alpha=0.07)
    axes.plot(*in_space(z, x, y), color=colour, lw=1)
    axes.plot(*in_space(z, [-half, half], 0), color=colour, lw=0.5)
    axes.plot(*in_space(z, 0, [-half, half]), color=colour, lw=0.5)


def space(axes: Axes, ends: Sequence[float]) -> None:
    """An oblique drawing with its optical axis."""
    axes.set_axis_off()
    axes.set_aspect("equal")
    axes.plot(*in_space(ends, 0, 0), color="0.5", lw=0.7, ls=(0, (14, 3, 2, 3)))


def stripes(axes: Axes, camera: Any, colours: dict[int, str]) -> None:
    """What the pixels of some lenslets take in at the main image: x in mm, slopes in mrad.

    A ray from x of slope theta meets the array at x + a theta: a pixel's box is dx/m wide, d/a high
    and slanted by -1/a.
    """
    a, m, d = camera.a * 1e3, abs(camera.m), camera.mla.diameter * 1e3
    n = round(camera.pixels_per_lenslet)
    for k, colour in colours.items():
        c = centres(camera)[k] * 1e3
        edges = c + (np.arange(n + 1) / n - 0.5) * d / m
        low = (c - d / 2 - edges) / a * 1e3
        boxes = [[(edges[i], low[i]), (edges[i + 1], low[i + 1]),
                  (edges[i + 1], low[i + 1] + d / a * 1e3), (edges[i], low[i] + d / a * 1e3)]
                 for i in range(n)]
        axes.add_collection(PolyCollection(boxes, facecolor=colour, edgecolor="w", lw=0.6,
                                           alpha=0.6), autolim=False)
    axes.set(xlabel="x on the main image / mm", ylabel=r"slope $\theta$ of a ray / mrad")


def _outline(z: float, middle: float, half: float, thick: float) -> np.ndarray:
    """A biconvex lens."""
    y = np.linspace(-1, 1, 41)
    bulge = thick * (1 - y**2)
    edge = np.r_[z + bulge, z - bulge[::-1]]
    return np.column_stack([edge, middle + half * np.r_[y, y[::-1]]])
