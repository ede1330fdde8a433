"""A point before the standard camera in phase space: figures 3.4, 3.5, 3.9 to 3.11, 3.15 and 3.16.

The camera is that of section 1.5: f = 120 mm in 2f and 2f, f_mu = 10 mm, 532 nm. A colour is a
zone of the main lens, the same in rays and in slices.
"""

from __future__ import annotations

from typing import Any

import matplotlib
import numpy as np
from common import Run
from drawing import LIGHT
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle
from rays import draw_camera, planes, stage, trace

from clplen import LightField, MicrolensArray, PlenopticCamera, PointSources, refocus
from clplen.cameras import Plenoptic1

QUICK = "a camera of 51 x 51 lenslets"
DEPTHS = {"in focus": 0.0, "closer": -50e-3, "farther": 50e-3}  # dz
BESIDE = 1.2e-3  # metres on the array between the points of `three`
ZONES = 9  # of the main lens, each with a colour
COLOURS = matplotlib.colormaps["plasma"](np.linspace(0, 0.88, ZONES))


def camera(run: Run, *, pitch: float = 150e-6, count: int = 101, pixels: int = 30) -> Plenoptic1:
    """The camera of section 1.5, or one of other lenslets and the aperture that matches them."""
    count = min(count, 51) if run.quick else count
    lenslets = MicrolensArray(pitch, 10e-3, count=count, fill="full")
    return PlenopticCamera.type1(focal_length=0.120, mla=lenslets, wavelength=532e-9,
                                 pixels_per_lenslet=pixels, device=run.device)


def taken(cam: Plenoptic1, dz: float) -> LightField:
    """Light field of a point on the axis."""
    return LightField.from_raw(cam.expose(PointSources((0, 0, dz))))


def three(cam: Plenoptic1) -> tuple[LightField, dict[str, float]]:
    """Light field of a point closer, one in focus and one farther, and where they are, X."""
    places = dict(zip(("closer", "in focus", "farther"), (-BESIDE, 0.0, BESIDE), strict=True))
    positions = [(-X * (cam.object_distance + DEPTHS[name]) / cam.image_distance, 0, DEPTHS[name])
                 for name, X in places.items()]
    return LightField.from_raw(cam.expose(PointSources(positions))), places


def summed(lf: LightField) -> np.ndarray:
    """The slice (u, x) of all light: summed over v and y, u (or theta) rising."""
    light = lf.to_numpy().astype(float).sum(axis=(0, 2))
    return light if lf.spacing[1] > 0 else light[::-1]


def sheared(lf: LightField, alpha: float, *, rescale: bool = False) -> np.ndarray:
    """The slice (u, x) of the light field that `refocus` sums up: column by column of the views."""
    views, rows = lf.shape[:2], []
    for u in range(views[1]):
        column = np.zeros(views)
        column[:, u] = 1
        one = LightField.from_array(lf.data, device=lf.device, spacing=lf.spacing, weights=column,
                                    camera=lf.camera)
        image = refocus(one, alpha=alpha, rescale=rescale).to_numpy().astype(float)
        rows.append(image.sum(axis=0) * views[0])
    return np.array(rows[::-1])


def axes_of(lf: LightField) -> tuple[np.ndarray, np.ndarray]:
    """u (or theta), rising, and x of a slice, in metres (or radians)."""
    (_, du, _, dx), (_, n, _, m) = lf.spacing, lf.shape
    return (np.arange(n) - (n - 1) / 2) * abs(du), (np.arange(m) - (m - 1) / 2) * dx


def slope(light: np.ndarray, u: np.ndarray, x: np.ndarray, *, within: float, reach: float) -> float:
    """dx/du of a slice: regression of x on u by the squared light, abs(u) and abs(x) limited."""
    weight = light**2 * (np.abs(u) < within)[:, None] * (np.abs(x) < reach)
    uu, xx = np.broadcast_arrays(u[:, None], x)
    mu, mx = (np.average(t, weights=weight) for t in (uu, xx))
    return float(np.sum(weight * (uu - mu) * (xx - mx)) / np.sum(weight * (uu - mu) ** 2))


