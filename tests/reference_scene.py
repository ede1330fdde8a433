"""Float64 twin of scenes of surfaces: 64 rays for every pixel of every view.

A surface's brightness in a pixel is that of the pixel's centre ray at the d where this ray meets it
if all 64 rays see it, else at the mean d of those that do.

Surfaces are read by their attributes; nothing here imports the package under test.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from reference_optics import Real
from scipy.ndimage import map_coordinates, spline_filter1d

NOTHING = -np.inf
SIDE = 8


def light_field(
    surfaces: Any, views: tuple[int, int], shape: tuple[int, int], *, background: float = 0.0
) -> Real:
    """L[v, u, y, x, c] without noise."""
    (V, U), (ny, nx) = views, shape
    channels = max(one.texture.samples.shape[2] for one in surfaces)
    out = np.zeros((V, U, ny, nx, channels))
    y, x = np.arange(ny)[:, None] - (ny - 1) / 2, np.arange(nx)[None, :] - (nx - 1) / 2
    parts = (np.arange(SIDE) + 0.5) / SIDE - 0.5
    for v in range(V):
        for u in range(U):
            a, b = v - (V - 1) / 2, u - (U - 1) / 2
            rays = np.broadcast_arrays(
                y[..., None, None] + parts[:, None], x[..., None, None] + parts
            )
            d, seen = first_hit(surfaces, *rays, a, b)
            centre, _ = first_hit(surfaces, *np.broadcast_arrays(y, x), a, b)
            for i, one in enumerate(surfaces):
                mine = seen == i
                count = mine.sum(axis=(2, 3))
                mean = np.where(mine, d, 0).sum(axis=(2, 3)) / np.maximum(count, 1)
                place = np.where(count == SIDE**2, centre, mean)
                light = brightness(one, y, x, place, a, b)
                out[v, u] += (count / SIDE**2)[..., None] * light
            out[v, u] += background * (seen < 0).mean(axis=(2, 3))[..., None]
    return out


def disparity(surfaces: Any, shape: tuple[int, int]) -> tuple[Real, Any]:
    """d and the surface's number at the pixels of the centre view."""
    ny, nx = shape
    y, x = np.arange(ny)[:, None] - (ny - 1) / 2, np.arange(nx)[None, :] - (nx - 1) / 2
    d, seen = first_hit(surfaces, *np.broadcast_arrays(y, x), 0.0, 0.0)
    return np.where(seen < 0, np.nan, d), seen


def first_hit(surfaces: Any, y: Real, x: Real, a: float, b: float) -> tuple[Real, Any]:
    """The largest d on each ray (y + d a, x + d b), and whose it is."""
    all_d = np.stack([hit(one, y, x, a, b) for one in surfaces])
    best = all_d.max(axis=0)
    return best, np.where(best == NOTHING, -1, all_d.argmax(axis=0))


def hit(one: Any, y: Real, x: Real, a: float, b: float) -> Real:
    """Where rays meet one surface."""
    if hasattr(one, "slope"):
        d = np.full(y.shape, float(one.disparity))
        for _ in range(200):  # a contraction where |gy a + gx b| < 1
            d = one.disparity + one.slope[0] * (y + d * a) + one.slope[1] * (x + d * b)
        Y, X = y + d * a, x + d * b
        return np.where(inside(one.outline, Y, X), d, NOTHING)

    def surface(d: float) -> Real:
        r2 = (y + d * a - one.centre[0]) ** 2 + (x + d * b - one.centre[1]) ** 2
        return ((d - one.disparity) / one.height) ** 2 + r2 / one.radius**2 - 1

    low, middle, high = (surface(d) for d in (-1.0, 0.0, 1.0))
    A, B = (low + high) / 2 - middle, (high - low) / 2
    rest = B**2 - 4 * A * middle
    return np.where(rest >= 0, (-B + np.sqrt(np.maximum(rest, 0))) / (2 * A), NOTHING)


