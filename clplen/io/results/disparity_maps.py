"""Disparity maps of any program, and the true disparity of a scene.

Maps are PFM, float TIFF, NumPy arrays, OME-TIFF and OME-Zarr. A truth lies in a file of its own, in
that of its light field, or in a folder. Our own are HDF5 with the datasets ``disparity``,
``surface`` and ``masks/NAME``, and ``z`` where it is known, all of shape (y, x); their attributes
``units`` and ``meaning`` describe them.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from clplen.cameras.scenes.ground_truth import Truth
from clplen.checks import fits_float64
from clplen.errors import FormatError
from clplen.files import PathLike
from clplen.io.formats import npy, pfm, picture
from clplen.io.formats.npy import map_npy
from clplen.io.formats.pfm import read_pfm
from clplen.io.formats.picture import read_picture
from clplen.io.lightfields.container_lightfields import is_matlab
from clplen.io.results import hci
from clplen.io.store import hdf5_files, zarr_files
from clplen.io.store.hdf5_files import (
    attributes_of,
    contents,
    created,
    dataset_of,
    number,
    opened,
    read_array,
)
from clplen.io.store.ome_tiff import read_ome_page
from clplen.io.store.ome_zarr import read_omezarr_channel

# convert2hdf5.py; a MATLAB struct; ours
_DISPARITY = ("disp_lowres", "LF/disp_lowres", "disparity")
_DEPTH = "GT_DEPTH"
_NUMBERS = ("dH", "focalLength", "shift")
_MASKS = "masks"
_MEANINGS = {  # units, meaning
    "disparity": ("pixels a view step", "of the centre view, nearer is larger; NaN: no surface"),
    "z": ("m", "from the focused plane, > 0 farther from the lens; NaN: no surface"),
    "surface": ("", "place of the surface in the scene, from 0; -1: none"),
    "edges": ("", "1: beside an edge of depth"),
    "near": ("", "1: beside an edge of depth, on the nearer surface"),
    "far": ("", "1: beside an edge of depth, on the farther surface"),
    "planes": ("", "1: on a plane, away from edges of depth"),
    "smooth": ("", "1: on a curved surface, away from edges of depth"),
}
Array = np.ndarray[Any, Any]
_HEAD = 8


def write_truth(path: PathLike, truth: Truth, *, durable: bool = False) -> None:
    """Write what is exactly so in a synthetic scene, as HDF5.

    Parameters
    ----------
    path : path-like
        ``.h5`` or ``.hdf5``.
    truth : Truth
        ``disparity`` and ``z`` are kept as float32, ``surface`` as int32, masks as 0 and 1 of
        uint8; a ``z`` without a number is left out.
    durable : bool
        Whether to wait until the disk has it, as in `clplen.files.replacing`.

    Raises
    ------
    ValueError, OSError
        If the suffix is another one; if the file cannot be written.

    Examples
    --------
    >>> disc = clplen.cameras.Plane(1.0, outline=clplen.cameras.Ellipse((0, 0), 8))
    >>> scene = clplen.SurfaceScene([clplen.cameras.Plane(-0.5), disc])
    >>> lf, truth = scene.light_field((3, 3), (32, 32))
    >>> clplen.io.write_truth("truth.h5", truth)
    >>> clplen.io.read_scene_truth("truth.h5")
    <Truth 32 x 32, disparity -0.500 to 1.000>
    """
    if Path(path).suffix.lower() not in hdf5_files.SUFFIXES:
        raise ValueError(f"The truth of a scene is written as .h5, not as {path}.")
    maps = {"disparity": truth.disparity, "surface": truth.surface}
    if np.isfinite(truth.z).any():
        maps["z"] = truth.z
    maps |= {f"{_MASKS}/{name}": mask.astype(np.uint8) for name, mask in truth.masks.items()}
    with created(path, durable=durable) as file:
        file.attrs["view"] = "centre, (V - 1)/2, (U - 1)/2"
        for name, values in maps.items():
            units, meaning = _MEANINGS.get(name.rpartition("/")[2], ("", ""))
            file.create_dataset(name, data=values)
            file[name].attrs.update({"units": units, "meaning": meaning})


def read_scene_truth(path: PathLike, *, max_bytes: int | None = None) -> Truth:
    """Read all of what `write_truth` wrote; `read_truth` gives the disparity of any data set.

    Parameters
    ----------
    path : path-like
        HDF5 of `write_truth`.
    max_bytes : int, optional
        Largest allocation that the file may ask for; default half of the free memory.

    Returns
    -------
    Truth
        A ``z`` that the file does not hold is NaN.

    Raises
    ------
    FormatError
        If the file is missing, damaged, or not one of `write_truth`.

    Examples
    --------
    >>> disc = clplen.cameras.Plane(1.0, outline=clplen.cameras.Ellipse((0, 0), 8))
    >>> scene = clplen.SurfaceScene([clplen.cameras.Plane(-0.5), disc])
    >>> lf, truth = scene.light_field((3, 3), (32, 32))
    >>> clplen.io.write_truth("truth.h5", truth)
    >>> found = clplen.io.read_scene_truth("truth.h5")
    >>> sorted(found.masks), found.surface[16, [0, 16]].tolist()
    (['edges', 'far', 'near', 'planes', 'smooth'], [0, 1])
    """
    path = Path(path)
    with opened(path) as file:
        disparity = _picture(dataset_of(file, "disparity", path), (), path, max_bytes)
        surface = _picture(dataset_of(file, "surface", path), (), path, max_bytes)
        z = np.full_like(disparity, np.nan)
        if isinstance(file.get("z"), h5py.Dataset):
            z = _picture(file["z"], (), path, max_bytes)
        group = file.get(_MASKS)
        names = list(group) if isinstance(group, h5py.Group) else []
        masks = {
            name: _picture(dataset_of(file, f"{_MASKS}/{name}", path), (), path, max_bytes) > 0
            for name in names
        }
    differing = {values.shape for values in (disparity, surface, z, *masks.values())}
    if len(differing) > 1:
        raise FormatError(f"{path} holds maps of the shapes {sorted(differing)}, not of one.")
    if not (np.abs(surface) < 2.0**31).all():  # NaN is not below either
        raise FormatError(f"{path} is damaged: its surfaces are no numbers of 32 bits.")
    return Truth(disparity, z, surface.astype(np.int32), masks)


def read_truth(
    path: PathLike, *, dataset: str | None = None, max_bytes: int | None = None
) -> np.ndarray[Any, np.dtype[np.float32]]:
    """Read the true disparity of the centre view, in pixels a view step, nearer being larger.

    Of HCI 2013 (Wanner, Meister, Goldluecke 2013), d = dH focalLength / depth - shift with the
    attributes of the file, from the centre view of ``GT_DEPTH`` (v, u, y, x). One view axis of that
    set is reversed against the set of 2016: read its light field with ``flip_v`` or ``flip_u``;
    ``clplen info`` tells which. Of HCI 2016 in HDF5, the dataset ``disp_lowres``; of a folder of
    that set, what `clplen.io.results.hci.read_truth` gives. Of a file of `write_truth`, its
    ``disparity``.

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
        Shape (y, x), float32; NaN where there is no depth.

    Raises
    ------
    FormatError
        If there is none, or the file is damaged.

    Examples
    --------
    >>> disc = clplen.cameras.Plane(1.0, outline=clplen.cameras.Ellipse((0, 0), 8))
    >>> scene = clplen.SurfaceScene([clplen.cameras.Plane(-0.5), disc])
    >>> lf, truth = scene.light_field((3, 3), (32, 32))
    >>> clplen.io.write_truth("truth.h5", truth)
    >>> disparity = clplen.io.read_truth("truth.h5")
    >>> disparity.shape, disparity[16, [0, 16]].tolist()
    ((32, 32), [-0.5, 1.0])
    """
    path = Path(path)
    if path.is_dir():
        if dataset is not None:
            raise FormatError(
                f"{path} is a folder, which has no dataset {dataset!r}: name a file, or use "
                "clplen.io.results.hci.read_truth(folder, high=True) for the large maps."
            )
        return hci.read_truth(path)
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
    bad = [name for name, value in values.items() if not fits_float64(value)]
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
    values = np.asarray(read_array(dataset, path, max_bytes, view), np.float32)
    return np.ascontiguousarray(values.T) if turned else values


def read_disparity(
    path: PathLike, *, shape: tuple[int, int] | None = None, max_bytes: int | None = None
) -> np.ndarray[Any, np.dtype[np.float32]]:
    """Read a disparity map, in pixels a view step, nearer larger.

    Parameters
    ----------
    path : path-like
        PFM (``.pfm``), a TIFF of floats or ``.npy`` of one channel; OME-TIFF and OME-Zarr of
        `write_depth`; HDF5 with a truth, as `read_truth` takes it.
    shape : tuple of int, optional
        (y, x) that it must have.
    max_bytes : int, optional
        Largest allocation that a TIFF may ask for; default half of the free memory.

    Returns
    -------
    numpy.ndarray
        Shape (y, x), float32, row 0 at the top; NaN and infinity are kept.

    Raises
    ------
    FormatError
        If the file is missing, damaged, of another kind or shape, or holds integers: pictures of 8
        or 16 bits do not say which disparity their levels mean.

    Examples
    --------
    >>> clplen.io.write_pfm("disparity.pfm", np.tile(np.linspace(-1, 1, 32), (24, 1)))
    >>> disparity = clplen.io.read_disparity("disparity.pfm", shape=(24, 32))
    >>> disparity.shape, float(disparity.max())
    ((24, 32), 1.0)
    """
    path = Path(path)
    values = _values(path, max_bytes)
    if values.dtype.kind != "f":
        raise FormatError(
            f"{path} holds {values.dtype}, whose levels are no disparities in pixels: give PFM, a "
            "TIFF of floats or .npy."
        )
    if values.ndim != 2 or values.size == 0:
        raise FormatError(f"{path} has shape {values.shape}; a disparity map has (y, x).")
    if shape is not None and values.shape != tuple(shape):
        raise FormatError(
            f"{path} has {values.shape[0]} x {values.shape[1]} pixels (y, x), but {shape[0]} x "
            f"{shape[1]} are meant: crop or pad it, do not resize it."
        )
    with np.errstate(over="ignore"):
        return values.astype(np.float32)


def _values(path: Path, max_bytes: int | None) -> Array:
    """What a file of any of the kinds holds."""
    if path.suffix.lower() == zarr_files.SUFFIX and path.is_dir():
        return read_omezarr_channel(path, 0, max_bytes=max_bytes)
    if not path.is_file():
        raise FormatError(f"There is no disparity map {path}.")
    with path.open("rb") as file:
        head = file.read(_HEAD)
    if head.startswith(npy.MAGIC):
        return map_npy(path, what="a disparity map")
    if head[:2] in pfm.MAGICS:
        return read_pfm(path)
    if head.startswith(hdf5_files.MAGIC):
        return read_truth(path, max_bytes=max_bytes)
    if [suffix.lower() for suffix in path.suffixes][-2:-1] == [".ome"]:
        return read_ome_page(path, 0, max_bytes=max_bytes)
    if path.suffix.lower() in picture.SUFFIXES:
        return read_picture(path, max_bytes=max_bytes)
    raise FormatError(
        f"{path} is no disparity map: give PFM, a TIFF of floats, .npy, what write_depth wrote, or "
        "HDF5 with a truth."
    )