def zones(cam: Any, rays: int = 1) -> np.ndarray:
    """Places u on the main lens in metres, so many in each zone, shape (ZONES, rays)."""
    step = cam.aperture_diameter / ZONES
    return (np.arange(ZONES)[:, None] - ZONES / 2 + (np.arange(rays) + 0.5) / rays) * step


def draw_cells(axes: Axes, cam: Any, dz: float, shown: int) -> None:
    """The slice as samples p wide and a zone high, filled by their share of the rays; in mm."""
    p, u = cam.lenslet_pitch * 1e3, zones(cam, rays=300)
    tall, middle = cam.aperture_diameter * 1e3 / ZONES, shown // 2
    hits = np.rint(u * (1 - cam.alpha(dz)) / cam.lenslet_pitch).astype(int)
    for n, (row, colour) in enumerate(zip(hits, COLOURS, strict=True)):
        for k in range(-middle, middle + 1):
            place = ((k - 0.5) * p, (n - ZONES / 2) * tall)
            axes.add_patch(Rectangle(place, p, tall, fc=colour, alpha=float(np.mean(row == k))))
            axes.add_patch(Rectangle(place, p, tall, fill=False, ec="0.75", lw=0.5))
    side, end = shown * p / 2, cam.aperture_diameter * 500
    axes.set(xlim=(-side, side), ylim=(-end, end))


def draw_end(axes: Axes, beside: Axes, cam: Plenoptic1, dz: float, line: np.ndarray,
             reach: float) -> None:
    """The last 12 mm by rays, and the light on the sensor by waves."""
    p, (_, _, array, sensor) = cam.lenslet_pitch * 1e3, planes(cam) * 1e3
    u = zones(cam, rays=12 if dz else 3)
    stage(axes, (array - 2, sensor + 0.4), (-reach * p, reach * p))
    draw_camera(axes, cam, pixels=False)
    _, _, x, s = trace(cam, (0.0, dz), u.ravel()) * 1e3
    for at, hit, colour in zip(x, s, np.repeat(COLOURS, u.shape[1], axis=0), strict=True):
        axes.plot([array, sensor], [at, hit], color=colour, lw=0.5)
    for k in np.arange(-6, 7):
        axes.axhspan((k - 0.5) * p, (k + 0.5) * p, color="0.96" if k % 2 else "0.9", lw=0)
        beside.axhspan((k - 0.5) * p, (k + 0.5) * p, color="0.96" if k % 2 else "0.9", lw=0)
    y = cam.grid.y * 1e3
    beside.fill_betweenx(y, 0, np.sqrt(line / line.max()), color="0.3", lw=0)
    beside.set(ylim=axes.get_ylim(), xlim=(0, 1.05), xticks=[], yticks=[])


def draw_slice(axes: Axes, lf: LightField, light: np.ndarray, shown: float) -> Any:
    """A measured slice: square root of the light over the largest, in mm, some lenslets wide."""
    u, x = axes_of(lf)
    (du, dx), side = (1e3 * (axis[1] - axis[0]) for axis in (u, x)), shown * 500 * lf.spacing[3]
    end = u.size * du / 2
    drawn = axes.imshow(np.sqrt(np.maximum(light, 0) / light.max()), cmap=LIGHT, aspect="auto",
                        origin="lower", extent=(-x.size * dx / 2, x.size * dx / 2, -end, end))
    axes.set(xlim=(-side, side), ylim=(-end, end))
    return drawn


def span(axes: Axes, start: tuple[float, float], end: tuple[float, float], text: str, *,
         aside: tuple[float, float] = (0, 3), **words: Any) -> None:
    """A dimension: a double arrow and its text, so many points beside its middle."""
    colour = words.get("color", "0.2")
    axes.annotate("", end, start, annotation_clip=False,
                  arrowprops={"arrowstyle": "<->", "color": colour, "lw": 0.9,
                              "shrinkA": 0, "shrinkB": 0, "mutation_scale": 8})
    middle = ((start[0] + end[0]) / 2, (start[1] + end[1]) / 2)
    axes.annotate(text, middle, aside, textcoords="offset points", annotation_clip=False,
                  **({"ha": "center", "va": "bottom", "color": colour} | words))
