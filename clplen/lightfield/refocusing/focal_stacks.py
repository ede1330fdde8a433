"""Refocusing: shift the views and average them, for one plane or many."""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Integral
from typing import Any, ClassVar

import numpy as np
import pyopencl.array as cla
from numpy.typing import ArrayLike

from clplen.checks import real_array
from clplen.compute.arrays import Image, OnDevice
from clplen.compute.device import Device, DeviceLike
from clplen.lightfield.arrays.ray_samples import along_rays
from clplen.lightfield.arrays.shear import shear_sum
from clplen.lightfield.arrays.stored_samples import C_TYPE
from clplen.lightfield.model.alpha_law import (
    require_overlap,
    shifts,
    unit_steps,
)
from clplen.lightfield.model.apertures import Weights
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.sampled_views import FocusableViews, SampledViews
from clplen.lightfield.model.stored_light_field import StoredLightField, as_lightfield
from clplen.lightfield.raw.raw_image import CameraModel, Spacing, is_telecentric
from clplen.lightfield.refocusing.magnification import magnify
from clplen.lightfield.refocusing.phase_ramps import fourier_refocus
from clplen.results import Plottable, Savable
from clplen.settings.declaration import setting_of
from clplen.settings.light_fields import PlaneSettings, StackSettings, one_of_planes

Vector = np.ndarray[Any, np.dtype[np.float64]]

UPSAMPLE_BASE = 1e-3  # weight of plain interpolation, which fills gaps between samples
_MAX_UPSAMPLE = 16  # pixels of the picture per pixel of a view, along an axis
DEVICE_FLOAT = 4.5  # bytes of a float on the device, whose spare buffers are up to an eighth larger
HOST_FLOAT = 4  # bytes of a float on the host
_TAPS = 2  # pixels that interpolation reaches beyond a shift


@dataclass(frozen=True, eq=False, repr=False)
class FocalStack(Savable, Plottable, OnDevice):
    """Refocused pictures of a light field, registered to its centre view.

    Attributes
    ----------
    data : pyopencl.array.Array
        float32, shape (n, y, x) or (n, y, x, c).
    device : Device
    disparities : numpy.ndarray
        Disparity of each plane in pixels a view step along x, float64, shape (n,).
    alphas : numpy.ndarray
        alpha = F/F' of each plane, float64, shape (n,); NaN without spacing.
    spacing : tuple of float or None
        Signed (dv, du, dy, dx) of the light field, in metres.
    camera : CameraModel or None
        Camera of the light field, if known.
    weights : numpy.ndarray or None
        Weights of the averaged views, float32, shape (V, U); None if unknown.
    positions : numpy.ndarray or None
        Positions of the views, as in `LightField`.

    Examples
    --------
    >>> plane = clplen.cameras.Plane(0.5, texture=clplen.cameras.noise(1))
    >>> lf, truth = clplen.SurfaceScene(plane).light_field((5, 5), (32, 32))
    >>> stack = clplen.focal_stack(lf, disparities=[-0.5, 0, 0.5, 1])
    >>> stack.shape, stack.disparities.tolist()
    ((4, 32, 32), [-0.5, 0.0, 0.5, 1.0])
    >>> int(stack.to_numpy().std(axis=(1, 2)).argmax())  # the sharpest
    2
    """

    _writer: ClassVar[str] = "write_stack"
    _figure: ClassVar[str] = "montage"

    data: cla.Array
    device: Device
    disparities: Vector
    alphas: Vector
    spacing: Spacing | None = None
    camera: CameraModel | None = None
    weights: Weights | None = None
    positions: Vector | None = None

    def __repr__(self) -> str:
        planes = f"disparities {self.disparities.min():g} to {self.disparities.max():g}"
        return f"<FocalStack {self.shape} {self.data.dtype}, {planes}, {self.device.name}>"


