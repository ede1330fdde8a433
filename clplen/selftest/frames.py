"""Checks of raw images: decoding, devignetting, focused cameras, and volumes of microscopes."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from clplen.compute.device import Device
from clplen.lightfield.calibration import raw_decoding
from clplen.lightfield.focused.focused_geometry import FocusedGeometry
from clplen.lightfield.focused.focused_rendering import render_focused
from clplen.lightfield.raw.decode import resample
from clplen.lightfield.raw.lenslet_grid import LensletGrid
from clplen.lightfield.raw.raw_image import RawImage
from clplen.microscopy.model.images import PointImages
from clplen.microscopy.reconstruction.deconvolution import MIN_SENSITIVITY, deconvolve
from clplen.microscopy.reconstruction.projector import Projector
from clplen.selftest import twins
from clplen.selftest.check import Check, Pairs

TURNED = LensletGrid((5, 7), (4, 6), (13.2, 9.7), (9.3, -1.1), (1.2, 9.4), 0.5)


def _raw(values: Any, device: Device, grid: LensletGrid) -> RawImage:
    return RawImage(device.upload(values), device, math.nan, grid, grid)


def _sampled(raw: Any, y: Any, x: Any, kernel: Any = twins.keys, *, clamp: bool = False) -> Any:
    """Interpolate a picture (ny, nx) at positions; outside is 0 or repeats the edge."""
    shape = np.broadcast(y, x).shape
    my, mx = (
        twins.interpolation(np.broadcast_to(p, shape).ravel(), n, kernel=kernel, clamp=clamp)
        for p, n in ((y, raw.shape[0]), (x, raw.shape[1]))
    )
    return np.einsum("pi,ij,pj->p", my, raw.astype(float), mx, optimize=True).reshape(shape)


def lenslet_centres(grid: LensletGrid) -> Any:
    """Return (y, x) of the lenslets' centres, shape (2, rows, columns)."""
    i, k = np.indices(grid.count)
    k = k + np.where(i % 2, grid.odd_row_shift, 0)
    first, row, column = (
        np.array(p)[:, None, None] for p in (grid.first, grid.row_step, grid.column_step)
    )
    return first + i * row + k * column


def _views_of(raw: Any, grid: LensletGrid, kernel: Any = twins.keys) -> Any:
    """Compute L[v, u, i, k] at the true centres."""
    V, U = grid.views
    y, x = lenslet_centres(grid)
    down, right = np.arange(V) - (V - 1) / 2, np.arange(U) - (U - 1) / 2
    return _sampled(raw, y + down[:, None, None, None], x + right[:, None, None], kernel)


def _decode(device: Device) -> Pairs:
    """Check that shifted rows of a hexagonal array are interpolated to the other rows."""
    raw = twins.reals(1, 61, 83)
    expected = _views_of(raw, TURNED)
    columns = TURNED.count[1]
    weights = twins.interpolation(np.arange(columns) - 0.5, columns, kernel=twins.keys, clamp=True)
    expected[:, :, 1::2] = expected[:, :, 1::2] @ weights.T
    yield expected, device.download(resample(device.upload(raw), TURNED, device))


def _divided(device: Device) -> Pairs:
    """Check division by the white level."""
    raw, white = twins.reals(3, 2, 3, 5, 7), twins.reals(4, 2, 3, 5, 7, low=0.2)
    out = device.zeros((2, 3, 5, 7, 3), np.float32)
    raw_decoding.divide_views(out, device.upload(raw), device.upload(white), 3, 1, device)
    expected = np.zeros(out.shape)
    expected[..., 1] = raw / np.maximum(white.astype(float), raw_decoding._FLOOR)
    yield expected, device.download(out)


FIRST, SECOND, ORIGIN = (12.4, -0.5), (0.6, 12.1), (7.0, 6.4)
SENSOR = (40, 39)


def _focused_raw(device: Device) -> tuple[Any, Any, RawImage, FocusedGeometry]:
    """Return a smooth random picture under 3 x 3 lenslets, positions, raw image and geometry."""
    y, x = np.indices(SENSOR)
    noise = 0.1 * twins.reals(7, *SENSOR)
    values = (1.5 + noise + np.sin(0.5 * y - 0.3 * x + 1)).astype(np.float32)
    i, j = np.indices((3, 3))[..., None]
    centres = np.array(ORIGIN) + i * np.array(FIRST) + j * np.array(SECOND)
    raw = _raw(values, device, LensletGrid((3, 3), (3, 3), ORIGIN, FIRST, SECOND))
    return values, centres, raw, FocusedGeometry.of(raw)


