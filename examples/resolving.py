"""What a standard and a focused camera resolve: figures 4.1 to 4.6.

Both have one sensor of 5 um pixels, one main lens (f = 120 mm in 2f and 2f, D = 10 mm), lenslets of
150 um and f_mu = 3 mm, and light of 532 nm. They differ in where the array and the sensor stand: on
the main lens' image and f_mu behind (1.0); a = 18 mm behind it and b = 3.6 mm (2.0, m = 0.2).
Places and frequencies are those of the main lens' image.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from common import BLUE, RED, Run, pixels
from drawing import LIGHT
from matplotlib.axes import Axes

from clplen import (
    LightField,
    MicrolensArray,
    PlenopticCamera,
    PointSources,
    RawImage,
    render_focused,
)
from clplen.analysis import PSF, circular_mtf, square_mtf
from clplen.cameras import Plenoptic1, Plenoptic2
from clplen.lightfield import FocusedGeometry, FocusedImage

M = 0.2
QUICK = "cameras of 75 x 75 lenslets, coarser curves"
COLOURS = {"1.0": RED, "2.0": BLUE}
HALF = 1.0e-3  # metres to either side of a point that its image is taken from


def _given(run: Run) -> dict[str, Any]:
    array = MicrolensArray(150e-6, 3e-3, count=75 if run.quick else 101, fill="full")
    return {"focal_length": 0.120, "mla": array, "wavelength": 532e-9, "aperture_diameter": 10e-3,
            "pixels_per_lenslet": 30, "device": run.device}


def standard(run: Run) -> Plenoptic1:
    """The 1.0 camera."""
    return PlenopticCamera.type1(**_given(run))


def focused(run: Run, m: float = M) -> Plenoptic2:
    """The 2.0 camera."""
    return PlenopticCamera.type2(**_given(run), m=m)


def pair(run: Run) -> dict[str, Any]:
    """Both cameras by their names."""
    return {"1.0": standard(run), "2.0": focused(run)}


def responses(run: Run) -> dict[str, PSF]:
    """The images of a point by both."""
    steps, fine = (4, 4e-6) if run.quick else (32, 3e-6)
    return {"1.0": response1(standard(run), steps), "2.0": response2(focused(run), fine)}


def exposed(cam: Any, x: float = 0.0, y: float = 0.0) -> RawImage:
    """Raw image of a point whose image lies at (x, y)."""
    return cam.expose(PointSources((-x, -y, 0)))


def about(raw: RawImage, half: float) -> RawImage:
    """The middle of a raw image, so many metres to either side: all that a point there needs."""
    ny, nx = raw.shape
    cut = [n // 2 - round(half / raw.pixel_pitch) for n in (ny, nx)]
    data = raw.to_numpy()[cut[0] : ny - cut[0], cut[1] : nx - cut[1]]
    grids = {name: replace(grid, first=(grid.first[0] - cut[0], grid.first[1] - cut[1]))
             for name, grid in (("sub_images", raw.sub_images), ("cells", raw.cells))}
    return replace(raw, data=raw.device.upload(np.ascontiguousarray(data)), **grids)


def blended(raw: RawImage, m: float, fine: float) -> FocusedImage:
    """The picture with samples so many metres apart on the main lens' image."""
    one = raw.pixel_pitch * FocusedGeometry.of(raw).ratio(m) / m
    return render_focused(raw, m=m, step=fine / one, interpolation="linear")


