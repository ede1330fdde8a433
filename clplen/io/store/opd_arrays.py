"""OPD maps in HDF5 and Zarr: a group with the arrays of `OPDMaps` in SI units.

Arrays ``path``, ``transmission`` and ``edge`` (wavelengths, fields, v, u), ``fields`` (fields, 2),
``distortion`` and ``pupil_shift`` (wavelengths, fields, 2), and ``wavelengths`` where there are
any; attributes ``symmetric`` and, if known, ``pupil_distance`` and ``pupil_diameter``. The group of
a camera has them as ``camera/opd``.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from clplen.cameras.focused_camera import Plenoptic2
from clplen.cameras.light_field_microscope import Microscope
from clplen.cameras.optics.opd_maps import OPDMaps
from clplen.cameras.standard_camera import Plenoptic1
from clplen.compute.device import Device
from clplen.errors import FormatError
from clplen.io.formats.untrusted import UNREADABLE
from clplen.io.store.attributes import CAMERA, CAMERA_NAMES, camera_attributes, read_camera
from clplen.io.store.containers import Container

OPD = "opd"
ARRAYS = ("path", "transmission", "edge", "fields", "wavelengths", "distortion", "pupil_shift")
NUMBERS = ("pupil_distance", "pupil_diameter")
SYMMETRIC = "symmetric"


def write_maps(container: Container, name: str, maps: OPDMaps) -> None:
    """Write OPD maps as a group of a container."""
    values = maps.values()
    numbers = {number: values[number] for number in NUMBERS if values[number] is not None}
    container.write_group(name, {SYMMETRIC: maps.symmetric} | numbers)
    for array in ARRAYS:
        if values[array] is not None:
            container.write(f"{name}/{array}", values[array])


def write_camera(container: Container, camera: Any) -> None:
    """Write a camera and its OPD maps as a group; skip cameras that cannot be stored."""
    attributes = camera_attributes(camera)
    if attributes is None:
        return
    container.write_group(CAMERA, attributes)
    aberrations = getattr(camera, "aberrations", None)
    if aberrations is not None and aberrations.main_lens_opd is not None:
        write_maps(container, f"{CAMERA}/{OPD}", aberrations.main_lens_opd)


def read_stored_camera(
    container: Container, device: Device, max_bytes: int | None = None
) -> Plenoptic1 | Plenoptic2 | Microscope | None:
    """Read the camera of a light field or raw image; return None for an unknown kind."""
    values = container.group(CAMERA, CAMERA_NAMES)
    if values is None:
        return None
    maps = read_maps(container, f"{CAMERA}/{OPD}", max_bytes)
    return read_camera(values, container.path, device, maps)


def read_maps(container: Container, name: str, max_bytes: int | None = None) -> OPDMaps | None:
    """Read the OPD maps in a group of a container, or return None without the group."""
    path = container.path
    numbers = container.group(name, (SYMMETRIC, *NUMBERS))
    if numbers is None:
        return None
    arrays: dict[str, Any] = {}
    for array in ARRAYS:
        stored = container.array(f"{name}/{array}")
        if stored is None and array in ("path", "fields"):
            raise FormatError(f"The OPD maps in {path} have no array {array!r}.")
        if stored is None:
            continue
        if stored.dtype.kind not in "iuf":
            raise FormatError(
                f"{path}: {array!r} of the OPD maps must hold numbers, got {stored.dtype}."
            )
        wider = 8 // stored.dtype.itemsize or 1
        stored.storage(max_bytes).wider(wider).require(
            8 * math.prod(stored.shape), f"{array!r} of the OPD maps"
        )
        arrays[array] = np.asarray(stored.item[...], np.float64)
    pupil = {number: float(numbers[number]) for number in NUMBERS if number in numbers}
    try:
        return OPDMaps(
            arrays.pop("path"), **arrays, **pupil, symmetric=bool(numbers.get(SYMMETRIC, False))
        )
    except UNREADABLE as error:
        raise FormatError(f"The OPD maps in {path} are invalid: {error}") from error
