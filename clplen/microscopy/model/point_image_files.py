"""HDF5 files of point images: a dataset per plane, the parameters and a digest."""

from __future__ import annotations

import hashlib
import io
import json
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from clplen.compute.memory import free_memory
from clplen.errors import FormatError
from clplen.files import PathLike, check_space, check_writable, replacing
from clplen.hdf5_safety import require_heaps, require_internal
from clplen.microscopy.model.fourier_images import FourierPointImages
from clplen.microscopy.model.images import PointImages
from clplen.outputs import MARK

AnyImages = PointImages | FourierPointImages
Parameters = dict[str, Any]

FORMAT = "clplen point images 1"
CELL_FORMAT = "clplen point images 3"  # cells of several lenslets, not supported by format 1
FOURIER = "clplen Fourier point images 1"
# Lower bound of the bytes of a file over those of its images; measured: 0.79 and 0.46 or more.
MIN_COMPRESSION = {"float32": 0.7, "float16": 0.4}

_MAX_DEFLATE_RATIO = 1032  # limit of the format
_MAX_SMALL_BYTES = 1 << 20  # datasets up to this size are always allowed
_DAMAGED = (
    OSError, ArithmeticError, AttributeError, LookupError, RuntimeError, TypeError, ValueError,
)  # fmt: skip


def write_point_images(path: PathLike, images: AnyImages) -> None:
    """Write point images to a file atomically.

    Parameters
    ----------
    path : path-like
        HDF5 file; an existing file is replaced.
    images : PointImages or FourierPointImages
        Point images of a microscope or of a Fourier microscope.

    Raises
    ------
    OSError
        If the file cannot be written; the message gives the required and the free bytes.

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
    attributes: dict[str, Any] = {"digest": digest(images)}
    if isinstance(images, FourierPointImages):
        attributes |= {"format": FOURIER, "side": images.side, "radius": images.radius}
        attributes["shape"] = images.shape
        arrays, chunk_axes = {"centres": images.centres, "corners": images.corners}, 2
    else:
        attributes["format"] = FORMAT if images.cell.lenslets == (1, 1) else CELL_FORMAT
        if images.notes:
            attributes["notes"] = json.dumps(images.notes)
        arrays, chunk_axes = {"scales": images.scales}, 1
    buffer = io.BytesIO()  # HDF5 aborts the whole program if a disk is full
    with h5py.File(buffer, "w") as file:
        file.attrs["software"] = MARK
        file.attrs["parameters"] = json.dumps(images.parameters)
        for name, value in attributes.items():
            file.attrs[name] = value
        for name, values in arrays.items():
            file[name] = values
        for number, values in enumerate(images.stored):
            file.create_dataset(
                f"planes/{number:04d}",
                data=values,
                chunks=(1,) * chunk_axes + values.shape[chunk_axes:],
                compression="gzip",
                compression_opts=1,
                shuffle=True,
            )
    check_space(path, buffer.getbuffer().nbytes)
    with replacing(path) as temporary:
        temporary.write_bytes(buffer.getbuffer())


def read_point_images(path: PathLike) -> AnyImages:
    """Read point images from a file.

    Parameters
    ----------
    path : path-like
        HDF5 file written by `write_point_images`.

    Returns
    -------
    PointImages or FourierPointImages
        Point images with the written values and parameters.

    Raises
    ------
    FormatError
        If the file contains no point images, was changed after writing, or does not fit the
        memory.
    FileNotFoundError
        If the file does not exist.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.fourier_microscope(
    ...     magnification=20, na=0.3, wavelength=525e-9, relay=0.05, pixel_pitch=8e-6,
    ...     mla=clplen.MicrolensArray(500e-6, 12e-3, count=3))
    >>> images = clplen.microscopy.fourier_point_images(camera, [0.0, 20e-6])
    >>> clplen.microscopy.write_point_images("images.h5", images)
    >>> again = clplen.microscopy.read_point_images("images.h5")
    >>> np.array_equal(again.image(1, (0, 0)), images.image(1, (0, 0)))
    True
    """
    path = Path(path)
    with _opened(path) as file:
        is_fourier = file.attrs["format"] == FOURIER
        planes = _planes_in(file)
        tables = [file[name] for name in (("centres", "corners") if is_fourier else ("scales",))]
        _check_memory(path, [*planes, *tables])
        read = _read_fourier if is_fourier else _read_images
        stored = tuple(plane[()] for plane in planes)
        images = read(file, json.loads(file.attrs["parameters"]), stored)
        written = file.attrs["digest"]
    if digest(images) != written:
        raise FormatError(
            f"The point images in {path} do not match their digest: the file is damaged; make it "
            "again."
        )
    return images


def _read_images(
    file: h5py.File, parameters: Parameters, stored: tuple[np.ndarray[Any, Any], ...]
) -> PointImages:
    notes = {
        str(name): float(value)
        for name, value in dict(json.loads(file.attrs.get("notes", "{}"))).items()
    }
    if not all(0 <= value < math.inf for value in notes.values()):
        raise ValueError(f"notes are {notes!r}")
    for name in {"planes", "lenslet_focal_lengths"} & parameters.keys():
        parameters[name] = tuple(parameters[name])
    return PointImages(
        parameters,
        np.array(parameters["planes"]),
        int(parameters["voxels_per_lenslet"]),
        int(parameters["pixels_per_lenslet"]),
        stored,
        file["scales"][()],
        notes,
    )


def _read_fourier(
    file: h5py.File, parameters: Parameters, stored: tuple[np.ndarray[Any, Any], ...]
) -> FourierPointImages:
    images = FourierPointImages(
        parameters,
        np.array(parameters["planes"], np.float64),
        int(parameters["voxels_per_pixel"]),
        float(file.attrs["side"]),
        (int(file.attrs["shape"][0]), int(file.attrs["shape"][1])),
        file["centres"][()],
        float(file.attrs["radius"]),
        stored,
        file["corners"][()],
    )
    planes, lenslets, b = len(images.planes), len(images.centres), images.voxels
    fits = images.centres.shape == (lenslets, 2) and lenslets > 0 and b > 0
    fits = fits and images.corners.shape == (planes, lenslets, 2) and len(stored) == planes
    fits = fits and all(
        p.ndim == 4 and p.shape[:2] == (b * b, lenslets) and p.shape[2] == p.shape[3]
        for p in stored
    )
    if not (fits and min(images.shape) > 0 and images.side > 0 and images.radius > 0):
        raise ValueError("arrays do not fit each other")
    return images


@contextmanager
def _opened(path: Path) -> Iterator[h5py.File]:
    """Open a file of point images; raise FormatError for a damaged file."""
    if not path.is_file():
        raise FileNotFoundError(f"There is no file {path}.")
    try:
        require_heaps(path)
        with h5py.File(path, "r") as file:
            if file.attrs.get("format") not in (FORMAT, CELL_FORMAT, FOURIER):
                raise FormatError(f"{path} contains no point images.")
            require_internal(file, path)
            yield file
    except _DAMAGED as error:
        if isinstance(error, FormatError):
            raise
        raise FormatError(
            f"{path} is not a complete file of point images: it is truncated, damaged or of "
            "another kind; make it again."
        ) from error


def _planes_in(file: h5py.File) -> list[h5py.Dataset]:
    """Return the datasets of the planes, in order."""
    return [file["planes"][name] for name in sorted(file["planes"])]


def _check_memory(path: Path, datasets: Sequence[h5py.Dataset]) -> None:
    """Raise an error for more samples than the file can contain, or the memory."""
    chunks = [math.prod(data.chunks or ()) * data.dtype.itemsize for data in datasets]
    nbytes = sum(data.nbytes for data in datasets)
    if max(nbytes, *chunks) > path.stat().st_size * _MAX_DEFLATE_RATIO + _MAX_SMALL_BYTES:
        raise ValueError(f"{nbytes:,} bytes are declared")
    free = free_memory()
    if nbytes > free:
        raise FormatError(
            f"The point images in {path} need {nbytes:,} bytes of memory, {free:,} are free: make "
            "them for fewer planes, with a larger cut or with store='float16'."
        )


def read_parameters(path: PathLike) -> tuple[Parameters, list[tuple[int, ...]]] | None:
    """Return the parameters and shapes of a file's point images without reading the images."""
    try:
        with _opened(Path(path)) as file:
            shapes = [plane.shape for plane in _planes_in(file)]
            return json.loads(file.attrs["parameters"]), shapes
    except (OSError, FormatError):
        return None


