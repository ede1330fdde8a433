"""Three stars at three distances before a focused and a standard camera: figure 4.1.

By geometrical rays: lenslets of 150 um and f_mu = 5 mm, F = 240 mm, D = 6.75 mm; the focused camera
has m = 0.2, a = 30 mm and b = 6 mm.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from common import Run, pixels
from drawing import LIGHT
from matplotlib.axes import Axes

from clplen import MicrolensArray, PlenopticCamera, RawImage, SurfaceScene
from clplen.cameras import Ellipse, Plane
from clplen.cameras import picture as table_of
from clplen.lightfield import FocusedImage

DEPTHS = {"near": -6e-3, "in focus": 0.0, "far": 15e-3}  # dz
SPOKES, ACROSS = 12, 0.28  # of a star; its diameter, of the sensor
QUICK = "cameras of 47 x 47 lenslets of 18 pixels"


def cameras(run: Run) -> tuple[Any, Any]:
    """The focused and the standard one."""
    array = MicrolensArray(150e-6, 5e-3, count=47 if run.quick else 75, fill="full")
    given = {"focal_length": 0.120, "mla": array, "wavelength": 532e-9, "device": run.device,
             "pixels_per_lenslet": 18 if run.quick else 30}
    focused = PlenopticCamera.type2(**given, m=0.2)
    D = focused.aperture_diameter
    return focused, PlenopticCamera.type1(**given, aperture_diameter=D)


def places(cam: Any) -> dict[str, float]:
    """X of the stars' middles, in lenslets from the axis."""
    return dict(zip(DEPTHS, np.array([-1, 0, 1]) * 0.31 * cam.mla.count[1], strict=True))


def radius(cam: Any) -> float:
    """Of a star, in lenslets."""
    return ACROSS / 2 * cam.mla.count[1]


def star(y: Any, x: Any) -> np.ndarray:
    """Brightness of a star of radius 1: soft spokes, 0.05 to 1."""
    r, t = np.hypot(y, x), np.arctan2(y, x)
    edge = np.clip(0.5 + 6 * SPOKES * r / 2 * np.sin(SPOKES * t) / SPOKES, 0, 1)
    return np.where(r < 1, 0.05 + 0.95 * edge, 0)


def exposed(cam: Any) -> RawImage:
    """The raw image of the stars."""
    R, n = radius(cam), 512
    grid = (np.arange(n) - (n - 1) / 2) / (n / 2) * 1.05
    table = table_of(star(grid[:, None], grid), scale=2.1 * R / n, smoothing=0.05)
    planes = []
    for name, X in places(cam).items():
        d = _disparity(cam, DEPTHS[name])
        moved = type(table)(table.samples, table.scale, centre=(1.05 * R, X + 1.05 * R))
        planes.append(Plane(d, texture=moved, outline=Ellipse((0.0, X), R)))
    return cam.expose(SurfaceScene(planes), model="rays")


def show(axes: Axes, cam: Any, values: np.ndarray, title: str) -> None:
    """A picture of the whole sensor, about the stars."""
    side = cam.grid.extent[1] * 500
    axes.imshow(values, cmap=LIGHT, vmin=0, vmax=np.quantile(values, 0.998),
                extent=(-side, side, side, -side), interpolation="antialiased")
    axes.set(ylim=(0.33 * side, -0.33 * side), title=title)


def likeness(cam: Any, picture: FocusedImage, name: str) -> float:
    """Correlation of a star with the true one."""
    y, x = (axis - np.mean(axis) for axis in picture.grid.axes())
    R, values = radius(cam) * picture.geometry.pitch, pixels(picture)
    v, u = y[:, None] / R, x / R - places(cam)[name] / radius(cam)
    near = np.hypot(v, u) < 0.95
    return float(np.corrcoef(values[near], star(v, u)[near])[0, 1])


def _disparity(cam: Any, dz: float) -> float:
    """d = (1 - beta) du/p, lenslets for a step of a view, as `SurfaceScene` counts."""
    step = cam.pixel_pitch * cam.array_distance / cam.sensor_distance
    return (1 - cam.array_alpha(dz)) * step / cam.lenslet_pitch
