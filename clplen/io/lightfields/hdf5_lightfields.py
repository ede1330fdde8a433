"""Light fields in HDF5, with everything that clplen knows about them.

Our own files hold the dataset ``lightfield`` with the attributes of `clplen.io.store.attributes`.
Those of other programs:

- HCI 2013: ``LF`` (v, u, y, x, 3) beside ``GT_DEPTH``; ``convert2hdf5.py`` of HCI 2016 has ``LF``
  too. `clplen.io.results.disparity_maps` reads their disparity.
- MATLAB 7.3, as LFToolbox writes ``LF`` of MATLAB size (t, s, v, u, c), t and s being row and
  column of the view, which is our (v, u, y, x, c): HDF5 shows the axes reversed. 2 or 4 channels
  of ``LF`` are 1 or 3 and a weight, as in `clplen.io.lightfields.array_files`.
- plenoptomos ``.vox``: ``data/image`` with ``axes`` such as "t:s:v:u", t and s being row and column
  inside a view; or a raw picture, in which every lenslet has whole pixels. Its rows are V y + v,
  its columns U x + u, as plenoptomos writes every light field (cicwi/plenoptomos, data_format.py);
  V x U is ``micro_lens/size``. A picture as a camera recorded it, whose lenslets do not lie on
  whole pixels, has to be decoded as a raw image.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from clplen.compute.device import Device
from clplen.errors import FormatError, argument
from clplen.files import PathLike
from clplen.hdf5_safety import require_own
from clplen.io.formats.untrusted import reading
from clplen.io.lightfields.array_sources import (
    OpenSource,
    Selection,
    Source,
    axes_known,
    chosen,
    own_source,
)
from clplen.io.lightfields.layout import Array, Layout, View
from clplen.io.raw.raw_files import is_raw
from clplen.io.store import attributes
from clplen.io.store.attributes import SAMPLES, axes_in
from clplen.io.store.hdf5_files import (
    attributes_of,
    created,
    dataset_of,
    datasets,
    read_array,
    require_size,
    storage,
)
from clplen.io.store.opd_arrays import (
    OPD,
    read_hdf5_maps,
    write_camera,
)
from clplen.lightfield.model.light_field import LightField

IMAGE = "data/image"
_CAMERA = "instrument/camera/"
_SIZE = "micro_lens/size"
_NAMES = {
    "pitch": "micro_lens/physical_size",
    "pixel": "sensor/pixel_size",
    "array": "micro_lenses_array/position",
    "sensor": "sensor/position",
}
_OFF = 1e-3  # pixels by which a lenslet may miss whole ones; float32 keeps 1e-5
LF = "LF"
_USUAL = (SAMPLES, LF, f"{LF}/{LF}", IMAGE)  # LF/LF: a MATLAB struct of HCI 2016


def vox_source(dataset: h5py.Dataset, path: Path, layout: Layout) -> Source:
    """A raw picture as the source of a light field with axes y, v, x, u."""
    if layout.order is not None:
        raise FormatError(
            f"{path}: {argument('order')} does not apply to the raw picture {IMAGE!r}, whose axes "
            "are y:v:x:u."
        )
    views = _views(dataset.file, path)
    shape = (dataset.shape[0] // views[0], views[0], dataset.shape[1] // views[1], views[1])
    if (shape[0] * views[0], shape[2] * views[1]) != dataset.shape:
        raise FormatError(
            f"{path}: {IMAGE!r} of shape {dataset.shape} has no whole number of lenslets of "
            f"{views[0]} x {views[1]} pixels."
        )

    def read(block: Selection) -> Array:
        y, v, x, u = block
        rows = slice(y.start * views[0], y.stop * views[0])
        columns = slice(x.start * views[1], x.stop * views[1])
        part = np.asarray(dataset[rows, columns])
        lenslets = (y.stop - y.start, views[0], x.stop - x.start, views[1])
        return part.reshape(lenslets)[:, v, :, u]

    bound = storage(dataset, path, layout.max_bytes)
    return Source(
        path,
        f"the raw picture {IMAGE!r}",
        shape,
        dataset.dtype,
        "yvxu",
        "axes y:v:x:u, as plenoptomos writes it",
        read,
        bound,
        chunks=(1, views[0], shape[2], views[1]),
    )


def _views(file: h5py.File, path: Path) -> View:
    """(V, U) whole pixels of every lenslet."""
    size = _pair(file, _SIZE, path)
    found = {key: _pair(file, name, path) for key, name in _NAMES.items()}
    with np.errstate(all="ignore"):
        pitch = found["pitch"] / found["pixel"]
        offset = (found["sensor"] - found["array"]) / found["pixel"]
    if not (np.abs(pitch - size) < _OFF).all() or not (np.abs(offset) < _OFF).all():
        raise FormatError(
            f"{path} holds a raw picture whose lenslets, {_text(pitch)} pixels wide from "
            f"{_text(offset)} on, do not lie on {_text(size)} whole pixels each: save {IMAGE!r} as "
            "TIFF and read that as a raw lenslet image."
        )
    if not (size >= 1).all() or (size % 1).any():
        raise FormatError(f"{path}: the lenslets have {_text(size)} pixels, no views.")
    return int(size[0]), int(size[1])


def _pair(file: h5py.File, name: str, path: Path) -> np.ndarray[Any, np.dtype[np.float64]]:
    """The first two numbers of a dataset."""
    dataset = file.get(_CAMERA + name)
    if not isinstance(dataset, h5py.Dataset) or dataset.shape not in ((2,), (3,)):
        raise FormatError(
            f"{path} holds a raw picture without {_CAMERA + name!r}, which says where its lenslets "
            f"lie: save {IMAGE!r} as TIFF and read that as a raw lenslet image."
        )
    require_size(dataset, 3, path)
    return np.asarray(dataset[:2], np.float64)


def _text(pair: np.ndarray[Any, Any]) -> str:
    return f"{pair[0]:g} x {pair[1]:g}"


def find_dataset(file: h5py.File, path: Path, name: str | None) -> h5py.Dataset:
    """The dataset of the light field."""
    for usual in _USUAL if name is None else [name]:
        if isinstance(file.get(usual), h5py.Dataset):  # soft links too, which are not listed
            return file[usual]
    held = {
        key: (item.shape or (), item.dtype if item.dtype.kind in "buif" else None)
        for key, item in datasets(file)
    }
    return file[chosen(path, "dataset", name, _USUAL, held)]


def dataset_source(dataset: h5py.Dataset, path: Path, layout: Layout) -> Source:
    """A dataset as the source of a light field."""
    name = str(dataset.name).strip("/")
    if name == IMAGE and dataset.ndim == 2:
        return vox_source(dataset, path, layout)
    turned = is_matlab(dataset)
    shape = dataset.shape[::-1] if turned else dataset.shape
    what = f"the dataset {name!r}"
    own = _own_axes(attributes_of(dataset, ("axes",), path))
    axes, known = axes_known(path, what, shape, order=layout.order, own=own)
    known += " of MATLAB, which HDF5 shows reversed" if turned else ""
    bound = storage(dataset, path, layout.max_bytes)
    return Source(
        path,
        what,
        dataset.shape,
        dataset.dtype,
        axes[::-1] if turned else axes,
        known,
        dataset.__getitem__,
        bound,
        dataset.chunks,
        weighted=turned and has_weights(name, axes, shape),
    )


def is_matlab(dataset: h5py.Dataset) -> bool:
    """Whether MATLAB 7.3 wrote a dataset, whose axes HDF5 then shows reversed."""
    return "MATLAB_class" in dataset.attrs


def has_weights(name: str, axes: str, shape: tuple[int, ...]) -> bool:
    """Whether the last channel of a MATLAB array is LFToolbox's weight."""
    last = name.rpartition("/")[2]
    return last == LF and axes[4:] == "c" and shape[4] in (2, 4)


