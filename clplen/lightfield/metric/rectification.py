"""`rectify_views`: views without distortion, as of pinholes on an even grid."""

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

_BETWEEN = 0.01  # views; a ray that is nearer to a view is taken from it alone
_UNEVEN = 0.02  # pixels at disparity 2 that rows and columns of views may differ by, on a grid


def rectify_views(
    light_field: LightField | ArrayLike,
    intrinsics: Intrinsics,
    *,
    device: DeviceLike | None = None,
) -> LightField:
    """Resample the views so that their distortion is gone and they see as pinholes on an even grid.

    Each sample is that of the ray which the camera of `Intrinsics.rectified` has there: cubic
    splines within views and, where the pixels of a view do not meet in one point (H13, H24), linear
    interpolation between them.

    Parameters
    ----------
    light_field : LightField or array_like
        Of the camera, shape (v, u, y, x[, c]).
    intrinsics : Intrinsics
        Of `calibrate` or `clplen.io.read_intrinsics`.
    device : Device or str, optional
        Where an array goes; default ``Device.open()``.

    Returns
    -------
    LightField
        The same shape and dtype; metres follow from its disparities by ``intrinsics.rectified`` or
        ``intrinsics.lengths``. Pixels that the views do not see repeat their edges. Where the steps
        between rows and columns of views differ, it has ``positions``.

    Raises
    ------
    ShapeError
        If the intrinsics belong to a light field of another shape.
    ValueError
        If the views have positions of their own, or are directions.

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
            "The views have positions of their own, and intrinsics describe views on a grid: read "
            "the light field without positions."
        )
    if lf.shape[:4] != intrinsics.shape:
        raise ShapeError(
            f"The intrinsics are of light fields of shape (v, u, y, x) = {intrinsics.shape}, and "
            f"this one has {lf.shape[:4]}: calibrate the camera that took it, read in the same way."
        )
    samples = lf.to_numpy()
    made = np.empty_like(samples)
    source = _Source(samples, lf.weights > 0)

    def one(view: tuple[int, int]) -> None:
        made[view] = _stored(source.at(*_places(intrinsics, view)), made.dtype)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(one, np.ndindex(*made.shape[:2])))
    flat = LightField.from_array(
        made, device=lf.device, weights=lf.weights, positions=_positions(intrinsics)
    )
    return replace(flat, linear=lf.linear)


def _places(intrinsics: Intrinsics, view: tuple[int, int]) -> tuple[Array, Array]:
    """Where the rays of a rectified view (v, u) lie: views (v, u) and pixels (y, x), (2, y, x)."""
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
    views = np.where(np.abs(views - at).max((0, 1)) < _BETWEEN, at, views)
    pixels = (direction - converge * views - middle) / pitch
    views = views + centres
    pixels = pixels + np.array([middle for _, middle in middles(shape)])
    return np.moveaxis(views[..., ::-1], -1, 0), np.moveaxis(pixels[..., ::-1], -1, 0)


class _Source:
    """Views that are sampled anywhere, between them too."""

    def __init__(self, samples: Array, seen: Array) -> None:
        self.samples = samples.reshape(*samples.shape[:4], -1)
        self.colours = samples.shape[4:]
        self.seen = seen

    def at(self, views: Array, pixels: Array) -> Array:
        """Samples at views (v, u) and pixels (y, x), each of shape (2, y, x)."""
        total = np.zeros((*views.shape[1:], self.samples.shape[4]))
        known = np.zeros(views.shape[1:])
        rims = np.array(self.samples.shape[:2])[:, None, None] - 1
        views = np.clip(views, 0, rims)
        low, high = np.floor(views.min((1, 2))).astype(int), np.ceil(views.max((1, 2))).astype(int)
        nearest = np.clip(np.rint(views.mean((1, 2))), low, high).astype(int)
        for v in range(low[0], high[0] + 1):
            for u in range(low[1], high[1] + 1):
                share = np.clip(1 - np.abs(views - np.array([v, u])[:, None, None]), 0, 1).prod(0)
                if self.seen[v, u] and share.any():
                    total += share[..., None] * self._of_view(v, u, pixels)
                    known += share
        if not known.any():
            alone = self._of_view(nearest[0], nearest[1], pixels)
            return alone.reshape(*views.shape[1:], *self.colours)
        with np.errstate(invalid="ignore"):
            mean = np.where(known[..., None] > 0, total / known[..., None], 0)
        return np.asarray(mean.reshape(*views.shape[1:], *self.colours))

    def _of_view(self, v: int, u: int, pixels: Array) -> Array:
        colours = [
            ndimage.map_coordinates(channel, pixels, np.float64, order=3, mode="nearest")
            for channel in np.moveaxis(self.samples[v, u].astype(np.float32), -1, 0)
        ]
        return np.stack(colours, -1)


def _stored(values: Array, dtype: np.dtype[Any]) -> Array:
    """Rounded and cut to what a type holds."""
    if dtype.kind == "u":
        values = np.clip(np.rint(values), 0, np.iinfo(dtype).max)
    return values.astype(dtype)


def _positions(intrinsics: Intrinsics) -> Array | None:
    """Where the views lie in steps of a row, shape (V, U, 2); None if that is their grid."""
    V, U = intrinsics.shape[:2]
    ratio = abs(intrinsics.matrix[1, 1] / intrinsics.matrix[0, 0])
    if abs(ratio - 1) * (V - 1) <= _UNEVEN:
        return None
    v, u = np.indices((V, U)) - np.array([(V - 1) / 2, (U - 1) / 2])[:, None, None]
    return np.stack([v * ratio, u], -1)
