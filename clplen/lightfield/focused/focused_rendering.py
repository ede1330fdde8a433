"""Pictures from the raw image of a focused (plenoptic 2.0) camera.

Each lenslet records a small picture, see `clplen.lightfield.focused.focused_geometry`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pyopencl.array as cla
from numpy.typing import ArrayLike

from clplen.checks import float64_array
from clplen.errors import argument
from clplen.lightfield.focused.focused_depth import FocusedDepth, focused_depth, reference_m
from clplen.lightfield.focused.focused_geometry import (
    FocusedGeometry,
    Pair,
    Values,
    alpha_of_m,
    require_finite,
    split_positions,
    white_level,
    z_of_m,
)
from clplen.lightfield.focused.focused_picture import FocusedImage, FocusedStack, PictureGrid
from clplen.lightfield.raw.raw_image import RawImage

METHODS = ("basic", "blended", "depth")
INTERPOLATIONS = ("cubic", "linear")

_MIN_RATIO = 1e-3  # of a pitch: a million lenslets see a point
_MIN_RADIUS = 0.5  # pixels: smallest radius of the window
_EDGE = 0.5  # pixels by which a patch may leave a sub-image


def render_focused(
    raw: RawImage,
    *,
    method: str = "blended",
    m: float | None = None,
    patch: float | None = None,
    step: float | None = None,
    view: Pair = (0.0, 0.0),
    aperture: float = 1.0,
    depth: FocusedDepth | None = None,
    white: ArrayLike | None = None,
    interpolation: str = "cubic",
) -> FocusedImage:
    """Render the picture of a focused camera from its raw image.

    Parameters
    ----------
    raw : RawImage
        Raw image, simulated or captured with a lattice; grey or colour; finite.
    method : {"basic", "blended", "depth"}
        Method of composing patches of sub-images, see Notes.
    m : float, optional
        Magnification b/a of the plane in focus, Keplerian positive, Galilean negative; its patch
        must fit in a sub-image. Default: the camera's, or the median of `focused_depth`.
    patch : float, optional
        Pixels across a patch, instead of mu, for "basic" and "blended"; a value other than mu makes
        seams visible. The sign is that of m.
    step : float, optional
        Pixels of the sensor between samples of the picture; default pitch/round(patch), i.e.
        ``round(patch)`` samples a lenslet.
    view : tuple of float
        Position (y, x) in pixels of the patches in the sub-images: another viewpoint on the main
        lens. Objects at m do not move.
    aperture : float
        Share of the sub-image's diameter that "blended" and "depth" use, in (0, 1].
    depth : FocusedDepth, optional
        Known depth for "depth".
    white : array_like, optional
        White image of the raw image's shape (ny, nx), used as weights, so that dark rims of
        sub-images leave no pattern.
    interpolation : {"cubic", "linear"}
        Interpolation of the raw image.

    Returns
    -------
    FocusedImage
        Picture of float32, shape (y, x[, c]), over the cells of all lenslets with their centre on
        the sensor; 0 without any recorded light.

    Raises
    ------
    ValueError
        If the method is unknown; m is 0, not finite or out of range; the patch, the aperture or the
        view exceeds the sub-image; or the raw image is of a plenoptic 1.0 camera or includes NaN.
    ShapeError
        If fewer than two by two lenslets lie on the sensor, or the white image differs in shape.
    DeviceError
        If the picture exceeds the device's memory.

    Notes
    -----
    The methods are:

    - "basic": one patch from the middle of every sub-image, mu = m p F/(z2 dx) pixels across,
      flipped if m > 0, side by side (Georgiev & Lumsdaine 2010, section 4, "basic rendering").
      Sharp and seamless at m only; patches of other depths do not join.
    - "blended": the mean over all lenslets that see a point (integration over directions).
      Objects off m are blurred, as by a large lens.
    - "depth": blended with the local m of `focused_depth`, sharp everywhere.

    For several lens types, "blended" and "depth" use the types in focus at m (a type with its
    focus at m_i blurs over p abs(m - m_i)), mixing two types over one pixel of blur.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.type2(
    ...     focal_length=0.12, mla=clplen.MicrolensArray(150e-6, 10e-3, count=7, fill="full"),
    ...     m=0.25, wavelength=532e-9, pixels_per_lenslet=16)
    >>> picture = clplen.render_focused(camera.expose(clplen.PointSources((0, 0, 0))))
    >>> picture.shape, f"m = {picture.m}"
    ((21, 21), 'm = 0.25')
    >>> np.argwhere(picture.to_numpy() == picture.to_numpy().max()).tolist()  # on the axis
    [[10, 10]]
    """
    _choice("method", method, METHODS)
    if method == "depth" and patch is not None:
        raise ValueError(
            f"{argument('method', 'depth')} sets the patches from the depth; omit "
            f"{argument('patch')}."
        )
    if depth is not None and method != "depth":
        raise ValueError(
            f"{argument('depth')} requires {argument('method', 'depth')}, got {method!r}."
        )
    gather = _Gather(raw, white, interpolation, view, aperture)
    geometry = gather.geometry
    if method == "depth" and depth is None:
        depth = focused_depth(raw, white=white)
    if m is None:
        m = reference_m(raw, white=white) if depth is None else depth.median
    ratio = checked_ratio(geometry, m)
    if patch is not None:
        ratio = math.copysign(_checked_patch(geometry, patch), ratio)
    size = abs(ratio) * geometry.pitch
    _require_view(geometry, view, size)
    grid = PictureGrid.over(geometry, size, step)
    gather.require_room((1, *grid.shape))
    if depth is None:
        data = gather(grid, np.array([ratio]), "nearest" if method == "basic" else "blend")
    else:
        data = gather(grid, _clipped_ratios(depth.ratios(grid), ratio), "blend")
    return FocusedImage(data.reshape(data.shape[1:]), raw.device, grid, float(m), geometry, ratio)


def focused_stack(
    raw: RawImage,
    *,
    ms: ArrayLike,
    step: float | None = None,
    view: Pair = (0.0, 0.0),
    aperture: float = 1.0,
    white: ArrayLike | None = None,
    interpolation: str = "cubic",
) -> FocusedStack:
    """Render blended pictures focused on several planes, on one grid.

    Parameters
    ----------
    raw : RawImage
        The raw image.
    ms : array_like
        Ratios b/a of the planes, shape (n,).
    step : float, optional
        Pixels of the sensor between samples; default for the largest patch among the planes.
    view, aperture, white, interpolation : tuple of float, float, array_like, str
        Options of `render_focused`.

    Returns
    -------
    FocusedStack
        A picture for each m.

    Raises
    ------
    ValueError, ShapeError, DeviceError
        See `render_focused`; also if ``ms`` is not a list of numbers.

    Examples
    --------
    >>> lenslets = clplen.MicrolensArray(150e-6, 3e-3, count=9, fill="full")
    >>> camera = clplen.PlenopticCamera.type2(
    ...     focal_length=0.12, mla=lenslets, wavelength=532e-9, pixels_per_lenslet=16, m=0.25
    ... )
    >>> raw = camera.expose(clplen.PointSources((0, 0, 0)), model="rays")
    >>> len(clplen.lightfield.focused_stack(raw, ms=[0.2, 0.25, 0.3]).ms)
    3
    """
    gather = _Gather(raw, white, interpolation, view, aperture)
    planes = float64_array(ms)
    if planes.ndim != 1 or planes.size == 0:
        raise ValueError(f"ms must be a list of ratios b/a, got an array of shape {planes.shape}.")
    ratios = np.array([checked_ratio(gather.geometry, float(m)) for m in planes])
    size = np.abs(ratios).max() * gather.geometry.pitch
    _require_view(gather.geometry, view, size)
    grid = PictureGrid.over(gather.geometry, size, step)
    gather.require_room((len(planes), *grid.shape))
    data = gather(grid, ratios, "blend")
    alphas, zs = alpha_of_m(raw, planes), z_of_m(raw, planes)
    return FocusedStack(data, raw.device, grid, planes, gather.geometry, alphas, zs)


def checked_ratio(geometry: FocusedGeometry, m: float) -> float:
    """Return patch over pitch of a plane."""
    if not (np.ndim(m) == 0 and np.isfinite(m)) or m == 0:
        raise ValueError(f"m = b/a must be a finite number other than 0, got {m!r}.")
    ratio = float(geometry.ratio(m))
    if abs(ratio) < _MIN_RATIO:
        raise ValueError(
            f"At m = {m:g} the patch of a sub-image is only {abs(ratio) * geometry.pitch:.2g} px "
            f"wide: the picture lies in the main lens' pupil (m = b/z2 = {geometry.pupil:.4g})."
        )
    if abs(m) >= 1 or abs(ratio) >= 1:
        raise ValueError(
            f"At m = {m:g} only {1 / (m * m):.2g} lenslets on average see a point, but each point "
            "must be seen by at least one: abs(m) must be below 1."
        )
    return ratio


def _checked_patch(geometry: FocusedGeometry, patch: float) -> float:
    """Return a given patch over the pitch."""
    if not (np.ndim(patch) == 0 and np.isfinite(patch)) or not patch > 0:
        raise ValueError(f"patch must be a positive number of pixels, got {patch!r}.")
    if patch > geometry.pitch:
        raise ValueError(
            f"patch must be at most a sub-image, {geometry.pitch:.4g} px, got {patch:g} px."
        )
    return float(patch) / geometry.pitch


def _require_view(geometry: FocusedGeometry, view: Pair, size: float) -> None:
    """Reject a view whose patch leaves the sub-image."""
    limit = max(0.0, (geometry.pitch - size) / 2)
    if math.hypot(*view) > limit + _EDGE:
        raise ValueError(
            f"view must be within {limit:.4g} px of the sub-image's centre, got {tuple(view)!r}: "
            f"its patch of {size:.4g} px leaves the sub-image of {geometry.pitch:.4g} px."
        )


def _choice(name: str, value: str, choices: tuple[str, ...]) -> None:
    if value not in choices:
        raise ValueError(f"{name} must be {', '.join(map(repr, choices))}, got {value!r}.")


def _clipped_ratios(ratios: Values, near: float) -> Values:
    """Clip a map of ratios to planes that can be rendered, on one side of 0."""
    size = np.clip(ratios * np.sign(near), 10 * _MIN_RATIO, 1 - _MIN_RATIO)
    return size * np.sign(near)


class _Gather:
    """Sampling of one raw image along chief rays, from one lenslet or blended from many."""

    def __init__(
        self, raw: RawImage, white: Any, interpolation: str, view: Any, aperture: Any
    ) -> None:
        self.raw = raw
        self.geometry = FocusedGeometry.of(raw)
        _choice("interpolation", interpolation, INTERPOLATIONS)
        self._view, self._radius = self._window(view, aperture)
        self._linear = interpolation == "linear"
        require_finite(raw, "rendering")
        self._white = raw.data if white is None else _uploaded_white(raw, white)
        self._has_white = white is not None

    def _window(self, view: Any, aperture: Any) -> tuple[Pair, float]:
        """Return the view, and the radius in pixels of the window around it."""
        rim = self.geometry.pitch / 2
        if np.shape(view) != (2,) or not np.isfinite(view).all():
            raise ValueError(f"view must be (y, x) in pixels, two finite numbers, got {view!r}.")
        if not (np.ndim(aperture) == 0 and 0 < aperture <= 1):
            raise ValueError(
                "aperture must be a share of the sub-image's diameter, above 0 and at most 1, got "
                f"{aperture!r}."
            )
        return (float(view[0]), float(view[1])), max(_MIN_RADIUS, rim * float(aperture))

    def __call__(self, grid: PictureGrid, ratios: Values, kernel: str) -> cla.Array:
        """Render pictures, float32, (n, y, x[, c]): n planes, or one with a ratio map (y, x)."""
        device, geometry, is_map = self.raw.device, self.geometry, ratios.ndim == 2
        channels = tuple(self.raw.data.shape[2:])
        shape = (1 if is_map else len(ratios), *grid.shape)
        out = device.empty((*shape, *channels), np.float32)
        device.launch_rows(
            device.kernel("focused_render.cl", kernel, **self._defines(is_map, kernel)),
            shape,
            *(out, self.raw.data, self._white),
            *geometry.tables(device),
            *(device.upload(table) for axis in grid.axes() for table in split_positions(axis)),
            device.upload(ratios.astype(np.float32)),
            geometry.lattice(self._view, device),
            *(np.int32(n) for n in (*geometry.kinds.shape, *geometry.shape, *grid.shape)),
            *(self._blending() if kernel == "blend" else ()),
        )
        return out

    def require_room(self, shape: tuple[int, ...]) -> None:
        """Reject pictures of a shape (n, y, x) that exceed the device's memory."""
        samples = math.prod((*shape, *self.raw.data.shape[2:]))
        self.raw.device.require_memory(4 * samples, f"Pictures of shape {shape}")

    def _defines(self, is_map: bool, kernel: str) -> dict[str, Any]:
        several = len(self.geometry.ranges) if kernel == "blend" else 0
        defines: dict[str, Any] = {
            "MAP": is_map,
            "LINEAR": self._linear,
            "WHITE": self._has_white,
            "TYPES": several if several > 1 else False,
            "CHANNELS": 3 if len(self.raw.data.shape) == 3 else False,
        }
        return {name: value for name, value in defines.items() if value}

    def _blending(self) -> tuple[Any, ...]:
        geometry = self.geometry
        ranges = np.array(geometry.ranges or ((0, 0),), np.float32)
        lengths = (self._radius, geometry.pitch / 2, geometry.pupil, geometry.pitch)
        return (self.raw.device.upload(ranges), *(np.float32(n) for n in lengths))


def _uploaded_white(raw: RawImage, white: Any) -> cla.Array:
    """Upload the white image with the raw image's channels, clipped at 0."""
    level = white_level(raw, white)
    if level.ndim < len(raw.data.shape):
        level = np.repeat(level[..., None], 3, axis=2)
    return raw.device.upload(np.maximum(level, 0))
