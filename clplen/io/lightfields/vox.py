"""Raw pictures in plenoptomos' ``.vox``, in which every lenslet has whole pixels.

The rows of ``data/image`` are V y + v, its columns U x + u, as plenoptomos writes every light field
(cicwi/plenoptomos, data_format.py); V x U is ``micro_lens/size``. A picture as a camera recorded
it, whose lenslets do not lie on whole pixels, has to be decoded as a raw image.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np

from clplen.errors import FormatError
from clplen.io.lightfields.array_sources import Selection, Source
from clplen.io.lightfields.layout import Array, Layout, View
from clplen.io.store.hdf5_files import require_size, storage

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


def source_of(dataset: h5py.Dataset, path: Path, layout: Layout) -> Source:
    """A raw picture as the source of a light field with axes y, v, x, u.

    Raises
    ------
    FormatError
        If the lenslets have no whole pixels, or the picture no whole lenslets.
    """
    if layout.order is not None:
        raise FormatError(
            f"{path}: order= does not apply to the raw picture {IMAGE!r}, whose axes are y:v:x:u."
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

    stored, ratio = storage(dataset, path, layout.max_bytes)
    return Source(
        path,
        f"the raw picture {IMAGE!r}",
        shape,
        dataset.dtype,
        "yvxu",
        "axes y:v:x:u, as plenoptomos writes it",
        read,
        stored,
        ratio,
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
