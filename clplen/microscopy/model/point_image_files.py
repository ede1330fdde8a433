"""Point images in HDF5: every plane a dataset of chunks, with all parameters and a digest."""

from __future__ import annotations

import hashlib
import io
import json
import math
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from clplen.compute.memory import free_memory
from clplen.errors import FormatError
from clplen.files import PathLike, check_space, replacing
from clplen.hdf5_safety import require_heaps, require_own
from clplen.microscopy.model.images import PointImages
from clplen.outputs import MARK

_DEFLATE = 1032  # largest ratio of gzip
_SLACK = 1 << 20  # bytes that any file may ask for
FORMAT = "clplen point images 1"
OF_CELLS = "clplen point images 2"  # with cells of several lenslets, which readers of 1 do not know
# Bytes of a file over those of its images; from .79 and .46 on were measured.
DENSEST = {"float32": 0.7, "float16": 0.4}


def write_point_images(path: PathLike, images: PointImages) -> None:
    """Write point images; the file appears whole or not at all.

    It is made in memory first: HDF5 ends the whole program where a disk is full.

    Parameters
    ----------
    path : path-like
        HDF5 file; one that is there is replaced.
    images : PointImages
        As `clplen.microscopy.point_images` gives them.

    Raises
    ------
    OSError
        If the file cannot be written, with the bytes it takes and those that the disk has free.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.microscope(
    ...     magnification=10, na=0.2, wavelength=525e-9, pixels_per_lenslet=11,
    ...     mla=clplen.MicrolensArray(60e-6, 1.5e-3, count=5, fill="full"))
    >>> images = clplen.microscopy.point_images(
    ...     camera, [0.0, 50e-6], voxels_per_lenslet=3, cut=0.05)
    >>> clplen.microscopy.write_point_images("images.h5", images)
    >>> clplen.microscopy.read_point_images("images.h5").planes.tolist()
    [0.0, 5e-05]
    """
    made = io.BytesIO()
    with h5py.File(made, "w") as file:
        file.attrs["software"] = MARK
        file.attrs["format"] = FORMAT if images.cell.lenslets == (1, 1) else OF_CELLS
        file.attrs["parameters"] = json.dumps(images.parameters)
        file.attrs["digest"] = digest(images)
        if images.notes:
            file.attrs["notes"] = json.dumps(images.notes)
        file["scales"] = images.scales
        for number, values in enumerate(images.stored):
            file.create_dataset(
                f"planes/{number:04d}",
                data=values,
                chunks=(1, *values.shape[1:]),
                compression="gzip",
                compression_opts=1,
                shuffle=True,
            )
    check_space(path, made.getbuffer().nbytes)
    with replacing(path) as temporary:
        temporary.write_bytes(made.getbuffer())


def read_point_images(path: PathLike) -> PointImages:
    """Read point images.

    Parameters
    ----------
    path : path-like
        HDF5 file that `write_point_images` wrote.

    Returns
    -------
    PointImages
        As they were written.

    Raises
    ------
    FormatError
        If the file holds no point images, was changed since it was written, or holds more than
        there is memory for.
    FileNotFoundError
        If there is none.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.microscope(
    ...     magnification=10, na=0.2, wavelength=525e-9, pixels_per_lenslet=11,
    ...     mla=clplen.MicrolensArray(60e-6, 1.5e-3, count=5, fill="full"))
    >>> images = clplen.microscopy.point_images(
    ...     camera, [0.0, 50e-6], voxels_per_lenslet=3, cut=0.05)
    >>> clplen.microscopy.write_point_images("images.h5", images)
    >>> again = clplen.microscopy.read_point_images("images.h5")
    >>> np.array_equal(again.image(1, (0, 0)), images.image(1, (0, 0)))
    True
    """
    place = Path(path)
    if not place.is_file():
        raise FileNotFoundError(f"There is no file {place}.")
    try:
        require_heaps(place)
        with h5py.File(place, "r") as file:
            if file.attrs.get("format") not in (FORMAT, OF_CELLS):
                raise FormatError(f"{place} holds no point images ({FORMAT!r}).")
            require_own(file, place)
            _check_memory(place, [*file["planes"].values(), file["scales"]])
            parameters = json.loads(file.attrs["parameters"])
            stored = tuple(file["planes"][name][()] for name in sorted(file["planes"]))
            scales, expected = file["scales"][()], file.attrs["digest"]
            notes = _numbers(json.loads(file.attrs.get("notes", "{}")))
        for name in {"planes", "lenslet_focal_lengths"} & parameters.keys():
            parameters[name] = tuple(parameters[name])
        images = PointImages(
            parameters,
            np.array(parameters["planes"]),
            int(parameters["voxels_per_lenslet"]),
            int(parameters["pixels_per_lenslet"]),
            stored,
            scales,
            notes,
        )
    except (OSError, AttributeError, LookupError, RuntimeError, TypeError, ValueError) as error:
        raise FormatError(
            f"{place} is no whole file of point images: it was cut short, damaged or is another "
            "file; make it again."
        ) from error
    if digest(images) != expected:
        raise FormatError(f"The point images in {place} are not those that were written: damaged.")
    return images


