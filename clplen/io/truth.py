"""True disparity of a scene: in the HDF5 file of its light field, or in a folder beside it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from clplen.errors import FormatError
from clplen.files import PathLike
from clplen.io import hci
from clplen.io.bounds import require_bytes
from clplen.io.hdf5_foreign import is_matlab
from clplen.io.hdf5_reading import attributes_of, contents, dataset_of, number, opened, storage

_DISPARITY = ("disp_lowres", "LF/disp_lowres")  # convert2hdf5.py; a MATLAB struct
_DEPTH = "GT_DEPTH"
_NUMBERS = ("dH", "focalLength", "shift")


def read_truth(
    path: PathLike, *, dataset: str | None = None, max_bytes: int | None = None
) -> np.ndarray[Any, np.dtype[np.float32]]:
    """The true disparity of the centre view, in pixels a view step, nearer being larger.

    Of HCI 2013 (Wanner, Meister, Goldluecke 2013), d = dH focalLength / depth - shift with the
    attributes of the file, from the centre view of ``GT_DEPTH`` (v, u, y, x). One view axis of that
    set is reversed against the set of 2016: read its light field with ``flip_v`` or ``flip_u``;
    ``clplen info`` tells which. Of HCI 2016 in HDF5, the dataset ``disp_lowres``; of a folder of
    that set, what `clplen.io.hci.read_truth` gives.

    Parameters
    ----------
    path : path-like
        An HDF5 file, or the folder of a scene of the HCI 4D benchmark.
    dataset : str, optional
        Another dataset (y, x) of disparity, such as "disp_highres"; of files only.
    max_bytes : int, optional
        Largest allocation that the file may ask for; default half of the free memory.

    Returns
    -------
    numpy.ndarray
        float32, shape (y, x); NaN where there is no depth.

    Raises
    ------
    FormatError
        If there is none, or the file is damaged.
    """
    path = Path(path)
    if path.is_dir():
        if dataset is not None:
            raise FormatError(
                f"{path} is a folder, which has no dataset {dataset!r}: name a file, or use "
                "clplen.io.hci.read_truth(folder, high=True) for the large maps."
            )
        return hci.read_truth(path)
    if not path.is_file():
        raise FormatError(f"There is no file or folder {path}.")
    with opened(path) as file:
        if dataset is not None:
            return _picture(dataset_of(file, dataset, path), (), path, max_bytes)
        for name in _DISPARITY:
            if isinstance(file.get(name), h5py.Dataset):
                return _picture(file[name], (), path, max_bytes)
        if not isinstance(file.get(_DEPTH), h5py.Dataset):
            raise FormatError(
                f"{path} has no true disparity: neither {_DISPARITY[0]!r} nor {_DEPTH!r}; it holds "
                f"{contents(file)}."
            )
        return _from_depth(file, path, max_bytes)


def _from_depth(
    file: h5py.File, path: Path, max_bytes: int | None
) -> np.ndarray[Any, np.dtype[np.float32]]:
    depths = file[_DEPTH]
    if depths.ndim != 4 or not (depths.shape[0] % 2 and depths.shape[1] % 2):
        raise FormatError(
            f"{path}: {_DEPTH!r} has shape {depths.shape}, not (v, u, y, x) with a centre view."
        )
    found = attributes_of(file, _NUMBERS, path)
    values = {name: number(found.get(name, math.nan)) for name in _NUMBERS}
    bad = [name for name, value in values.items() if not math.isfinite(value)]
    if bad:
        raise FormatError(
            f"{path} lacks {', '.join(bad)}: d = dH focalLength / depth - shift needs each as one "
            "number, an attribute of the file."
        )
    centre = (depths.shape[0] // 2, depths.shape[1] // 2)
    depth = _picture(depths, centre, path, max_bytes).astype(np.float64)
    depth[~(depth > 0)] = np.nan
    disparity = values["dH"] * values["focalLength"] / depth - values["shift"]
    return np.asarray(disparity.astype(np.float32))


def _picture(
    dataset: h5py.Dataset, view: tuple[int, ...], path: Path, max_bytes: int | None
) -> np.ndarray[Any, np.dtype[np.float32]]:
    """A dataset (y, x), or a view of one (v, u, y, x), as float32."""
    turned = is_matlab(dataset)
    if dataset.ndim != len(view) + 2 or dataset.dtype.kind not in "uif":
        raise FormatError(
            f"{path}: {dataset.name!r} of shape {dataset.shape} holds {dataset.dtype}, no map "
            "(y, x) of real numbers."
        )
    stored, ratio = storage(dataset, path, max_bytes)
    require_bytes(
        math.prod(dataset.shape) * dataset.dtype.itemsize,
        path=path,
        what=f"the dataset {dataset.name!r}",
        stored=stored,
        ratio=ratio,
        max_bytes=max_bytes,
    )
    values = np.asarray(dataset[view], np.float32)
    return np.ascontiguousarray(values.T) if turned else values
