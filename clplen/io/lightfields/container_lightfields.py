"""Light fields in HDF5 and Zarr, with everything that clplen knows about them.

Our own containers hold the array ``lightfield`` with the attributes of
`clplen.io.store.attributes`. Zarr (formats 2 and 3, a folder or a zip archive) has chunks that are
rows of views, (1, U, ny, nx, c), or bands of them, so that a set larger than memory can be read
part by part. Those of other programs:

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
    axes_known,
    chosen,
    own_source,
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
_OFF = 1e-3  # pixels by which a lenslet may miss whole ones; float32 keeps 1e-5
LF = "LF"
_CHUNK = 64 << 20  # bytes of the largest chunk of Zarr that is written: it is unpacked as a whole
_USUAL = (SAMPLES, LF, f"{LF}/{LF}", IMAGE)  # LF/LF: a MATLAB struct of HCI 2016


def _vox_source(array: StoredArray, path: Path, layout: Layout) -> Source:
    """Return a raw picture as the source of a light field with axes y, v, x, u."""
    if layout.order is not None:
        raise FormatError(
            f"{path}: {argument('order')} does not apply to the raw picture {IMAGE!r}, whose axes "
            "are y:v:x:u."
        )
    views = _views(HDF5Container(array.item.file, path))
    shape = (array.shape[0] // views[0], views[0], array.shape[1] // views[1], views[1])
    if (shape[0] * views[0], shape[2] * views[1]) != array.shape:
        raise FormatError(
            f"{path}: {IMAGE!r} of shape {array.shape} has no whole number of lenslets of "
            f"{views[0]} x {views[1]} pixels."
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
    """Return (V, U), the whole pixels of every lenslet."""
    path = container.path
    size = _pair(container, _SIZE)
    found = {key: _pair(container, name) for key, name in _NAMES.items()}
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


def _pair(container: HDF5Container, name: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return the first two numbers of a dataset."""
    array = container.array(_CAMERA + name)
    if array is None or array.shape not in ((2,), (3,)):
        raise FormatError(
            f"{container.path} holds a raw picture without {_CAMERA + name!r}, which says where "
            f"its lenslets lie: save {IMAGE!r} as TIFF and read that as a raw lenslet image."
        )
    array.require_numbers(3)
    return np.asarray(array.item[:2], np.float64)


def _text(pair: np.ndarray[Any, Any]) -> str:
    return f"{pair[0]:g} x {pair[1]:g}"


def _find(container: Container, name: str | None) -> StoredArray:
    """Return the array of the light field."""
    path, whole = container.path, container.array("")
    if whole is not None:
        if name is not None:
            raise FormatError(
                f"{path} is one array, with no dataset {name!r}: leave {argument('dataset')} out."
            )
        return whole
    for usual in _USUAL if name is None else [name]:
        array = container.array(usual)  # by soft links too, which are not listed
        if array is not None:
            return array
    arrays = container.arrays()
    held = {
        key: (item.shape, item.dtype if item.dtype.kind in "buif" else None)
        for key, item in arrays.items()
    }
    return arrays[chosen(path, "dataset", name, _USUAL, held)]


def _source(array: StoredArray, path: Path, layout: Layout) -> Source:
    """Return an array as the source of a light field."""
    if array.name == IMAGE and len(array.shape) == 2:
        return _vox_source(array, path, layout)
    turned = is_matlab(array.item)
    shape = array.shape[::-1] if turned else array.shape
    own = _own_axes(array.attributes(["axes"]))
    axes, known = axes_known(path, array.what, shape, order=layout.order, own=own)
    known += " of MATLAB, which HDF5 shows reversed" if turned else ""
    return Source(
        path,
        array.what,
        array.shape,
        array.dtype,
        axes[::-1] if turned else axes,
        known,
        lambda block: np.asarray(array.item[block]),
        array.storage(layout.max_bytes),
        array.chunks,
        weighted=turned and has_weights(array.name, axes, shape),
    )


def is_matlab(dataset: Any) -> bool:
    """Return whether MATLAB 7.3 wrote a dataset, whose axes HDF5 then shows reversed."""
    return "MATLAB_class" in dataset.attrs


def has_weights(name: str, axes: str, shape: tuple[int, ...]) -> bool:
    """Return whether the last channel of a MATLAB array is LFToolbox's weight."""
    last = name.rpartition("/")[2]
    return last == LF and axes[4:] == "c" and shape[4] in (2, 4)


def _own_axes(attributes: dict[str, Any]) -> str | None:
    """Return the axes that a file says; plenoptomos writes t and s for y and x."""
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
        chunks = (1, lf.shape[1], min(lf.shape[2], max(_CHUNK // line, 1)), *lf.shape[3:])
        with lf.device.on_host(lf.data, write=False) as values:
            container.write(SAMPLES, values, chunks=chunks, **attributes.sample_attributes(lf))
        for name, array in attributes.companion_arrays(lf).items():
            container.write(name, array)
        write_camera(container, lf.camera)


@contextmanager
def open_hdf5(path: Path, *, device: Device, layout: Layout) -> Iterator[OpenSource]:
    """Open a light field of `write_container`, or of another program.

    Taken is the array that ``dataset=`` names, else the only array itself, else ``lightfield``,
    else that of a known program, else the only one of 4 or 5 dimensions. Its axes are those of
    ``order=``, else of its attribute ``axes``, else v, u, y, x, c.
    """
    with ExitStack() as files:
        with reading(path):
            file = files.enter_context(h5py.File(path, "r"))
            require_internal(file, path)
            if layout.dataset is None and is_raw(file):
                raise FormatError(
                    f"{path} holds a raw image, not a light field: 'clplen render', 'stack' and "
                    "'depth' take that of a focused camera; LightField.from_raw(read_raw(path)) "
                    "decodes another."
                )
            found = _open_source(HDF5Container(file, path), path, device, layout)
        yield found


@contextmanager
def open_zarr(path: Path, *, device: Device, layout: Layout) -> Iterator[OpenSource]:
    """Open a light field in Zarr, as `open_hdf5` does."""
    with zarr_files.open_checked(path, "use .h5", max_bytes=layout.max_bytes) as root:
        with reading(path):
            found = _open_source(ZarrContainer(root, path), path, device, layout)
        yield found


def _open_source(container: Container, path: Path, device: Device, layout: Layout) -> OpenSource:
    array = _find(container, layout.dataset)
    source = _source(array, path, layout)
    if array.name != SAMPLES:
        return OpenSource(source, device, layout)
    beside = {}
    for name in attributes.COMPANIONS:
        stored = container.array(name)
        if stored is not None:
            stored.require_numbers(2 * source.views[0] * source.views[1])
            beside[name] = stored.load(layout.max_bytes)
    found = array.attributes(attributes.NAMES)
    return own_source(source, device, layout, found, beside, read_stored_camera(container, device))
