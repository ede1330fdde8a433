"""Disparity maps of any program, and ground truth of scenes.

Maps are PFM, float TIFF, NumPy arrays, OME-TIFF and OME-Zarr. Ground truth is in a separate file,
in the file of its light field, or in a folder. clplen writes HDF5 with the datasets ``disparity``,
``surface``, ``masks/NAME`` and, if known, ``z``, of shape (y, x), described by the attributes
``units`` and ``meaning``.
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
    create_hdf5,
    dataset_of,
    number,
    open_hdf5,
    read_array,
)
from clplen.io.store.ome_tiff import read_ome_page
from clplen.io.store.ome_zarr import read_omezarr_channel

# names in files of convert2hdf5.py, of a MATLAB struct, of write_truth
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
_HEADER_BYTES = 8


def write_truth(path: PathLike, truth: Truth, *, durable: bool = False) -> None:
    """Write the ground truth of a synthetic scene as HDF5.

    Parameters
    ----------
    path : path-like
        Output file, ``.h5`` or ``.hdf5``.
    truth : Truth
        Ground truth. ``disparity`` and ``z`` are stored as float32, ``surface`` as int32, masks as
        uint8 of 0 and 1; a ``z`` of NaN only is left out.
    durable : bool
        True to wait until the file is on disk, as in `clplen.files.replacing`.

    Raises
    ------
    ValueError, OSError
        If the suffix is unknown; if the file cannot be written.

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
        raise ValueError(f"path must end in .h5 for the truth of a scene, got {path}.")
    maps = {"disparity": truth.disparity, "surface": truth.surface}
    if np.isfinite(truth.z).any():
        maps["z"] = truth.z
    maps |= {f"{_MASKS}/{name}": mask.astype(np.uint8) for name, mask in truth.masks.items()}
    with create_hdf5(path, durable=durable) as file:
        file.attrs["view"] = "centre, (V - 1)/2, (U - 1)/2"
        for name, values in maps.items():
            units, meaning = _MEANINGS.get(name.rpartition("/")[2], ("", ""))
            file.create_dataset(name, data=values)
            file[name].attrs.update({"units": units, "meaning": meaning})


def read_scene_truth(path: PathLike, *, max_bytes: int | None = None) -> Truth:
    """Read a file of `write_truth`; `read_truth` reads the disparity of any data set.

    Parameters
    ----------
    path : path-like
        HDF5 file of `write_truth`.
    max_bytes : int, optional
        Largest allocation that the file may cause; default half of the free memory.

    Returns
    -------
    Truth
        Ground truth; ``z`` is NaN if the file does not contain it.

    Raises
    ------
    FormatError
        If the file is missing, damaged, or not written by `write_truth`.

    Examples
    --------
    >>> disc = clplen.cameras.Plane(1.0, outline=clplen.cameras.Ellipse((0, 0), 8))
    >>> scene = clplen.SurfaceScene([clplen.cameras.Plane(-0.5), disc])
    >>> lf, truth = scene.light_field((3, 3), (32, 32))
    >>> clplen.io.write_truth("truth.h5", truth)
    >>> stored = clplen.io.read_scene_truth("truth.h5")
    >>> sorted(stored.masks), stored.surface[16, [0, 16]].tolist()
    (['edges', 'far', 'near', 'planes', 'smooth'], [0, 1])
    """
    path = Path(path)
    with open_hdf5(path) as file:
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
    shapes = {values.shape for values in (disparity, surface, z, *masks.values())}
    if len(shapes) > 1:
        raise FormatError(f"The maps in {path} must have equal shapes, got {sorted(shapes)}.")
    if not (np.abs(surface) < 2.0**31).all():  # rejects NaN too
        raise FormatError(f"{path} is damaged: the indices of its surfaces exceed 32 bits.")
    return Truth(disparity, z, surface.astype(np.int32), masks)


