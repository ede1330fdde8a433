"""Checks of traced scenes: a slanted ground and a sphere, as views and behind a camera."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from clplen.cameras.exposure.ray_exposure import SAMPLES, sample_rays
from clplen.cameras.plenoptic_camera import PlenopticCamera
from clplen.cameras.scenes.surface_scene import SurfaceScene
from clplen.cameras.scenes.surfaces import Plane, Sphere
from clplen.cameras.scenes.textures import Texture
from clplen.selftest import twins
from clplen.selftest.check import Check, Pairs
from clplen.wave.lenslets import MicrolensArray

if TYPE_CHECKING:
    from clplen.compute.device import Device

GREY = Texture(twins.reals(1, 5, 7), 2.3, centre=(1.7, -0.6))
GROUND = Plane(-0.9, (0.031, -0.043), texture=GREY, shade=(0.02, -0.013))
BALL = Sphere((0.8, -1.3), 4.6, disparity=-0.4, height=1.7, texture=GREY)


def _hits(ball: Any, ground: Any, y: Any, x: Any, a: Any, b: Any) -> tuple[Any, Any]:
    """d of the ball (or -inf) and of the ground on the rays (y + d a, x + d b)."""
    d = (ground.disparity + ground.slope[0] * y + ground.slope[1] * x) / (
        1 - ground.slope[0] * a - ground.slope[1] * b
    )
    h, r = ball.height, ball.radius
    py, px = y - ball.centre[0], x - ball.centre[1]
    A = 1 / h**2 + (a**2 + b**2) / r**2  # A d^2 - 2 B d + C = 0
    B = ball.disparity / h**2 - (py * a + px * b) / r**2
    C = (ball.disparity / h) ** 2 + (py**2 + px**2) / r**2 - 1
    root = B**2 - A * C
    return np.where(root >= 0, (B + np.sqrt(np.maximum(root, 0))) / A, -np.inf), d


def _spline_weights(t: Any) -> Any:
    """Of a cubic B-spline at -1, 0, 1, 2, on a new last axis."""
    away = np.abs(np.asarray(t)[..., None] - np.arange(-1, 3))
    near, far = (4 - 6 * away**2 + 3 * away**3) / 6, (2 - away) ** 3 / 6
    return np.where(away <= 1, near, np.where(away < 2, far, 0.0))


def _light(surface: Any, y: Any, x: Any, d: Any, a: Any, b: Any) -> Any:
    """Brightness of a surface at d: its texture, a periodic spline through samples, and shade."""
    from scipy.ndimage import spline_filter

    Y, X = y + d * a, x + d * b
    values = np.asarray(surface.texture.samples, float)[..., 0]
    knots = spline_filter(values, 3, mode="grid-wrap")
    (ny, nx), scale, centre = values.shape, surface.texture.scale, surface.texture.centre
    ty, tx = (Y - centre[0]) / scale + ny // 2, (X - centre[1]) / scale + nx // 2
    rows, columns = (np.floor(t).astype(int)[..., None] + np.arange(-1, 3) for t in (ty, tx))
    wy, wx = (_spline_weights(t - np.floor(t)) for t in (ty, tx))
    found = knots[rows[..., :, None] % ny, columns[..., None, :] % nx]
    shade = np.maximum(0, 1 + surface.shade[0] * Y + surface.shade[1] * X)
    return shade * np.einsum("...i,...j,...ij->...", wy, wx, found)


def _scene(device: Device) -> Pairs:
    """Pixels of which all rays see one surface: brightness by the pixel's centre ray."""
    views, (ny, nx) = (2, 3), (11, 14)
    lf, truth = SurfaceScene([GROUND, BALL]).light_field(views, (ny, nx), device=device)
    y, x = np.arange(ny)[:, None] - (ny - 1) / 2, np.arange(nx) - (nx - 1) / 2
    y, x = np.broadcast_arrays(y, x)
    yield np.maximum(*_hits(BALL, GROUND, y, x, 0, 0)), truth.disparity
    parts = np.linspace(-0.5, 0.5, 11)
    pictures, rim = lf.to_numpy(), 0
    for v, u in np.ndindex(views):
        a, b = v - 0.5, u - 1.0
        ball, ground = _hits(BALL, GROUND, y, x, a, b)
        fine = _hits(
            BALL, GROUND, y[..., None, None] + parts[:, None], x[..., None, None] + parts, a, b
        )
        share = (fine[0] > fine[1]).mean(axis=(2, 3))
        mine, other = (_light(s, y, x, np.where(np.isfinite(d), d, 0), a, b)
                       for s, d in ((BALL, ball), (GROUND, ground)))  # fmt: skip
        plain = (share == 0) | (share == 1)
        rim += np.count_nonzero(~plain)
        yield np.where(share == 1, mine, other)[plain], pictures[v, u][plain]
    assert rim > 0


def _camera(device: Device) -> Pairs:
    """The sensor of a small camera: rays from each pixel through each lenslet, backwards."""
    ground = Plane(-0.15, (0.03, -0.02), texture=Texture(twins.reals(2, 5, 4), 1.3))
    colour = Texture(twins.reals(3, 3, 3))
    ball = Sphere((-0.3, 0.6), 0.7, disparity=0.1, height=0.2, texture=colour)
    mla = MicrolensArray(150e-6, 10e-3, count=(3, 2), fill="full")
    camera = PlenopticCamera.type1(
        focal_length=0.01, mla=mla, wavelength=700e-9, pixels_per_lenslet=6.3, device=device,
        aperture_diameter=0.26e-3,
    )  # fmt: skip
    raw = camera.expose(SurfaceScene([ground, ball], background=0.2), model="rays").to_numpy()
    samples = sample_rays(mla, count=SAMPLES).astype(float)
    z2, z3, pixel = camera.array_distance, camera.sensor_distance, camera.pixel_pitch
    places = np.stack(np.meshgrid(camera.grid.y, camera.grid.x, indexing="ij"), -1)
    sensor = places[:, :, None] + samples[:, 2:] * pixel
    step, expected = pixel * z2 / z3, np.zeros(raw.shape)
    for centre in mla.centres().reshape(-1, 2):
        at = centre + samples[:, :2] * mla.pitch
        u = at - z2 * ((sensor - at) / z3 + samples[:, :2] * mla.pitch / 10e-3)
        passes = (u**2).sum(axis=-1) <= (camera.aperture_diameter / 2) ** 2
        a, b = np.moveaxis(-u / step, -1, 0)
        y, x = (np.broadcast_to(p, a.shape) for p in (at / mla.pitch).T)
        near, far = _hits(ball, ground, y, x, a, b)
        sees = near > far
        light = _light(ground, y, x, far, a, b)
        light[sees] = _light(ball, y, x, np.where(sees, near, 0), a, b)[sees]
        expected += np.where(passes, light, 0).mean(axis=-1)
    # Of 1e5 rays a few meet a rim, and fall on its other side in float32: up to 8 pixels.
    agreed = np.argsort(np.abs(raw - expected), axis=None)[:-8]
    yield expected.ravel()[agreed], raw.ravel()[agreed]


CHECKS = (
    Check("scene", "views and disparity of a ground and a ball", _scene, 2e-5,
          ("scene.cl", "surfaces.cl")),
    Check("rays", "the same kind of scene behind a camera", _camera, 1e-4, ("rays.cl",)),
)  # fmt: skip