def _focused(device: Device) -> Pairs:
    """Check patches of the nearest sub-image, and the mean of all sub-images of a point."""
    values, all_centres, raw, geometry = _focused_raw(device)
    for method, ratio in (("basic", 0.31), ("blended", -0.3)):
        picture = render_focused(raw, method=method, m=ratio, step=2.37)
        values_on_device = picture.to_numpy()
        y, x = (axis[:, None, None] if k == 0 else axis[None, :, None]
                for k, axis in enumerate(picture.grid.axes()))  # fmt: skip
        centres = all_centres.reshape(-1, 2)
        dy, dx = ratio * (centres[:, 0] - y), ratio * (centres[:, 1] - x)
        at_y, at_x = np.broadcast_arrays(centres[:, 0] + dy, centres[:, 1] + dx)
        samples = _sampled(values, at_y, at_x, clamp=True)
        ny, nx = SENSOR
        recorded = (at_y >= 0) & (at_y <= ny - 1) & (at_x >= 0) & (at_x <= nx - 1)
        near = np.hypot(dy, dx)
        w = np.clip(geometry.pitch / 2 - near + 0.5, 0, 1) ** 2 * recorded
        if method == "basic":
            w = (near == near.min(axis=-1, keepdims=True)) & recorded
        lit = w.sum(axis=-1) > 0
        expected = (w * samples).sum(axis=-1) / np.maximum(w.sum(axis=-1), 1e-30)
        # Beyond the lenslets nothing is recorded, and the nearest lattice point is no lenslet.
        inner = lit & (near.min(axis=-1) < 0.45 * geometry.pitch * abs(ratio))
        yield expected[inner], values_on_device[inner]


SHAPE, V, N = (5, 6), 2, 3  # lenslets; voxels and pixels per lenslet along an axis
OPTICS = {"na": 0.5, "medium_index": 1.0, "magnification": 20.0, "lenslet_pitch": 125e-6}


def _projector(device: Device) -> Projector:
    """Create a projector of two random planes with the symmetries of a square lattice."""
    planes = []
    for r in (1, 2):
        side = (2 * r + 1) * N
        h = twins.reals(r, side, side, low=0.1)
        planes.append((h + h.T)[None])
    z = np.array([1e-6, -4e-6])
    images = PointImages(OPTICS, z, V, N, tuple(planes), np.ones(2))
    return Projector(images, SHAPE, device=device)


def _matrix(projector: Projector) -> Any:
    """Return H[pixel, voxel], the image of every voxel on the frame."""
    (planes, ny, nx), (height, width) = projector.volume_shape, projector.frame_shape
    H = np.zeros((height * width, planes, ny, nx))
    for z, y, x in np.ndindex(planes, ny, nx):
        image, r = projector.images.image(z, (y % V, x % V)), projector.images.radii[z]
        frame = np.zeros((height + 2 * r * N, width + 2 * r * N))
        top, left = y // V * N, x // V * N
        frame[top : top + len(image), left : left + len(image)] = image
        H[:, z, y, x] = frame[r * N : r * N + height, r * N : r * N + width].ravel()
    return H.reshape(height * width, -1)


def _projected(device: Device) -> Pairs:
    projector = _projector(device)
    H = _matrix(projector)
    volume, frame = twins.reals(3, *projector.volume_shape), twins.reals(4, *projector.frame_shape)
    yield (H @ volume.ravel()).reshape(frame.shape), projector.forward(volume)
    yield (H.T @ frame.ravel()).reshape(volume.shape), projector.backward(frame)


def _deconvolved(device: Device) -> Pairs:
    """Check V <- V H'(w I/(w H V + b)) / H'w with acceleration (Biggs and Andrews 1997)."""
    projector = _projector(device)
    H = _matrix(projector)
    I, w = (twins.reals(k, *projector.frame_shape, low=0.5).astype(float) for k in (5, 6))  # noqa: E741
    b, (I, w) = 0.2, (I.ravel() * 50, w.ravel())  # noqa: E741
    sensitivity, x = H.T @ w, np.full(H.shape[1], I.sum() / H.shape[1] / w.mean())
    origin = before = x
    last = None
    for k in range(4):
        if k:
            step = x - origin
            a = 0.0 if last is None else np.clip(step @ last / (last @ last), 0, 0.999)
            x, before, last = np.maximum(x + a * (x - before), 0), x, step
            origin = x
        back = H.T @ (w * I / (w * (H @ x) + b))
        x = np.where(sensitivity > MIN_SENSITIVITY * sensitivity.max(), x * back / sensitivity, 0)
    shape = projector.frame_shape
    result = deconvolve(
        I.reshape(shape), projector, iterations=4, background=b, white=w.reshape(shape),
        accelerate=True,
    )  # fmt: skip
    yield x.reshape(projector.volume_shape), result.volume


CHECKS = (
    Check("decode", "hexagonal array, turned, to views", _decode, 1e-5, ("decode.cl",)),
    Check("devignette", "views over those of the white image", _divided, 1e-5, ("devignette.cl",)),
    Check("focused_render", "focused camera: patches, blended", _focused, 2e-5,
          ("focused_render.cl", "focused.cl")),
    Check("projector", "volumes to frames of a microscope and back", _projected, 1e-5,
          ("projector.cl", "lattice.cl", "lattice_spectra.cl", "lattice_transform.cl")),
    Check("richardson_lucy", "4 iterations of a deconvolution, accelerated", _deconvolved, 1e-4,
          ("richardson_lucy.cl",)),
)  # fmt: skip
