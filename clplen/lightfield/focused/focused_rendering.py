"""Pictures from the raw image of a focused (plenoptic 2.0) camera.

Every lenslet holds a small picture of its own, `clplen.lightfield.focused.focused_geometry` says of
what.
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

_LEAST_RATIO = 1e-3  # of a pitch: a million lenslets see a point
_LEAST_RADIUS = 0.5  # pixels
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
    """Render the picture that a focused camera took.

    Parameters
    ----------
    raw : RawImage
        Simulated, or captured with a lattice; grey or colour; finite.
    method : {"basic", "blended", "depth"}
        How patches of sub-images become the picture: see Notes.
    m : float, optional
        Magnification b/a of the plane in focus, Keplerian positive, Galilean negative, its patch at
        most a sub-image; default that of the camera, else the median of what `focused_depth` finds.
    patch : float, optional
        Pixels across a patch in place of mu, for "basic" and "blended": another value than mu shows
        its seams. Its sign is that of m.
    step : float, optional
        Pixels of the sensor from sample to sample of the picture; default
        pitch/round(patch), that is ``round(patch)`` samples a lenslet.
    view : tuple of float
        (y, x) in pixels, the place in the sub-images round which patches are taken: another
        viewpoint on the main lens. What lies at m stays where it is.
    aperture : float
        In (0, 1], the share of the sub-image's diameter that "blended" and "depth" use.
    depth : FocusedDepth, optional
        For "depth", where it is known.
    white : array_like, optional
        White image of the raw image's shape (ny, nx): samples count by it, so that the dark rims of
        sub-images leave no pattern.
    interpolation : {"cubic", "linear"}
        Of the raw image.

    Returns
    -------
    FocusedImage
        Of float32, shape (y, x[, c]), over the cells of all lenslets whose centre is on the sensor;
        0 where none has recorded anything.

    Raises
    ------
    ValueError
        For an unknown method, m that is 0, not finite or so large that a patch is no part of a
        sub-image, a patch larger than a sub-image, an aperture or view outside the sub-image, a raw
        image of a plenoptic 1.0 camera, or NaN in it.
    ShapeError
        If fewer than two by two lenslets lie on the sensor, or the white image does not fit.
    DeviceError
        If the picture is larger than the device's memory.

    Notes
    -----
    The methods are:

    - "basic": one patch from the middle of every sub-image, mu = m p F/(z2 dx) pixels across,
      flipped where m > 0, side by side (Georgiev & Lumsdaine 2010, section 4, "basic rendering").
      Sharp and seamless at m only: elsewhere the patches do not join.
    - "blended": the mean over all lenslets that see a point (integration over directions): what is
      not at m is blurred, as by a large lens.
    - "depth": blended with the m of each place, as `focused_depth` finds it: sharp everywhere.

    Where the raw image has several lens types, "blended" and "depth" use those that are in focus at
    m (a type with its focus at m_i blurs over p abs(m - m_i)), mixing two over one pixel of blur.

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
            f"{argument('method', 'depth')} takes its patches from the depth: leave out "
            f"{argument('patch')}."
        )
    if depth is not None and method != "depth":
        raise ValueError(
            f"{argument('depth')} belongs to {argument('method', 'depth')}, not to {method!r}."
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
    """Blended pictures focused on several planes, on one grid.

    Parameters
    ----------
    raw : RawImage
        The raw image.
    ms : array_like
        b/a of the planes, shape (n,).
    step : float, optional
        Default that of the largest patch among the planes.
    view, aperture, white, interpolation : tuple of float, float, array_like, str
        As for `render_focused`.

    Returns
    -------
    FocusedStack
        A picture for each m.

    Raises
    ------
    ValueError, ShapeError, DeviceError
        As for `render_focused`; if ``ms`` is no list of numbers.

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
        raise ValueError(f"ms is a list of planes b/a, not an array of shape {planes.shape}.")
    ratios = np.array([checked_ratio(gather.geometry, float(m)) for m in planes])
    size = np.abs(ratios).max() * gather.geometry.pitch
    _require_view(gather.geometry, view, size)
    grid = PictureGrid.over(gather.geometry, size, step)
    gather.require_room((len(planes), *grid.shape))
    data = gather(grid, ratios, "blend")
    alphas, zs = alpha_of_m(raw, planes), z_of_m(raw, planes)
    return FocusedStack(data, raw.device, grid, planes, gather.geometry, alphas, zs)


def checked_ratio(geometry: FocusedGeometry, m: float) -> float:
    """Patch over pitch of a plane."""
    if not (np.ndim(m) == 0 and np.isfinite(m)) or m == 0:
        raise ValueError(f"m = b/a is a finite number other than 0, not {m!r}.")
    ratio = float(geometry.ratio(m))
    if abs(ratio) < _LEAST_RATIO:
        raise ValueError(
            f"At m = {m:g} the patch of a sub-image is {abs(ratio) * geometry.pitch:.2g} px wide: "
            f"the picture lies in the main lens' pupil (m = b/z2 = {geometry.pupil:.4g})."
        )
    if abs(m) >= 1 or abs(ratio) >= 1:
        raise ValueError(
            f"At m = {m:g} a point is seen by {1 / (m * m):.2g} lenslets on average, but every "
            "point has to be seen by one: abs(m) is below 1."
        )
    return ratio


def _checked_patch(geometry: FocusedGeometry, patch: float) -> float:
    """Patch over pitch."""
    if not (np.ndim(patch) == 0 and np.isfinite(patch)) or not patch > 0:
        raise ValueError(f"patch is a positive number of pixels, not {patch!r}.")
    if patch > geometry.pitch:
        raise ValueError(
            f"A patch of {patch:g} px is larger than a sub-image, {geometry.pitch:.4g} px: give at "
            "most that."
        )
    return float(patch) / geometry.pitch


def _require_view(geometry: FocusedGeometry, view: Pair, size: float) -> None:
    """Refuse a view whose patch leaves the sub-image."""
    most = max(0.0, (geometry.pitch - size) / 2)
    if math.hypot(*view) > most + _EDGE:
        raise ValueError(
            f"A patch of {size:.4g} px round {tuple(view)!r} leaves the sub-image of "
            f"{geometry.pitch:.4g} px: view lies within {most:.4g} px of its centre."
        )


def _choice(name: str, value: str, known: tuple[str, ...]) -> None:
    if value not in known:
        raise ValueError(f"{name} is one of {', '.join(map(repr, known))}, not {value!r}.")


def _clipped_ratios(ratios: Values, near: float) -> Values:
    """A map whose planes all can be rendered, on one side of 0."""
    size = np.clip(ratios * np.sign(near), 10 * _LEAST_RATIO, 1 - _LEAST_RATIO)
    return size * np.sign(near)


class _Gather:
    """Samples of one raw image along chief rays, by one lenslet or blended from many."""

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
        """View, and radius in pixels of the window round it."""
        rim = self.geometry.pitch / 2
        if np.shape(view) != (2,) or not np.isfinite(view).all():
            raise ValueError(f"view is (y, x) in pixels, two finite numbers, not {view!r}.")
        if not (np.ndim(aperture) == 0 and 0 < aperture <= 1):
            raise ValueError(
                "aperture is the share of a sub-image's diameter, above 0 up to 1, not "
                f"{aperture!r}."
            )
        return (float(view[0]), float(view[1])), max(_LEAST_RADIUS, rim * float(aperture))

    def __call__(self, grid: PictureGrid, ratios: Values, kernel: str) -> cla.Array:
        """Pictures, float32, shape (n, y, x[, c]): n planes, or one whose ratio is a map (y, x)."""
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
        """Refuse pictures of a shape (n, y, x) that are larger than the device's memory."""
        samples = math.prod((*shape, *self.raw.data.shape[2:]))
        self.raw.device.require_memory(4 * samples, f"Pictures of shape {shape}")

    def _defines(self, is_map: bool, kernel: str) -> dict[str, Any]:
        several = len(self.geometry.ranges) if kernel == "blend" else 0
        found: dict[str, Any] = {
            "MAP": is_map,
            "LINEAR": self._linear,
            "WHITE": self._has_white,
            "TYPES": several if several > 1 else False,
            "CHANNELS": 3 if len(self.raw.data.shape) == 3 else False,
        }
        return {name: value for name, value in found.items() if value}

    def _blending(self) -> tuple[Any, ...]:
        geometry = self.geometry
        ranges = np.array(geometry.ranges or ((0, 0),), np.float32)
        lengths = (self._radius, geometry.pitch / 2, geometry.pupil, geometry.pitch)
        return (self.raw.device.upload(ranges), *(np.float32(n) for n in lengths))


def _uploaded_white(raw: RawImage, white: Any) -> cla.Array:
    """The white image as the kernels take it: as many channels as the raw image, none below 0."""
    level = white_level(raw, white)
    if level.ndim < len(raw.data.shape):
        level = np.repeat(level[..., None], 3, axis=2)
    return raw.device.upload(np.maximum(level, 0))