def read_truth(
    path: PathLike, *, dataset: str | None = None, max_bytes: int | None = None
) -> np.ndarray[Any, np.dtype[np.float32]]:
    """Read the true disparity of the centre view, in pixels per view step, larger when nearer.

    HCI 2013 (Wanner, Meister, Goldluecke 2013): d = dH focalLength / depth - shift, with the
    attributes of the file and the centre view of ``GT_DEPTH`` (v, u, y, x). In this data set a view
    axis is reversed compared with 2016: read the light field with ``flip_v`` or ``flip_u``, as
    ``clplen info`` recommends. HCI 2016 in HDF5: the dataset ``disp_lowres``; in a folder: the
    result of `clplen.io.results.hci.read_truth`. File of `write_truth`: its ``disparity``.

    Parameters
    ----------
    path : path-like
        HDF5 file, or folder of a scene of the HCI 4D benchmark.
    dataset : str, optional
        Name of another disparity dataset (y, x) of a file, such as "disp_highres".
    max_bytes : int, optional
        Largest allocation that the file may cause; default half of the free memory.

    Returns
    -------
    numpy.ndarray
        Disparity, float32 of shape (y, x); NaN where the depth is unknown.

    Raises
    ------
    FormatError
        If there is no disparity, or the file is damaged.

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
                f"{path} is a folder without a dataset {dataset!r}: give a file, or use "
                "clplen.io.results.hci.read_truth(folder, high=True) for the large maps."
            )
        return hci.read_truth(path)
    with open_hdf5(path) as file:
        if dataset is not None:
            return _picture(dataset_of(file, dataset, path), (), path, max_bytes)
        for name in _DISPARITY:
            if isinstance(file.get(name), h5py.Dataset):
                return _picture(file[name], (), path, max_bytes)
        if not isinstance(file.get(_DEPTH), h5py.Dataset):
            raise FormatError(
                f"{path} has no true disparity, neither {_DISPARITY[0]!r} nor {_DEPTH!r}; it has "
                f"{contents(file)}."
            )
        return _from_depth(file, path, max_bytes)


def _from_depth(
    file: h5py.File, path: Path, max_bytes: int | None
) -> np.ndarray[Any, np.dtype[np.float32]]:
    depths = file[_DEPTH]
    if depths.ndim != 4 or not (depths.shape[0] % 2 and depths.shape[1] % 2):
        raise FormatError(
            f"{path}: {_DEPTH!r} must have shape (v, u, y, x) with a centre view, got "
            f"{depths.shape}."
        )
    attributes = attributes_of(file, _NUMBERS, path)
    values = {name: number(attributes.get(name, math.nan)) for name in _NUMBERS}
    missing = [name for name, value in values.items() if not fits_float64(value)]
    if missing:
        raise FormatError(
            f"{path} must have the numbers {', '.join(missing)} as attributes of the file, for d = "
            "dH focalLength / depth - shift."
        )
    centre = (depths.shape[0] // 2, depths.shape[1] // 2)
    depth = _picture(depths, centre, path, max_bytes).astype(np.float64)
    depth[~(depth > 0)] = np.nan
    disparity = values["dH"] * values["focalLength"] / depth - values["shift"]
    return np.asarray(disparity.astype(np.float32))


def _picture(
    dataset: h5py.Dataset, view: tuple[int, ...], path: Path, max_bytes: int | None
) -> np.ndarray[Any, np.dtype[np.float32]]:
    """Return a dataset (y, x), or a view of a dataset (v, u, y, x), as float32."""
    is_transposed = is_matlab(dataset)
    if dataset.ndim != len(view) + 2 or dataset.dtype.kind not in "uif":
        raise FormatError(
            f"{path}: {dataset.name!r} must be a map (y, x) of real numbers, got {dataset.dtype} "
            f"of shape {dataset.shape}."
        )
    values = np.asarray(read_array(dataset, path, max_bytes, view), np.float32)
    return np.ascontiguousarray(values.T) if is_transposed else values


def read_disparity(
    path: PathLike, *, shape: tuple[int, int] | None = None, max_bytes: int | None = None
) -> np.ndarray[Any, np.dtype[np.float32]]:
    """Read a disparity map, in pixels per view step, larger when nearer.

    Parameters
    ----------
    path : path-like
        PFM (``.pfm``), float TIFF or ``.npy`` with one channel; OME-TIFF or OME-Zarr of
        `write_depth`; HDF5 with ground truth, as for `read_truth`.
    shape : tuple of int, optional
        Required shape (y, x).
    max_bytes : int, optional
        Largest allocation that a TIFF may cause; default half of the free memory.

    Returns
    -------
    numpy.ndarray
        Disparity, float32 of shape (y, x), row 0 at the top; NaN and infinity are kept.

    Raises
    ------
    FormatError
        If the file is missing, damaged, of another kind or shape, or holds integers: pictures of 8
        or 16 bits do not define the disparity of their levels.

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
            f"{path} must hold floats, got {values.dtype}, whose levels are not disparities in "
            "pixels: give PFM, a TIFF of floats or .npy."
        )
    if values.ndim != 2 or values.size == 0:
        raise FormatError(
            f"A disparity map must have shape (y, x), got {values.shape} from {path}."
        )
    if shape is not None and values.shape != tuple(shape):
        raise FormatError(
            f"{path} must have {shape[0]} x {shape[1]} pixels (y, x), got {values.shape[0]} x "
            f"{values.shape[1]}: crop or pad it, do not resize it."
        )
    with np.errstate(over="ignore"):
        return values.astype(np.float32)


def _values(path: Path, max_bytes: int | None) -> Array:
    """Return the array in a file of any supported kind."""
    if path.suffix.lower() == zarr_files.SUFFIX and path.is_dir():
        return read_omezarr_channel(path, 0, max_bytes=max_bytes)
    if not path.is_file():
        raise FormatError(f"There is no disparity map {path}.")
    with path.open("rb") as file:
        head = file.read(_HEADER_BYTES)
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
        f"{path} is not a disparity map: give PFM, a TIFF of floats, .npy, a file of write_depth, "
        "or HDF5 with ground truth."
    )
