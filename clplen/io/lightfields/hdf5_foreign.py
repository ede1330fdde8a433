"""Light fields of other programs in HDF5.

- HCI 2013: ``LF`` (v, u, y, x, 3) beside ``GT_DEPTH``; ``convert2hdf5.py`` of HCI 2016 has ``LF``
  too. `clplen.io.results.disparity_maps` reads their disparity.
- MATLAB 7.3, as LFToolbox writes ``LF`` of MATLAB size (t, s, v, u, c), t and s being row and
  column of the view, which is our (v, u, y, x, c): HDF5 shows the axes reversed. 2 or 4 channels
  of ``LF`` are 1 or 3 and a weight, as in `clplen.io.lightfields.matlab`.
- plenoptomos ``.vox``: ``data/image`` with ``axes`` such as "t:s:v:u", t and s being row and column
  inside a view, or a raw picture (`clplen.io.lightfields.vox`).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py

from clplen.errors import FormatError
from clplen.io.lightfields import vox
from clplen.io.lightfields.array_sources import Source, axes_known
from clplen.io.lightfields.layout import Layout
from clplen.io.store.attributes import SAMPLES, axes_in
from clplen.io.store.hdf5_files import attributes_of, contents, dataset_of, datasets, storage

LF = "LF"
_USUAL = (SAMPLES, LF, f"{LF}/{LF}", vox.IMAGE)  # LF/LF: a MATLAB struct of HCI 2016


def find(file: h5py.File, path: Path, name: str | None) -> h5py.Dataset:
    """The dataset of the light field.

    Parameters
    ----------
    file : h5py.File
    path : pathlib.Path
    name : str or None
        As the user says; None takes a usual name, else the only dataset of 4 or 5 dimensions.

    Raises
    ------
    FormatError
        Listing the datasets, if it is not there or there are several.
    """
    if name is not None:
        return dataset_of(file, name, path)
    for usual in _USUAL:
        if isinstance(file.get(usual), h5py.Dataset):
            return file[usual]
    fitting = [item for item in datasets(file).values() if _may_be(item)]
    if len(fitting) == 1:
        return fitting[0]
    count = "several datasets" if fitting else "no dataset"
    raise FormatError(
        f"{path} has {count} of real numbers in 4 or 5 dimensions and none named "
        f"{', '.join(_USUAL)}; it holds {contents(file)}; name one by dataset=."
    )


def _may_be(item: h5py.Dataset) -> bool:
    return len(item.shape or ()) in (4, 5) and item.dtype.kind in "buif"


def source_of(dataset: h5py.Dataset, path: Path, layout: Layout) -> Source:
    """A dataset as the source of a light field.

    Parameters
    ----------
    dataset : h5py.Dataset
    path : pathlib.Path
    layout : Layout
        Its ``order`` counts the axes of MATLAB files as MATLAB does.

    Raises
    ------
    FormatError
        If its axes are none, or it cannot be read.
    """
    name = str(dataset.name).strip("/")
    if name == vox.IMAGE and dataset.ndim == 2:
        return vox.source_of(dataset, path, layout)
    turned = is_matlab(dataset)
    shape = dataset.shape[::-1] if turned else dataset.shape
    what = f"the dataset {name!r}"
    own = _own_axes(attributes_of(dataset, ("axes",), path))
    axes, known = axes_known(path, what, shape, order=layout.order, own=own)
    known += " of MATLAB, which HDF5 shows reversed" if turned else ""
    stored, ratio = storage(dataset, path, layout.max_bytes)
    return Source(
        path,
        what,
        dataset.shape,
        dataset.dtype,
        axes[::-1] if turned else axes,
        known,
        dataset.__getitem__,
        stored,
        ratio,
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
