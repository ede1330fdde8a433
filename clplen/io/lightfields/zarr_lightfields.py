"""Light fields in Zarr (formats 2 and 3, a folder or a zip archive), laid out as in HDF5.

A group with the array ``lightfield`` and what `clplen.io.store.attributes` names, or one array.
Chunks are rows of views, (1, U, ny, nx, c), or bands of them, so that a set larger than memory can
be read part by part.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from clplen.compute.device import Device
from clplen.errors import FormatError, argument
from clplen.files import PathLike, filling
from clplen.io.formats.untrusted import reading
from clplen.io.lightfields.array_sources import (
    OpenSource,
    Source,
    axes_known,
    chosen,
    own_source,
)
from clplen.io.lightfields.layout import Layout, View
from clplen.io.store import attributes
from clplen.io.store.attributes import SAMPLES
from clplen.io.store.opd_arrays import OPD, maps_of, read_zarr_maps, write_zarr_maps
from clplen.io.store.zarr_files import (
    FORMAT_2,
    array_name,
    attributes_of,
    opened_store,
    storage,
    zarr_package,
)
from clplen.lightfield.model.light_field import LightField
from clplen.outputs import MARK

_CHUNK = 64 << 20  # bytes of the largest chunk that is written: it is unpacked as a whole
_DEPTH = 4  # groups in groups that are looked into


def write_zarr(path: PathLike, lf: LightField) -> None:
    """Write a light field with its spacing, weights, positions and camera, in Zarr format 2."""
    zarr = _zarr()
    with filling(path) as folder:
        store = zarr.storage.LocalStore(folder)  # a name may look like an address
        group = zarr.open_group(store, mode="w", **FORMAT_2)
        group.attrs["software"] = MARK
        chunks = _chunks(lf)
        data = zarr.create(
            lf.shape, chunks=chunks, dtype=lf.dtype, store=store, path=SAMPLES, **FORMAT_2
        )
        with lf.device.on_host(lf.data, write=False) as values:
            for v, row in enumerate(values):
                data[v] = row
        data.attrs.update(attributes.of_samples(lf))
        for name, array in attributes.arrays_beside(lf).items():
            words = {"chunks": array.shape, "dtype": array.dtype, "path": name, **FORMAT_2}
            beside = zarr.create(array.shape, store=store, **words)
            beside[...] = array
        camera = attributes.of_camera(lf.camera)
        if camera is not None:
            inner = group.create_group(attributes.CAMERA)
            inner.attrs.update(camera)
            maps = maps_of(lf.camera)
            if maps is not None:
                write_zarr_maps(inner.create_group(OPD), maps, FORMAT_2)


@contextmanager
def open_zarr(path: Path, *, device: Device, layout: Layout) -> Iterator[OpenSource]:
    """Open a light field of `write_zarr`, or of another program.

    Taken is the array that ``dataset=`` names, else the only array itself, else ``lightfield``,
    else the only one of 4 or 5 dimensions. Its axes are those of ``order=``, else of its attribute
    ``axes``, else v, u, y, x, c.
    """
    with opened_store(path, "use .h5", max_bytes=layout.max_bytes) as root:
        with reading(path):
            found = _open_source(root, path, device, layout)
        yield found


def _open_source(root: Any, path: Path, device: Device, layout: Layout) -> OpenSource:
    array = _find(root, path, layout.dataset)
    found = attributes_of(array)
    source = _source(array, found, path, layout)
    if array_name(array) != SAMPLES:
        return OpenSource(source, device, layout)
    beside = _arrays_beside(root, path, source.views, layout.max_bytes)
    return own_source(source, device, layout, found, beside, _camera(root, path, device))


def _chunks(lf: LightField) -> tuple[int, ...]:
    line = math.prod((lf.shape[1], *lf.shape[3:])) * lf.dtype.itemsize
    return (1, lf.shape[1], min(lf.shape[2], max(_CHUNK // line, 1)), *lf.shape[3:])


def _arrays(group: Any, depth: int = _DEPTH) -> dict[str, Any]:
    """The arrays of a group and of the groups in it."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = {array_name(array): array for _, array in group.arrays()}
        for _, inner in group.groups() if depth else ():
            found |= _arrays(inner, depth - 1)
    return found


def _is_array(item: Any) -> bool:
    return isinstance(item, _zarr().Array)


def _find(root: Any, path: Path, name: str | None) -> Any:
    if _is_array(root):
        if name is not None:
            raise FormatError(
                f"{path} is one array, with no dataset {name!r}: leave {argument('dataset')} out."
            )
        return root
    found = _arrays(root)
    held = {key: (tuple(item.shape), item.dtype) for key, item in found.items()}
    return found[chosen(path, "array", name, (SAMPLES,), held)]


def _source(array: Any, found: dict[str, Any], path: Path, layout: Layout) -> Source:
    what = f"the dataset {array_name(array)!r}" if array_name(array) else "its array"
    shape = tuple(int(n) for n in array.shape)
    own = attributes.axes_in(found)
    axes, known = axes_known(path, what, shape, order=layout.order, own=own)
    bound = storage(array, path, what, layout.max_bytes)
    return Source(
        path,
        what,
        shape,
        np.dtype(array.dtype),
        axes,
        known,
        lambda block: np.asarray(array[block]),
        bound,
        tuple(int(n) for n in array.chunks),
    )


def _arrays_beside(
    root: Any, path: Path, views: View, max_bytes: int | None
) -> dict[str, np.ndarray[Any, Any]]:
    found = {}
    for name in attributes.BESIDE:
        if name in root:
            array = root[name]
            if not _is_array(array) or tuple(array.shape) not in (views, (*views, 2)):
                raise FormatError(f"{path}: {name!r} is no array of {views[0]} x {views[1]} views.")
            what = f"the array {name!r}"
            storage(array, path, what, max_bytes).require(
                math.prod(array.shape) * np.dtype(array.dtype).itemsize, what
            )
            found[name] = np.asarray(array[...])
    return found


def _camera(root: Any, path: Path, device: Device) -> Any:
    if attributes.CAMERA not in root or _is_array(root[attributes.CAMERA]):
        return None
    group = root[attributes.CAMERA]
    maps = read_zarr_maps(group.get(OPD), path)
    return attributes.read_camera(attributes_of(group), path, device, maps)


def _zarr() -> Any:
    return zarr_package("use .h5")