def refocus(
    lf: LightField | ArrayLike,
    *,
    alpha: float | None = None,
    disparity: ArrayLike | None = None,
    rescale: bool = False,
    interpolation: str = "linear",
    upsample: int = 1,
    device: DeviceLike | None = None,
) -> Image:
    """Render a light field refocused on another plane, or on a tilted or curved surface.

    The picture is the weighted mean over the views of

        L[v, u](y - (v - vc) d_y, x - (u - uc) d),    vc = (V - 1)/2, uc = (U - 1)/2

    interpolated linearly (Ng 2005, shift and add, with constant shifts). A sample outside a view
    has no weight. d_y = d if views and pixels have equal spacings along y and x, else
    d (dv/dy)/(du/dx) with signed spacings. ``positions`` of the light field replace v - vc and
    u - uc.

    Parameters
    ----------
    lf : LightField or array_like
        Light field on a device, or an array of shape (v, u, y, x[, c]).
    alpha : float, optional
        Ratio F/F', above 1 for planes beyond the focus; requires ``lf.spacing``.
    disparity : float or array_like, optional
        Shift d in pixels a view step along x, positive for nearer planes: a number, or a map of
        shape (y, x), as from `plane_through` or a `DepthMap` (shifts are then computed in
        float32). Exactly one of alpha and disparity is required.
    rescale : bool
        True to return the picture on the synthetic plane, where it has another size:
        alpha^2 R(alpha x') about the middle of the picture R, 0 outside. The Jacobian alpha^2
        keeps its sum (thesis, eq. 3.7). Requires ``lf.spacing``. It has no effect on naive cells,
        whose R is that picture, or on telecentric cameras, whose size is constant.
    interpolation : {"linear", "nearest", "cubic", "fourier"}
        Interpolation for fractions of a pixel. "nearest" rounds (halves up); "cubic" (Keys 1981,
        a = -1/2) repeats edge samples within a view and accepts no positions outside; "fourier"
        applies phase ramps to the spectra, exact below the Nyquist frequency, with periodic edges
        and all views in every pixel.
    upsample : int
        Pixels of the picture per pixel of a view along each axis, 1 to 16. At non-integer
        disparities the samples of the views interleave and resolve more detail (`upsampled`).
    device : Device or str, optional
        Device for an array; default ``Device.open()``. A light field stays on its device.

    Returns
    -------
    Image
        Picture, float32, shape (y, x[, c]), or (n y, n x[, c]) for ``upsample=n``.

    Raises
    ------
    ValueError
        If not exactly one of alpha and disparity is set, a value is not finite or alpha not
        positive, no two views overlap on the plane or the surface, the spacing for alpha is
        unknown, or options are incompatible.
    TypeError
        If the light field is stored, or is a raw image.
    ShapeError
        If a disparity map does not match the pixels.

    Examples
    --------
    >>> plane = clplen.cameras.Plane(0.5, texture=clplen.cameras.noise(1, 64))
    >>> lf, truth = clplen.SurfaceScene(plane).light_field((5, 5), (32, 32))
    >>> sharp, blurred = (clplen.refocus(lf, disparity=d) for d in (0.5, -0.5))
    >>> sharp.shape, bool(sharp.to_numpy().std() > blurred.to_numpy().std())
    ((32, 32), True)
    >>> clplen.refocus(lf, disparity=0.5, upsample=2).shape
    (64, 64)
    """
    lf = as_lightfield(lf, "focal_stack", device=device)
    plane = real_array(_require_one(alpha=alpha, disparity=disparity), "A plane", np.float64)
    _check_options(np.ndim(plane), rescale, interpolation, upsample)
    if np.ndim(plane) == 1:
        raise ValueError("refocus needs a single plane; pass one number, or call focal_stack.")
    disparities, alphas = _planes(lf, np.atleast_1d(plane), alpha is not None)
    rescale = rescale and not is_telecentric(lf)
    require_overlap(lf, lf.weights, disparities)
    if np.ndim(plane):
        return Image(on_surface(lf, disparities, interpolation), lf.device)
    if rescale:
        require_alphas(alphas)
    if upsample != 1:
        return Image(upsampled(lf, float(disparities[0]), upsample, lf.weights), lf.device)
    picture = _mean_of_views(lf, disparities, lf.weights, interpolation).reshape(lf.shape[2:])
    if rescale and lf.decode != "naive":
        picture = magnify(picture, float(alphas[0]), device=lf.device)
    return Image(picture, lf.device)


def stack_on_planes(
    lf: LightField, planes: Vector, ratios: Vector, weights: Weights, interpolation: str = "linear"
) -> FocalStack:
    """Compute a focal stack on checked planes; views of a tile may overlap outside it."""
    stack = 4 * planes.size * int(np.prod(lf.shape[2:], dtype=np.int64))
    lf.device.require_memory(stack + lf.data.nbytes, "This focal stack with its light field")
    data = _mean_of_views(lf, planes, weights, interpolation)
    return stack_of(lf, data, lf.device, planes, ratios, weights, interpolation)


def stack_of(
    lf: LightField | StoredLightField,
    data: cla.Array,
    device: Device,
    planes: Vector,
    ratios: Vector,
    weights: Weights,
    interpolation: str,
) -> FocalStack:
    """Wrap pictures as a FocalStack; weights are stored for linear interpolation only."""
    stored_weights = weights if interpolation == "linear" else None
    return FocalStack(
        data, device, planes, ratios, lf.spacing, lf.camera, stored_weights, lf.positions
    )


