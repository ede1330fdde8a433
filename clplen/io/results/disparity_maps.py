"""Disparity maps of any program: PFM, float TIFF and NumPy arrays."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from clplen.errors import FormatError
from clplen.files import PathLike
from clplen.io.formats.pfm import read_pfm
from clplen.io.formats.picture import SUFFIXES, read_picture
from clplen.io.results.truth import read_truth
from clplen.io.store.ome_tiff import read_ome_page
from clplen.io.store.ome_zarr import read_omezarr_channel

Array = np.ndarray[Any, Any]

_NUMPY, _HDF5 = b"\x93NUMPY", b"\x89HDF\r\n\x1a\n"
_HEAD = 8


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
        float32, shape (y, x), row 0 at the top; NaN and infinity are kept.

    Raises
    ------
    FormatError
        If the file is missing, damaged, of another kind or shape, or holds integers: pictures of 8
        or 16 bits do not say which disparity their levels mean.
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
    if path.suffix.lower() == ".zarr" and path.is_dir():
        return read_omezarr_channel(path, 0, max_bytes=max_bytes)
    if not path.is_file():
        raise FormatError(f"There is no disparity map {path}.")
    with path.open("rb") as file:
        head = file.read(_HEAD)
    if head.startswith(_NUMPY):
        return _npy(path)
    if head[:2] in (b"Pf", b"PF"):
        return read_pfm(path)
    if head.startswith(_HDF5):
        return read_truth(path, max_bytes=max_bytes)
    if [suffix.lower() for suffix in path.suffixes][-2:-1] == [".ome"]:
        return read_ome_page(path, 0, max_bytes=max_bytes)
    if path.suffix.lower() in SUFFIXES:
        return read_picture(path, max_bytes=max_bytes)
    raise FormatError(
        f"{path} is no disparity map: give PFM, a TIFF of floats, .npy, what write_depth wrote, or "
        "HDF5 with a truth."
    )


def _npy(path: Path) -> Array:
    """An array that is mapped, so that it cannot be larger than its file."""
    try:
        return np.asarray(np.load(path, mmap_mode="r", allow_pickle=False))
    except Exception as error:  # NumPy raises all kinds on damaged headers
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise FormatError(f"{path} cannot be read ({reason[:200]}).") from error