def _own_axes(attributes: dict[str, Any]) -> str | None:
    """The axes that a file says; plenoptomos writes t and s for y and x."""
    axes = axes_in(attributes)
    if axes is not None and {"v", "u", "t", "s"} <= set(axes):
        return axes.replace("t", "y").replace("s", "x")
    return axes


def write_hdf5(path: PathLike, lf: LightField) -> None:
    """Write a light field with its spacing, weights, positions and camera."""
    with created(path) as file:
        with lf.device.on_host(lf.data, write=False) as values:
            data = file.create_dataset(attributes.SAMPLES, data=values)
        data.attrs.update(attributes.of_samples(lf))
        for name, array in attributes.arrays_beside(lf).items():
            file.create_dataset(name, data=array)
        write_camera(file, lf.camera)


@contextmanager
def open_hdf5(path: Path, *, device: Device, layout: Layout) -> Iterator[OpenSource]:
    """Open a light field of `write_hdf5`, or of another program.

    Taken is the dataset that ``dataset=`` names, else ``lightfield``, else that of a known
    program, else the only one of 4 or 5 dimensions. Its axes are those of ``order=``, else of its
    attribute ``axes``, else v, u, y, x, c.
    """
    with ExitStack() as held:
        with reading(path):
            file = held.enter_context(h5py.File(path, "r"))
            require_own(file, path)
            found = _open_source(file, path, device, layout)
        yield found


def _open_source(file: h5py.File, path: Path, device: Device, layout: Layout) -> OpenSource:
    if layout.dataset is None and is_raw(file):
        raise FormatError(
            f"{path} holds a raw image, not a light field: 'clplen render', 'stack' and 'depth' "
            "take that of a focused camera; LightField.from_raw(read_raw(path)) decodes another."
        )
    dataset = find_dataset(file, path, layout.dataset)
    source = dataset_source(dataset, path, layout)
    if str(dataset.name).strip("/") != attributes.SAMPLES:
        return OpenSource(source, device, layout)
    found = attributes_of(dataset, attributes.NAMES, path)
    beside = _arrays_beside(file, path, source.views, layout.max_bytes)
    return own_source(source, device, layout, found, beside, _camera(file, path, device))


def _arrays_beside(
    file: h5py.File, path: Path, views: tuple[int, int], max_bytes: int | None
) -> dict[str, np.ndarray[Any, Any]]:
    found = {}
    for name in attributes.BESIDE:
        if name in file:
            dataset = dataset_of(file, name, path)
            require_size(dataset, 2 * views[0] * views[1], path)
            found[name] = read_array(dataset, path, max_bytes)
    return found


def _camera(file: h5py.File, path: Path, device: Device) -> Any:
    group = file.get(attributes.CAMERA)
    if not isinstance(group, h5py.Group):
        return None
    values = attributes_of(group, attributes.CAMERA_NAMES, path)
    maps = read_hdf5_maps(group.get(OPD), path)
    return attributes.read_camera(values, path, device, maps)
