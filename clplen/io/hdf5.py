"""Light fields in HDF5, with everything that clplen knows about them.

Dataset ``lightfield`` with the attributes ``axes`` ("v:u:y:x" or "v:u:y:x:c"), ``spacing`` (signed
dv, du, dy, dx in metres), ``wavelength`` (metres), ``centre`` (v, u of the central view) and
``decode``; beside it the dataset ``weights`` (V, U), and the group ``camera`` with the parameters
of the camera as attributes, in SI units.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from clplen.cameras.camera import PlenopticCamera
from clplen.cameras.plenoptic1 import Plenoptic1
from clplen.compute.device import Device
from clplen.errors import FormatError
from clplen.files import PathLike, naming, replacing
from clplen.io.layout import Layout
from clplen.lightfield.lightfield import LightField
from clplen.wave.lenslets import MicrolensArray

_OWN_AXES = "vuyxc"
_CAMERA = (
    "focal_length",
    "wavelength",
    "pixels_per_lenslet",
    "object_distance",
    "image_distance",
    "aperture_diameter",
    "field_lens",
)
_ARRAY = ("pitch", "f", "count", "lattice", "fill", "diameter", "offset", "rotation")


def write_hdf5(path: PathLike, lf: LightField) -> None:
    """Write a light field with its spacing, weights and camera.

    Parameters
    ----------
    path : path-like
    lf : LightField
        Its samples are stored as they are (uint8, uint16 or float32). The raw image that it was
        decoded from is not stored.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    with replacing(path) as temporary:
        try:
            with h5py.File(temporary, "w") as file:
                _write(file, lf)
        except RuntimeError as error:  # a full disk, found when the file is closed
            raise OSError(str(error)) from error


def _write(file: h5py.File, lf: LightField) -> None:
    data = file.create_dataset("lightfield", data=lf.to_numpy())
    data.attrs["axes"] = ":".join(_OWN_AXES[: len(lf.shape)])
    data.attrs["centre"] = [(lf.shape[0] - 1) / 2, (lf.shape[1] - 1) / 2]
    data.attrs["decode"] = lf.decode
    if lf.spacing is not None:
        data.attrs["spacing"] = np.array(lf.spacing, np.float64)
    file.create_dataset("weights", data=lf.weights)
    if lf.camera is not None:
        data.attrs["wavelength"] = float(lf.camera.wavelength)
    if isinstance(lf.camera, Plenoptic1):
        _write_camera(file.create_group("camera"), lf.camera)


def _write_camera(group: h5py.Group, camera: Plenoptic1) -> None:
    group.attrs["kind"] = "type1"
    for name in _CAMERA:
        group.attrs[name] = getattr(camera, name)
    for name in _ARRAY:
        group.attrs[f"mla_{name}"] = getattr(camera.mla, name)


def read(
    path: PathLike, *, device: Device, layout: Layout, progress: bool = False
) -> tuple[LightField, str]:
    """Read a light field that `write_hdf5`, or a program with the same layout, wrote.

    Parameters
    ----------
    path : path-like
    device : Device
    layout : Layout
    progress : bool
        Whether to show a bar on standard error.

    Returns
    -------
    LightField, str
        The light field, and what was taken for what, in one sentence.

    Raises
    ------
    FormatError
        If the file is truncated, or has no dataset ``lightfield`` of real numbers or an ``axes``
        that does not fit it, or its camera is none.
    ValueError, ShapeError
        If samples, spacing or weights are refused by `LightField.from_array`.
    """
    path = Path(path)
    try:
        with h5py.File(path, "r") as file:
            data, attributes = _read_samples(file, path, device)
            weights = _dataset(file, "weights", path)[...] if "weights" in file else None
            camera = _read_camera(file["camera"], path, device) if "camera" in file else None
    except OSError as error:
        raise FormatError(f"{path} is truncated or damaged: copy or write it again.") from error
    with naming(path):
        lf = LightField.from_array(
            data,
            device=device,
            spacing=_plain(attributes["spacing"]) if "spacing" in attributes else None,
            weights=weights,
            camera=camera,
        )
    lf = replace(lf, decode=str(attributes.get("decode", "calibrated")))
    size = " x ".join(str(n) for n in data.shape[2:])
    return lf, (
        f"{data.shape[0]} x {data.shape[1]} views (V x U) of {size} {data.dtype} from {path}, "
        f"axes {attributes.get('axes', 'not given, taken for v:u:y:x')}"
    )


def _read_samples(
    file: h5py.File, path: Path, device: Device
) -> tuple[np.ndarray[Any, Any], dict[str, Any]]:
    """The samples as (v, u, y, x[, c]), and the attributes of the dataset."""
    dataset = _dataset(file, "lightfield", path)
    own = ":".join(_OWN_AXES[: dataset.ndim])
    axes = "".join(str(dataset.attrs.get("axes", own)).split(":"))
    if sorted(axes) not in (sorted("vuyx"), sorted(_OWN_AXES)) or len(axes) != dataset.ndim:
        raise FormatError(
            f"{path} has a 'lightfield' of shape {dataset.shape} with axes {axes!r}: expected "
            "v, u, y, x and perhaps c, each once, one for each dimension."
        )
    device.require_memory(dataset.nbytes, "This light field")
    order = [axes.index(letter) for letter in _OWN_AXES[: len(axes)]]
    return dataset[...].transpose(order), dict(dataset.attrs)


def _dataset(file: h5py.File, name: str, path: Path) -> h5py.Dataset:
    """A dataset of real numbers."""
    dataset = file.get(name)
    if not isinstance(dataset, h5py.Dataset):
        held = [
            item if isinstance(file.get(item), h5py.Dataset) else f"the group {item}"
            for item in file
        ]
        raise FormatError(
            f"{path} has no dataset {name!r}; it holds {', '.join(held) or 'nothing'}."
        )
    if dataset.dtype.kind not in "buif":
        raise FormatError(f"The dataset {name!r} of {path} holds {dataset.dtype}, no real numbers.")
    return dataset


def _read_camera(group: h5py.Group, path: Path, device: Device) -> Plenoptic1 | None:
    """The camera that took the light field; None where it is of a kind unknown here."""
    values = {name: _plain(value) for name, value in group.attrs.items()}
    if values.get("kind") != "type1":
        return None
    try:
        mla = {name: values[f"mla_{name}"] for name in _ARRAY}
        camera = {name: values[name] for name in _CAMERA}
    except KeyError as error:
        raise FormatError(f"The camera in {path} lacks {error}.") from error
    pitch, focal_length = mla.pop("pitch"), mla.pop("f")
    try:
        array = MicrolensArray(pitch, focal_length, **mla)
        return PlenopticCamera.type1(mla=array, device=device, **camera)
    except (TypeError, ValueError) as error:
        raise FormatError(f"The camera in {path} is none: {error}") from error


def _plain(value: Any) -> Any:
    """An attribute as plain Python: numbers, words and tuples."""
    if isinstance(value, np.ndarray):
        return tuple(value.tolist())
    return value.item() if isinstance(value, np.generic) else value
