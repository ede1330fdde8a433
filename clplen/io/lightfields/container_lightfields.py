"""Light fields in HDF5 and Zarr with all their properties.

Containers of clplen have the array ``lightfield`` with the attributes of
`clplen.io.store.attributes`. Zarr (formats 2 and 3, a folder or a zip archive) has chunks that are
rows of views, (1, U, ny, nx, c), or bands of rows, so that data larger than memory can be read in
parts. Containers of other programs:

- HCI 2013: ``LF`` (v, u, y, x, 3) and ``GT_DEPTH``; ``convert2hdf5.py`` of HCI 2016 writes ``LF``
  too. `clplen.io.results.disparity_maps` reads their disparity.
- MATLAB 7.3: LFToolbox writes ``LF`` of MATLAB size (t, s, v, u, c), with row t and column s of
  the view, equal to (v, u, y, x, c) here; HDF5 shows the axes reversed. 2 or 4 channels of ``LF``
  are 1 or 3 and a weight, as in `clplen.io.lightfields.array_files`.
- plenoptomos ``.vox``: ``data/image`` with ``axes`` such as "t:s:v:u", with row t and column s
  inside a view; or a raw picture with an integer number of pixels per lenslet, ``micro_lens/size``
  (V x U). Its rows are V y + v and its columns U x + u (cicwi/plenoptomos, data_format.py).
  Pictures of real cameras, with fractional lenslet sizes, must be decoded as raw images.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from clplen.compute.device import Device
from clplen.errors import FormatError, argument
from clplen.files import PathLike
from clplen.hdf5_safety import require_internal
from clplen.io.formats.untrusted import reading
from clplen.io.lightfields.array_sources import (
    OpenSource,
    Selection,
    Source,
    container_source,
    resolve_axes,
    select_array,
)
from clplen.io.lightfields.layout import Array, Layout, View
from clplen.io.raw.raw_files import is_raw
from clplen.io.store import attributes, hdf5_files, zarr_files
from clplen.io.store.attributes import SAMPLES, axes_in
from clplen.io.store.containers import Container, StoredArray
from clplen.io.store.hdf5_files import HDF5Container
from clplen.io.store.opd_arrays import read_stored_camera, write_camera
from clplen.io.store.zarr_files import ZarrContainer
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
_MAX_OFFSET = 1e-3  # pixels between lenslets and the pixel grid; float32 rounds to 1e-5
LF = "LF"
_MAX_CHUNK_BYTES = 64 << 20  # of a written Zarr chunk, which is decoded as a unit
_DEFAULT_NAMES = (SAMPLES, LF, f"{LF}/{LF}", IMAGE)  # LF/LF: a MATLAB struct of HCI 2016


def _vox_source(array: StoredArray, path: Path, layout: Layout) -> Source:
    """Return a raw picture as a light field source with axes y, v, x, u."""
    if layout.order is not None:
        raise FormatError(
            f"{path}: {argument('order')} does not apply to the raw picture {IMAGE!r}, whose axes "
            "are y:v:x:u."
        )
    views = _views(HDF5Container(array.item.file, path))
    shape = (array.shape[0] // views[0], views[0], array.shape[1] // views[1], views[1])
    if (shape[0] * views[0], shape[2] * views[1]) != array.shape:
        raise FormatError(
            f"{path}: the shape of {IMAGE!r} must be a multiple of its lenslets of {views[0]} x "
            f"{views[1]} pixels, got {array.shape}."
        )

    def read(block: Selection) -> Array:
        y, v, x, u = block
        rows = slice(y.start * views[0], y.stop * views[0])
        columns = slice(x.start * views[1], x.stop * views[1])
        part = np.asarray(array.item[rows, columns])
        lenslets = (y.stop - y.start, views[0], x.stop - x.start, views[1])
        return part.reshape(lenslets)[:, v, :, u]

    return Source(
        path,
        f"the raw picture {IMAGE!r}",
        shape,
        array.dtype,
        "yvxu",
        "axes y:v:x:u, as plenoptomos writes it",
        read,
        array.storage(layout.max_bytes),
        chunks=(1, views[0], shape[2], views[1]),
    )


def _views(container: HDF5Container) -> View:
    """Return (V, U), the integer pixels of every lenslet."""
    path = container.path
    size = _pair(container, _SIZE)
    values = {key: _pair(container, name) for key, name in _NAMES.items()}
    with np.errstate(all="ignore"):
        pitch = values["pitch"] / values["pixel"]
        offset = (values["sensor"] - values["array"]) / values["pixel"]
    if not (np.abs(pitch - size) < _MAX_OFFSET).all() or not (np.abs(offset) < _MAX_OFFSET).all():
        raise FormatError(
            f"{path} has a raw picture whose lenslets must lie on {_text(size)} whole pixels, got "
            f"{_text(pitch)} pixels from {_text(offset)} on: save {IMAGE!r} as TIFF and read it as "
            "a raw lenslet image."
        )
    if not (size >= 1).all() or (size % 1).any():
        raise FormatError(f"{path}: the lenslets must have whole pixels, got {_text(size)}.")
    return int(size[0]), int(size[1])


def _pair(container: HDF5Container, name: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return the first two numbers of a dataset."""
    array = container.array(_CAMERA + name)
    if array is None or array.shape not in ((2,), (3,)):
        raise FormatError(
            f"{container.path} has a raw picture without {_CAMERA + name!r}, the position of its "
            f"lenslets: save {IMAGE!r} as TIFF and read it as a raw lenslet image."
        )
    array.require_numbers(3)
    return np.asarray(array.item[:2], np.float64)


