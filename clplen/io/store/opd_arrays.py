"""OPD maps in HDF5 and Zarr: a group with the arrays of `OPDMaps`, in SI units.

Arrays ``path``, ``transmission`` and ``edge`` (wavelengths, fields, v, u), ``fields`` (fields, 2),
``distortion`` and ``pupil_shift`` (wavelengths, fields, 2), and ``wavelengths`` where there are
any; attributes ``symmetric``, ``pupil_distance`` and ``pupil_diameter``, the latter two where they
are known. With a camera it lies in its group, as ``camera/opd``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from clplen.cameras.optics.opd_maps import OPDMaps
from clplen.errors import FormatError
from clplen.io.formats.untrusted import UNREADABLE, Bound
from clplen.io.store import hdf5_files, zarr_files
from clplen.io.store.attributes import CAMERA, of_camera

OPD = "opd"
ARRAYS = ("path", "transmission", "edge", "fields", "wavelengths", "distortion", "pupil_shift")
NUMBERS = ("pupil_distance", "pupil_diameter")
SYMMETRIC = "symmetric"


def maps_of(camera: Any) -> OPDMaps | None:
    """The OPD maps of a camera's main lens, None without any."""
    aberrations = getattr(camera, "aberrations", None)
    return None if aberrations is None else aberrations.main_lens_opd


def write_hdf5_maps(group: Any, maps: OPDMaps) -> None:
    """Put maps into a group of an HDF5 file."""
    for name, array in _arrays(maps).items():
        group.create_dataset(name, data=array)
    group.attrs.update(_numbers(maps))


def write_camera(file: h5py.File, camera: Any) -> None:
    """Keep a camera of this package with its maps in a group of its own."""
    known = of_camera(camera)
    if known is not None:
        group = file.create_group(CAMERA)
        group.attrs.update(known)
        maps = maps_of(camera)
        if maps is not None:
            write_hdf5_maps(group.create_group(OPD), maps)


def write_zarr_maps(group: Any, maps: OPDMaps, words: dict[str, Any]) -> None:
    """Put maps into a group of a Zarr store; ``words`` are those of its format."""
    zarr = zarr_files.zarr_package("use .h5")
    for name, array in _arrays(maps).items():
        inside = f"{group.path}/{name}".strip("/")
        made = zarr.create(
            array.shape, chunks=array.shape, dtype=array.dtype, store=group.store, path=inside,
            **words,
        )  # fmt: skip
        made[...] = array
    group.attrs.update(_numbers(maps))


def read_hdf5_maps(group: Any, path: Path, max_bytes: int | None = None) -> OPDMaps | None:
    """The maps in a group of an HDF5 file; None without a group."""
    if not isinstance(group, h5py.Group):
        return None
    held = {name: group[name] for name in ARRAYS if isinstance(group.get(name), h5py.Dataset)}
    numbers = hdf5_files.attributes_of(group, (SYMMETRIC, *NUMBERS), path)
    return _made(held, numbers, path, max_bytes, hdf5_files.storage)


def read_zarr_maps(group: Any, path: Path, max_bytes: int | None = None) -> OPDMaps | None:
    """The maps in a group of a Zarr store; None without a group. Errors as `read_hdf5_maps`."""
    array = zarr_files.zarr_package("use .h5").Array
    if group is None or isinstance(group, array):
        return None
    held = {name: group[name] for name in ARRAYS if name in group}
    held = {name: one for name, one in held.items() if isinstance(one, array)}

    def storage(one: Any, path: Path, limit: int | None) -> Bound:
        return zarr_files.storage(one, path, f"the array {zarr_files.array_name(one)!r}", limit)

    return _made(held, zarr_files.attributes_of(group), path, max_bytes, storage)


def _arrays(maps: OPDMaps) -> dict[str, Any]:
    values = maps.values()
    return {name: values[name] for name in ARRAYS if values[name] is not None}


def _numbers(maps: OPDMaps) -> dict[str, Any]:
    values = maps.values()
    known = {name: values[name] for name in NUMBERS if values[name] is not None}
    return {SYMMETRIC: maps.symmetric} | known


def _made(
    held: dict[str, Any],
    numbers: dict[str, Any],
    path: Path,
    max_bytes: int | None,
    storage: Callable[[Any, Path, int | None], Bound],
) -> OPDMaps:
    missing = [name for name in ("path", "fields") if name not in held]
    if missing:
        raise FormatError(f"The OPD maps in {path} lack the array {missing[0]!r}.")
    arrays: dict[str, Any] = {}
    for name, one in held.items():
        if np.dtype(one.dtype).kind not in "iuf":
            raise FormatError(f"{path}: {name!r} of the OPD maps holds {one.dtype}, not numbers.")
        storage(one, path, max_bytes).wider(8 // np.dtype(one.dtype).itemsize or 1).require(
            8 * math.prod(int(n) for n in one.shape), f"{name!r} of the OPD maps"
        )
        arrays[name] = np.asarray(one[...], np.float64)
    known = {name: float(numbers[name]) for name in NUMBERS if name in numbers}
    try:
        return OPDMaps(
            arrays.pop("path"), **arrays, **known, symmetric=bool(numbers.get(SYMMETRIC, False))
        )
    except UNREADABLE as error:
        raise FormatError(f"The OPD maps in {path} are none: {error}") from error
