"""Refocusing: shift every view by its constant and average, one plane or many."""

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

UPSAMPLE_BASE = 1e-3  # share of plain interpolation, which fills what no sample comes near
_MOST_UPSAMPLE = 16
DEVICE_FLOAT = 4.5  # bytes of one on the device: its spare buffers are up to an eighth larger
HOST_FLOAT = 4  # bytes of one on the host
_TAPS = 2  # pixels beyond a shift that interpolations reach


@dataclass(frozen=True, eq=False, repr=False)
class FocalStack(Savable, Plottable, OnDevice):
    """Refocused pictures of one light field, registered to its centre view.

    Attributes
    ----------
    data : pyopencl.array.Array
        float32, shape (n, y, x) or (n, y, x, c).
    device : Device
    disparities : numpy.ndarray
        float64, shape (n,): pixels a view step along x.
    alphas : numpy.ndarray
        float64, shape (n,): alpha = F/F' of each plane; NaN without spacing.
    spacing : tuple of float or None
        Signed (dv, du, dy, dx) of the light field, in metres.
    camera : CameraModel or None
        The camera that took it, when known.
    weights : numpy.ndarray or None
        Of the views that were averaged, float32, shape (V, U); None when not known.
    positions : numpy.ndarray or None
        Of the views, as in `LightField`.

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
    """Make the picture focused on another plane, or on a tilted or curved surface.

    It is the weighted mean over the views of

        L[v, u](y - (v - vc) d_y, x - (u - uc) d),    vc = (V - 1)/2, uc = (U - 1)/2

    interpolated linearly (Ng 2005, shift and add, in constant shifts a view); a sample outside a
    view counts neither in the sum nor in the weights. d_y = d where views and pixels are spaced
    alike along y and x, else in proportion to their signed spacings, d (dv/dy)/(du/dx). Where the
    light field has ``positions``, they take the place of v - vc and u - uc.

    Parameters
    ----------
    lf : LightField or array_like
        On a device, or an array of shape (v, u, y, x[, c]).
    alpha : float, optional
        F/F', above 1 for planes farther than the one in focus; needs ``lf.spacing``.
    disparity : float or array_like, optional
        Shift d in pixels a view step along x, positive for nearer planes; or one of every pixel,
        shape (y, x), as from `plane_through` or a `DepthMap` (whose shifts are then made in
        float32). Exactly one of the two.
    rescale : bool
        The picture as it is on the synthetic plane, where it has another size: alpha^2 R(alpha x')
        about the middle of the picture R, 0 outside; the Jacobian alpha^2 keeps its sum (thesis,
        eq. 3.7). Needs ``lf.spacing``. Views of naive cells are directions, so that R is that
        picture already, and that of a telecentric camera has the same size on every plane.
    interpolation : {"linear", "nearest", "cubic", "fourier"}
        How views are moved by fractions of a pixel. "nearest" rounds (halves up); "cubic" (Keys
        1981, a = -1/2) repeats the edge sample within a view and takes no place outside it;
        "fourier" turns the phases of their spectra, exact below the Nyquist frequency, with
        periodic edges and every view in every pixel.
    upsample : int
        Pixels of the picture along each axis for one of the views, 1 to 16. For a disparity off
        the integers the samples of the views interleave and more detail is resolved (`upsampled`).
    device : Device or str, optional
        Where an array goes; default ``Device.open()``. A light field brings its own.

    Returns
    -------
    Image
        Values of float32, shape (y, x[, c]), or (n y, n x[, c]) for ``upsample=n``.

    Raises
    ------
    ValueError
        If both or neither of alpha and disparity are given, the value is not finite or alpha is
        not positive, no two views overlap on the plane or anywhere on the surface, what alpha needs
        is not known, or options do not go together.
    TypeError
        If it is stored and not on a device, or a raw image.
    ShapeError
        If disparities are not one of every pixel.

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
    given = real_array(_exactly_one(alpha=alpha, disparity=disparity), "A plane", np.float64)
    _check_options(np.ndim(given), rescale, interpolation, upsample)
    if np.ndim(given) == 1:
        raise ValueError("refocus makes one picture: give one number, or use focal_stack.")
    disparities, alphas = _planes(lf, np.atleast_1d(given), alpha is not None)
    rescale = rescale and not is_telecentric(lf)
    require_overlap(lf, lf.weights, disparities)
    if np.ndim(given):
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
    """Make a focal stack on checked planes; of a tile, views may overlap only beyond it."""
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
    """The pictures of a light field with what it knows; weights for linear interpolation only."""
    known = weights if interpolation == "linear" else None
    return FocalStack(data, device, planes, ratios, lf.spacing, lf.camera, known, lf.positions)


@dataclass(frozen=True)
class MemoryEstimate:
    """What a computation needs beside the samples, so that it can be made in tiles."""

    what: str  # As the subject of a sentence
    planes: tuple[slice, ...]  # Groups of planes that are made one after the other of each tile
    halo: tuple[int, int]  # (y, x) pixels that a result depends on, on every side
    per_pixel: int  # Bytes a pixel that is read: temporary arrays and results, on device and host
    largest: int  # Those of the largest array among them
    kept: int = 0  # Bytes a pixel of the whole picture that are held until the end
    before: int = 0  # Those that are held, at most, before and after the pass over the tiles
    passes: int = 1  # How often all samples are read


def shear_halo(source: SampledViews, planes: Vector, reach: int) -> tuple[int, int]:
    """Pixels (y, x) around a tile: as far as the planes shift views, and windows reach."""
    ends = np.array([planes.min(), planes.max()])  # shifts are linear in the disparity
    down, right = shifts(source, ends)
    if source.positions is None:
        down, right = np.broadcast_arrays(down[:, :, None], right[:, None, :])
    lit = source.weights > 0
    y, x = (int(np.ceil(np.abs(shift[:, lit]).max())) + _TAPS + reach for shift in (down, right))
    return min(y, source.shape[2]), min(x, source.shape[3])


def stack_memory(
    source: SampledViews, planes: Vector, *, kept: int = 0
) -> list[MemoryEstimate]:
    """What a focal stack needs: all planes of a tile at once, or fewer and fewer."""
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
                kept,
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
    """(disparities, alphas) of the planes of a stack, given as one of them.

    Views of these weights must overlap on every plane; None for a linear map, where planes beyond
    the views are zero.
    """
    one_of_planes(alphas, disparities)
    if alphas is None:
        given = plane_values(_exactly_one(alphas=alphas, disparities=disparities))
    else:
        given = plane_values(alphas, "alphas")
    if given.ndim != 1 or given.size == 0:
        raise ValueError(
            f"A focal stack takes a list of at least one plane, not shape {given.shape}."
        )
    planes = _planes(lf, given, alphas is not None)
    if weights is not None:
        require_overlap(lf, weights, planes[0])
    return planes


def plane_values(planes: Any, name: str = "disparities") -> Vector:
    """Return planes, numbers or START:STOP:N, as float64; ``name`` is that of the argument."""
    rule = setting_of(PlaneSettings, name)
    given = rule.checked(planes) if isinstance(planes, str) else planes
    values = real_array(given, "A list of planes", np.float64)
    if values.ndim == 1 and not np.isfinite(values).all():
        rule.checked(values.tolist())
    return values


def check_interpolation(interpolation: str) -> None:
    """Refuse an unknown way to move views by fractions of a pixel."""
    setting_of(StackSettings, "interpolation").checked(interpolation)


def _check_options(ndim: int, rescale: bool, interpolation: str, upsample: int) -> None:
    """Refuse options of `refocus` that do not go together."""
    check_interpolation(interpolation)
    if ndim and (rescale or upsample != 1 or interpolation == "fourier"):
        raise ValueError(
            "Focus on a surface (a disparity of every pixel) goes neither with rescale, nor with "
            "upsample, nor with interpolation='fourier': give one disparity, or leave them out."
        )
    if upsample != 1 and (rescale or interpolation != "linear"):
        raise ValueError(
            "upsample puts samples at their own places: leave out rescale and interpolation."
        )


def require_alphas(alphas: Vector) -> None:
    """Refuse to rescale planes whose alpha is not known or not positive."""
    wrong = alphas[~(alphas > 0)]
    if wrong.size:
        raise ValueError(
            "rescale=True needs a positive alpha = F/F', and so the spacing of views and pixels in "
            f"metres; here alpha is {wrong[0]}."
        )


def _exactly_one(**given: Any) -> Any:
    """The one that is given of two options."""
    values = [value for value in given.values() if value is not None]
    if len(values) != 1:
        first, second = given
        count = "both were" if values else "neither was"
        raise ValueError(f"Give exactly one of {first} and {second}; {count} given.")
    return values[0]


def _planes(lf: FocusableViews, given: Any, are_alphas: bool) -> tuple[Vector, Vector]:
    """(disparities, alphas) of planes given as one of them."""
    values = real_array(given, "A plane", np.float64)
    if not np.isfinite(values).all():
        raise ValueError(f"Planes are finite numbers, not {given!r}.")
    if are_alphas:
        return lf.disparity(values), values
    return values, lf.alpha(values)


def _mean_of_views(
    lf: LightField, disparities: Vector, weights: Any, interpolation: str
) -> cla.Array:
    """Means of the views moved by their shifts, shape (n, y, x[, c])."""
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
    """`refocus` on a surface, shape (y, x); of a tile, views may overlap only beyond it."""
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
    """A picture focused on one disparity with n times the pixels along each axis.

    For a disparity off the integers, samples of different views fall between each other. Each is
    put at its own place with a tent of one fine pixel to each side, and the sum divided by the
    weights; a tent of one pixel of the views with weight `UPSAMPLE_BASE` fills what
    none comes near. Fine pixel Y lies at (Y + 1/2)/n - 1/2 in pixels of the views.
    """
    if not isinstance(n, Integral) or not 1 <= n <= _MOST_UPSAMPLE:
        raise ValueError(f"upsample is a whole number from 1 to {_MOST_UPSAMPLE}, not {n!r}.")
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