def inside(outline: Any, Y: Real, X: Real) -> Any:
    """Whether points lie in an outline."""
    if outline is None:
        return np.ones(Y.shape, bool)
    if hasattr(outline, "contours"):
        found = np.zeros(Y.shape, bool)
        for line in outline.contours:
            for (y0, x0), (y1, x1) in zip(line, np.roll(line, -1, axis=0), strict=True):
                if x0 != x1:  # rays towards +Y
                    crossed = (x0 > X) != (x1 > X)
                    found ^= crossed & (y0 + (X - x0) * (y1 - y0) / (x1 - x0) > Y)
        return found
    z = ((Y - outline.centre[0]) + 1j * (X - outline.centre[1])) * np.exp(-1j * outline.angle)
    if not hasattr(outline, "count"):
        return (z.real / outline.half[0]) ** 2 + (z.imag / outline.half[1]) ** 2 <= 1
    share = z.real / outline.length + 0.5
    width = outline.widths[0] * (1 - share) + outline.widths[1] * share
    middles = (np.arange(outline.count) - (outline.count - 1) / 2) * outline.period
    near = np.abs(z.imag[..., None] - middles).min(axis=-1)
    return (np.abs(z.real) <= outline.length / 2) & (near <= width / 2)


def texture(one: Any, Y: Real, X: Real) -> Real:
    """A periodic cubic B-spline through the samples, shape (..., c)."""
    values = np.asarray(one.samples, np.float64)
    ny, nx, _ = values.shape
    places = [
        Y / one.scale - one.centre[0] / one.scale + ny // 2,
        X / one.scale - one.centre[1] / one.scale + nx // 2,
    ]
    planes = []
    for plane in np.moveaxis(values, 2, 0):
        for axis in (0, 1):
            if plane.shape[axis] > 1:
                plane = spline_filter1d(plane, 3, axis=axis, mode="grid-wrap")
        planes.append(map_coordinates(plane, places, order=3, mode="grid-wrap", prefilter=False))
    return np.stack(planes, axis=-1)


def brightness(one: Any, y: Real, x: Real, d: Real, a: float, b: float) -> Real:
    """What a surface shows at d on the rays of (y, x)."""
    Y, X = y + d * a, x + d * b
    shade = np.maximum(0, 1 + one.shade[0] * Y + one.shade[1] * X)
    light = texture(one.texture, Y, X) * shade[..., None]
    for spot in one.spots:
        Y0, X0 = spot.centre
        r2 = (y + spot.disparity * a - Y0) ** 2 + (x + spot.disparity * b - X0) ** 2
        light = light + (spot.strength * np.exp(-r2 / (2 * spot.width**2)))[..., None]
    return light


def camera_image(camera: Any, scene: Any, samples: Real) -> Real:
    """Raw image of a plenoptic camera: rays from the sensor through all of its lenslets.

    samples: (y, x) in a lenslet, along the lattice in row pitches and pitches, and (y, x) in a
    pixel, along the lattice in pixels; shape (n, 4).
    """
    mla, z2, z3 = camera.mla, camera.array_distance, camera.sensor_distance
    cos, sin = np.cos(mla.rotation), np.sin(mla.rotation)
    turn = np.array([[cos, sin], [-sin, cos]])  # (y, x) of the lattice to those of the sensor
    in_lens = (samples[:, :2] * (mla.row_pitch, mla.pitch)) @ turn.T
    in_pixel = samples[:, 2:] @ turn.T * camera.pixel_pitch
    grid = camera.grid
    sensor = np.stack(
        np.meshgrid(
            *(o + (np.arange(n) - n // 2) * camera.pixel_pitch
              for o, n in zip(grid.origin, grid.shape, strict=True)),
            indexing="ij",
        ),
        axis=-1,
    )[:, :, None] + in_pixel  # fmt: skip
    step = camera.pixel_pitch * z2 / z3
    lengths = np.asarray(mla.focal_lengths)[mla.types()].ravel()
    out = np.zeros(grid.shape)
    for centre, f in zip(mla.centres().reshape(-1, 2), lengths, strict=True):
        x = centre + in_lens
        slope = (sensor - x) / z3 + in_lens / f  # before the lenslet
        u = (0 if camera.field_lens else x) - z2 * slope
        passes = (u**2).sum(axis=-1) <= (camera.aperture_diameter / 2) ** 2
        place = (x - mla.offset) @ turn / (mla.row_pitch, mla.pitch)  # lenslets from the middle
        b = -(u @ turn) / step
        a = b[..., 0] * mla.pitch / mla.row_pitch
        y, x = np.broadcast_to(place[:, 0], a.shape), np.broadcast_to(place[:, 1], a.shape)
        d, seen = first_hit(scene.surfaces, y, x, a, b[..., 1])
        light = np.where(seen < 0, scene.background, 0.0)
        for i, one in enumerate(scene.surfaces):
            mine = brightness(one, y, x, np.where(seen == i, d, 0), a, b[..., 1]).mean(axis=-1)
            light = np.where(seen == i, mine, light)
        out += np.where(passes, light, 0).mean(axis=-1)
    return out
