"""Simulated raw images in HDF5, with the camera that took them.

The dataset ``raw`` (y, x) or (y, x, c), float32, as it lies on the sensor, with the attributes
``pixel_pitch`` and ``wavelength`` in metres, and the group ``camera`` of `clplen.io.store.attributes`.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from clplen.cameras.geometry import raw_image
from clplen.cameras.microscope import Microscope
from clplen.compute.device import DeviceLike, as_device
from clplen.errors import FormatError
from clplen.files import PathLike, replacing
from clplen.io.formats.untrusted import require_bytes
from clplen.io.store.attributes import CAMERA, CAMERA_NAMES, RAW, SAMPLES, of_camera, read_camera
from clplen.io.store.hdf5_files import attributes_of, dataset_of, opened, storage
from clplen.lightfield.raw import RawImage
from clplen.outputs import MARK

SUFFIXES = (".h5", ".hdf5")


def write_raw(path: PathLike, raw: RawImage, *, durable: bool = False) -> None:
    """Write a raw image with the camera that took it, so that `read_raw` gives both back.

    Parameters
    ----------
    path : path-like
        ``.h5`` or ``.hdf5``.
    raw : RawImage
        Of a `PlenopticCamera`. How it was exposed and a scene's truth are not kept.
    durable : bool
        Whether to wait until the disk has the file, as in `clplen.files.replacing`.

    Raises
    ------
    ValueError
        If the suffix is another one, or the raw image has no camera of this package.
    OSError
        If the file cannot be written.
    """
    if Path(path).suffix.lower() not in SUFFIXES:
        raise ValueError(
            f"A raw image with its camera is written as .h5, not as {Path(path).name}."
        )
    camera: Any = raw.camera
    known = of_camera(camera)
    if known is None:
        raise ValueError(
            "This raw image was taken by no camera of this package: keep its picture by "
            "write_picture and its lattice by Lattice.save."
        )
    with replacing(path, durable=durable) as temporary:
        try:
            with h5py.File(temporary, "w") as file:
                file.attrs["software"] = MARK
                data = file.create_dataset(RAW, data=raw.to_numpy())
                data.attrs["pixel_pitch"] = float(raw.pixel_pitch)
                data.attrs["wavelength"] = float(camera.wavelength)
                file.create_group(CAMERA).attrs.update(known)
        except RuntimeError as error:  # a full disk, found when the file is closed
            raise OSError(str(error)) from error


def is_raw(file: h5py.File) -> bool:
    """Whether an open file is one of `write_raw`."""
    held = isinstance(file.get(RAW), h5py.Dataset) and isinstance(file.get(CAMERA), h5py.Group)
    return held and SAMPLES not in file


def is_raw_file(path: PathLike) -> bool:
    """Whether a file is one of `write_raw`; False for what is no HDF5."""
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES or not path.is_file() or not h5py.is_hdf5(path):
        return False
    with opened(path) as file:
        return is_raw(file)


def read_raw_file(
    path: PathLike, *, device: DeviceLike | None = None, max_bytes: int | None = None
) -> RawImage:
    """Read what `write_raw` wrote.

    Parameters
    ----------
    path : path-like
    device : Device or str, optional
        Default ``Device.open()``.
    max_bytes : int, optional
        Largest allocation that the file may ask for; default half of the free memory.

    Returns
    -------
    RawImage
        With ``camera``, and by it the places of sub-images and cells, the spacing and lens types.

    Raises
    ------
    FormatError
        If it is damaged, no such file, or its camera is none or of another sensor.
    """
    path = Path(path)
    device = as_device(device, optional=True)
    with opened(path) as file:
        dataset = dataset_of(file, RAW, path)
        group = file.get(CAMERA)
        values = attributes_of(group, CAMERA_NAMES, path) if isinstance(group, h5py.Group) else {}
        camera = read_camera(values, path, device)
        if camera is None:
            raise FormatError(f"{path} does not tell which camera took its raw image.")
        _require_sensor(dataset, camera.grid.shape, path)
        stored, ratio = storage(dataset, path, max_bytes)
        require_bytes(
            math.prod(dataset.shape) * dataset.dtype.itemsize,
            path=path,
            what=f"the dataset {RAW!r}",
            stored=stored,
            ratio=ratio,
            max_bytes=max_bytes,
        )
        data = np.ascontiguousarray(dataset[...], np.float32)
    if isinstance(camera, Microscope):
        return camera.raw_image(device.upload(data))
    return raw_image(camera, device.upload(data))


def _require_sensor(dataset: h5py.Dataset, shape: tuple[int, int], path: Path) -> None:
    fits = tuple(dataset.shape[:2]) == shape and dataset.shape[2:] in ((), (3,))
    if not fits or dataset.dtype.kind not in "uif":
        raise FormatError(
            f"{path}: the dataset {RAW!r} of shape {dataset.shape} holds {dataset.dtype}, not real "
            f"numbers on the sensor of its camera, {shape}."
        )
