"""Volumes of microscopes: OME-TIFF and OME-Zarr with the size of a voxel."""

from __future__ import annotations

import json
import math
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import tifffile

from clplen.errors import FormatError, ShapeError
from clplen.files import PathLike
from clplen.io.formats.tiff import decode_tiff_stack
from clplen.io.formats.untrusted import require_bytes
from clplen.io.results.stack_files import is_series, write_series
from clplen.io.store.ome_tiff import SUFFIXES
from clplen.io.store.ome_zarr import SUFFIX
from clplen.io.store.picture_blocks import Array, whole
from clplen.io.store.zarr_files import opened_store, storage


def write_volume(
    path: PathLike,
    volume: Any,
    *,
    planes: Any,
    voxel: tuple[float, float],
    description: dict[str, Any] | None = None,
    durable: bool = False,
    replace: bool = False,
) -> None:
    """Write a volume as linear float32, whole or not at all.

    Parameters
    ----------
    path : path-like
        ``.tif`` or ``.tiff``, OME-TIFF; ``.zarr``, OME-Zarr (a folder).
    volume : array_like
        Shape (planes, y, x).
    planes : array_like
        z of each plane in metres: OME's PositionZ, or the place of an OME-Zarr. Where they rise
        and are equidistant their step is the size of a voxel.
    voxel : tuple of float
        (dy, dx) in metres.
    description : dict, optional
        What else is known, of JSON; "planes_um" is added.
    durable, replace : bool
        As in `write_stack`.

    Raises
    ------
    ValueError, ShapeError
        If the suffix is another one, or there are not as many planes as z.
    FormatError, FileExistsError, OSError
        As `write_stack`.
    """
    if not is_series(path):
        raise ValueError(f"A volume is written as .tif or .zarr, not as {Path(path).name}.")
    values, z = np.asarray(volume, np.float32), np.asarray(planes, np.float64)
    if values.ndim != 3 or z.shape != values.shape[:1]:
        raise ShapeError(
            f"A volume has shape (planes, y, x) and a z for each plane, not {values.shape} and "
            f"{z.shape}."
        )
    write_series(
        path,
        whole(values),
        shape=values.shape,
        axes="ZYX",
        description={**(description or {}), "planes_um": [round(one * 1e6, 9) for one in z]},
        spacing=(math.nan, math.nan, *voxel),
        depth=_step(z),
        positions=z.tolist(),
        durable=durable,
        replace=replace,
    )


def _step(z: Array) -> float | None:
    """The distance of planes in metres, None where they do not rise or are not equidistant."""
    steps = np.diff(z)
    if steps.size == 0 or steps[0] <= 0 or np.ptp(steps) > 1e-6 * steps[0]:
        return None
    return round(float(steps.mean()), 15)


def read_volume(path: PathLike, *, max_bytes: int | None = None) -> tuple[Array, dict[str, Any]]:
    """Read a volume, and what its file says of it.

    Parameters
    ----------
    path : path-like
        TIFF of pages that are alike, OME-Zarr or ``.npy``.
    max_bytes : int, optional
        Largest allocation; default half of the free memory.

    Returns
    -------
    numpy.ndarray, dict
        Shape (planes, y, x); the description of `write_volume`, empty for other files.

    Raises
    ------
    FormatError
        If it is missing, damaged, of another kind or no volume of numbers.
    """
    path = Path(path)
    if not path.exists():
        raise FormatError(f"There is no volume {path}.")
    try:
        if path.suffix.lower() == SUFFIX:
            with opened_store(path, "write .tif", max_bytes) as group:
                level = group["0"]
                stored, ratio = storage(level, path, "a volume", max_bytes)
                _require(path, level, stored, ratio, max_bytes)
                values = np.asarray(level[...])
        elif path.suffix.lower() == ".npy":
            mapped = np.load(path, mmap_mode="r", allow_pickle=False)
            _require(path, mapped, path.stat().st_size, 1, max_bytes)
            values = np.array(mapped)
        elif path.suffix.lower() in SUFFIXES:
            size = path.stat().st_size
            require_bytes(
                size, path=path, what="the volume", stored=size, ratio=1, max_bytes=max_bytes
            )
            values = decode_tiff_stack(path.read_bytes(), path, max_bytes=max_bytes)
        else:
            raise ValueError("volumes are .tif, .zarr and .npy")
    except FormatError:
        raise
    except Exception as error:  # what parsers raise on damaged files
        raise FormatError(f"{path} is no volume that can be read ({str(error)[:200]}).") from error
    values = values[None] if values.ndim == 2 else values
    if values.ndim != 3 or values.dtype.kind not in "uif" or values.size == 0:
        raise FormatError(f"{path} holds {values.dtype} of shape {values.shape}, not (z, y, x).")
    return values, describe_volume(path)


def describe_volume(path: PathLike) -> dict[str, Any]:
    """What `write_volume` wrote about a volume; empty if there is no such file.

    Parameters
    ----------
    path : path-like
    """
    path = Path(path)
    try:
        if path.suffix.lower() == SUFFIX:
            with opened_store(path, "write .tif") as group:
                found = group.attrs["clplen"] if "0" in group else {}
        else:
            with tifffile.TiffFile(path, is_ome=False, is_imagej=False) as file:
                text = file.pages.first.description or "<OME/>"
            if "<!DOCTYPE" in text or "<!ENTITY" in text:  # could claim any amount of memory
                return {}
            root = ET.fromstring(text)
            found = json.loads(next(one.text or "" for one in root.iter() if _is_text(one)))
    except Exception:  # what other programs wrote, or nothing
        return {}
    return dict(found) if isinstance(found, dict) else {}


def is_volume(path: PathLike) -> bool:
    """Whether a file was written by `write_volume`.

    Parameters
    ----------
    path : path-like
    """
    return "planes_um" in describe_volume(path)


def _is_text(element: ET.Element) -> bool:
    return element.tag.endswith("Description")


def _require(path: Path, array: Any, stored: int, ratio: float, max_bytes: int | None) -> None:
    nbytes = math.prod(array.shape) * np.dtype(array.dtype).itemsize
    require_bytes(
        nbytes, path=path, what="a volume", stored=stored, ratio=ratio, max_bytes=max_bytes
    )