def read_matching(path: PathLike | None, parameters: Parameters) -> AnyImages | None:
    """Return the point images of a file; raise ValueError if its parameters differ.

    Return None if the file does not exist; raise OSError if it could not be written.
    """
    if path is None:
        return None
    if not Path(path).is_file():
        check_writable(path)
        return None
    images = read_point_images(path)
    for name, value in parameters.items():
        saved = images.parameters.get(name)
        if saved != value:
            raise ValueError(
                f"The point images in {path} were made with {_difference(name, saved, value)}: "
                "give another path, or remove the file to make them again."
            )
    return images


def _difference(name: str, saved: Any, expected: Any) -> str:
    """Describe the saved and the expected value; for planes their number or first difference."""
    if name == "planes" and saved is not None:
        if len(saved) != len(expected):
            return f"{len(saved)} planes, not {len(expected)}"
        pairs = enumerate(zip(saved, expected, strict=True))
        number, (saved, expected) = next(pair for pair in pairs if pair[1][0] != pair[1][1])
        name = f"planes[{number}]"
    if isinstance(expected, list | tuple) and len(expected) > 2:
        return f"other {name}"
    return f"{name} = {saved!r}, not {expected!r}"


def digest(images: AnyImages) -> str:
    """Return the SHA-256 of the parameters and of all arrays with their shapes."""
    if isinstance(images, FourierPointImages):
        numbers = np.array([images.side, images.radius, *images.shape], np.float64)
        tables = [numbers, images.centres, images.corners]
    else:
        tables = [images.scales]
    total = hashlib.sha256(json.dumps(images.parameters, sort_keys=True).encode())
    for values in (*tables, *images.stored):
        total.update(str(values.shape).encode())
        total.update(np.ascontiguousarray(values).tobytes())
    return total.hexdigest()
