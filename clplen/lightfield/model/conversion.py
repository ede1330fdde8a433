"""The light field that an argument names: one on a device, or an array."""

from __future__ import annotations

from typing import Any

import pyopencl.array as cla

from clplen.compute.arrays import HostArray
from clplen.compute.device import DeviceLike, as_device, require_same_device
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.stored_light_field import StoredLightField
from clplen.lightfield.raw.raw_image import RawImage


def as_lightfield(
    source: Any, streams: str = "", *, device: DeviceLike | None = None
) -> LightField:
    """A light field as it is, and an array as one on a device.

    Parameters
    ----------
    source : LightField or array_like
        An array, of NumPy or with ``__array__``, is L[v, u, y, x(, c)].
    streams : str, optional
        The function that takes a stored light field.
    device : Device or str, optional
        Where an array goes; default ``Device.open()``.

    Returns
    -------
    LightField

    Raises
    ------
    TypeError
        If it is anything else; of a stored light field and a raw image with what takes them.
    ShapeError, ValueError
        As `LightField.from_array`.
    DeviceError
        If a light field is on another device.
    """
    if isinstance(source, LightField):
        if device is not None:
            require_same_device(source.device, as_device(device))
        return source
    if isinstance(source, RawImage):
        raise TypeError(
            "This is a raw image, not a light field: decode it with LightField.from_raw, or take "
            "render_focused where its camera is a focused one."
        )
    if isinstance(source, StoredLightField):
        other = f"take {streams}, or .load(device)" if streams else "take .load(device)"
        raise TypeError(f"This light field is stored, not on a device: {other} where it fits.")
    is_array = hasattr(type(source), "__array__") and not isinstance(source, HostArray)
    if is_array or isinstance(source, cla.Array):
        return LightField.from_array(source, device=as_device(device, optional=True))
    raise TypeError(
        "A light field is needed, as LightField.from_array and read_lightfield give it, or an "
        f"array L[v, u, y, x(, c)], not of type {type(source).__name__}."
    )