def _text(pair: np.ndarray[Any, Any]) -> str:
    return f"{pair[0]:g} x {pair[1]:g}"


def _find(container: Container, name: str | None) -> StoredArray:
    """Return the array of the light field."""
    path, root_array = container.path, container.array("")
    if root_array is not None:
        if name is not None:
            raise FormatError(
                f"{path} is a single array without a dataset {name!r}: omit {argument('dataset')}."
            )
        return root_array
    for default_name in _DEFAULT_NAMES if name is None else [name]:
        array = container.array(default_name)  # follows soft links, which are not listed
        if array is not None:
            return array
    arrays = container.arrays()
    listing = {
        key: (item.shape, item.dtype if item.dtype.kind in "buif" else None)
        for key, item in arrays.items()
    }
    return arrays[select_array(path, "dataset", name, _DEFAULT_NAMES, listing)]


def _source(array: StoredArray, path: Path, layout: Layout) -> Source:
    """Return an array as the source of a light field."""
    if array.name == IMAGE and len(array.shape) == 2:
        return _vox_source(array, path, layout)
    is_reversed = is_matlab(array.item)
    shape = array.shape[::-1] if is_reversed else array.shape
    stored = _stored_axes(array.attributes(["axes"]))
    axes, axes_text = resolve_axes(path, array.what, shape, order=layout.order, stored=stored)
    axes_text += " of MATLAB, reversed in HDF5" if is_reversed else ""
    return Source(
        path,
        array.what,
        array.shape,
        array.dtype,
        axes[::-1] if is_reversed else axes,
        axes_text,
        lambda block: np.asarray(array.item[block]),
        array.storage(layout.max_bytes),
        array.chunks,
        weighted=is_reversed and has_weights(array.name, axes, shape),
    )


def is_matlab(dataset: Any) -> bool:
    """Return True for a dataset of MATLAB 7.3, whose axes are reversed in HDF5."""
    return "MATLAB_class" in dataset.attrs


def has_weights(name: str, axes: str, shape: tuple[int, ...]) -> bool:
    """Return True if the last channel of a MATLAB array is LFToolbox's weight."""
    last = name.rpartition("/")[2]
    return last == LF and axes[4:] == "c" and shape[4] in (2, 4)


def _stored_axes(attributes: dict[str, Any]) -> str | None:
    """Return the axes stored in a file; plenoptomos writes t and s for y and x."""
    axes = axes_in(attributes)
    if axes is not None and {"v", "u", "t", "s"} <= set(axes):
        return axes.replace("t", "y").replace("s", "x")
    return axes


def write_container(path: PathLike, lf: LightField) -> None:
    """Write a light field with its spacing, weights, positions and camera to HDF5 or Zarr."""
    with ExitStack() as files:
        container: Container
        if Path(path).suffix.lower() == zarr_files.SUFFIX:
            container = files.enter_context(zarr_files.create_zarr(path))
        else:
            container = HDF5Container(files.enter_context(hdf5_files.create_hdf5(path)), path)
        line = math.prod((lf.shape[1], *lf.shape[3:])) * lf.dtype.itemsize
        chunks = (1, lf.shape[1], min(lf.shape[2], max(_MAX_CHUNK_BYTES // line, 1)), *lf.shape[3:])
        with lf.device.on_host(lf.data, write=False) as values:
            container.write(SAMPLES, values, chunks=chunks, **attributes.sample_attributes(lf))
        for name, array in attributes.companion_arrays(lf).items():
            container.write(name, array)
        write_camera(container, lf.camera)


@contextmanager
def open_hdf5(path: Path, *, device: Device, layout: Layout) -> Iterator[OpenSource]:
    """Open a light field of `write_container`, or of another program.

    The array is that of ``dataset=``, else a root array, else ``lightfield``, else that of a known
    program, else the only array of 4 or 5 dimensions. Its axes are those of ``order=``, else of its
    attribute ``axes``, else v, u, y, x, c.
    """
    with ExitStack() as files:
        with reading(path):
            file = files.enter_context(h5py.File(path, "r"))
            require_internal(file, path)
            if layout.dataset is None and is_raw(file):
                raise FormatError(
                    f"{path} is a raw image, not a light field: use 'clplen render', 'stack' and "
                    "'depth' for a focused camera, or LightField.from_raw(read_raw(path)) to "
                    "decode another camera."
                )
            opened = _open_source(HDF5Container(file, path), path, device, layout)
        yield opened


@contextmanager
def open_zarr(path: Path, *, device: Device, layout: Layout) -> Iterator[OpenSource]:
    """Open a light field in Zarr, as `open_hdf5` does."""
    with zarr_files.open_checked(path, "use .h5", max_bytes=layout.max_bytes) as root:
        with reading(path):
            opened = _open_source(ZarrContainer(root, path), path, device, layout)
        yield opened


def _open_source(container: Container, path: Path, device: Device, layout: Layout) -> OpenSource:
    array = _find(container, layout.dataset)
    source = _source(array, path, layout)
    if array.name != SAMPLES:
        return OpenSource(source, device, layout)
    companions = {}
    for name in attributes.COMPANIONS:
        stored = container.array(name)
        if stored is not None:
            stored.require_numbers(2 * source.views[0] * source.views[1])
            companions[name] = stored.load(layout.max_bytes)
    stored_attributes = array.attributes(attributes.NAMES)
    return container_source(
        source, device, layout, stored_attributes, companions, read_stored_camera(container, device)
    )
