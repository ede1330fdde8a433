"""`rectify_views`: undistorted views of pinholes on an even grid."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from clplen.checks import require
from clplen.compute.device import DeviceLike
from clplen.errors import ShapeError
from clplen.lightfield.metric.intrinsics import Intrinsics
from clplen.lightfield.metric.ray_model import distorted, middles, parameters_of
from clplen.lightfield.model.alpha_law import require_two_plane
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.stored_light_field import as_lightfield

Array = np.ndarray[Any, Any]

_MIN_FRACTION = 0.01  # views: a ray nearer to a view is sampled from it alone
# Pixels at disparity 2: maximum difference of rows and columns of views on a grid
_MAX_UNEVENNESS = 0.02


def rectify_views(
    light_field: LightField | ArrayLike,
    intrinsics: Intrinsics,
    *,
    device: DeviceLike | None = None,
) -> LightField:
    """Resample the views to undistorted pinholes on an even grid.

    Each sample belongs to the ray of the camera `Intrinsics.rectified`. Samples are interpolated by
    cubic splines within views and, if the pixels of a view do not meet in one point (H13, H24),
    linearly between views.

    Parameters
    ----------
    light_field : LightField or array_like
        Light field of the camera, shape (v, u, y, x[, c]).
    intrinsics : Intrinsics
        Intrinsics from `calibrate` or `clplen.io.read_intrinsics`.
    device : Device or str, optional
        Device for an array; default ``Device.open()``.

    Returns
    -------
    LightField
        Light field of unchanged shape and dtype, with the intrinsics ``intrinsics.rectified`` and
        lengths ``intrinsics.lengths``. Pixels outside the views repeat their edges. It has
        ``positions`` if the steps between rows and columns of views differ.

    Raises
    ------
    ShapeError
        If the intrinsics and the light field differ in shape.
    ValueError
        If the views have positions off the grid, or are directions.

    Examples
    --------
    >>> H = np.diag([1e-3, 1e-3, 2e-3, 2e-3, 1.0])
    >>> H[:4, 4] = -H.diagonal()[:4] * (1, 1, 23.5, 15.5)
    >>> camera = clplen.lightfield.Intrinsics(H, [0, 0, -0.3, 0, 0], (3, 3, 32, 48))
    >>> views = np.random.default_rng(0).random((3, 3, 32, 48), np.float32)
    >>> flat = clplen.lightfield.rectify_views(views, camera)
    >>> flat.shape, bool(np.allclose(flat.to_numpy()[..., 15:17, 23:25], views[..., 15:17, 23:25],
    ...                              atol=1e-3))
    ((3, 3, 32, 48), True)
    """
    lf = as_lightfield(light_field, device=device)
    require(Intrinsics, intrinsics, "intrinsics", "calibrate")
    require_two_plane(lf.parametrisation, "Rectifying")
    if lf.positions is not None:
        raise ValueError(
            "Intrinsics describe views on a grid, and these views have positions; read the light "
            "field without positions."
        )
    if lf.shape[:4] != intrinsics.shape:
        raise ShapeError(
            f"light_field must have the shape of the intrinsics, {intrinsics.shape}, got "
            f"{lf.shape[:4]}; calibrate its camera with light fields read with equal options."
        )
    samples = lf.to_numpy()
    rectified = np.empty_like(samples)
    source = _Source(samples, lf.weights > 0)

    def rectify(view: tuple[int, int]) -> None:
        rectified[view] = _stored(source.at(*_ray_positions(intrinsics, view)), rectified.dtype)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(rectify, np.ndindex(*rectified.shape[:2])))
    flat = LightField.from_array(
        rectified, device=lf.device, weights=lf.weights, positions=_positions(intrinsics)
    )
    return replace(flat, linear=lf.linear)


def _ray_positions(intrinsics: Intrinsics, view: tuple[int, int]) -> tuple[Array, Array]:
    """Return views (v, u) and pixels (y, x), (2, y, x), of the rays of a rectified view (v, u)."""
    shape = intrinsics.shape
    p = parameters_of(intrinsics.matrix, intrinsics.distortion, shape)
    flat = parameters_of(intrinsics.rectified.matrix, np.zeros(5), shape)
    step, converge, pitch, middle, e = p[:10].reshape(5, 2)
    pixels = np.meshgrid(*(np.arange(n) - (n - 1) / 2 for n in shape[:1:-1]), indexing="xy")
    pixel = np.stack(pixels, -1)  # (k', l')
    centres = np.array([middle for middle, _ in middles(shape)])
    at = np.array(view[::-1]) - centres
    direction = distorted(flat[2:4] * at + flat[4:6] * pixel, intrinsics.distortion)[0]
    views = (flat[:2] * at - e * (direction - middle)) / (step - e * converge)
    views = np.where(np.abs(views - at).max((0, 1)) < _MIN_FRACTION, at, views)
    pixels = (direction - converge * views - middle) / pitch
    views = views + centres
    pixels = pixels + np.array([middle for _, middle in middles(shape)])
    return np.moveaxis(views[..., ::-1], -1, 0), np.moveaxis(pixels[..., ::-1], -1, 0)


class _Source:
    """Views that are sampled at any position, also between views."""

    def __init__(self, samples: Array, is_valid: Array) -> None:
        self.samples = samples.reshape(*samples.shape[:4], -1)
        self.colours = samples.shape[4:]
        self.is_valid = is_valid

    def at(self, views: Array, pixels: Array) -> Array:
        """Sample at views (v, u) and pixels (y, x), each of shape (2, y, x)."""
        total = np.zeros((*views.shape[1:], self.samples.shape[4]))
        valid = np.zeros(views.shape[1:])
        rims = np.array(self.samples.shape[:2])[:, None, None] - 1
        views = np.clip(views, 0, rims)
        low, high = np.floor(views.min((1, 2))).astype(int), np.ceil(views.max((1, 2))).astype(int)
        nearest = np.clip(np.rint(views.mean((1, 2))), low, high).astype(int)
        for v in range(low[0], high[0] + 1):
            for u in range(low[1], high[1] + 1):
                share = np.clip(1 - np.abs(views - np.array([v, u])[:, None, None]), 0, 1).prod(0)
                if self.is_valid[v, u] and share.any():
                    total += share[..., None] * self._of_view(v, u, pixels)
                    valid += share
        if not valid.any():
            nearest_samples = self._of_view(nearest[0], nearest[1], pixels)
            return nearest_samples.reshape(*views.shape[1:], *self.colours)
        with np.errstate(invalid="ignore"):
            mean = np.where(valid[..., None] > 0, total / valid[..., None], 0)
        return np.asarray(mean.reshape(*views.shape[1:], *self.colours))

    def _of_view(self, v: int, u: int, pixels: Array) -> Array:
        colours = [
            ndimage.map_coordinates(channel, pixels, np.float64, order=3, mode="nearest")
            for channel in np.moveaxis(self.samples[v, u].astype(np.float32), -1, 0)
        ]
        return np.stack(colours, -1)


def _stored(values: Array, dtype: np.dtype[Any]) -> Array:
    """Round and clip values to the range of a dtype."""
    if dtype.kind == "u":
        values = np.clip(np.rint(values), 0, np.iinfo(dtype).max)
    return values.astype(dtype)


def _positions(intrinsics: Intrinsics) -> Array | None:
    """Return the view positions in steps of a row, shape (V, U, 2); None if on the grid."""
    V, U = intrinsics.shape[:2]
    ratio = abs(intrinsics.matrix[1, 1] / intrinsics.matrix[0, 0])
    if abs(ratio - 1) * (V - 1) <= _MAX_UNEVENNESS:
        return None
    v, u = np.indices((V, U)) - np.array([(V - 1) / 2, (U - 1) / 2])[:, None, None]
    return np.stack([v * ratio, u], -1)