@dataclass(frozen=True)
class MemoryEstimate:
    """Memory of a computation in addition to the samples, for planning tiles."""

    subject: str  # Subject of a message
    planes: tuple[slice, ...]  # Groups of planes that are computed in turn for each tile
    halo: tuple[int, int]  # Pixels (y, x) on every side that a result depends on
    per_pixel: int  # Bytes a pixel read: temporary arrays and results, on device and host
    largest: int  # Bytes a pixel of the largest array among them
    result_bytes: int = 0  # Bytes a pixel of the whole picture that are stored until the end
    before: int = 0  # Maximum bytes a pixel stored before and after the pass over the tiles
    passes: int = 1  # Number of passes over all samples


def shear_halo(source: SampledViews, planes: Vector, reach: int) -> tuple[int, int]:
    """Return the halo (y, x) of a tile: shifts of the planes plus reach of the windows."""
    ends = np.array([planes.min(), planes.max()])  # shifts are linear in the disparity
    down, right = shifts(source, ends)
    if source.positions is None:
        down, right = np.broadcast_arrays(down[:, :, None], right[:, None, :])
    lit = source.weights > 0
    y, x = (int(np.ceil(np.abs(shift[:, lit]).max())) + _TAPS + reach for shift in (down, right))
    return min(y, source.shape[2]), min(x, source.shape[3])


