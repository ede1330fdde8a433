"""Volumes of microscopes in OME-TIFF and OME-Zarr with their voxel size."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from clplen.checks import check_finite, real_array
from clplen.errors import FormatError, ShapeError
from clplen.files import PathLike
from clplen.io.formats import npy
from clplen.io.formats.npy import map_npy
from clplen.io.formats.untrusted import Bound
from clplen.io.store.picture_blocks import Array, as_block
from clplen.io.store.picture_series import describe_series, open_series, write_series


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
    """Write a volume as linear float32; the file appears only when complete.

    Parameters
    ----------
    path : path-like
        ``.tif`` or ``.tiff`` for OME-TIFF; ``.zarr`` for OME-Zarr (a folder).
    volume : array_like
        Volume of shape (planes, y, x).
    planes : array_like
        Depth z of each plane in metres, stored as PositionZ of OME or the translation of OME-Zarr.
        If the planes rise equidistantly, their step is the voxel size along z.
    voxel : tuple of float
        Voxel size (dy, dx) in metres.
    description : dict, optional
        Further description, of JSON values; "planes_um" is added.
    durable, replace : bool
        Options as in `write_stack`.

    Raises
    ------
    ValueError, ShapeError, FormatError, FileExistsError, OSError
        If the suffix is unknown or the number of planes differs; errors of `write_stack`.

    Examples
    --------
    >>> volume = np.zeros((5, 24, 32), np.float32)
    >>> volume[2, 12, 16] = 1
    >>> planes = np.linspace(-10e-6, 10e-6, 5)  # in metres
    >>> clplen.io.write_volume("volume.tif", volume, planes=planes, voxel=(0.5e-6, 0.5e-6))
    >>> clplen.io.read_volume("volume.tif")[0].shape
    (5, 24, 32)
    """
    values, z = real_array(volume, "A volume"), real_array(planes, "planes", np.float64)
    if values.ndim != 3 or z.shape != values.shape[:1]:
        raise ShapeError(
            f"A volume must have shape (planes, y, x) and a z for each plane, got {values.shape} "
            f"and {z.shape}."
        )
    check_finite(planes=z)
    write_series(
        path,
        as_block(values),
        "A volume is",
        shape=values.shape,
        axes="ZYX",
        description={**(description or {}), "planes_um": [round(depth * 1e6, 9) for depth in z]},
        spacing=(math.nan, math.nan, *voxel),
        depth=plane_step(z),
        positions=z.tolist(),
        durable=durable,
        replace=replace,
    )


def plane_step(z: Array) -> float | None:
    """Return the distance of rising equidistant planes in metres, or None."""
    steps = np.diff(z)
    if steps.size == 0 or steps[0] <= 0 or np.ptp(steps) > 1e-6 * steps[0]:
        return None
    return round(float(steps.mean()), 15)


def read_volume(path: PathLike, *, max_bytes: int | None = None) -> tuple[Array, dict[str, Any]]:
    """Read a volume and its description.

    Parameters
    ----------
    path : path-like
        TIFF with pages of equal shape, OME-Zarr or ``.npy``.
    max_bytes : int, optional
        Largest allocation; default half of the free memory.

    Returns
    -------
    numpy.ndarray, dict
        Volume of shape (planes, y, x), and the description of `write_volume`, empty for other
        files.

    Raises
    ------
    FormatError
        If the file is missing, damaged, of another kind, a series of volumes or not a volume of
        numbers.

    Examples
    --------
    >>> volume = np.zeros((5, 24, 32), np.float32)
    >>> volume[2, 12, 16] = 1
    >>> planes = np.linspace(-10e-6, 10e-6, 5)  # in metres
    >>> clplen.io.write_volume("volume.tif", volume, planes=planes, voxel=(0.5e-6, 0.5e-6))
    >>> stored, about = clplen.io.read_volume("volume.tif")
    >>> stored.shape, about["planes_um"]
    ((5, 24, 32), [-10.0, -5.0, 0.0, 5.0, 10.0])
    """
    path = Path(path)
    if path.suffix.lower() not in npy.SUFFIXES:
        _require_single(path)
        kinds = ".tif, .zarr and .npy"
        with open_series(path, what="a volume", kinds=kinds, max_bytes=max_bytes) as series:
            values, about = series.read(), series.about
    else:
        mapped = map_npy(path, what="a volume")
        size = path.stat().st_size
        Bound(path, size, 1, max_bytes).require(mapped.nbytes, "a volume")
        values, about = np.array(mapped), {}
        values = values[None] if values.ndim == 2 else values
    if values.ndim != 3 or values.dtype.kind not in "uif" or values.size == 0:
        raise FormatError(
            f"{path} must hold numbers of shape (z, y, x), got {values.dtype} of {values.shape}."
        )
    return values, about


def _require_single(path: Path) -> None:
    """Raise an error for a series of volumes, whose pages would pass for planes."""
    records = describe_series(path).get("records")
    if isinstance(records, list) and len(records) > 1:
        raise FormatError(
            f"{path} must hold a single volume, got a series of {len(records)}: use open_volumes "
            "or read_volume_series."
        )


def is_volume(path: PathLike) -> bool:
    """Return True if a file states the z of its planes, like files of `write_volume`."""
    return "planes_um" in describe_series(path)
