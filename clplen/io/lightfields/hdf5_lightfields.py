"""Light fields in HDF5, with everything that clplen knows about them.

Our own files hold the dataset ``lightfield`` with the attributes of
`clplen.io.store.attributes`; those of other programs are in `clplen.io.lightfields.hdf5_foreign`.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from clplen.compute.device import Device
from clplen.errors import FormatError
from clplen.files import PathLike, replacing
from clplen.hdf5_safety import require_own
from clplen.io.lightfields.array_sources import Found, light_field, reading, stored_light_field
from clplen.io.lightfields.hdf5_foreign import find, source_of
from clplen.io.lightfields.layout import Layout
from clplen.io.raw.raw_files import is_raw
from clplen.io.store import attributes
from clplen.io.store.hdf5_files import attributes_of, dataset_of, opened, require_size
from clplen.lightfield.lightfield import LightField
from clplen.lightfield.stored import StoredLightField
from clplen.outputs import MARK


def write_hdf5(path: PathLike, lf: LightField) -> None:
    """Write a light field with its spacing, weights, positions and camera.

    Parameters
    ----------
    path : path-like
    lf : LightField
        Its samples are stored as they are (uint8, uint16, float16 or float32). The raw image that
        it was decoded from is not stored.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    with replacing(path) as temporary:
        try:
            with h5py.File(temporary, "w") as file:
                file.attrs["software"] = MARK
                _write(file, lf)
        except RuntimeError as error:  # a full disk, found when the file is closed
            raise OSError(str(error)) from error


def _write(file: h5py.File, lf: LightField) -> None:
    with lf.device.on_host(lf.data, write=False) as values:
        data = file.create_dataset(attributes.SAMPLES, data=values)
    data.attrs.update(attributes.of_samples(lf))
    for name, array in attributes.arrays_beside(lf).items():
        file.create_dataset(name, data=array)
    camera = attributes.of_camera(lf.camera)
    if camera is not None:
        file.create_group(attributes.CAMERA).attrs.update(camera)


def read(
    path: PathLike, *, device: Device, layout: Layout, progress: bool = False
) -> tuple[LightField, str]:
    """Read a light field of `write_hdf5`, or of another program.

    Taken is the dataset that ``dataset=`` names, else ``lightfield``, else those of
    `clplen.io.lightfields.hdf5_foreign`, else the only one of 4 or 5 dimensions. Its axes are those of
    ``order=``, else of its attribute ``axes``, else v, u, y, x, c.

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
        If the file is truncated or damaged, has no such dataset or several, its axes or camera are
        none, or its values make no light field.
    """
    path = Path(path)
    with opened(path) as file:
        found = _found(file, path, device, layout)
        return light_field(found, device=device, layout=layout, progress=progress)


@contextmanager
def open_parts(
    path: PathLike, *, device: Device, layout: Layout
) -> Iterator[tuple[StoredLightField, str]]:
    """What `read` reads, part by part while the file is open.

    Parameters
    ----------
    path : path-like
    device : Device
    layout : Layout

    Yields
    ------
    StoredLightField, str

    Raises
    ------
    FormatError
        As `read`; what is damaged or NaN, when it is read.
    """
    path = Path(path)
    with ExitStack() as held:
        with reading(path):
            file = held.enter_context(h5py.File(path, "r"))
            require_own(file, path)
            stored = stored_light_field(_found(file, path, device, layout), layout)
        yield stored


def _found(file: h5py.File, path: Path, device: Device, layout: Layout) -> Found:
    if layout.dataset is None and is_raw(file):
        raise FormatError(
            f"{path} holds a raw image, not a light field: 'clplen render', 'stack' and 'depth' "
            "take that of a focused camera; LightField.from_raw(read_raw(path)) decodes another."
        )
    dataset = find(file, path, layout.dataset)
    source = source_of(dataset, path, layout)
    if str(dataset.name).strip("/") != attributes.SAMPLES:
        return Found(source)
    found = attributes_of(dataset, attributes.NAMES, path)
    known = _arrays_beside(file, path, source.views)
    placed = "positions" in known or layout.positions is not None
    known |= attributes.known_of(found, path, layout, placed=placed)
    known["camera"] = _camera(file, path, device)
    return Found(source, known, attributes.words_in(found, path))


def _arrays_beside(
    file: h5py.File, path: Path, views: tuple[int, int]
) -> dict[str, np.ndarray[Any, Any]]:
    found = {}
    for name in attributes.BESIDE:
        if name in file:
            dataset = dataset_of(file, name, path)
            require_size(dataset, 2 * views[0] * views[1], path)
            found[name] = dataset[...]
    return found


def _camera(file: h5py.File, path: Path, device: Device) -> Any:
    group = file.get(attributes.CAMERA)
    if not isinstance(group, h5py.Group):
        return None
    values = attributes_of(group, attributes.CAMERA_NAMES, path)
    return attributes.read_camera(values, path, device)
