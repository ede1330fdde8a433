"""Point images of a Fourier light-field microscope in HDF5, with all parameters and a digest."""

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
from clplen.microscopy.fourier.fourier_images import FourierPointImages
from clplen.outputs import MARK

FORMAT = "clplen Fourier point images 1"
_DEFLATE = 1032  # largest ratio of gzip
_SLACK = 1 << 20  # bytes that any file may ask for


def write_fourier_point_images(path: PathLike, images: FourierPointImages) -> None:
    """Write point images of a Fourier microscope; the file appears whole or not at all.

    Parameters
    ----------
    path : path-like
        HDF5 file; one that is there is replaced.
    images : FourierPointImages
        As `fourier_point_images` or `measure_point_images` give them.

    Raises
    ------
    OSError
        If the file cannot be written, with the bytes it takes and those that the disk has free.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.fourier_microscope(
    ...     magnification=20, na=0.3, wavelength=525e-9, relay=0.05, pixel_pitch=8e-6,
    ...     mla=clplen.MicrolensArray(500e-6, 12e-3, count=3))
    >>> images = clplen.microscopy.fourier_point_images(camera, [0.0, 20e-6])
    >>> clplen.microscopy.write_fourier_point_images("images.h5", images)
    >>> clplen.microscopy.read_fourier_point_images("images.h5").planes.tolist()
    [0.0, 2e-05]
    """
    made = io.BytesIO()
    with h5py.File(made, "w") as file:
        file.attrs["software"] = MARK
        file.attrs["format"] = FORMAT
        file.attrs["parameters"] = json.dumps(images.parameters)
        file.attrs["digest"] = digest(images)
        file.attrs["side"], file.attrs["radius"] = images.side, images.radius
        file.attrs["shape"] = images.shape
        file["centres"], file["corners"] = images.centres, images.corners
        for number, values in enumerate(images.stored):
            file.create_dataset(
                f"planes/{number:04d}",
                data=values,
                chunks=(1, 1, *values.shape[2:]),
                compression="gzip",
                compression_opts=1,
                shuffle=True,
            )
    check_space(path, made.getbuffer().nbytes)
    with replacing(path) as temporary:
        temporary.write_bytes(made.getbuffer())


def read_fourier_point_images(path: PathLike) -> FourierPointImages:
    """Read point images of a Fourier microscope.

    Parameters
    ----------
    path : path-like
        HDF5 file that `write_fourier_point_images` wrote.

    Returns
    -------
    FourierPointImages
        As they were written.

    Raises
    ------
    FormatError
        If the file holds none, was changed since it was written, or holds more than there is
        memory for.
    FileNotFoundError
        If there is none.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.fourier_microscope(
    ...     magnification=20, na=0.3, wavelength=525e-9, relay=0.05, pixel_pitch=8e-6,
    ...     mla=clplen.MicrolensArray(500e-6, 12e-3, count=3))
    >>> images = clplen.microscopy.fourier_point_images(camera, [0.0, 20e-6])
    >>> clplen.microscopy.write_fourier_point_images("images.h5", images)
    >>> again = clplen.microscopy.read_fourier_point_images("images.h5")
    >>> np.array_equal(again.image(1, (0, 0)), images.image(1, (0, 0)))
    True
    """
    place = Path(path)
    if not place.is_file():
        raise FileNotFoundError(f"There is no file {place}.")
    try:
        require_heaps(place)
        with h5py.File(place, "r") as file:
            if file.attrs.get("format") != FORMAT:
                raise FormatError(f"{place} holds no point images of a Fourier microscope.")
            require_own(file, place)
            names = sorted(file["planes"])
            of_planes = [file["planes"][name] for name in names]
            _check_memory(place, [*of_planes, file["centres"], file["corners"]])
            parameters = json.loads(file.attrs["parameters"])
            images = FourierPointImages(
                parameters,
                np.array(parameters["planes"], np.float64),
                int(parameters["voxels_per_pixel"]),
                float(file.attrs["side"]),
                (int(file.attrs["shape"][0]), int(file.attrs["shape"][1])),
                file["centres"][()],
                float(file.attrs["radius"]),
                tuple(one[()] for one in of_planes),
                file["corners"][()],
            )
            expected = file.attrs["digest"]
        _check_shapes(images)
    except (OSError, AttributeError, LookupError, RuntimeError, TypeError, ValueError) as error:
        if isinstance(error, FormatError):
            raise
        raise FormatError(
            f"{place} is no whole file of point images: it was cut short, damaged or is another "
            "file; make it again."
        ) from error
    if digest(images) != expected:
        raise FormatError(f"The point images in {place} are not those that were written: damaged.")
    return images


def _check_shapes(images: FourierPointImages) -> None:
    """Refuse arrays that do not belong together."""
    planes, lenslets, b = len(images.planes), len(images.centres), images.voxels
    fits = images.centres.shape == (lenslets, 2) and lenslets > 0 and b > 0
    fits = fits and images.corners.shape == (planes, lenslets, 2) and len(images.stored) == planes
    fits = fits and all(
        one.ndim == 4 and one.shape[:2] == (b * b, lenslets) and one.shape[2] == one.shape[3]
        for one in images.stored
    )
    if not (fits and min(images.shape) > 0 and images.side > 0 and images.radius > 0):
        raise ValueError("arrays do not fit each other")


def is_fourier(path: PathLike) -> bool:
    """Whether a file says that it holds point images of a Fourier microscope."""
    try:
        require_heaps(Path(path))
        with h5py.File(path, "r") as file:
            return bool(file.attrs.get("format") == FORMAT)
    except (OSError, FormatError, RuntimeError, ValueError):
        return False


def read_fourier_parameters(path: PathLike) -> tuple[dict[str, Any], list[tuple[int, ...]]] | None:
    """What a file's point images depend on, and their shapes, without reading them.

    Parameters
    ----------
    path : path-like

    Returns
    -------
    (dict, list of tuple) or None
        None where there is no file that holds point images of a Fourier microscope.
    """
    if not is_fourier(path):
        return None
    try:
        with h5py.File(path, "r") as file:
            require_own(file, Path(path))
            planes = file["planes"]
            return json.loads(file.attrs["parameters"]), [planes[k].shape for k in sorted(planes)]
    except (OSError, AttributeError, FormatError, LookupError, RuntimeError, ValueError):
        return None


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
            "for fewer planes, or with a larger cut."
        )


def read_matching(path: PathLike, parameters: dict[str, Any]) -> FourierPointImages | None:
    """Point images of a file, None if there is no file.

    Raises
    ------
    ValueError
        If they have other parameters, naming the first that differs.
    FormatError
        As `read_fourier_point_images`.
    """
    if not Path(path).is_file():
        return None
    images = read_fourier_point_images(path)
    for name, wanted in parameters.items():
        there = images.parameters.get(name)
        if there != wanted:
            long = isinstance(wanted, list) and len(wanted) > 2
            said = f"other {name}" if long else f"{name} = {there!r}, not {wanted!r}"
            raise ValueError(
                f"The point images in {path} were made with {said}: give another path, or remove "
                "the file to have them made anew."
            )
    return images


def digest(images: FourierPointImages) -> str:
    """SHA-256 of the parameters and all numbers."""
    total = hashlib.sha256(json.dumps(images.parameters, sort_keys=True).encode())
    numbers = np.array([images.side, images.radius, *images.shape], np.float64)
    for values in (numbers, images.centres, images.corners, *images.stored):
        total.update(str(values.shape).encode())
        total.update(np.ascontiguousarray(values).tobytes())
    return total.hexdigest()