def stack_memory(
    source: SampledViews, planes: Vector, *, result_bytes: int = 0
) -> list[MemoryEstimate]:
    """Estimate a stack's memory: all planes of a tile at once, then ever smaller groups."""
    channels = (*source.shape, 1)[4]
    halo = shear_halo(source, planes, 0)
    estimates, count = [], planes.size
    while True:
        groups = [slice(i, min(i + count, planes.size)) for i in range(0, planes.size, count)]
        estimates.append(
            MemoryEstimate(
                "A focal stack",
                tuple(groups),
                halo,
                int(count * channels * (DEVICE_FLOAT + 2 * HOST_FLOAT)),
                4 * count * channels,
                result_bytes,
            )
        )
        if count == 1:
            return estimates
        count = -(-count // 2)


def stack_planes(
    lf: FocusableViews,
    weights: Weights | None,
    *,
    alphas: ArrayLike | None,
    disparities: ArrayLike | None,
) -> tuple[Vector, Vector]:
    """Return (disparities, alphas) of the planes of a stack from one of them.

    Views of these weights must overlap on every plane; None skips the check for a linear map, in
    which planes beyond the views are zero.
    """
    one_of_planes(alphas, disparities)
    if alphas is None:
        values = plane_values(_require_one(alphas=alphas, disparities=disparities))
    else:
        values = plane_values(alphas, "alphas")
    if values.ndim != 1 or values.size == 0:
        raise ValueError(
            f"A focal stack needs a list of at least one plane, got shape {values.shape}."
        )
    planes = _planes(lf, values, alphas is not None)
    if weights is not None:
        require_overlap(lf, weights, planes[0])
    return planes


def plane_values(planes: Any, name: str = "disparities") -> Vector:
    """Return planes, numbers or START:STOP:N, as float64; ``name`` is the argument's name."""
    rule = setting_of(PlaneSettings, name)
    numbers = rule.checked(planes) if isinstance(planes, str) else planes
    values = real_array(numbers, "A list of planes", np.float64)
    if values.ndim == 1 and not np.isfinite(values).all():
        rule.checked(values.tolist())
    return values


def check_interpolation(interpolation: str) -> None:
    """Reject an unknown interpolation."""
    setting_of(StackSettings, "interpolation").checked(interpolation)


def _check_options(ndim: int, rescale: bool, interpolation: str, upsample: int) -> None:
    """Reject incompatible options of `refocus`."""
    check_interpolation(interpolation)
    if ndim and (rescale or upsample != 1 or interpolation == "fourier"):
        raise ValueError(
            "A per-pixel disparity cannot be combined with rescale, upsample or "
            "interpolation='fourier'; pass one disparity, or omit these options."
        )
    if upsample != 1 and (rescale or interpolation != "linear"):
        raise ValueError("upsample cannot be combined with rescale or interpolation; omit them.")


def require_alphas(alphas: Vector) -> None:
    """Reject rescaling of planes with an unknown or non-positive alpha."""
    wrong = alphas[~(alphas > 0)]
    if wrong.size:
        raise ValueError(
            "rescale=True needs a positive alpha = F/F' and therefore the spacing of views and "
            f"pixels in metres, got alpha {wrong[0]}."
        )


def _require_one(**options: Any) -> Any:
    """Return the value of the only option that is set."""
    values = [value for value in options.values() if value is not None]
    if len(values) != 1:
        first, second = options
        count = "both" if values else "neither"
        raise ValueError(f"Pass exactly one of {first} and {second}, got {count}.")
    return values[0]


def _planes(lf: FocusableViews, planes: Any, are_alphas: bool) -> tuple[Vector, Vector]:
    """Return (disparities, alphas) of planes given as one of them."""
    values = real_array(planes, "A plane", np.float64)
    if not np.isfinite(values).all():
        raise ValueError(f"Planes must be finite numbers, got {planes!r}.")
    if are_alphas:
        return lf.disparity(values), values
    return values, lf.alpha(values)


def _mean_of_views(
    lf: LightField, disparities: Vector, weights: Any, interpolation: str
) -> cla.Array:
    """Average the views after their shifts, shape (n, y, x[, c])."""
    if interpolation == "fourier":
        return fourier_refocus(lf, disparities, weights)
    if interpolation == "cubic":
        out = lf.device.empty((len(disparities), *lf.shape[2:]), np.float32)
        for index, d in enumerate(disparities):
            picture = _on_surface(lf, weights, d, interpolation)
            lf.device.copy_into(out, picture, index * picture.nbytes)
        return out
    down, right = shifts(lf, disparities)
    if interpolation == "nearest":
        down, right = np.floor(down + 0.5), np.floor(right + 0.5)
    return shear_sum(lf.data, weights, down, right, device=lf.device)


def on_surface(lf: LightField, disparity: Any, interpolation: str = "linear") -> cla.Array:
    """Refocus on a surface, shape (y, x); views of a tile may overlap outside it."""
    return _on_surface(lf, lf.weights, disparity, interpolation)


def _on_surface(lf: LightField, weights: Any, disparity: Any, interpolation: str) -> cla.Array:
    return along_rays(
        lf.data,
        "mean",
        device=lf.device,
        weights=weights,
        steps=unit_steps(lf),
        disparity=disparity,
        interpolation=interpolation,
    )


def upsampled(lf: LightField, disparity: float, n: int, weights: Any) -> cla.Array:
    """Refocus on one disparity with n times the pixels along each axis.

    At a non-integer disparity, samples of different views interleave. Each contributes at its
    position with a tent of one fine pixel to each side, normalised by the weights. A tent of one
    view pixel with weight `UPSAMPLE_BASE` fills gaps. Fine pixel Y lies at (Y + 1/2)/n - 1/2 in
    pixels of the views.
    """
    if not isinstance(n, Integral) or not 1 <= n <= _MAX_UPSAMPLE:
        raise ValueError(f"upsample must be an integer from 1 to {_MAX_UPSAMPLE}, got {n!r}.")
    n = int(n)
    _, _, ny, nx = lf.shape[:4]
    channels = lf.shape[4] if len(lf.shape) == 5 else 1
    views = np.flatnonzero(weights)
    out_shape = (n * ny, n * nx, *lf.shape[4:])
    lf.device.require_memory(4 * n * n * ny * nx * channels + lf.data.nbytes, "The finer picture")
    out = lf.device.empty(out_shape, np.float32)
    steps = unit_steps(lf).reshape(-1, 2)[views]
    steps = steps * disparity
    phases = (np.arange(n) + 0.5) / n - 0.5
    tables: list[Any] = [views.astype(np.int32), np.float32(weights).ravel()[views]]
    for along in (0, 1):
        position = steps[:, along, None] + phases
        shift = np.floor(position)
        distance = np.stack((position - shift, 1 - (position - shift)), axis=-1)
        tents = np.concatenate((np.maximum(1 - n * distance, 0), 1 - distance), axis=-1)
        tables += [np.clip(shift, -(2**20), 2**20).astype(np.int32), tents.astype(np.float32)]
    lf.device.launch_rows(
        lf.device.kernel("upsample.cl", "interleave", SAMPLE=C_TYPE[lf.dtype]),
        (n * ny, n * nx * channels),
        out,
        lf.data,
        *(lf.device.upload(table) for table in tables),
        *(np.int32(m) for m in (views.size, n)),
        np.float32(UPSAMPLE_BASE),
        *(np.int32(m) for m in (ny, nx, channels)),
    )
    return out
