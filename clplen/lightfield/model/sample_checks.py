"""What a light field may hold: arrays, spacing, positions and weights, checked."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
import pyopencl.array as cla

from clplen.checks import host_array, masked_array
from clplen.compute.arrays import count_bad
from clplen.compute.device import Device
from clplen.errors import DeviceError, SamplingWarning, ShapeError, warn_caller, worded
from clplen.lightfield.arrays.stored_samples import C_TYPE, lit_views
from clplen.lightfield.raw.raw_image import Spacing
from clplen.types import Array


class Shaped(Protocol):
    """What has the shape of a light field."""

    @property
    def shape(self) -> tuple[int, ...]: ...


def checked_samples(a: Any, device: Device) -> tuple[cla.Array, Array | None]:
    """The samples on the device in a storage type of the light field, all of them finite.

    The second array is False for views with masked samples; None where no sample is masked.
    """
    data, valid = _adopt(a, device)
    check_shape(data.shape)
    require_finite(count_bad(data, device))
    return data, valid


def fill_masked(values: Array, mask: Array) -> tuple[Array, Array]:
    """Replace masked samples by 0; return which views (v, u) have none."""
    check_shape(values.shape)
    of_views = mask.reshape(*mask.shape[:2], -1)
    valid = np.asarray(~of_views.any(axis=-1))
    some = np.count_nonzero(~valid & ~of_views.all(axis=-1))
    if not valid.any():
        raise ValueError(
            "A light field must have a view without masked samples, as weights belong to whole "
            "views: replace the samples by array.filled(value), or give flatten their mask."
        )
    if some:
        warn_caller(
            f"{some} of {valid.size} views have masked samples and valid ones; weights belong to "
            "whole views, so these views have weight 0.",
            SamplingWarning,
        )
    return np.where(mask, np.zeros((), values.dtype), values), valid


def check_shape(shape: Any) -> None:
    """Refuse what is no shape of a light field."""
    if len(shape) not in (4, 5) or 0 in shape:
        raise ShapeError(
            "A light field has shape (v, u, y, x) or (v, u, y, x, c), none of them empty, not "
            f"{tuple(shape)}."
        )


def require_finite(bad: int) -> None:
    """Refuse a light field with so many samples that are NaN or infinite."""
    if bad:
        raise ValueError(
            f"The light field has {bad} samples that are NaN or infinite, which interpolation "
            "would spread: replace them by 0"
            + worded(python=" and give their views weight 0 (weights=).", command=".", file=".")
        )


def storage_dtype(dtype: np.dtype[Any]) -> np.dtype[Any]:
    """The type in which samples of a real type are kept: their own, or float32."""
    if dtype.kind not in "buif":
        raise TypeError(f"A light field is real, not {dtype}.")
    native = dtype.newbyteorder("=")
    return native if native in C_TYPE else np.dtype(np.float32)


def _adopt(a: Any, device: Device) -> tuple[cla.Array, Array | None]:
    if isinstance(a, cla.Array):
        return _adopt_device(a, device), None
    values, mask = masked_array(a, "A light field")
    dtype = storage_dtype(values.dtype)
    device.require_memory(values.size * dtype.itemsize, "This light field")
    valid = None
    if mask is not None:
        values, valid = fill_masked(values, mask)
    return device.upload(values.astype(dtype, copy=False)), valid


def _adopt_device(a: cla.Array, device: Device) -> cla.Array:
    """An array that is on the device already, when everything on its own queue is done."""
    if a.context != device.context:
        raise DeviceError(
            f"The array lives in another OpenCL context than {device!r}: make it on device.queue."
        )
    if np.dtype(a.dtype) not in C_TYPE:
        raise TypeError(
            f"On the device a light field is uint8, uint16, float16 or float32, not {a.dtype}."
        )
    if not a.flags.c_contiguous:
        raise ShapeError(
            f"On the device a light field is C-contiguous, not of strides {a.strides}: copy it "
            "into a new array, or give a NumPy array."
        )
    if a.queue is not None:
        a.queue.finish()
    return a if a.offset == 0 else a.copy(queue=device.queue)


def checked_spacing(spacing: Any) -> Spacing | None:
    """Four signed steps, none of them 0, or None; NaN and infinite where a camera has none."""
    if spacing is None:
        return None
    try:
        values = tuple(float(s) for s in spacing)
    except OverflowError:  # a whole number above 1.8e308
        values = ()
    if len(values) != 4 or 0.0 in values:
        raise ValueError(
            f"spacing is (dv, du, dy, dx) in metres, none of them 0, not {spacing!r}."
        )
    return values


def checked_positions(positions: Any, data: Shaped) -> np.ndarray[Any, np.dtype[np.float64]] | None:
    """(y, x) of each view, float64, or None."""
    if positions is None:
        return None
    values = np.array(host_array(positions, "positions"), np.float64)
    views = (int(data.shape[0]), int(data.shape[1]))
    if values.shape != (*views, 2):
        raise ShapeError(
            f"Positions are (y, x) of each of {views[0]} x {views[1]} views, shape "
            f"{(*views, 2)}, not {values.shape}."
        )
    if not np.isfinite(values).all():
        raise ValueError("Positions of views are finite, in view steps; some are NaN or infinite.")
    return values


def weights_of_lit(data: cla.Array, device: Device) -> np.ndarray[Any, np.dtype[np.float32]]:
    """0 for views that are black throughout, if there are others, else 1."""
    return weights_where(lit_views(data, device))


def weights_where(
    lit: np.ndarray[Any, np.dtype[np.bool_]],
) -> np.ndarray[Any, np.dtype[np.float32]]:
    """1 for the views with light, 0 for the others; 1 for all if none has any."""
    return (lit if lit.any() else ~lit).astype(np.float32)


def checked_weights(weights: Any, data: Shaped) -> np.ndarray[Any, np.dtype[np.float32]]:
    """One of each view, float32, not negative; masked weights are 0."""
    given, mask = masked_array(weights, "weights")
    values = np.array(given if mask is None else np.where(mask, 0, given), np.float32)
    views = (int(data.shape[0]), int(data.shape[1]))
    if values.shape != views:
        raise ShapeError(f"The weights have shape {values.shape}, the views {views}.")
    if not (np.isfinite(values).all() and (values >= 0).all() and values.any()):
        raise ValueError("Weights of views are finite, not negative and not all 0.")
    return values