def read_parameters(path: PathLike) -> tuple[dict[str, Any], list[tuple[int, ...]]] | None:
    """What a file's point images depend on, and their shapes, without reading them.

    Parameters
    ----------
    path : path-like

    Returns
    -------
    (dict, list of tuple) or None
        `PointImages.parameters` and the shape of `PointImages.stored` in each plane; None where
        there is no file that holds point images.
    """
    try:
        require_heaps(Path(path))
        with h5py.File(path, "r") as file:
            if file.attrs.get("format") not in (FORMAT, OF_CELLS):
                return None
            require_own(file, Path(path))
            planes = file["planes"]
            return json.loads(file.attrs["parameters"]), [planes[k].shape for k in sorted(planes)]
    except (OSError, AttributeError, FormatError, LookupError, RuntimeError, ValueError):
        return None


def _numbers(notes: Any) -> dict[str, float]:
    """Notes as numbers from 0 on, by name."""
    found = {str(name): float(one) for name, one in dict(notes).items()}
    if not all(0 <= one < math.inf for one in found.values()):
        raise ValueError(f"notes are {notes!r}")
    return found


def _check_memory(path: Path, datasets: list[h5py.Dataset]) -> None:
    """Refuse more samples than the file can hold, or the memory."""
    chunks = [math.prod(one.chunks or ()) * one.dtype.itemsize for one in datasets]
    nbytes = sum(one.nbytes for one in datasets)
    if max(nbytes, *chunks) > path.stat().st_size * _DEFLATE + _SLACK:
        raise ValueError(f"{nbytes:,} bytes are declared")
    free = free_memory()
    if nbytes > free:
        raise FormatError(
            f"The point images in {path} need {nbytes:,} bytes, and {free:,} are free: make them "
            "for fewer planes, of less depth or with store='float16'."
        )


def read_matching(path: PathLike, parameters: dict[str, Any]) -> PointImages | None:
    """Point images of a file, None if there is no file.

    Raises
    ------
    ValueError
        If they have other parameters, naming the first that differs.
    FormatError
        As `read_point_images`.
    """
    if not Path(path).is_file():
        return None
    images = read_point_images(path)
    for name, wanted in parameters.items():
        there = images.parameters.get(name)
        if there != wanted:
            raise ValueError(
                f"The point images in {path} were made with {_difference(name, there, wanted)}: "
                "give another path, or remove the file to have them made anew."
            )
    return images


def _difference(name: str, there: Any, wanted: Any) -> str:
    """What is there, and what is wanted; of planes their number, or the first that differs."""
    if name == "planes":
        if len(there) != len(wanted):
            return f"{len(there)} planes, not {len(wanted)}"
        pairs = enumerate(zip(there, wanted, strict=True))
        number, (there, wanted) = next(pair for pair in pairs if pair[1][0] != pair[1][1])
        name = f"planes[{number}]"
    return f"{name} = {there!r}, not {wanted!r}"


def digest(images: PointImages) -> str:
    """SHA-256 of the parameters and all numbers."""
    total = hashlib.sha256(json.dumps(images.parameters, sort_keys=True).encode())
    for values in (images.scales, *images.stored):
        total.update(str(values.shape).encode())
        total.update(np.ascontiguousarray(values).tobytes())
    return total.hexdigest()