def response2(cam: Plenoptic2, fine: float = 3e-6) -> PSF:
    """Image of a point by the 2.0 camera, blended from all lenslets that see it."""
    picture = blended(about(exposed(cam), HALF + 0.6e-3), cam.m, fine)
    (y, x), side = picture.positions(), 2 * round(HALF / picture.pitch) + 1
    psf = PSF(pixels(picture), picture.pitch, (float(y[y.size // 2]), float(x[x.size // 2])))
    return psf.cut((0.0, 0.0), (side, side))


def response1(cam: Plenoptic1, steps: int) -> PSF:
    """Image of a point by the 1.0 camera, as it is where the point moves in fractions of a lenslet.

    A lenslet at x shows R(x - X) of a point at X: the renderings of points at X = 0, p/steps, ..
    interleaved, summed along y; R is taken to be the same along both axes.
    """
    p, n = cam.lenslet_pitch, cam.mla.count[1]
    lines = [pixels(LightField.from_raw(exposed(cam, k * p / steps)).render()).sum(axis=0)
             for k in range(steps // 2 + 1)]
    lines += [lines[steps - k][::-1] for k in range(steps // 2 + 1, steps)]  # by symmetry
    shift = np.arange(steps)
    shift[steps // 2 + 1 :] -= steps
    places = (np.arange(n) - (n - 1) / 2) * p - shift[:, None] * p / steps
    order = np.argsort(places.ravel())
    t, line = places.ravel()[order], np.array(lines).ravel()[order]
    near = np.flatnonzero(np.abs(t) < HALF)
    line, t = line[near], t[near]
    return PSF(np.outer(line, line), p / steps, (float(t[t.size // 2]),) * 2)


def rendered(raw: RawImage, psf: PSF) -> tuple[np.ndarray, float]:
    """The picture of the point and its pitch: one pixel a lenslet, or as fine as the PSF."""
    if raw.camera.kind == "focused":
        return psf.values, psf.pitch[1]
    return pixels(LightField.from_raw(raw).render()), raw.camera.lenslet_pitch


def two_points(cam: Any, separation: float) -> tuple[np.ndarray, float]:
    """Rendering of two points beside each other on the axis, and its pitch."""
    raw = cam.expose(PointSources([(-separation / 2, 0, 0), (separation / 2, 0, 0)]))
    if cam.kind == "focused":
        found = blended(about(raw, 1e-3), cam.m, 6e-6)
        return pixels(found), found.pitch
    return pixels(LightField.from_raw(raw).render()), cam.lenslet_pitch


def draw_cells(axes: Axes, cam: Any) -> None:
    """The borders of the cells about the axis."""
    for edge in (np.arange(-7, 7) + 0.5) * cam.lenslet_pitch * 1e3:
        axes.axvline(edge, color="w", lw=0.4, alpha=0.5)
        axes.axhline(edge, color="w", lw=0.4, alpha=0.5)


def draw_spots(axes: Axes, cam: Any) -> None:
    """The raw image of a point, about the axis."""
    near, values = 0.9, about(exposed(cam), 1e-3).to_numpy()
    side = values.shape[0] * cam.pixel_pitch * 500
    axes.imshow(np.sqrt(values), cmap=LIGHT, extent=(-side, side, side, -side))
    draw_cells(axes, cam)
    axes.set(xlim=(-near, near), ylim=(near, -near), xlabel="x / mm",
             title=f"m = {cam.m:g}: {cam.views:.1f} views")


def transfer1(cam: Plenoptic1, f: Any) -> np.ndarray:
    """In closed form: Airy's pattern of the main lens, averaged over a lenslet."""
    return np.sinc(f * cam.lenslet_pitch) * circular_mtf(
        f, wavelength=cam.wavelength, distance=cam.image_distance, width=cam.aperture_diameter)


def transfer2(cam: Plenoptic2, f: Any) -> np.ndarray:
    """In closed form: a lenslet's diffraction, a pixel, and linear interpolation between pixels."""
    return np.sinc(f * cam.pixel_pitch / abs(cam.m)) ** 3 * square_mtf(
        f, wavelength=cam.wavelength, distance=abs(cam.a), width=cam.lenslet_diameter)


def line_of(transfer: np.ndarray, f: np.ndarray, x: np.ndarray) -> np.ndarray:
    """The image of a line from its transfer function, 1 in the middle."""
    line = np.cos(2 * np.pi * np.multiply.outer(x, f)) @ transfer
    return line / line.max()


def half_width(x: np.ndarray, line: np.ndarray) -> float:
    """Full width at half maximum of a line with one maximum, straight between its samples."""
    at = np.linspace(x[0], x[-1], 50001)
    inside = at[np.interp(at, x, line) > line.max() / 2]
    return float(np.ptp(inside))


TRANSFERS = {"1.0": transfer1, "2.0": transfer2}
