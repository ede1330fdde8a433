"""Statistics of the samples of all views along the rays that meet on a surface."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.checks import host_array, real_array
from clplen.compute.device import Device
from clplen.errors import ShapeError
from clplen.lightfield.arrays.stored_samples import C_TYPE

Table = np.ndarray[Any, Any]

STATISTICS = ("mean", "variance", "median", "max", "min")
INTERPOLATIONS = ("linear", "nearest", "cubic")
_ROUNDING = 2.0**-20  # pixels: shifts are rounded to it, so that 3 x 0.1 and 0.3 give equal results
_MAX_MEDIAN_VIEWS = 1024  # views of a median: one work-item stores all of them


def along_rays(
    data: cla.Array,
    statistic: str,
    *,
    device: Device,
    weights: Table,
    steps: Table,
    disparity: Table | float = 0.0,
    interpolation: str = "linear",
    mask: Any = None,
) -> cla.Array:
    """Compute a statistic over the views of the samples on a surface.

    The samples are L[v, u](y + s_y d, x + s_x d) with (s_y, s_x) = steps[v, u], weighted with
    w[v, u] times the valid share of their taps. Linear interpolation drops taps outside a view and
    normalises the rest; "nearest" rounds halves up; "cubic" (Keys 1981, a = -1/2) repeats edge
    samples and omits positions outside the view.
    """
    _check(statistic, interpolation, mask)
    shape = tuple(int(n) for n in data.shape)
    w = np.asarray(weights, np.float64)
    lit = np.flatnonzero(w)
    d = checked_disparity(disparity, (shape[2], shape[3]))
    pixels, fractions = _split(steps.reshape(-1, 2)[lit, ::-1], d)
    tables = (
        _mask_of(mask, shape[:4]),
        np.float32(d).reshape(-1),
        lit.astype(np.int32),
        (w.ravel()[lit] / max(float(w.max()), np.finfo(float).tiny)).astype(np.float32),
        pixels,
        fractions,
    )
    defines = _defines(data, d, interpolation, mask)
    extra: tuple[Any, ...] = ()
    name = statistic
    if statistic in ("max", "min"):
        name, extra = "extreme", (np.float32(1 if statistic == "max" else -1),)
    if statistic == "median":
        defines["VIEWS"] = _room(lit.size)
    channels = shape[4] if len(shape) == 5 else 1
    out = device.empty(shape[2:], np.float32)
    device.launch_rows(
        device.kernel("along_rays.cl", name, **defines),
        (shape[2], shape[3] * channels),
        out,
        data,
        *(device.upload(table) for table in tables),
        *(np.int32(n) for n in (lit.size, shape[2], shape[3], channels)),
        *extra,
    )
    return out


def checked_disparity(disparity: Any, size: tuple[int, int]) -> Table:
    """Return a disparity as float64: a scalar, or an array with a value for each pixel."""
    d = real_array(disparity, "A disparity", np.float64)
    if d.shape not in ((), size):
        raise ShapeError(
            f"disparity must be a number or an array of shape {size}, got shape {d.shape}."
        )
    if not np.isfinite(d).all():
        raise ValueError(
            "disparity must be finite; fill the pixels that are NaN or infinite first."
        )
    return d


def _check(statistic: str, interpolation: str, mask: Any) -> None:
    for value, choices, argument in (
        (statistic, STATISTICS, "statistic"),
        (interpolation, INTERPOLATIONS, "interpolation"),
    ):
        if value not in choices:
            raise ValueError(f"{argument} must be {', '.join(map(repr, choices))}, got {value!r}.")
    if mask is not None and interpolation == "cubic":
        raise ValueError("mask requires interpolation='linear' or 'nearest', got 'cubic'.")


def _split(steps: Table, d: Table) -> tuple[Table, Table]:
    """Split shifts (x, y) into pixels and fractions; for a map, return zeros and the steps."""
    if d.ndim:
        return np.zeros(steps.shape, np.int32), steps.astype(np.float32)
    shift = np.round(steps * float(d) / _ROUNDING) * _ROUNDING
    pixels = np.floor(shift)
    return np.clip(pixels, -(2**20), 2**20).astype(np.int32), (shift - pixels).astype(np.float32)


def _mask_of(mask: Any, rays: tuple[int, ...]) -> Table:
    if mask is None:
        return np.zeros(1, np.uint8)
    values = host_array(mask, "A mask")
    if values.shape != rays:
        raise ShapeError(f"mask must have one value per ray, shape {rays}, got {values.shape}.")
    return (values != 0).astype(np.uint8)


def _defines(data: cla.Array, d: Table, interpolation: str, mask: Any) -> dict[str, Any]:
    defines: dict[str, Any] = {"SAMPLE": C_TYPE[np.dtype(data.dtype)]}
    if d.ndim:
        defines["MAP"] = True
    if interpolation != "linear":
        defines[interpolation.upper()] = True
    if mask is not None:
        defines["MASK"] = True
    return defines


def _room(views: int) -> int:
    """Return the capacity of a median; few different sizes keep the number of kernels small."""
    if views > _MAX_MEDIAN_VIEWS:
        raise ValueError(
            f"A median takes at most {_MAX_MEDIAN_VIEWS} views, got {views}; pass a smaller "
            "aperture."
        )
    return next(size for size in (16, 64, 128, 256, 512, _MAX_MEDIAN_VIEWS) if views <= size)
